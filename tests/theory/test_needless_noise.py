"""Noise terms that do nothing: they cost no states, go one by one, and start no search anew."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.engine.likelihood.fit import maximise_likelihood
from spiral.engine.likelihood.noise import NoiseTerm, first_noise, noise_matrices, size_limits
from spiral.engine.likelihood.predict import total_log_likelihood
from spiral.inference.likelihood import seed_fit
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    fit_by_likelihood,
    is_uncorrected_motion_right,
    with_estimate,
)
from spiral.inference.likelihood.needless_noise import drop_needless_noise
from spiral.inference.likelihood.seed_fit import (
    restart_from_given_values,
    restart_from_sensor_noise,
)
from spiral.inference.problem import silent
from spiral.inference.simulate import simulate
from spiral.types.model import seed_model
from tests.scenes import registry
from tests.swept_oscillator import RATE, TRUTH, record_of, relaxed, task_of, unfitted

LIMIT, LASTING = 2.0, 40


def pushed(seed, size, samples=1500):
    """An oscillator beside whose force one acts that lasts 40 samples and that nobody records."""
    rng, time = np.random.default_rng(seed), np.arange(samples) / RATE
    hidden = relaxed(rng, samples, np.exp(-1 / LASTING))
    force = 30 * np.sin(2 * np.pi * (1 + 3 * time / time[-1]) * time)
    model = seed_model(Oscillator(), values=TRUTH)
    record = simulate(model, time, {"force": force + size * hidden}, 0.01, rng)
    return replace(record, inputs={"force": force})


@pytest.mark.parametrize(
    ("kind", "where"), [("gust", "observed"), ("coloured", "x"), ("drift", "x")]
)
def test_a_term_at_its_least_size_has_no_states(kind, where):
    """And the likelihood is that of the noise without it."""
    task, settings = task_of(record_of(0))
    plain, term = first_noise(task, 0.1), NoiseTerm(kind, where)
    values = {term.time: 0.05} if term.time else {}
    least = plain.with_terms((term,), {term.size: size_limits(task, term.size)[0], **values})
    more = least.with_values({term.size: 1.001 * least.values[term.size]})
    assert noise_matrices(task, settings, least).phi.size == 0
    assert noise_matrices(task, settings, more).phi.size > 0
    heights = [total_log_likelihood(((task, settings),), n) for n in (plain, least, more)]
    np.testing.assert_allclose(heights, heights[0], atol=1e-3)


def test_one_of_two_forces_goes_that_does_nothing():
    """The kind is worth its penalty, one of its terms is not."""
    assembly, state = unfitted(pushed(1, 8.0))
    fit = fit_by_likelihood(assembly, state)
    terms = (NoiseTerm("gust", "x_rate"), NoiseTerm("gust", "x"))
    sizes = {"gust.x_rate": 0.1, "gust.x": 2e-5, "gust.time": LASTING / RATE}
    noise = fit.estimate.noise.with_terms(terms, sizes)
    both = fit_by_likelihood(assembly, fit.state, noise)
    assert both.log_likelihood > fit.log_likelihood + 10
    less = drop_needless_noise(assembly, both, silent)
    assert [t.size for t in less.estimate.noise.terms if t.kind == "gust"] == ["gust.x_rate"]
    assert less.log_likelihood > both.log_likelihood - 0.5 * np.log(1500)


@pytest.mark.parametrize(("cubic", "right"), [(0.0, True), (4e5, False)])
def test_motion_is_right_where_nothing_has_to_correct_it(cubic, right):
    """A spring that is missing is followed by a random force, one sample ahead as well as ever."""
    effects = (registry().effect_from_label("cubic_stiffness", {}),) if cubic else ()
    values = {"cubic_stiffness.stiffness": cubic} if cubic else {}
    assembly, state = unfitted(record_of(2, effects=effects, values=values, noise=0.01))
    fit = fit_by_likelihood(assembly, state)
    assert fit.estimate.finite
    assert is_uncorrected_motion_right(fit, LIMIT) == right


def test_coloured_noise_may_hide_motion():
    """Noise that is predicted from its past is larger than what is missed one sample ahead."""
    rng, record = np.random.default_rng(4), record_of(4, noise=0.0)
    own, spread = relaxed(rng, record.samples, 0.95), np.std(record.channels["x"])
    assembly, state = unfitted(
        replace(record, channels={"x": record.channels["x"] + 0.05 * spread * own})
    )
    term = NoiseTerm("coloured", "x")
    task = fit_by_likelihood(assembly, state, steps=0).estimate.prepared[0][0]
    noise = first_noise(task, 0.0).with_terms(
        (term,), {term.size: 0.05 * spread, term.time: 20 / RATE}
    )
    fit = fit_by_likelihood(assembly, state, noise)
    assert not is_uncorrected_motion_right(fit, LIMIT)


def test_a_start_that_ends_at_the_same_values_selects_no_noise_anew(monkeypatch):
    """From given values near by; and it does where the fit stands somewhere else."""
    given = {"system.mass": 1.05, "linear_stiffness.stiffness": 410.0}
    assembly, state = unfitted(pushed(1, 8.0), given)
    sizes = {"gust.x_rate": 0.1, "gust.time": LASTING / RATE}
    first = fit_by_likelihood(assembly, state)
    noise = first.estimate.noise.with_terms((NoiseTerm("gust", "x_rate"),), sizes)
    fit, asked = fit_by_likelihood(assembly, first.state, noise), []
    monkeypatch.setattr(
        seed_fit, "select_noise_model", lambda _, again, __: asked.append(again) or again
    )
    restart_from_given_values(assembly, fit, silent)
    assert asked == []
    prepared = tuple(
        (t.with_values({"linear_stiffness.stiffness": 480.0}), s) for t, s in fit.estimate.prepared
    )
    off = maximise_likelihood(prepared, fit.estimate.keys, noise, steps=1)
    off = replace(off, prepared=prepared)
    restart_from_given_values(assembly, LikelihoodFit(with_estimate(fit.state, off), off), silent)
    assert len(asked) == 1


def test_a_restart_that_ends_where_the_noise_was_selected_selects_it_no_more(monkeypatch):
    """And it does where the fit that it was selected from had other noise, or where none is."""
    assembly, state = unfitted(pushed(1, 8.0))
    begun = fit_by_likelihood(assembly, state)
    sizes = {"gust.x_rate": 0.1, "gust.time": LASTING / RATE}
    noise = begun.estimate.noise.with_terms((NoiseTerm("gust", "x_rate"),), sizes)
    fit, asked = fit_by_likelihood(assembly, begun.state, noise, steps=1), []
    monkeypatch.setattr(seed_fit, "is_noise_settled", lambda *_: False)
    monkeypatch.setattr(seed_fit, "is_white", lambda *_: False)
    monkeypatch.setattr(
        seed_fit, "select_noise_model", lambda _, again, __: asked.append(again) or again
    )
    assert restart_from_sensor_noise(assembly, fit, silent, begun) is fit
    assert asked == []
    other = begun.estimate.noise.with_values({"force.observed": 0.5})
    elsewhere = fit_by_likelihood(assembly, begun.state, other, steps=0)
    restart_from_sensor_noise(assembly, fit, silent, elsewhere)
    restart_from_sensor_noise(assembly, fit, silent)
    assert len(asked) == 2
