"""Transitions over samples whose slopes are those of an earlier sample are made once."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
import spiral.engine.likelihood.predict as predict
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.alike import (
    FOUND,
    KEPT,
    find_alike,
    keep_transition,
    memory_of_transitions,
)
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import log_likelihood, predict_readings
from spiral.physics.slope_bounds import compile_slope_bounds
from spiral.physics.trace import trace
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.scenes import effect

MASSES = 9
LAWS = {
    "clearance": {"stiffness": 400.0, "gap": 0.02, "width": 1e-4},
    "coulomb_friction": {"level": 0.5, "width": 1e-3},
    "cubic_stiffness": {"stiffness": 2e4},
}


def chain():
    """Nine masses on springs, the first pushed and the last measured."""
    names = [f"x{i}" for i in range(MASSES)]
    rows = {n: [f"k*{n}"] if i == 0 else [] for i, n in enumerate(names)}
    for a, b in pairwise(names):
        rows[a].append(f"k*({a} - {b})")
        rows[b].append(f"k*({b} - {a})")
    rows[names[0]].append("-F")
    return spiral.system({
        "equations": [f"m*{n}'' + c*{n}' + {' + '.join(parts)} = 0" for n, parts in rows.items()],
        "states": dict.fromkeys(names, "m"), "inputs": {"F": "N"},
        "parameters": {"m": "1 kg", "c": "0.4 N*s/m", "k": "300 N/m"}, "free": ["k"],
        "observed": [names[-1]],
    })  # fmt: skip


def task_with(law, substeps=4):
    """The chain with an effect at its first mass, filtered along a record without it."""
    rng = np.random.default_rng(4)
    time = np.arange(600) * 0.02
    push = np.convolve(rng.normal(size=600), np.hanning(15), "same")
    stiff = 300 * (2 * np.eye(MASSES) - np.eye(MASSES, k=1) - np.eye(MASSES, k=-1))
    stiff[-1, -1] = 300

    def rates(t, s):
        force = np.zeros(MASSES)
        force[0] = np.interp(t, time, push)
        return np.concatenate([s[MASSES:], force - 0.4 * s[MASSES:] - stiff @ s[:MASSES]])

    moved = solve_ivp(rates, (0, time[-1]), np.zeros(2 * MASSES), t_eval=time, rtol=1e-8).y
    system = chain()
    values = {"system.m": 1.0, "system.c": 0.4, "system.k": 300.0}
    values |= {f"{law}.{k}": v for k, v in LAWS[law].items()}
    model = seed_model(system, (effect(law),), values=values)
    reading = {system.observed[0]: moved[MASSES - 1] + 1e-3 * rng.normal(size=600)}
    record = make_record(system, "chain", time, reading, {"F": push})
    return prepare_filter(prepare_task(model, record, substeps=substeps, every=True), ())


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("keys", [(), ("system.k", "system.c")])
def test_predictions_are_those_of_transitions_made_anew(law, keys, monkeypatch):
    task, settings = task_with(law)
    noise = first_noise(task, 0.05)
    alike = predict_readings(task, settings, noise, keys, keep=True, carry=True)
    monkeypatch.setattr(predict, "MANY_STATES", 1000)
    anew = predict_readings(task, settings, noise, keys, keep=True, carry=True)
    for name in ("misses", "spreads", "slopes", "means", "transitions"):
        expected = getattr(anew, name)
        size = np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(getattr(alike, name), expected, rtol=0, atol=1e-7 * size)
    assert log_likelihood((alike,)) == pytest.approx(log_likelihood((anew,)), abs=1e-6)


@pytest.mark.parametrize(("law", "constant"), [("clearance", True), ("cubic_stiffness", False)])
def test_slopes_that_vary_over_a_sample_have_their_range(law, constant):
    """Deep in a gap, and beyond it, a spring's slope is one number; a cubic one's is a range."""
    system = chain()
    traced = trace(system, (effect(law),))
    bounds = compile_slope_bounds(traced)
    known = {"system.m": 1.0, "system.c": 0.4, "system.k": 300.0}
    known |= {f"{law}.{k}": v for k, v in LAWS[law].items()}
    p = np.array([known[k] for k in traced.keys])
    inputs = np.zeros((13, len(traced.inputs)))
    found = []
    for place in (0.005, 0.1):
        x = np.zeros(2 * MASSES)
        x[0], x[MASSES] = place, 0.01
        seen = np.array([[np.inf], [-np.inf]])
        assert bounds.count == 1
        _call(bounds.advance, x, inputs, p, seen)
        assert x[0] != place  # it goes on by four steps
        assert (seen[1, 0] - seen[0, 0] < 1e-9 * abs(seen).max()) == constant
        found.append(seen[:, 0])
    inside, beyond = found
    assert beyond[0] < inside[0] - 100


def _call(advance, x, inputs, p, seen):
    import numba as nb

    @nb.njit
    def call(function, x, inputs, p, seen):
        function(x, inputs, 0, 3, 4, 0.001, p, seen)

    call(advance, x, inputs, p, seen)


def test_what_is_kept_is_found_again_and_the_oldest_goes():
    kept, slopes, bounds, counts, _ = memory_of_transitions(2, 1)
    for number in range(KEPT + 1):
        bounds[:2] = 10.0 + number
        assert find_alike(bounds, slopes, counts) == -1
        keep_transition(np.full((2, 2), float(number)), kept, bounds, slopes, counts)
    bounds[:2] = 10.0
    assert find_alike(bounds, slopes, counts) == -1  # four came after it
    bounds[:2] = 10.0 + KEPT
    place = find_alike(bounds, slopes, counts)
    assert kept[place, 0, 0] == KEPT
    assert counts[FOUND] == 1
    bounds[1] += 1e-3
    assert find_alike(bounds, slopes, counts) == -2
    bounds[:2] = np.nan
    assert find_alike(bounds, slopes, counts) == -2
