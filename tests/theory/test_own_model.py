"""Models that users have: a right-hand side in Python."""

import json
import math
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from spiral_plugins.effects.restoring import ConstantLoad

import spiral
from experiments.studies.signals import band_limited
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.storage import model_data, rebuild_model
from spiral.io.testing import check_system, failed
from spiral.physics.formulas.function import CannotTraceError, definition_from
from spiral.physics.formulas.laws import laws_of
from spiral.types.errors import SpiralError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.compiled_rates import rates


def motor(t, x, u, p):
    _, speed, current = x
    return {
        "w": (p["k"] * current - p.d * speed) / p.J,
        "th": speed,
        "i": (u[0] - p.R * current - p.k * speed) / p.L,
    }


MOTOR = {
    "states": {"th": "rad", "w": "rad/s", "i": "A"},
    "inputs": {"U": "V"},
    "parameters": {
        "k": (0.1, "N*m/A"), "d": (1e-3, "N*m*s"), "J": (1e-3, "kg*m^2"), "R": "2.0 ohm",
        "L": {"value": 0.01, "unit": "H"},
    },
    "observed": ["w", "i"],
}  # fmt: skip


def cart(t, x, u, p):
    th, w = x[1], x.w
    own = p.M + p.m * np.sin(th) ** 2
    push = u.F + p.m * np.sin(th) * (p.l * w**2 + 9.81 * np.cos(th))
    turn = -u.F * np.cos(th) - p.m * p.l * w**2 * np.cos(th) * np.sin(th)
    turn = turn - (p.M + p.m) * 9.81 * np.sin(th)
    return np.array([x.v, w, push / own, turn / (p.l * own)])


CART = {
    "states": {"s": "m", "th": "rad", "v": "m/s", "w": "rad/s"},
    "inputs": {"F": "N"},
    "parameters": {"M": "1.0 kg", "m": "0.2 kg", "l": "0.5 m"},
    "observed": ["s", "th"],
    "mass": [["M + m", "m*l*cos(th)"], ["m*l*cos(th)", "m*l**2"]],
}
STIFFNESS = np.array([[0.0, 1.0], [-400.0, -2.0]])


def corners(t, x, u):
    bump = np.where(x.x > 0.1, 2.0 * np.abs(x.x), np.maximum(x.x_rate, 0.2))
    bump = bump + np.hypot(1.0 * x.x, x.x_rate)
    return STIFFNESS @ x + np.array([0, 3.0]) * np.sqrt(bump) + [0, u.F * np.exp(-((1.0 * t) ** 2))]


CORNERS = {
    "states": {"x": "", "x_rate": "1/s"},
    "inputs": {"F": "1/s^2"},
    "observed": ["x"],
}


def in_place(t, x, u):
    """Forces of a chain summed up link by link, beside an input that its actuator clips."""
    force = [0.0, 0.0]
    for i, stiffness in enumerate((300.0, 200.0)):
        pull = stiffness * (x[i] - (x[i - 1] if i else 0.0))
        force[i] -= pull
        if i:
            force[i - 1] += pull
    drive = np.array([0.0 * x.a, np.clip(u.F, -0.5, 0.5)])
    drive += np.array(force)
    return [x.va, x.vb, *drive]


IN_PLACE = {
    "states": {"a": "", "b": "", "va": "1/s", "vb": "1/s"},
    "inputs": {"F": "1/s^2"},
    "observed": ["a"],
}
CASES = {"motor": (motor, MOTOR), "cart": (cart, CART), "corners": (corners, CORNERS),
         "in_place": (in_place, IN_PLACE)}  # fmt: skip


@pytest.fixture(scope="module")
def systems():
    return {name: spiral.system(rhs, **given) for name, (rhs, given) in CASES.items()}


@pytest.mark.parametrize("name", CASES)
def test_compiled_rates_are_those_of_the_function(systems, name):
    """Called with numbers and compiled from expressions, at states drawn at random."""
    rhs, system = CASES[name][0], systems[name]
    rng = np.random.default_rng(1)
    for _ in range(5):
        states = {s.name: float(rng.normal()) for s in system.states}
        inputs = {i.name: float(rng.normal()) for i in system.inputs} | {"time": 0.4}
        ordered = [states[n] for n in CASES[name][1]["states"]]
        known = SimpleNamespace(**{p.name: p.start for p in system.parameters})
        from spiral.physics.formulas.function import Values

        given = (
            0.4, Values(dict(zip(CASES[name][1]["states"], ordered, strict=True))),
            Values({i.name: inputs[i.name] for i in system.inputs}), Values(vars(known)),
        )  # fmt: skip
        due = rhs(*given[: rhs.__code__.co_argcount])
        if not isinstance(due, dict):
            due = dict(zip(CASES[name][1]["states"], due, strict=True))
        found = rates(system, (), {}, states, inputs)
        assert found == pytest.approx({k: float(v) for k, v in due.items()}, rel=1e-12)


