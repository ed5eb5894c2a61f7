"""What acted at random, as the whole record tells it, and whether it was chance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from spiral_plugins.systems.oscillator import Oscillator

from spiral.engine.likelihood.disturbances import smoothed_forces
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm, noise_matrices
from spiral.engine.likelihood.predict import predict_readings
from spiral.inference.likelihood.exogenous import (
    _acted_on,
    _delayed_curves,
    _explained,
    _largest_within,
    followed_force,
    followed_force_sentences,
)
from spiral.inference.likelihood.fitting import fit_by_likelihood
from spiral.types.model import seed_model
from tests.scenes import effect
from tests.swept_oscillator import record_of, relaxed, shaken, states_alone, task_of, unfitted

WHITE = NoiseModel(
    (NoiseTerm("white", "x"), NoiseTerm("force", "observed")),
    {"white.x": 0.02, "force.observed": 0.05},
)
GUST = WHITE.with_terms((NoiseTerm("gust", "x_rate"),), {"gust.x_rate": 0.1, "gust.time": 0.05})


def test_only_states_on_which_a_force_of_some_size_acts_are_asked():
    """A force that is next to nothing tells the slope of the likelihood, and no force."""
    task, _ = task_of(record_of(1, samples=64, noise=0.02))
    rate = task.states.index("x_rate")
    assert _acted_on(task, WHITE) == [rate]
    assert _acted_on(task, WHITE.with_values({"force.observed": 1e-5})) == []
    assert _acted_on(task, GUST.with_values({"force.observed": 1e-5})) == [rate]


@pytest.mark.parametrize("noise", [WHITE, GUST])
def test_smoothed_forces_are_the_conditional_mean(noise):
    """Of a linear machine E[w | y] = Cov(w, y) Cov(y)^-1 (y - E y), by matrices of the whole."""
    task, settings = task_of(record_of(1, samples=64, noise=0.02))
    parts = noise_matrices(task, settings, noise)
    run = predict_readings(task, settings, noise, keep=True, carry=True)
    count, size, n = len(run.misses), len(parts.q), len(task.states)
    # every w_k and the first state as one vector; x_k and y_k are linear in it
    whole = size * count
    covariance = np.zeros((whole, whole))
    covariance[:size, :size] = parts.p
    for k in range(1, count):
        covariance[k * size :, k * size :][:size, :size] = parts.q
    state, rows = np.zeros((size, whole)), []
    for k in range(count):
        state[:, k * size : (k + 1) * size] += np.eye(size)
        rows.append(run.rows[k] @ state)
        state = run.transitions[k] @ state
    seen = np.concatenate(rows)
    free = task.series.y[:, 0] - states_alone(task, settings)[:, 0]
    spread = seen @ covariance @ seen.T + noise.values["white.x"] ** 2 * np.eye(count)
    told = (covariance @ seen.T @ np.linalg.solve(spread, free)).reshape(count, size)
    expected = np.zeros((count, n))
    z = np.zeros(size - n)
    for k in range(count - 1):
        expected[k] = told[k + 1, :n] + task.series.dt * parts.driven @ z
        z = parts.phi @ z + told[k + 1, n:]
    got = smoothed_forces(task, settings, noise)
    assert got == pytest.approx(expected, rel=1e-6, abs=1e-9 * np.abs(expected).max())


def curves_of(sources):
    return [curve for name, s in sources.items() for curve in _delayed_curves(name, s)]


@pytest.mark.parametrize("keep", [0.0, 0.95, 0.995])
def test_chance_is_called_chance(keep):
    """Of 40 forces that know nothing of the motion, whatever both spectra, none follows it."""
    rng = np.random.default_rng(7)
    for _ in range(40):
        sources = {"u": relaxed(rng, 1500, 0.9), "x": relaxed(rng, 1500, 0.98)}
        assert _explained("v", relaxed(rng, 1500, keep), curves_of(sources), sources) is None


@pytest.mark.parametrize("seed", [7, 8])
def test_what_changes_slowly_is_seldom_taken_for_what_follows_a_ramp(seed):
    """Of a force as slow as the record few shifts are independent: the best of ten is chance.

    A battery that empties, with nothing hidden, was told a flow that follows its charge.
    """
    rng, told = np.random.default_rng(seed), 0
    for _ in range(60):
        ramp = np.cumsum(np.abs(relaxed(rng, 1500, 0.98)) + 0.3)
        sources = {"d": ramp / ramp[-1], "x": relaxed(rng, 1500, 0.998)}
        force = relaxed(rng, 1500, 0.9999)
        told += _explained("v", force, curves_of(sources), sources) is not None
    assert told <= 2


def test_what_switches_late_is_found_with_its_source_and_delay():
    rng = np.random.default_rng(3)
    sources = {"u": relaxed(rng, 3000, 0.9), "x": relaxed(rng, 3000, 0.98)}
    late = np.roll(sources["x"], 8)
    force = np.where(late > 0.5, 1.0, 0.0) + 0.3 * relaxed(rng, 3000, 0.9)
    found = _explained("v", force, curves_of(sources), sources)
    assert found is not None
    assert (found.state, found.source) == ("v", "x")
    assert found.lag == pytest.approx(8, abs=4)
    assert found.share > 0.4


@pytest.mark.parametrize("delay", [0, 40, 120])
def test_an_echo_of_the_motion_is_found_with_its_delay(delay):
    """A narrow motion that returns after many of its periods, beside as much that is random."""
    rng = np.random.default_rng(5)
    noise = rng.normal(size=3000)
    ringing = lfilter([1.0], [1.0, -2 * 0.97 * np.cos(0.3), 0.97**2], noise)
    sources = {"u": noise, "x": ringing}
    force = np.roll(ringing, delay) + ringing.std() * relaxed(rng, 3000, 0.9)
    found = _explained("v", force, curves_of(sources), sources)
    assert (found.source, found.lag) == ("x", pytest.approx(delay, abs=1))


@pytest.mark.parametrize("width", [1, 2, 3, 7, 16, 50])
def test_the_largest_of_the_next_values(width):
    values = np.random.default_rng(width).normal(size=50)
    around = [np.arange(i, i + width) % 50 for i in range(50)]
    expected = [places[np.argmax(values[places])] for places in around]
    assert _largest_within(values, width).tolist() == expected


def fit_beside_force(record, known):
    """The most likely values of the oscillator beside white noise and a white force."""
    assembly, state = unfitted(record)
    return fit_by_likelihood(assembly, replace(state, labels=known), steps=12, rough=True)


def test_a_force_that_stands_in_for_a_spring_is_no_chance_and_one_that_shakes_is():
    labels = seed_model(Oscillator()).labels
    spring = effect("cubic_stiffness")
    values = {"cubic_stiffness.stiffness": 4000.0, "linear_damping.damping": 8.0}
    missing = fit_beside_force(record_of(0, 1500, 0.002, (spring,), values), labels)
    found = followed_force(missing)
    assert found is not None
    assert (found.state, found.source) == ("x_rate", "x")
    (told,) = followed_force_sentences(missing)
    assert told.startswith("the random force on x is no chance")
    random = fit_beside_force(shaken(0, 0.05), labels)
    assert followed_force(random) is None
    assert followed_force_sentences(random) == ()
