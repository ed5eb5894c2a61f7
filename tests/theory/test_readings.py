"""Sensors that report no state: accelerations, forces and distances, by formulas of states."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
import yaml
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import multivariate_normal
from spiral_plugins.effects.restoring import ConstantLoad, CubicStiffness
from spiral_plugins.effects.sensors import Delay, Gain

import spiral
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm
from spiral.engine.likelihood.predict import log_likelihood, predict_readings
from spiral.engine.series import prepare_series
from spiral.engine.start import smoothed_motion
from spiral.engine.study import CompiledStudy
from spiral.inference.likelihood.scores import predicted_motion
from spiral.io.readers.dialect import is_unit
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.testing import check_system, failed
from spiral.physics.compile import compile_model
from spiral.physics.signatures import SystemMotion, port_motion_along, signatures
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError, SpiralError
from spiral.types.model import seed_model
from spiral.types.parameter import Input, State
from spiral.types.record import make_record
from spiral.types.system import System
from spiral.types.units import factor

TWO = {
    "equations": [
        "m*x'' + c*x' + k*x + q*(x - z) = F",
        "n*z'' + d*z' + q*(z - x) = 0",
    ],
    "states": {"x": "m", "z": "m"},
    "inputs": {"F": "N"},
    "parameters": {
        "m": "2 kg", "n": "1 kg", "c": "3 N*s/m", "d": "2 N*s/m", "k": "2000 N/m", "q": "1500 N/m",
    },
    "free": ["c", "k"],
    "observed": ["z", "x''", "mount = q*(x - z)"],
}  # fmt: skip
ONE = {
    "equations": ["m*x'' + c*x' + k*x = F"],
    "states": {"x": "m"},
    "inputs": {"F": {"unit": "N", "interpolation": "zero_order"}},
    "parameters": {"m": "1 kg", "c": "4 N*s/m", "k": "4000 N/m"},
    "free": ["c", "k"],
    "observed": ["a = x''"],
}
VALUES = {"system.c": 4.0, "system.k": 4000.0}


def equations(given, **changed):
    text = yaml.safe_dump({**given, **changed})
    return load_registry(NO_FOLDER).make("system", "equations", {"text": text})


def test_channels_may_be_accelerations_and_formulas_with_units_of_their_own():
    system = equations(TWO)
    assert system.observed == ("z", "x_acceleration", "mount")
    assert [system.unit_of(c) for c in system.observed] == ["m", "m/s^2", "N"]
    traced = trace(system, ())
    x = {"x": 0.01, "z": -0.02, "x_rate": 0.3, "z_rate": 0.5}
    symbols = {**dict(zip(traced.x, (x[n] for n in traced.states), strict=True)), traced.u[0]: 7.0}
    known = {**{p.name: p.start for p in system.parameters}, "c": 3.0, "k": 2000.0}
    symbols |= dict(zip(traced.p, (known[k.split(".")[1]] for k in traced.keys), strict=True))
    told = [float(e.subs(symbols)) for e in traced.output]
    own = (7.0 - 3 * 0.3 - 2000 * 0.01 - 1500 * 0.03) / 2
    assert told == pytest.approx([-0.02, own, 1500 * 0.03])
    assert not failed(check_system(system))


@pytest.mark.parametrize(
    ("observed", "said"),
    [
        (["k*x"], "load = k*x"),
        (["load = k*y"], "'y', which is not declared"),
        (["load = k*x + c*x"], "observed: load = k*x + c*x"),
        (["x = k*x"], "twice"),
        (["1a = x''"], "letters, digits"),
    ],
)
def test_a_formula_that_is_none_is_refused_with_its_place(observed, said):
    with pytest.raises(ConfigError, match=re.escape(said)):
        equations(TWO, observed=observed)


@pytest.mark.parametrize(
    ("formula", "unit"),
    [
        ("yield_*mu*S/(Ks + S)*X", "kg/m^3/s"),
        ("X*sqrt(S/(Ks + S))", "kg/m^3"),
        ("abs(S - X)*mu", "kg/m^3/s"),
        ("1/(Ks + S)", "m^3/kg"),
    ],
)
def test_a_formula_has_the_unit_that_follows_also_of_a_sum_under_a_quotient(formula, unit):
    system = equations({
        "equations": ["X' = mu*S/(Ks + S)*X - D*X", "S' = -yield_*mu*S/(Ks + S)*X + D*(F - S)"],
        "states": {"X": "kg/m^3", "S": "kg/m^3"}, "inputs": {"D": "1/s", "F": "kg/m^3"},
        "parameters": {"mu": "1e-4 1/s", "Ks": "1.2 kg/m^3", "yield_": "2 1"},
        "observed": [f"r = {formula}"],
    })  # fmt: skip
    assert system.unit_of("r") == unit


def test_a_rate_of_first_order_is_a_reading():
    system = equations({
        "equations": ["C*T' = P - h*T"], "states": {"T": "K"}, "inputs": {"P": "W"},
        "parameters": {"C": "50 J/K", "h": "0.5 W/K"}, "observed": ["T'"],
    })  # fmt: skip
    assert system.observed == ("T_rate",)
    assert system.unit_of("T_rate") == "K/s"
    with pytest.raises(ConfigError, match="of a coordinate"):
        equations({
            "equations": ["C*T' = P - h*T"], "states": {"T": "K"}, "inputs": {"P": "W"},
            "parameters": {"C": "50 J/K", "h": "0.5 W/K"}, "observed": ["T''"],
        })  # fmt: skip


def accelerations(samples=400, kick=0.0, seed=0):
    """A mass on a spring, force and kicks held between samples: solved exactly."""
    dt, rng = 0.002, np.random.default_rng(seed)
    a = np.array([[0.0, 1.0], [-4000.0, -4.0]])
    flow = expm(np.block([[a, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]) * dt)
    time = dt * np.arange(samples)
    pushed = 20 * np.sin(2 * np.pi * (3 + 4 * time) * time)
    acting = pushed + kick * rng.normal(size=samples)
    x, found = np.zeros(2), np.empty((samples, 3))
    for k in range(samples):
        found[k] = [*x, a[1] @ x + acting[k]]
        x = flow[:2, :2] @ x + flow[:2, 2] * acting[k]
    return time, pushed, found


def record_of(system, time, force, told, noise=0.02, seed=1):
    noisy = told + noise * told.std() * np.random.default_rng(seed).normal(size=len(told))
    return make_record(system, "shaken", time, {"a": noisy}, {"F": force})


def test_a_random_force_reaches_an_accelerometer_at_once():
    """A linear machine's readings are jointly Gaussian: a held force moves them at once."""
    system = equations(ONE)
    time, force, states = accelerations(samples=64)
    record = record_of(system, time, force, states[:, 2])
    task, settings = prepare_filter(
        prepare_task(seed_model(system, values=VALUES), record, substeps=16), ()
    )
    values = {"white.a": 0.3, "force.observed": 0.5}
    noise = NoiseModel((NoiseTerm("white", "a"), NoiseTerm("force", "observed")), values)
    found = log_likelihood([predict_readings(task, settings, noise)])
    spread = 0.5 * np.sqrt(task.scales[1] * task.rates[1] / task.series.dt)
    count, dt = len(time), task.series.dt
    a = np.array([[0.0, 1.0], [-4000.0, -4.0]])
    whole = expm(np.block([[a, np.array([[0.0], [1.0]])], [np.zeros((1, 3))]]) * dt)
    flow, push, row = whole[:2, :2], whole[:2, 2], a[1]
    by_start, by_push, by_force = np.zeros((count, 2)), np.zeros((count, count)), np.zeros(count)
    reached, turned, x = np.eye(2), np.zeros((2, count)), np.zeros(2)
    for k in range(count):
        by_start[k], by_push[k], by_force[k] = row @ reached, row @ turned, row @ x + force[k]
        by_push[k, k] += 1.0
        reached, turned = flow @ reached, flow @ turned
        turned[:, k] += push
        x = flow @ x + push * force[k]
    covariance = by_start @ settings.covariance @ by_start.T
    covariance += spread**2 * by_push @ by_push.T + 0.3**2 * np.eye(count)
    mean = by_force + by_start @ settings.start
    dense = multivariate_normal.logpdf(record.channels["a"], mean, covariance)
    assert found == pytest.approx(dense, abs=0.05)  # it is pushed in two halves of a sample