def test_roles_ports_and_units_follow_from_the_equations(systems):
    """The motor turns, its current is of first order; the cart's ports are forces and torques."""
    roles = systems["motor"]
    assert [c.name for c in roles.coordinates] == ["th"]
    assert roles.rate_name("th") == "w"
    assert [s.name for s in roles.others] == ["i"]
    assert [(p.name, p.force_unit) for p in roles.ports] == [("th", "N*m")]
    assert [(p.name, p.force_unit) for p in systems["cart"].ports] == [("s", "N"), ("th", "N*m")]
    for name in ("motor", "cart"):
        assert not failed(check_system(systems[name]))
    labels = [e.label for e in load_registry(NO_FOLDER).candidates(systems["cart"], True)]
    assert {"cubic_stiffness", "coulomb_friction@th"} <= {*labels}


def test_a_force_at_a_port_acts_as_the_input_at_its_place(systems):
    """M^-1 J^T F of one newton on the cart is what one newton of the input does, pole included."""
    states = {"s": 0.1, "th": 0.7, "v": 0.3, "w": -0.4}
    still, pushed = {"F": 0.0, "time": 0.0}, {"F": 1.0, "time": 0.0}
    load = (ConstantLoad(),)
    by_port = rates(systems["cart"], load, {"constant_load.force": 1.0}, states, still)
    by_input = rates(systems["cart"], load, {"constant_load.force": 0.0}, states, pushed)
    assert by_port == pytest.approx(by_input, rel=1e-9)


def test_effects_and_laws_act_at_places_that_have_no_unit(systems):
    """Each has units of its own, some per unit of the place."""
    found = load_registry(NO_FOLDER).candidates(systems["in_place"], True)
    assert "cubic_stiffness@b" in [e.label for e in found]
    assert laws_of(systems["in_place"])
    share = spiral.system(
        lambda t, x, u: [u.F - 0.2 * x.c], states={"c": ""}, inputs={"F": "1/s"}, observed=["c"]
    )
    assert laws_of(share)


def test_a_model_is_data_and_needs_its_function_no_more(systems):
    """Pickled for a worker, and through the JSON of a saved run."""
    system = systems["motor"]
    assert pickle.loads(pickle.dumps(system)) == system
    saved = json.loads(json.dumps(model_data(seed_model(system))))
    again = rebuild_model(saved, load_registry(NO_FOLDER))
    assert again.system == system


BARE = {"states": {"x": "m", "v": "m/s"}, "inputs": {"F": "N"}, "observed": ["x"],
        "parameters": {"k": (4.0, "1/s^2")}}  # fmt: skip


def decides(t, x):
    if x.x > 0:
        return [x.v, 0]
    return [x.v, 1]


def fills(t, x):
    rates = np.zeros(2)
    rates[0] = x.v
    return rates


