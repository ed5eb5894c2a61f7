"""Searches on stretches of long records: what they show, and that the whole records decide."""

from dataclasses import replace

import numpy as np
import pytest

from spiral.engine.likelihood.noise import first_noise
from spiral.inference.discover import discover
from spiral.inference.evidence.excerpt import representative_stretches
from spiral.inference.likelihood.excerpts import (
    excerpt_fit,
    excerpt_study,
    search_on_excerpt,
    whole_state,
    whole_study,
)
from spiral.inference.likelihood.fitting import fit_by_likelihood
from spiral.inference.likelihood.noise_selection import select_noise_model, select_sensor_drift
from spiral.inference.problem import Problem, silent
from spiral.types.model import seed_model
from tests.scenes import effect, registry
from tests.swept_oscillator import TRUTH, Oscillator, record_of, relaxed, unfitted

LONG = 24_000


def shown(record):
    assembly, _ = unfitted(record)
    return representative_stretches(assembly.study.series)


@pytest.fixture(scope="module")
def long_record():
    return record_of(1, samples=LONG)


@pytest.fixture(scope="module")
def fitted(long_record):
    assembly, state = unfitted(long_record)
    return assembly, fit_by_likelihood(assembly, state, rough=True)


def test_a_short_record_has_no_excerpt():
    assembly, state = unfitted(record_of(1, samples=3000))
    assert shown(record_of(1, samples=3000)) == ()
    assert excerpt_study(assembly, state) is None


def test_stretches_span_the_energies_of_a_record(long_record):
    """Swept through its resonance: the liveliest stretch and the quietest one are among them."""
    stretches = shown(long_record)
    assert [s.last - s.first for s in stretches] == [2048] * 4
    y = long_record.channels["x"]
    blocks = [np.var(y[k : k + 2048]) for k in range(0, LONG - 2047, 2048)]
    chosen = [np.var(y[s.first : s.last]) for s in stretches]
    assert max(chosen) == pytest.approx(max(blocks))
    assert min(chosen) == pytest.approx(min(blocks))


def test_a_record_whose_level_moves_slowly_has_no_excerpt(long_record):
    """Stretches would not show a level that follows the day."""
    slow = 40 * np.std(long_record.channels["x"]) * np.sin(np.linspace(0, 3, LONG))
    x = long_record.channels["x"] + slow
    assert shown(replace(long_record, channels={"x": x})) == ()


def test_a_stretch_is_predicted_as_within_its_record(fitted):
    """Same values, noise and scales: once its first doubt has gone, innovations are the same."""
    assembly, fit = fitted
    noise = first_noise(fit.estimate.prepared[0][0], 0.3)
    part, state = excerpt_study(assembly, fit.state, fit)
    there = fit_by_likelihood(part, state, noise, steps=0)
    here = fit_by_likelihood(assembly, fit.state, noise, steps=0)
    whole = here.estimate.predictions[0].whitened
    for stretch, prediction in zip(part.excerpt.stretches, there.estimate.predictions, strict=True):
        own = whole[stretch.first + 400 : stretch.last]
        np.testing.assert_allclose(prediction.whitened[400:], own, atol=1e-3)


def test_a_state_goes_to_an_excerpt_and_back(fitted):
    assembly, fit = fitted
    begun = replace(fit.state, starts=(np.array([0.1, -2.0]),), spreads=(np.array([0.3, 0.4]),))
    part, state = excerpt_study(assembly, begun, fit)
    again, study = whole_state(part, state), whole_study(part)
    np.testing.assert_array_equal(again.values, begun.values)
    np.testing.assert_array_equal(again.starts[0], begun.starts[0])
    np.testing.assert_array_equal(again.spreads[0], begun.spreads[0])
    assert study.excerpt is None
    assert study.problem.records == assembly.problem.records
    assert study.study.series == assembly.study.series


def test_an_excerpt_of_an_excerpt_is_none(fitted):
    part, again = excerpt_fit(*fitted)
    assert excerpt_fit(part, again) is None