@pytest.mark.parametrize(
    "effect", [CubicStiffness(port="x"), ConstantLoad(port="z"), Gain(port="x_acceleration")]
)
def test_signatures_in_readings_are_the_slopes_of_the_compiled_effect(effect):
    """What an effect adds to an acceleration at once is the derivative of the traced reading."""
    system = equations(TWO)
    time = 0.01 * np.arange(64)
    rng = np.random.default_rng(3)
    told = {c: rng.normal(size=64) for c in system.observed}
    record = make_record(system, "r", time, told, {"F": rng.normal(size=64)})
    values = {"system.c": 3.0, "system.k": 2000.0}
    task, settings = prepare_filter(prepare_task(seed_model(system, values=values), record), ())
    noise = NoiseModel(tuple(NoiseTerm("white", c) for c in told),
                       {f"white.{c}": 1.0 for c in told})  # fmt: skip
    run = predict_readings(task, settings, noise, keep=True)

    along = predicted_motion(SimpleNamespace(problem=SimpleNamespace(model=task.model)), task, run)
    rates, readings = signatures(along, effect, {})
    traced = trace(system, (effect,))
    keys = [i for i, k in enumerate(traced.keys) if k.startswith(effect.label)]
    own = [0.0 if k.startswith(effect.label) else task.values[task.keys.index(k)]
           for k in traced.keys]  # fmt: skip
    symbols = [*traced.x, *traced.u, *traced.p]
    for matrix, found in ((traced.output_p, readings), (traced.rate_p, rates)):
        slopes = sp.lambdify(symbols, matrix[:, keys].tolist(), "numpy")
        for k in (0, 17, 63):
            due = np.array(slopes(*along.states[k], *along.inputs[k], *own), float)
            np.testing.assert_allclose(found[k], due, rtol=1e-9, atol=1e-9)


