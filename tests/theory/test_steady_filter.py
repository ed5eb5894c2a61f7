"""Where nothing changes from sample to sample, a stationary covariance gives the same numbers.

The recursion is followed sample by sample where the noise of a reading has a size of its own at
each, even where that is the same at all.
"""

from dataclasses import replace

import numpy as np
import pytest

import spiral
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.noise import NoiseTerm, first_noise
from spiral.engine.likelihood.predict import predict_readings, vary_noise
from spiral.types.model import seed_model
from spiral.types.record import make_record

SAMPLES, DT, GAP = 1200, 0.01, 900
KEYS = ("system.c", "system.k")
EXACT = 1e-9


def _chain(t, x, u, p):
    pull = p.k * (x.a - x.b) + p.c * (x.va - x.vb)
    return {
        "a": x.va, "va": (u.F - p.k * x.a - p.c * x.va - pull) / p.m,
        "b": x.vb, "vb": (pull - u.w * p.k * x.b - p.c * x.vb) / p.m,
    }  # fmt: skip


def _task(gap):
    """Two masses, both measured, an input that stays; ``gap``: one reading is missing."""
    rng = np.random.default_rng(1)
    system = spiral.system(
        _chain, states={"a": "m", "va": "m/s", "b": "m", "vb": "m/s"}, inputs={"F": "N", "w": "1"},
        parameters={"m": (1.0, "kg"), "c": (20.0, "N*s/m"), "k": (400.0, "N/m")},
        observed=["a", "b"], free=["c", "k"],
    )  # fmt: skip
    time = np.arange(SAMPLES) * DT
    read = {n: 1e-3 * np.cumsum(rng.normal(size=SAMPLES)) for n in ("a", "b")}
    given = {"F": rng.normal(size=SAMPLES), "w": np.full(SAMPLES, 1.3)}
    record = make_record(system, "chain", time, read, given)
    model = seed_model(system, values={"system.c": 20.0, "system.k": 400.0})
    task = prepare_task(model, record)
    seen = np.ones((SAMPLES, 2), dtype=bool)
    seen[GAP, 1] = not gap
    return replace(task, series=replace(task.series, seen=seen))


def _followed(task):
    """The same task, its covariance followed at every sample."""
    return replace(task, series=replace(task.series, growth=2 * ((0.0, 1e12, 1.0),)))


def _noise(task):
    """A force at random, noise of a sensor with a past of its own, white noise."""
    noise = first_noise(task, 0.05)
    term = NoiseTerm("coloured", "a")
    return noise.with_terms((term,), {term.size: 1e-3, term.time: 0.05})


def _close(given, expected):
    scale = np.abs(expected).max() or 1.0
    assert np.max(np.abs(given - expected)) <= EXACT * scale


@pytest.fixture(scope="module", params=[False, True], ids=["all read", "a gap"])
def runs(request):
    """(task, settings, noise, run) by the short way and sample by sample."""
    task = _task(request.param)
    both = []
    for one in (task, _followed(task)):
        prepared, settings = prepare_filter(one, ())
        noise = _noise(prepared)
        run = predict_readings(prepared, settings, noise, KEYS, carry=True)
        both.append((prepared, settings, noise, run))
    return both


def test_an_input_that_changes_is_told_from_one_that_stays(runs):
    task = runs[0][0]
    assert task.series.changing_inputs(task.compiled.traced.inputs) == ("F", "time")


@pytest.mark.parametrize(
    "what", ["misses", "spreads", "slopes", "means", "gains", "rows", "transitions"]
)
def test_predictions_are_those_of_the_recursion(runs, what):
    (*_, short), (*_, followed) = runs
    assert short.whole
    _close(getattr(short, what), getattr(followed, what))


def test_variances_do_become_stationary(runs):
    """Else the test above would compare the recursion with itself."""
    (*_, short), _ = runs
    assert np.all(np.ptp(short.spreads[GAP - 100 : GAP], axis=0) == 0.0)


def test_other_noise_along_the_same_motion_does_as_well(runs):
    results = []
    for task, settings, noise, run in runs:
        others = [noise.with_values({n: 1.1 * v}) for n, v in noise.values.items()]
        results.append(vary_noise(task, settings, noise, others, run))
    for short, followed in zip(*results, strict=True):
        for given, expected in zip(short, followed, strict=True):
            _close(given, expected)
