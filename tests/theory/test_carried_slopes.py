"""Slopes by sizes of the noise that a step corrects: Broyden's secant, and the same maximum."""

import numpy as np
import pytest

from spiral.engine.likelihood.fit import _Search, maximise_likelihood
from spiral.engine.likelihood.noise import NoiseTerm, first_noise
from spiral.engine.likelihood.predict import predict_cases
from spiral.engine.likelihood.slope_cache import SlopeCache
from tests.swept_oscillator import record_of, shaken, task_of
from tests.theory.test_likelihood import TERMS

TERM = NoiseTerm("coloured", "x")
MORE = {TERM.size: 0.02, "coloured.time": 0.03}


def begun():
    """Predictions at first sizes of the noise, with slopes made there."""
    prepared = (task_of(shaken(3, 0.3)),)
    noise = first_noise(prepared[0][0], 0.1).with_terms((TERM,), MORE)
    at = maximise_likelihood(prepared, (), noise, steps=0)
    return prepared, noise, _Search(()).with_size_slopes(at)


def slopes_of(cache, name, part):
    """Slopes of the misses themselves, and of log s, by the logarithm of one size."""
    miss, grown = cache.sizes[name][0]
    return miss / part.weight, grown


def test_a_step_foresees_itself_and_leaves_what_lies_across():
    prepared, noise, at = begun()
    step = {"white.x": 0.3, TERM.size: -0.2}
    larger = noise.with_values({n: noise.values[n] * np.exp(b) for n, b in step.items()})
    after = predict_cases([(prepared, larger)])[0]
    kept = at.kept.carried(at.predictions, after, larger, step)
    (old,), (new,) = at.predictions, after
    along = [slopes_of(kept, n, new) for n in step]
    miss, grown = (sum(b * x[i] for b, x in zip(step.values(), along, strict=True)) for i in (0, 1))
    assert miss == pytest.approx(new.misses - old.misses, abs=1e-12)
    assert grown == pytest.approx(np.log(new.spreads / old.spreads), abs=1e-12)
    across = zip((0.2, 0.3), step, strict=True)  # at right angles to the step
    change = sum(
        w * (slopes_of(kept, n, new)[0] - slopes_of(at.kept, n, old)[0]) for w, n in across
    )
    assert change == pytest.approx(np.zeros_like(miss), abs=1e-12)
    assert kept.sizes["force.observed"] is at.kept.sizes["force.observed"]
    assert kept.are_stale(larger, tuple(step), 0.1)  # they were made elsewhere
    assert not kept.are_far(larger, tuple(step), 0.1)


def test_a_step_that_is_too_short_tells_nothing():
    prepared, noise, at = begun()
    after = predict_cases([(prepared, noise)])[0]
    assert at.kept.carried(at.predictions, after, noise, {"white.x": 1e-3}) is at.kept
    assert at.kept.carried(at.predictions, after, noise, {"nothing": 1.0}) is at.kept


def test_noise_is_tuned_as_well_with_fewer_runs_of_the_filter(monkeypatch):
    """From first sizes of nine kinds of noise, with slopes corrected and with slopes made anew."""
    from spiral.engine.likelihood import fit

    prepared, runs, whole, heights = (task_of(record_of(0)),), [], fit.vary_noise, []

    def counted(*given):
        runs[-1] += len(given[3])
        return whole(*given)

    monkeypatch.setattr(fit, "vary_noise", counted)
    for carry in (SlopeCache.carried, lambda cache, *_: cache):
        monkeypatch.setattr(SlopeCache, "carried", carry)
        runs.append(0)
        for terms in TERMS.values():
            noise = first_noise(prepared[0][0], 0.1)
            noise = noise.with_terms(*terms) if terms else noise
            heights.append(maximise_likelihood(prepared, (), noise, rough=True).log_likelihood)
    corrected, anew = np.reshape(heights, (2, -1))
    assert runs[0] < 0.8 * runs[1]
    assert np.mean(corrected - anew) > -0.5  # of 4500; a rough search ends at 0.75 a step


def test_a_size_that_comes_back_from_its_least_value_has_its_slopes_made():
    """It had none when the others were made, and carried on."""
    prepared, noise, at = begun()
    kept = SlopeCache().made_at(noise, {n: x for n, x in at.kept.sizes.items() if n != "white.x"})
    assert kept.are_far(noise, ("white.x",), 0.7)
    assert kept.are_stale(noise, ("white.x",), 0.7)
    step = {TERM.size: 0.3}
    larger = noise.with_values({TERM.size: noise.values[TERM.size] * np.exp(0.3)})
    after = predict_cases([(prepared, larger)])[0]
    assert kept.carried(at.predictions, after, larger, step).are_far(larger, ("white.x",), 0.7)
