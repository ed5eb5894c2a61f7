"""Speed a little wrong, phase not measured: the smooth phase correction (design, fact 9)."""

from dataclasses import replace

import numpy as np
import pytest

from spiral.inference.compare import compare
from spiral.inference.discover import discover
from spiral.types.record import make_record
from tests.scenes import BRIEF, admitted, coastdown_problem

FEW = (
    "cross_stiffness", "cubic_stiffness", "gyroscopic", "cross_damping", "speed_stiffness",
    "antisymmetric_damping", "coulomb_friction", "quadratic_damping", "quadratic_stiffness",
    "shaft_bow",
)  # fmt: skip
"""What is hidden, and candidates that look like it."""


def _spoiled(record, system, scale: float, noise: float):
    rng = np.random.default_rng(7)
    speed = record.inputs["speed"] * (1 + scale)
    speed = speed + noise * np.abs(speed).max() * rng.normal(size=len(speed))
    return make_record(
        system, record.name, record.time, record.channels, {"speed": speed}, record.noise
    )


def _problem(scale: float, noise: float, fields=None):
    problem = coastdown_problem(11, **(fields or {}))
    system = problem.model.system
    return replace(
        problem,
        records=(_spoiled(problem.records[0], system, scale, noise),),
        test=(_spoiled(problem.test[0], system, scale, noise),),
    )


CASES = [
    pytest.param(1e-3, 0.0, id="scale-1e-3", marks=pytest.mark.slow),
    pytest.param(1e-4, 0.0, id="scale-1e-4", marks=pytest.mark.slow),
    pytest.param(0.0, 2e-3, id="noise-0.2-percent", marks=pytest.mark.slow),
]


@pytest.mark.slow
def test_the_same_effects_are_found_in_a_short_record_with_a_wrong_speed():
    problem = _problem(1e-3, 0.0, BRIEF)
    candidates = tuple(c for c in problem.candidates if c.label in FEW)
    _found(replace(problem, candidates=candidates))


@pytest.mark.parametrize(("scale", "noise"), CASES)
def test_the_same_effects_are_found_under_speed_errors(scale, noise):
    _found(_problem(scale, noise))


def _found(problem):
    run = discover(problem)
    names = admitted(run)
    assert names[:3] == ["cross_stiffness", "cubic_stiffness", "gyroscopic"]
    assert set(names[3:]) <= {"cross_damping", "speed_stiffness"}
    found = run.model.estimates()["gyroscopic"]["coefficient"]
    assert found.estimate == pytest.approx(4.80e-3, rel=0.15)


def test_without_the_correction_a_true_model_does_not_fit():
    problem = _problem(1e-3, 0.0)
    model = problem.model
    for label in ("cross_stiffness", "cubic_stiffness", "gyroscopic", "cross_damping"):
        model = model.add(next(c for c in problem.candidates if c.label == label))
    corrected = compare(replace(problem, model=model))
    plain = compare(
        replace(problem, model=model, settings=replace(problem.settings, phase_knot=0.0))
    )
    assert corrected.chi2_per_dof == pytest.approx(1.0, abs=0.03)
    assert plain.chi2_per_dof > 10
