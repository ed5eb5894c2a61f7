"""Calibration on whole records, hidden states free: unbiased, with errors that mean something."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from experiments.hidden_states import several_records
from experiments.hidden_states.several_records import MACHINE
from spiral.inference.problem import Problem
from spiral.inference.reconstruction.calibrate import calibrate, cramer_rao
from spiral.inference.simulate import with_defaults
from spiral.types.model import seed_model

SYSTEM = TiltingRotor()
TRUE = with_defaults(seed_model(SYSTEM))
BEARINGS = tuple(k for k in TRUE.values if "@bearing" in k)


def records(count=1, duration=14.0, **fields):
    source = RotorCoastdown(duration=duration, **fields)
    return tuple(replace(source, seed=s).load(SYSTEM)[0] for s in range(1, count + 1))


def calibrated(share, seed, given, together=()):
    """From a model whose bearing parameters are each wrong by the share, with random signs."""
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), len(BEARINGS))
    if together:
        signs[:] = 1.0
    wrong = {k: TRUE.values[k] * (1 + share * s) for k, s in zip(BEARINGS, signs, strict=True)}
    model = replace(TRUE, values={**TRUE.values, **wrong})
    return calibrate(Problem(model, given, ()), together=together)


@pytest.mark.slow
def test_the_deeper_of_two_valleys_is_found():
    """Bearings that differ can share a stiffness in two ways; from 10 % off both are reached."""
    seed, duration = 1, 7.0
    signs = np.random.default_rng([seed, 7]).choice((-1.0, 1.0), len(BEARINGS))
    wrong = {k: MACHINE.values[k] * (1 + 0.1 * s) for k, s in zip(BEARINGS, signs, strict=True)}
    given = several_records.records(1000 * seed, 1, duration)
    found = calibrate(Problem(replace(MACHINE, values={**MACHINE.values, **wrong}), given, ()))
    bound = cramer_rao(Problem(MACHINE, given, ()))
    z = [(found.model.values[k] - MACHINE.values[k]) / bound[k] for k in BEARINGS]
    assert max(map(abs, z)) < 4
    assert np.sqrt(np.mean(np.square(z))) < 1.6


@pytest.mark.slow
def test_every_bearing_parameter_comes_back_from_ten_percent_off():
    found = calibrated(0.1, 1, records())
    assert found.converged
    assert found.horizon == 14_000
    bound = cramer_rao(Problem(TRUE, records(), ()))
    z = {k: (found.model.values[k] - TRUE.values[k]) / bound[k] for k in found.model.errors}
    assert set(BEARINGS) < set(z)
    assert max(map(abs, z.values())) < 3
    assert np.sqrt(np.mean(np.square(list(z.values())))) < 1.5
    untold = {"cross_damping@bearing_1.damping", "cross_damping@bearing_2.damping"}
    assert untold <= set(found.untold)  # what the record does not tell is said
    assert "linear_stiffness@bearing_1.stiffness_x" not in found.untold


@pytest.mark.slow
def test_one_common_factor_is_found_a_hundred_times_better():
    found = calibrated(0.2, 1, records(), together=BEARINGS)
    factors = np.array([found.model.values[k] / TRUE.values[k] for k in BEARINGS])
    assert np.ptp(factors) < 1e-12  # ratios kept
    assert abs(factors[0] - 1) < 2e-3


@pytest.mark.slow
def test_records_whose_phase_is_measured_share_one_origin():
    """Each record's filter finds its own to start from; a shared column would keep them apart."""
    found = calibrated(0.2, 1, records(2, 7.0), together=BEARINGS)
    origins = [m.values["system.phase_origin"] for m in found.models]
    assert origins[0] == origins[1]
    bound = cramer_rao(Problem(TRUE, records(2, 7.0), ()))["system.phase_origin"]
    assert abs(origins[0] - TRUE.values["system.phase_origin"]) < 3 * bound


def test_bound_is_that_of_the_design_and_falls_with_records():
    """Design, fact 7; four records of equal length halve every standard error."""
    one, four = (cramer_rao(Problem(TRUE, records(n), ())) for n in (1, 4))
    share = {k: one[k] / TRUE.values[k] for k in BEARINGS}
    assert share["linear_stiffness@bearing_1.stiffness_x"] == pytest.approx(0.0126, rel=0.05)
    assert share["cross_stiffness@bearing_1.stiffness"] == pytest.approx(0.08, rel=0.05)
    assert share["cubic_stiffness@bearing_1.stiffness"] == pytest.approx(0.035, rel=0.05)
    assert 0.17 < share["linear_damping@bearing_1.damping_x"] < 0.36
    assert share["cross_damping@bearing_1.damping"] > 5
    assert all(one[k] / four[k] == pytest.approx(2.0, rel=0.01) for k in BEARINGS)