def test_a_coordinate_behind_an_accelerometer_starts_from_its_integrals():
    system = equations(ONE)
    time, force, states = accelerations(samples=3000)
    record = record_of(system, time, force, states[:, 2], noise=0.01)
    study = CompiledStudy(compile_model(trace(system, ())), (prepare_series(system, record, 1),))
    moving = smoothed_motion(study, study.series[0], 5)
    for i in range(2):
        assert np.corrcoef(moving.states[200:-200, i], states[200:-200, i])[0, 1] > 0.9
    assert np.corrcoef(moving.acceleration[:, 0], states[:, 2])[0, 1] > 0.99


class Body(System):
    """pitch' = pitch_rate, pitch_rate' = command: all rates given, none by a balance of forces."""

    states = (State("pitch", "rad"), State("pitch_rate", "rad/s"))
    observed = ("pitch",)
    inputs = (Input("command", "rad/s^2", "zero_order"),)
    injections = (State("pitch_rate", "rad/s^2"),)
    parameters = ()
    ports = ()
    seed = ()

    def rate(self, x, u, p, injected):
        return {"pitch": x.pitch_rate, "pitch_rate": u.command + injected["pitch_rate"]}


def test_a_state_named_after_the_rate_of_another_needs_no_balance_of_forces():
    system, time = Body(), 0.01 * np.arange(500)
    record = make_record(system, "body", time, {"pitch": np.sin(time)}, {"command": -np.sin(time)})
    study = CompiledStudy(compile_model(trace(system, ())), (prepare_series(system, record, 1),))
    moving = smoothed_motion(study, study.series[0], 7)
    np.testing.assert_allclose(moving.states[10:-10, 1], np.cos(time)[10:-10], atol=1e-4)
    assert moving.acceleration.shape == (500, 0)


def shaken(seed, friction=0.0):
    """An oscillator with dry friction seen by its accelerometer alone, 1 % noise."""
    rng, time = np.random.default_rng(seed), 0.002 * np.arange(2500)
    turns, phase = 2 * np.pi * np.linspace(1, 40, 30), rng.uniform(0, 6.28, 30)

    def force(t):
        return 5 * np.sin(np.multiply.outer(t, turns) + phase).sum(axis=-1)

    def acceleration(t, x):
        return force(t) - 4 * x[1] - 4000 * x[0] - friction * np.tanh(x[1] / 2e-3)

    run = solve_ivp(lambda t, x: [x[1], acceleration(t, x)], (0, time[-1]), [0, 0],
                    t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.002)  # fmt: skip
    told = acceleration(time, run.y)
    values = {"m": "1 kg", "c": "5 N*s/m", "k": "3500 N/m"}
    system = equations(ONE, inputs={"F": "N"}, parameters=values)
    return system, record_of(system, time, force(time), told, noise=0.01, seed=seed)


