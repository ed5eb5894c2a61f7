"""Machines that only an unseen force moves: a bridge in the wind, a tank with an unknown inflow."""

import numpy as np
import pytest

import spiral
from spiral.engine.filter.response import response_scales
from spiral.engine.filter.task import prepare_task
from spiral.inference.nearness import is_free_run_carried_away, is_moved_unseen
from spiral.types.model import seed_model
from spiral.types.record import make_record

RATE, LEVEL = 50, 0.02  # samples/s; of the white acceleration, m/s^1.5


def oscillator(observed=("x",), damping=1.5):
    return spiral.system(
        ["x'' = -k*x - d*x' + g*F"], states={"x": "m"}, inputs={"F": "m/s^2"},
        parameters={"k": "150 1/s^2", "d": f"{damping} 1/s", "g": "1 1"}, observed=list(observed),
    )  # fmt: skip


def storeys():
    return spiral.system(
        [
            "x1'' = -k1*x1 - c*x1' + k2*(x2 - x1) + c*(x2' - x1')",
            "x2'' = -k2*(x2 - x1) - c*(x2' - x1')",
        ],
        states={"x1": "m", "x2": "m"}, free=["k1", "k2", "c"], observed=["x1", "x2"],
        parameters={"k1": "300 1/s^2", "k2": "500 1/s^2", "c": "0.6 1/s"},
    )  # fmt: skip


def shaken(seed, cubic=0.0, seconds=60):
    """(time, x1, x2) of two storeys whose floors a white force shakes; Euler and Maruyama."""
    rng, dt = np.random.default_rng(seed), 1e-3
    x, v, kept = np.zeros(2), np.zeros(2), []
    for _ in range(int(seconds / dt)):
        twist = x[1] - x[0]
        between = 400 * twist + 0.4 * (v[1] - v[0]) + cubic * twist**3
        push = LEVEL * rng.normal(size=2) / np.sqrt(dt)
        a = np.array([-400 * x[0] - 0.4 * v[0] + between, -between]) + push
        v = v + dt * a
        x = x + dt * v
        kept.append(x)
    seen = np.array(kept)[:: round(1 / (RATE * dt))]
    seen = seen + 0.01 * seen.std(axis=0) * rng.normal(size=seen.shape)
    return np.arange(len(seen)) / RATE, *seen.T


def record(system, seed, **settings):
    time, x1, x2 = shaken(seed, **settings)
    return make_record(system, f"{seed}", time, {"x1": x1, "x2": x2}, {})


def series_of(system, values, force=None):
    time = np.arange(len(values)) / RATE
    inputs = {"F": np.zeros(len(time)) if force is None else force}
    channel = system.observed[0]
    return make_record(system, "one", time, {channel: values}, inputs)


def scales_of(system, values):
    task = prepare_task(seed_model(system), series_of(system, values))
    return response_scales(task.compiled, task.values, task.series)


def test_an_oscillator_responds_as_its_stationary_covariance_says():
    """v = w x and a^2 = (w^4 + d^2 w^2) x^2 of a white force, whatever its size."""
    noise = np.random.default_rng(0).normal(size=5000)
    states, rates = scales_of(oscillator(), 0.003 * noise)
    x, w2 = 0.003 * noise.std(), 150.0
    assert states == pytest.approx([x, np.sqrt(w2) * x], rel=1e-9)
    assert rates == pytest.approx([np.sqrt(w2) * x, np.sqrt(w2**2 + 1.5**2 * w2) * x], rel=1e-9)


def test_a_sensor_of_the_acceleration_tells_the_motion():
    noise = np.random.default_rng(0).normal(size=5000)
    states, _ = scales_of(oscillator(observed=["x''"]), noise)
    assert states[0] * np.sqrt(150**2 + 1.5**2 * 150) == pytest.approx(noise.std(), rel=1e-9)


def test_one_without_damping_has_a_response_over_its_record_and_one_that_runs_away_none():
    noise = np.random.default_rng(0).normal(size=5000)
    states, _ = scales_of(oscillator(damping=0.0), noise)
    assert states == pytest.approx(np.array([1, np.sqrt(150)]) * noise.std(), rel=0.02)
    assert scales_of(oscillator(damping=-3.0), noise) is None


def test_what_moves_a_record_is_unseen_where_no_input_does_and_it_lasts():
    system, rng = oscillator(), np.random.default_rng(0)

    def unseen(values, force=None):
        return prepare_task(seed_model(system), series_of(system, values, force)).is_driven_unseen

    noise = rng.normal(size=600)
    assert unseen(noise)
    assert unseen(noise, np.full(600, 2.0))
    assert not unseen(noise, rng.normal(size=600))
    assert not unseen(noise * np.exp(-np.arange(600) / 100))


def test_nothing_is_missing_where_only_the_wind_blows():
    system = storeys()
    run = spiral.discover(
        record(system, 1), system, test=record(system, 2),
        candidates=["cubic_stiffness", "quadratic_damping", "coulomb_friction"],
    )  # fmt: skip
    assert run.verdict == "nothing_missing"
    assert "what moves it, which no input tells" in run.summary
    assert is_moved_unseen(run.final)
    assert is_free_run_carried_away(run.final)
    values, errors = run.model.values, run.model.errors
    for key in ("system.k1", "system.k2"):
        assert abs(values[key] - 400) < 3 * errors[key]


def test_a_spring_that_stiffens_is_found_in_the_wind():
    system = storeys()
    run = spiral.discover(
        record(system, 1, cubic=8e7), system, test=record(system, 2, cubic=8e7),
        candidates=["cubic_stiffness", "quadratic_damping", "coulomb_friction"],
    )  # fmt: skip
    assert run.missing == ("cubic_stiffness@x1_x2",)
    key = "cubic_stiffness@x1_x2.stiffness"
    assert abs(run.model.values[key] - 8e7) < 3 * run.model.errors[key]
