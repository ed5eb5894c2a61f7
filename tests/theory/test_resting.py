"""Where a model rests, and the integration steps that stiff models need there."""

import numpy as np
import pytest

import spiral
from spiral.engine import resting
from spiral.engine.filter.task import enough_substeps
from spiral.engine.kernel import trajectories
from spiral.engine.resting import (
    find_rest_state,
    hidden_of_first_order,
    resting_jacobian,
    steps_for_stability,
)
from spiral.engine.series import MOST_SUBSTEPS, prepare_series, stable_steps
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.record import Record

REACTOR = {
    "equations": [
        "n' = (rho + aT*(T - T0) - beta)/Lam*n + lam*c",
        "c' = beta/Lam*n - lam*c",
        "tau*T' = aP*n - (T - T1)",
    ],
    "states": {"n": "1", "c": "1", "T": "K"},
    "inputs": {"rho": "1"},
    "constants": {"T0": "600 K", "T1": "560 K"},
    "parameters": {
        "beta": {"value": 0.0065, "unit": "1"}, "Lam": "1e-3 s", "lam": "0.08 1/s",
        "aT": "-1.2e-4 1/K", "tau": "40 s", "aP": "40 K",
    },
    "observed": ["n", "T"],
}  # fmt: skip
STEP = 20.0  # s between samples, 130 times as long as prompt neutrons live


@pytest.fixture(scope="module")
def reactor():
    system = spiral.system(REACTOR)
    compiled = compile_model(trace(system, ()), ())
    parameters = {f"system.{p.name}": p.start for p in system.parameters}
    return system, compiled, np.array([parameters[k] for k in compiled.traced.keys])


def _record(samples=200):
    time = np.arange(samples) * STEP
    rho = 2e-4 * np.sin(2 * np.pi * time / 900)
    readings = {"n": np.ones(samples), "T": np.full(samples, 600.0)}
    return Record("reactor", time, readings, {"rho": rho})


def test_hidden_states_rest_where_their_rates_vanish(reactor):
    _, compiled, values = reactor
    hidden = hidden_of_first_order(compiled.traced)
    assert [compiled.traced.states[i] for i in hidden] == ["c"]
    start, inputs = np.array([1.1, 0.0, 600.0]), np.zeros(len(compiled.traced.u))
    state = find_rest_state(compiled, values, start, inputs, hidden)
    assert state[1] == pytest.approx(1.1 * 0.0065 / 1e-3 / 0.08, rel=1e-9)
    assert state[[0, 2]] == pytest.approx(start[[0, 2]])


def test_the_rest_state_does_not_depend_on_what_memory_held_before(reactor, monkeypatch):
    """The slopes of a model are written where they are not zero; the others must be zero."""
    _, compiled, values = reactor
    start, inputs = np.array([1.0, 0.0, 600.0]), np.zeros(len(compiled.traced.u))
    clean = find_rest_state(compiled, values, start, inputs, [0, 1, 2])
    monkeypatch.setattr(resting.np, "empty", lambda shape: np.full(shape, 1e9))
    assert find_rest_state(compiled, values, start, inputs, [0, 1, 2]) == pytest.approx(clean)


def test_a_stiff_model_is_integrated_stably(reactor):
    """Prompt neutrons decay 130 times within a sample: at rest (n = 0) nothing shows it."""
    system, compiled, values = reactor
    series = prepare_series(system, _record(), 1)
    steps = steps_for_stability(compiled, values, series)
    assert MOST_SUBSTEPS < steps <= 100
    runs = []
    for count in (steps, 4 * steps):
        series = prepare_series(system, _record(), count)
        states, readings = np.empty((series.samples, 3)), np.empty_like(series.y)
        begin = np.array([[1.0, 81.25, 600.0]])
        assert trajectories(
            compiled.rate_value, compiled.output_value, begin, np.zeros(1, dtype=np.int64),
            np.array([series.samples]), values[None], series.inputs, count, series.dt, states,
            readings,
        )  # fmt: skip
        runs.append(readings)
    assert np.abs(runs[1] - runs[0]).max() < 1e-5 * np.std(runs[1], axis=0).min()


def test_a_stiff_model_is_simulated(reactor):
    time = np.arange(200) * STEP
    rho = 2e-4 * np.sin(2 * np.pi * time / 900)
    start = {"n": 1.0, "c": 81.25, "T": 600.0}
    record = spiral.simulate(reactor[0], 200 * STEP, 1 / STEP, inputs={"rho": rho}, start=start)
    assert 0.5 < record.channels["n"].min() < record.channels["n"].max() < 2.0


@pytest.mark.parametrize("seen", ["x", "level = log(x/s)"])
def test_a_state_that_is_never_zero_asks_for_no_steps_there(seen):
    """x' = a (u s / x - x): at zero its rate is beyond all steps, at its readings it is slow."""
    system = spiral.system(
        ["x' = a*(u*s/x - x)"], states={"x": "kg/m^3"}, inputs={"u": "kg/m^3"}, observed=[seen],
        parameters={"a": "0.05 1/s", "s": "1 kg/m^3"},
    )  # fmt: skip
    compiled = compile_model(trace(system, ()), ())
    time = np.arange(100) * 0.5
    x = 1.4 + 0.6 * np.sin(time)
    channel = seen.split()[0]
    readings = {channel: x if channel == "x" else np.log(x)}
    series = prepare_series(system, Record("r", time, readings, {"u": x**2}), 1)
    assert enough_substeps(compiled, np.array([0.05, 1.0]), series) == 1
    fastest = -resting_jacobian(compiled, np.array([0.05, 1.0]), series)[0, 0]
    where = x.min() if channel == "x" else x.max()  # as it is seen; where it rests
    assert fastest == pytest.approx(0.05 * ((x.max() / where) ** 2 + 1), rel=1e-6)


def test_a_hidden_state_with_a_declared_start_asks_for_no_steps_at_zero():
    """A pressure in a root of a root: without end at zero, slow where it is declared to begin."""
    system = spiral.system(
        ["w' = b*(abs(p/p0)^0.25 - w)", "p' = a*(u - p) - a*p*abs(p/p0)^-0.5"],
        states={"w": "1", "p": {"unit": "Pa", "start": 2e5}}, inputs={"u": "Pa"}, observed=["w"],
        parameters={"a": "2 1/s", "b": "1 1/s", "p0": "1e5 Pa"},
    )  # fmt: skip
    compiled = compile_model(trace(system, ()), ())
    time = np.arange(100) * 0.02
    record = Record("r", time, {"w": 1.1 + 0.05 * np.sin(time)}, {"u": np.full(100, 3e5)})
    series = prepare_series(system, record, 1)
    given = {"system.a": 2.0, "system.b": 1.0, "system.p0": 1e5}
    values = np.array([given[k] for k in compiled.traced.keys])
    assert enough_substeps(compiled, values, series) == 1
    matrix = resting_jacobian(compiled, values, series)
    place = compiled.traced.states.index("p")
    slope = -2.0 * (1 + 0.5 * 2.0**-0.5)
    assert matrix[place, place] == pytest.approx(slope, rel=1e-6)


def test_steps_for_stability_are_those_of_decay_and_swing_not_of_growth():
    assert stable_steps(np.array([-6.5]), 20.0) == 65
    assert stable_steps(np.array([100j, -100j]), 1.0) == 50
    assert stable_steps(np.array([86.0, -0.1]), 20.0) == 1  # what grows is not stable in any step