@pytest.mark.slow
def test_friction_is_named_by_an_accelerometer_alone():
    system, record = shaken(5, friction=4.0)
    run = spiral.discover(record, system, plugins=NO_FOLDER)
    assert run.missing == ("coulomb_friction",)
    level = run.model.estimates()["coulomb_friction"]["level"]
    assert abs(level.estimate - 4.0) < 3 * level.se + 0.02
    assert run.model.estimates()["system"]["k"].estimate == pytest.approx(4000, rel=2e-3)
    assert run.rounds[-1].comparison.chi2_per_dof == pytest.approx(1.0, abs=0.1)


def test_nothing_is_named_where_an_accelerometer_sees_all_there_is():
    system, record = shaken(6)
    run = spiral.discover(record, system, plugins=NO_FOLDER)
    assert run.verdict == "nothing_missing"
    assert not run.missing


def test_what_needs_measured_states_says_so():
    system, record = shaken(6)
    with pytest.raises(SpiralError, match="no state"):
        spiral.discover(record, system, strategy="paper", plugins=NO_FOLDER)
    with pytest.raises(SpiralError, match="no state"):
        spiral.identify(record, system, plugins=NO_FOLDER)


def test_sensors_of_readings_may_be_late():
    """A delay follows a reading that is no state by states of its own."""
    system = equations(ONE)
    traced = trace(system, (Delay(),))
    assert [n for n in traced.states if n.startswith("delay")] == [
        "delay.level", "delay.slope", "delay.later_level", "delay.later_slope",
    ]  # fmt: skip
    assert traced.output[0].has(traced.u[0])


def test_states_that_follow_a_reading_begin_there():
    """A sensor of a logarithm is no state; what follows it begins at what it reads."""
    system = equations({
        "equations": ["mixed' = (fed - mixed) / T"], "states": {"mixed": ""},
        "inputs": {"fed": ""}, "parameters": {"T": "4 s"}, "observed": ["scale = log(mixed)"],
    })  # fmt: skip
    time = np.arange(200) * 0.1
    seen, fed = 1.0 + 0.1 * np.sin(time), np.exp(1.0 + 0.1 * np.sin(time))
    record = make_record(system, "late", time, {"scale": seen}, {"fed": fed})
    model = seed_model(system, (Delay(),), values={"delay.time": 1.0, "delay.scale": 1.0})
    compiled = compile_model(trace(system, (Delay(),)))
    series = prepare_series(system, record, 2)
    states = smoothed_motion(CompiledStudy(compiled, (series,)), series, 7).states
    names = compiled.traced.states
    for name in ("delay.level", "delay.later_level"):
        np.testing.assert_allclose(states[:, names.index(name)], seen, atol=1e-4)
        task = prepare_task(model, record, substeps=2)
        assert task.start[names.index(name)] == pytest.approx(1.0, abs=1e-3)


def test_a_node_of_a_structure_may_have_an_accelerometer():
    mass, stiffness = np.eye(3), 100 * np.array([[2, -1, 0], [-1, 2, -1], [0, -1, 1.0]])
    nodes = {"base": {"dof": 0, "use": "input"}, "tip": {"dof": 2, "use": "accelerometer port"}}
    system = spiral.structure({"M": mass, "K": stiffness}, nodes, size=3, band=(0, 5))
    assert system.observed == ("tip_acceleration",)
    assert system.unit_of("tip_acceleration") == "m/s^2"
    traced = trace(system, ())
    assert traced.output[0] == traced.rate[traced.states.index("tip_rate")]
    assert not failed(check_system(system))


def test_a_function_may_have_an_accelerometer():
    """Of a function the acceleration is the rate of its velocity."""
    system = spiral.system(
        lambda t, x, u, p: [x.v, (u.F - p.k * x.x) / p.m],
        states={"x": "m", "v": "m/s"}, inputs={"F": "N"}, observed=["a = v'"],
        parameters={"m": (2.0, "kg"), "k": (800.0, "N/m")},
    )  # fmt: skip
    assert system.unit_of("a") == "m/s^2"
    traced = trace(system, ())
    assert traced.output[0] == traced.rate[traced.states.index("v")]
    assert traced.accelerated == {"x": 0}