def test_noise_found_on_an_excerpt_has_the_sizes_that_the_whole_record_gives_it(long_record):
    """AR(1) noise of 0.9: its kind is told by stretches, its size and time by all samples."""
    sigma = 0.02 * np.std(long_record.channels["x"])
    clean = record_of(1, samples=LONG, noise=0.0)
    noise = sigma * relaxed(np.random.default_rng(3), LONG, 0.9)
    record = replace(clean, channels={"x": clean.channels["x"] + noise}, noise={})
    assembly, state = unfitted(record)
    fit = fit_by_likelihood(assembly, state, rough=True)
    result = search_on_excerpt(assembly, fit, lambda a, f: select_noise_model(a, f, silent))
    noise = result.estimate.noise
    assert noise.has_kind("coloured")
    assert noise.values["coloured.x"] == pytest.approx(sigma, rel=0.05)
    assert noise.values["coloured.time"] == pytest.approx(-1 / 200 / np.log(0.9), rel=0.1)
    assert len(result.estimate.predictions[0].misses) == LONG


def test_a_drift_too_slow_for_stretches_is_found_on_the_whole_record(long_record):
    sigma = 0.01 * np.std(long_record.channels["x"])
    rng = np.random.default_rng(4)
    walk = 3 * sigma / np.sqrt(LONG) * np.cumsum(rng.normal(size=LONG))
    clean = record_of(1, samples=LONG, noise=0.0).channels["x"]
    x = clean + walk + sigma * rng.normal(size=LONG)
    assembly, state = unfitted(replace(long_record, channels={"x": x}, noise={}))
    fit = fit_by_likelihood(assembly, state, rough=True)
    result = search_on_excerpt(
        assembly, fit, lambda a, f: select_noise_model(a, f, silent), select_sensor_drift
    )
    size = 3 * sigma / np.sqrt(LONG / 200)
    assert result.estimate.noise.values["drift.x"] == pytest.approx(size, rel=0.25)


def long_problem(effects, values, seed):
    record = record_of(seed, LONG, 0.01, effects, values)
    test = record_of(seed + 1, 4000, 0.01, effects, values)
    model = seed_model(Oscillator(), values=TRUTH)
    offered = tuple(e for e in registry().candidates(model.system) if e.label not in model.labels)
    return Problem(
        model, (record,), (test,), candidates=offered,
        strategy=registry().make("strategy", "likelihood"),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 5])
def test_nothing_is_missing_from_a_long_record_of_the_model_itself(seed):
    run = discover(long_problem((), {}, seed))
    assert run.verdict == "nothing_missing"
    assert len(run.rounds) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("label", "values"),
    [
        ("cubic_stiffness", {"cubic_stiffness.stiffness": 300.0}),
        ("coulomb_friction", {"coulomb_friction.level": 1.0, "coulomb_friction.width": 0.02}),
    ],
)
def test_an_effect_of_a_long_record_is_named_and_fitted_to_all_of_it(label, values):
    told = []
    run = discover(long_problem((effect(label),), values, 1), told.append)
    assert [r.admitted for r in run.rounds[1:]] == [(label,)]
    assert run.verdict == "effect_missing"
    known = run.model.estimates()[label]
    name = next(iter(values)).split(".")[1]
    assert abs(known[name].estimate - next(iter(values.values()))) < 4 * known[name].se
    assert any(t.startswith(f"so far: Missing was {label}") for t in told)


@pytest.mark.slow
def test_a_law_of_a_long_record_is_looked_for_on_stretches_and_fitted_to_all_of_it():
    """The level has the error of all samples: that of an excerpt would be 1.7 times as large."""
    values = {"coulomb_friction.level": 1.0, "coulomb_friction.width": 0.02}
    asked = replace(long_problem((effect("coulomb_friction"),), values, 1), candidates=())
    run = discover(asked)
    law = run.model.estimates()["tanh_friction_law"]["a"]
    assert run.verdict == "effect_missing"
    assert law.se < 0.005
    assert abs(law.estimate - 1.0) < 4 * law.se
