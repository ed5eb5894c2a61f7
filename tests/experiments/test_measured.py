"""Measured records: what is found, and the error on the test record, where the data are there."""

import os
from pathlib import Path

import numpy as np
import pytest

from experiments.measured import problem_of, scored
from experiments.rk4_rotor_runup import sweep
from spiral.inference.compare import compare
from spiral.inference.discover import discover

DATA = os.environ.get("SPIRAL_DATA")


def needs(file: str):
    return pytest.mark.skipif(
        not DATA or not (Path(DATA or ".") / file).exists(), reason=f"{file} is not in SPIRAL_DATA"
    )


@needs("cascaded_tanks/dataBenchmark.csv")
@pytest.mark.slow
def test_the_tanks_name_the_overflow_first():
    """One round: the seed near 0.70 V, the overflow on half of the record near 0.54 V."""
    problem = problem_of("cascaded_tanks", ("settings.max_rounds=1", "strategy=shooting"))
    seed, first = scored(problem, discover(problem))
    assert seed.all == pytest.approx(0.70, abs=0.02)
    assert first.admitted == ("overflow",)
    assert first.all < 0.56


@needs("cascaded_tanks/dataBenchmark.csv")
def test_the_overflow_of_the_measured_tanks_is_named():
    """By the likelihood, first; then what bends the free run, at most 0.36 V; more is missing."""
    problem = problem_of("cascaded_tanks", ("settings.max_rounds=2",))
    result = discover(problem)
    assert result.missing[0] == "overflow"
    assert len(result.missing) == 2
    assert "More is missing" in result.summary
    assert result.rounds[1].comparison.test_error < 0.28
    assert result.rounds[-1].comparison.test_error < 0.18
    assert scored(problem, result)[-1].all < 0.36
    assert 7 < result.model.values["overflow.rim"] < 12


@needs("multiarm_pendulum/SinglePendulumDataForParameterEstimation.mat")
def test_the_pendulum_needs_dry_friction_and_drag_together():
    """Neither alone helps on the smaller swings of the test; the pair halves the error and more."""
    words = "effect=[{}]", "values={{coulomb_friction.width: 0.05}}"
    windows = ("strategy=shooting",)
    dry, drag = "coulomb_friction", "quadratic_damping"

    def error(*effects):
        given = [words[0].format(",".join(effects))]
        given += [words[1].format()] if dry in effects else []
        return compare(problem_of("multiarm_pendulum", (*given, *windows))).test_error

    seed = compare(problem_of("multiarm_pendulum", windows)).test_error
    assert seed == pytest.approx(0.083, abs=0.002)
    assert min(error(dry), error(drag)) > 0.99 * seed
    assert error(dry, drag) < 0.4 * seed


@needs("rk4_rotor_runup/runup_1x_1037_2615rpm.csv")
def test_the_run_up_is_a_sweep_of_two_axes():
    """Beats where the measured amplitude has them; steady speeds have none and move the mode."""
    problem = problem_of(sweep.PRESET, (sweep.WHOLE,))
    record = problem.test[0]
    still, one = sweep.steady(record), sweep.swept(problem, "one mode")
    pair, words = sweep.two_axes(record)
    assert still.critical - one.critical > 50
    assert len(sweep.beats(record, still.slow)) == 0
    left = [np.sqrt(np.mean(np.abs(r.slow - sweep.measured(record)) ** 2)) for r in (one, pair)]
    assert left[1] < 0.5 * left[0] < 1.0
    seen = sweep.beats(record, sweep.measured(record))
    np.testing.assert_allclose(sweep.beats(record, pair.slow)[:8], seen[:8], atol=9)
    assert "-84 degrees" in words