@pytest.mark.parametrize(
    ("given", "wanted", "due"),
    [("g", "m/s^2", 9.80665), ("mg", "mm/s^2", 9.80665), ("m/s2", "m/s^2", 1.0),
     ("m s-2", "m/s^2", 1.0), ("cm/s2", "m/s^2", 0.01), ("g", "kg", 1e-3)],
)  # fmt: skip
def test_units_of_accelerations_are_read_as_people_write_them(given, wanted, due):
    assert factor(given, wanted, "a") == pytest.approx(due)
    assert is_unit(given)


@pytest.mark.parametrize("name", ["T2", "A2", "m1"])
def test_a_name_in_brackets_is_no_power_of_a_unit(name):
    assert not is_unit(name)


def test_a_reading_s_rate_is_there_for_a_stretch_of_one_sample():
    """Scores go through a record in pieces, the last of which may be one sample long."""
    readings = np.linspace(0.0, 1.0, 5)[:, None] ** 2
    none, rates = np.zeros((5, 2)), np.gradient(readings, 0.1, axis=0)
    along = SystemMotion(equations(ONE), none, none, none, readings, {}, reading_rates=rates)
    position, velocity = port_motion_along(along.part(slice(4, 5)), Delay())
    assert position.shape == velocity.shape == (1, 1)
    assert velocity[0, 0] == rates[4, 0]


def test_a_distance_without_sign_has_a_unit():
    assert equations(TWO, observed=["gap = abs(x - z)"]).unit_of("gap") == "m"


@pytest.mark.slow
def test_the_zero_of_an_accelerometer_is_told_from_slow_noise():
    """Noise behind a filter with a bias under it: first taken for noise that hardly moves."""
    system, record = shaken(7)
    rng = np.random.default_rng(8)
    slow, white = np.zeros(len(record.time)), rng.normal(size=len(record.time))
    for k in range(1, len(slow)):
        slow[k] = 0.6 * slow[k - 1] + white[k]
    clean = record.channels["a"]
    told = clean + 0.01 * clean.std() * slow / slow.std() + 0.4
    biased = make_record(system, "biased", record.time, {"a": told}, dict(record.inputs))
    run = spiral.discover(biased, system, plugins=NO_FOLDER)
    assert run.missing == ("offset",)
    found = run.model.estimates()["offset"]["offset"]
    assert abs(found.estimate - 0.4) < 3 * found.se + 1e-3
    assert run.final.test_error < 1.2 * run.final.noise_floor


def test_readings_are_text_alone_or_named_in_yaml():
    assert equations(TWO, observed=["x", {"load": "k*(x - z)"}]).observed == ("x", "load")
    given = {"states": {"x": "m", "v": "m/s"}, "parameters": {"k": (2.0, "1/s^2")}}
    rhs = lambda t, x, u, p: [x.v, -p.k * x.x]  # noqa: E731
    assert spiral.system(rhs, **given, observed="a = v'").observed == ("a",)
    with pytest.raises(SpiralError, match="NAME = FORMULA"):
        spiral.system(rhs, **given, observed=[rhs])


@pytest.mark.parametrize("formula", ["load = F", "load = 2*k"])
def test_a_reading_that_tells_of_no_state_is_refused(formula):
    """What is driven, or constant, says nothing of the machine."""
    rhs = lambda t, x, u, p: [x.v, u.F / p.m - p.k * x.x]  # noqa: E731
    system = spiral.system(
        rhs, states={"x": "m", "v": "m/s"}, inputs={"F": "N"}, observed=["x", formula],
        parameters={"k": (2.0, "1/s^2"), "m": (1.0, "kg")},
    )  # fmt: skip
    t = 0.01 * np.arange(100)
    with pytest.raises(SpiralError, match="tells of no state"):
        compared(system, t)


def compared(system, t):
    record = make_record(system, "r", t, {"x": np.sin(t), "load": t}, {"F": t})
    return spiral.compare(record, system)
