"""Values by free runs: left alone beside forces that are random, taken where they are not."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.effects.dissipative import CoulombFriction
from spiral_plugins.strategies.likelihood import Likelihood
from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.likelihood import free_fit
from spiral.inference.likelihood.comparison import compare_by_likelihood
from spiral.inference.likelihood.fitting import fit_by_likelihood, is_random_force_small
from spiral.inference.likelihood.free_fit import (
    FREE_RUN_VALUES_NOTE,
    free_run_sentences,
    refit_by_free_run,
)
from spiral.inference.nearness import shortfalls
from spiral.inference.problem import Settings, silent
from spiral.io.problem_setup import pose_problem
from spiral.io.registry import load_registry
from spiral.types.model import seed_model
from tests.swept_oscillator import TRUTH, record_of, shaken


def fitted(record, test=None):
    seed = seed_model(Oscillator(), values=TRUTH)
    tests = None if test is None else (test,)
    begun = Likelihood().begin(pose_problem(load_registry(), seed, (record,), tests), silent)
    return begun.assembly, fit_by_likelihood(begun.assembly, begun.fit_state)


@pytest.mark.slow
def test_beside_random_forces_the_more_precise_values_stay():
    """Forces of a quarter of the machine's own, in 12 records: efficient values are left alone."""
    kept = []
    for seed in range(12):
        assembly, found = fitted(shaken(seed, 0.25))
        assert not is_random_force_small(found)
        free = refit_by_free_run(assembly, found, silent)
        assert not free_run_sentences(found, free)
        kept.append(free is found)
    assert np.mean(kept) >= 11 / 12


@pytest.mark.slow
def test_standard_errors_of_a_free_run_know_the_random_forces():
    """Mean square of error over standard error in 12 records; by blocks alone it is 42."""
    squares = []
    for seed in range(12):
        assembly, found = fitted(shaken(seed, 0.25))
        free = refit_by_free_run(assembly, found, silent, halves_agree=False).estimate
        if free is not found.estimate:
            squares += [((free.values[k] - TRUTH[k]) / free.errors[k]) ** 2 for k in free.keys]
    assert len(squares) >= 15
    assert 0.2 < np.mean(squares) < 2.0


def test_where_friction_is_missing_a_run_is_predicted_better():
    """A strong dry friction that the model lacks: one-step values are corrected for it."""
    values = {"coulomb_friction.level": 12.0, "coulomb_friction.width": 0.02}
    records = [
        record_of(s, samples=3000, noise=0.01, effects=(CoulombFriction(),), values=values)
        for s in (1, 2)
    ]
    assembly, found = fitted(*records)
    assert not is_random_force_small(found)
    free = refit_by_free_run(assembly, found, silent)
    assert free is not found
    state, told = compare_by_likelihood(assembly, found, silent)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(free_fit, "_BETTER", 0.0)
        _, stepwise = compare_by_likelihood(assembly, found, silent)
    assert told.test_error < 0.9 * stepwise.test_error
    assert FREE_RUN_VALUES_NOTE in told.notes
    assert FREE_RUN_VALUES_NOTE not in stepwise.notes
    assert "the force beside the model is not random" in told.contradictions[0]
    assert any("where the next sample is predicted best" in s for s in shortfalls(told, Settings()))
    (said,) = stepwise.contradictions  # a force that follows the motion is none of chance
    assert said.startswith("the random force on x is no chance")
    assert told.random == stepwise.random  # what is at random is told beside the likeliest values
    assert replace(state, settle=None).values == pytest.approx(found.state.values)