@pytest.mark.parametrize(
    ("rhs", "changed", "said"),
    [
        (lambda t, x, u, p: [x.v, p.kk * x.x], {}, ["'kk'", "did you mean 'k'"]),
        (lambda t, x: [x.v], {}, ["1 values", "2, one for each of x, v"]),
        (lambda t, x, u, p: [x.v, -p.k * x.x], {"parameters": {"k": (np.nan, "1/s^2")}},
         ["k: nan", "a finite number"]),
        (lambda t, x, u, p: [x.v, -p.k * x.x], {"parameters": {"k": "inf 1/s^2"}},
         ["k: inf", "a finite number"]),
        (lambda t, x, u, p: [x.v, -p.k * x.x], {"free": ["k"],
         "parameters": {"k": {"value": 4.0, "unit": "1/s^2", "lower": 5.0}}},
         ["'k' of 4 1/s^2", "lower 5"]),
        (lambda t, x, u, p: [x.v, -p.k * x.v], {}, ["k*v", "m/s^2", "1.0*x"]),
        (lambda t, x, u, p: [x.v, -p.k * x.x], {"parameters": {"k": (4.0, "1/s^2", 0.1)}},
         ["uncertainties of known parameters are not used"]),
        (lambda t, x, u, p: [x.v, -p.k * x.x], {"observed": ["y"]}, ["observed: y"]),
        (cart, {**CART, "mass": None}, ["M + m*sin(th)**2", "mass matrix"]),
    ],
)  # fmt: skip
def test_what_cannot_be_followed_is_said_with_its_line(rhs, changed, said):
    with pytest.raises(SpiralError) as caught:
        spiral.system(rhs, **{**BARE, **changed})
    for words in said:
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("rhs", "said"),
    [
        (decides, ["decides(), line", "if x.x > 0:", "a decision by x > 0", "numpy.where"]),
        (fills, ["rates[0] = x.v", "a list in place of an array"]),
        (lambda t, x: [x.v, math.sin(x.x)], ["numpy.sin in place of math.sin"]),
        (lambda t, x: [x.v, np.arctan(x.x)], ["numpy.arctan", "one of sin"]),
        (lambda t, x: [x.v, np.sign(x.v)], ["a step", "numpy.tanh(v/w)"]),
    ],
)
def test_what_cannot_be_traced_is_said_with_its_line(rhs, said):
    """Such functions are compiled instead (test_outside.py)."""
    with pytest.raises(CannotTraceError) as caught:
        definition_from(rhs, BARE)
    for words in said:
        assert words in str(caught.value)


@pytest.mark.parametrize("hidden", [0.0, pytest.param(0.03, marks=pytest.mark.slow)])
def test_friction_is_found_in_a_machine_that_has_states_of_first_order_too(hidden):
    """A motor whose current lags its voltage, integrated by SciPy with dry friction and without."""
    time = np.arange(3000) / 500
    voltage = band_limited(np.random.default_rng(3), 4.0, (0.3, 20.0), 6.0)(time)
    drive = CubicSpline(time, voltage)

    def truth(t, x):
        given = {"k": 0.1, "d": 1e-3, "J": 1e-3, "R": 2.0, "L": 0.01}
        rates = motor(t, x, [float(drive(t))], Given(given))
        rates["w"] -= hidden * math.tanh(x[1] / 0.5) / 1e-3
        return [rates["th"], rates["w"], rates["i"]]

    motion = solve_ivp(truth, (0, time[-1]), [0, 0, 0], "DOP853", time, rtol=1e-9, atol=1e-12).y
    drawn = np.random.default_rng(4).normal(size=(2, len(time)))
    th, i = (motion[k] + 0.005 * motion[k].std() * e for k, e in zip((0, 2), drawn, strict=True))
    system = spiral.system(motor, **{**MOTOR, "observed": ["th", "i"]}, free=["J", "d", "R"])
    record = make_record(system, "motor", time, {"th": th, "i": i}, {"U": voltage})
    wrong = {"system.J": 1.2e-3, "system.d": 0.8e-3, "system.R": 2.2}
    run = spiral.discover(record, system, values=wrong)
    assert run.missing == (("coulomb_friction",) if hidden else ())
    values = run.model.estimates()
    assert abs(values["system"]["J"].estimate - 1e-3) < 3 * values["system"]["J"].se
    if hidden:
        level = values["coulomb_friction"]["level"]
        assert abs(level.estimate - hidden) < 3 * level.se


class Given(dict):
    """Parameters by name, as attributes too."""

    __getattr__ = dict.__getitem__


def test_roots_of_roots_and_of_sums_of_squares_are_followed():
    """sqrt(sqrt(x^2 + s^2)), which SymPy makes a fourth root of a sum of squares."""
    given = {
        "states": {"x": "m"}, "observed": ["x"],
        "parameters": {"k": (1.3, "m^0.5/s"), "s": (0.1, "m"), "T": (2.0, "s")},
    }  # fmt: skip

    def twice(t, x, u, p):
        return [p.k * np.sqrt(np.sqrt(x.x * x.x + p.s * p.s)) - x.x / p.T]

    def power(t, x, u, p):
        return [p.k * (x.x**2 + p.s**2) ** 0.25 - x.x / p.T]

    at = SimpleNamespace
    for rhs in (twice, power):
        system = spiral.system(rhs, **given)
        p = at(**{q.name: q.start for q in system.parameters})
        for x in (-0.3, 0.0, 0.7):
            told = system.rate(at(x=x), at(time=0.0), p, {"x": 0.0})["x"]
            assert float(told) == pytest.approx(1.3 * (x**2 + 0.01) ** 0.25 - x / 2.0)
