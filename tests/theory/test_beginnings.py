"""Where records begin, and what a filter's likelihood is worth that begins near there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from spiral_plugins.effects.memory import HiddenStore
from spiral_plugins.effects.sensors import SensorLag

import spiral
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task, with_start_spread
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import log_likelihood, predict_readings
from spiral.inference.evidence.enlarge import reorder_starts
from spiral.inference.likelihood.initial_states import (
    likely_initial_state,
    set_likely_initial_state,
)
from spiral.physics.trace import trace
from spiral.types.record import make_record

DT, COUNT, NOISE = 0.02, 200, 0.02
BEGUN = (0.0, 0.3)


def machine(cubic):
    """A sensor x that follows a hidden z by a spring that stiffens; z decays."""

    def rhs(t, x, u, p):
        return [p.rate * (x.z + p.cubic * x.z**3 - x.x), p.rate * (u.force - x.z)]

    return spiral.system(
        rhs, states={"x": "1", "z": "1"}, inputs={"force": "1"},
        parameters={"cubic": (cubic, "1"), "rate": (1.0, "1/s")}, observed=["x"],
    )  # fmt: skip


def task_of(cubic, seed=0):
    """A record that begins with z of 0.3, and the filter's task for it."""
    system = machine(cubic)
    rng, time = np.random.default_rng(seed), DT * np.arange(COUNT)
    force = np.sin(2 * time) + 0.5 * np.cos(5 * time)
    run = solve_ivp(
        lambda t, x: [-x[0] + x[1] + cubic * x[1] ** 3, CubicSpline(time, force)(t) - x[1]],
        (0, time[-1]), BEGUN, t_eval=time, rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    x = run.y[0] + NOISE * rng.normal(size=COUNT)
    record = make_record(system, "near", time, {"x": x}, {"force": force}, {"x": NOISE})
    task = prepare_task(spiral.Model(system, ()), record)
    noise = first_noise(task, 1e-6)
    return task, noise.with_values({n: NOISE for n in noise.values if n.startswith("white")})


def height(task, noise):
    return log_likelihood((predict_readings(*prepare_filter(task, (), {}), noise),))


def integral(task, noise):
    """log of the integral of p(y | x0) over first states, which may be anywhere of the motion."""
    grid = [b + w * np.linspace(-1, 1, 61) for b, w in zip(BEGUN, (0.05, 0.1), strict=True)]
    tiny = np.full(2, 1e-9)
    each = np.array(
        [
            [
                height(with_start_spread(replace(task, start=np.array([x, z])), tiny), noise)
                for z in grid[1]
            ]
            for x in grid[0]
        ]
    )
    each -= np.log(tiny / task.scales).sum()  # p(y | x0) itself
    steps = [g[1] - g[0] for g in grid]
    area = np.exp(each - each.max()).sum() * np.prod(steps)
    return each.max() + np.log(area) - np.log(2 * np.pi * task.scales.prod())


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_the_likelihood_is_the_integral_over_first_states(seed):
    """By brute force, from wherever the search begins.

    The filter that begins anywhere is misled where the machine is not linear.
    """
    task, noise = task_of(cubic=8.0, seed=seed)
    exact, wide, near = integral(task, noise), [], []
    for z in (-1.0, 0.0, 1.0, 2.0):
        begun = replace(task, start=np.array([0.0, z]))
        wide.append(height(begun, noise))
        near.append(height(set_likely_initial_state(begun, noise), noise))
    np.testing.assert_allclose(near, exact, atol=0.6)
    assert np.min(wide) < exact - 20


def test_a_linear_machine_begins_as_ever():
    task, noise = task_of(cubic=0.0)
    begun = likely_initial_state(task, noise)
    assert begun.start is task.start
    near = with_start_spread(replace(task, start=np.array(BEGUN)), np.array([0.2, 0.4]))
    wide = with_start_spread(near, None)
    assert height(near, noise) == pytest.approx(height(wide, noise), abs=0.1)


ROOM = spiral.system(
    ["C*T' = P - G*(T - Tw)", "W*Tw' = G*(T - Tw) - H*(Tw - To)"],
    states={"T": "K", "Tw": {"unit": "K", "start": 285}}, observed=["T"],
    inputs={"P": {"unit": "W", "interpolation": "zero_order"}, "To": "K"},
    parameters={"C": "5e5 J/K", "W": "6e6 J/K", "G": "120 W/K", "H": "30 W/K"}, free=["C", "G"],
)  # fmt: skip


def test_states_that_an_effect_brings_begin_as_declared_beside_states_that_were_smoothed():
    """A store beside a room at 293 K began at 0 K, and was no candidate any more."""
    rng, count, step = np.random.default_rng(0), 1200, 600.0
    power = 1200.0 * (rng.normal(size=count // 12).repeat(12) > 0)
    outside = 278 + 5 * np.sin(2 * np.pi * step * np.arange(count) / 86400)

    def rates(t, x):
        row = min(int(t / step + 1e-9), count - 1)
        room, wall, store = x
        beside = 75 * (room - store)
        flows = [power[row] - 70 * (room - wall) - beside,
                 70 * (room - wall) - 30 * (wall - outside[row]), beside]  # fmt: skip
        return np.divide(flows, [6.2e5, 6e6, 1.5e6])

    states = [np.array([293.0, 284.0, 293.0])]
    for k in range(count - 1):
        states.append(solve_ivp(rates, (k * step, (k + 1) * step), states[-1], rtol=1e-9).y[:, -1])
    seen = np.array(states)[:, 0] + 0.03 * rng.normal(size=count)
    data = {"t": step * np.arange(count), "T": seen, "P": power, "To": outside}
    record = spiral.read(data, ROOM, time="t", units={"T": "K", "To": "K"}, hold={"To": "linear"})
    run = spiral.discover(record, ROOM, candidates=["hidden_store", "linear_loss"], progress=False)
    assert run.missing == ("hidden_store@T",)
    found = run.estimates().loc["hidden_store@T"]["estimate"]
    assert found["rate"] == pytest.approx(75 / 6.2e5, rel=0.1)
    assert found["time_constant"] == pytest.approx(1.5e6 / 75, rel=0.1)


def test_new_states_take_what_they_are_like_at_the_first_sample():
    series = SimpleNamespace(inputs=np.array([[7.0, 278.0]]), y=np.array([[293.5]]))
    traced = trace(ROOM, (HiddenStore(port="T"), SensorLag()))
    before = ("T", "Tw")
    (start,) = reorder_starts((np.array([293.0, 284.0]),), before, traced, (series,))
    begun = dict(zip(traced.states, start, strict=True))
    assert begun["T"] == begun["hidden_store@T.level"] == 293.0
    assert begun["Tw"] == 284.0
    assert begun["sensor_lag.level"] == 293.0
    assert reorder_starts(None, before, traced, (series,)) is None
