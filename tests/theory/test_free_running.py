"""Evidence of free runs: independent values, chance, and a candidate that no likelihood tells."""

import numpy as np
import pytest
from scipy.signal import lfilter

from spiral.engine.likelihood.free_misses import (
    free_run_gain,
    free_run_level,
    independent_misses,
)
from spiral.inference.evidence.enlarge import enlarge
from spiral.inference.problem import silent
from spiral.inference.strategies.likelihood.accepted import NOTHING_TRIED
from spiral.inference.strategies.likelihood.free_running import first_to_take_free_run
from spiral.inference.strategy_options import LikelihoodOptions
from tests.swept_oscillator import shaken
from tests.theory.test_free_fit import fitted


def lasting(rng, samples, memory, channels=1):
    noise = rng.normal(size=(channels, samples + 500))
    return lfilter([1.0], [1.0, -memory], noise)[:, 500:].T


@pytest.mark.parametrize("memory", [0.0, 0.8, 0.97])
def test_independent_values_of_misses_that_last(memory):
    """nu = N (1 - phi^2) / (1 + phi^2) of an AR(1); several records add up."""
    rng, samples = np.random.default_rng(1), 4000
    exact = samples * (1 - memory**2) / (1 + memory**2)
    one = np.median([independent_misses([lasting(rng, samples, memory)])[0] for _ in range(20)])
    two = np.median([independent_misses([lasting(rng, samples, memory)] * 2)[0] for _ in range(20)])
    assert 0.6 * exact < one < 1.1 * exact
    assert two == pytest.approx(2 * one, rel=0.1)
    assert independent_misses([np.zeros((50, 2))]).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.98])
def test_chance_is_as_rare_as_it_says(memory):
    """Misses regressed on two unrelated motions that last as long: at most 5 % under 5 %."""
    rng, levels = np.random.default_rng(2), []
    for _ in range(400):
        miss = lasting(rng, 1000, memory)
        slopes = lasting(rng, 1000, memory, 2)
        left = miss - slopes @ np.linalg.lstsq(slopes, miss, rcond=None)[0]
        nu = independent_misses([miss])
        gain = free_run_gain([miss], [left], nu)
        levels.append(free_run_level(gain, float(nu[0]), 0, 2))
    assert np.mean(np.array(levels) < 0.05) < 0.08
    assert np.mean(np.array(levels) < 0.5) > 0.2


def test_as_many_numbers_as_values_are_no_evidence():
    assert free_run_level(50.0, 4.0, 3, 2) == 1.0
    assert free_run_level(0.0, 100.0, 3, 2) == 1.0
    assert free_run_level(20.0, 100.0, 3, 1) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.5, 1.0])
def test_beside_truly_random_forces_no_candidate_passes(level):
    """20 records; what a candidate takes of a free run is chance, before unseen data are asked."""

    def asked(whole):
        raise AssertionError("a candidate passed")

    for seed in range(20):
        assembly, found = fitted(shaken(seed, level))
        assembly = enlarge(assembly, found.state.labels)
        outcome, _ = first_to_take_free_run(
            LikelihoodOptions(), assembly, found, NOTHING_TRIED, 0.01 / 3, asked, silent
        )
        assert outcome.passed is None
        assert all("may be chance" in r for r in outcome.rejected.values())
