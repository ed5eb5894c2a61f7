"""Models that users have: a right-hand side in Python, equations in a file."""

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
from spiral.io.compute_curves import gather_curves
from spiral.io.config import build_system, compose
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.storage import model_data, rebuild_model
from spiral.io.testing import check_system, failed
from spiral.physics.compile import compile_model
from spiral.physics.formulas.function import CannotTraceError, definition_from
from spiral.physics.formulas.laws import laws_of
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError, SpiralError
from spiral.types.model import seed_model
from spiral.types.record import make_record


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


def rates(system, effects, values, states, inputs):
    """The compiled rates by name."""
    traced = trace(system, effects)
    found = np.zeros(len(traced.states))
    x, u = ([given[n] for n in names] for given, names in (
        (states, traced.states), (inputs, traced.inputs)))  # fmt: skip
    p = [values.get(k, q.start) for k, q in zip(traced.keys, traced.parameters, strict=True)]
    compile_model(traced).rate_value(*(np.array(a, float) for a in (x, u, p)), found)
    return dict(zip(traced.states, found, strict=True))


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
        (lambda t, x: [x.v], {}, ["1 values", "x, v"]),
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


TWO_MASSES = """\
equations:
  - m1*x'' + c1*x' + k1*x - c2*(z' - x') - k2*(z - x) = F
  - -k2*(x - z) = m2*z'' - c2*(x' - z') + 2*k2*(z - x)
states: {x: m, z: m}
inputs: {F: {unit: N, interpolation: band_limited}}
parameters:
  m1: 1.0 kg
  m2: [0.2, kg]
  k1: {value: 400, unit: N/m, lower: 0}
  c1: N*s/m
  k2: 100 N/m
  c2: 0.3 N*s/m
free: [k1]
observed: [x, z']
ports: {coupling: z - x}
"""


def test_a_file_of_second_order_equations(tmp_path):
    """m2 z'' = c2 (x' - z') + k2 (x - z), whatever side terms stand on; chosen as system=FILE."""
    file = tmp_path / "two.yaml"
    file.write_text(TWO_MASSES, encoding="utf-8")
    registry = load_registry(NO_FOLDER)
    system = build_system(compose([f"system={file}"], registry), registry)
    states = {"x": 0.2, "z": 0.5, "x_rate": 0.1, "z_rate": -0.3}
    values = {"system.k1": 400.0, "system.c1": 2.0}
    found = rates(system, (), values, states, {"F": 7.0, "time": 0.0})
    link = 0.3 * (-0.3 - 0.1) + 100 * 0.3
    assert found["x_rate"] == pytest.approx(7.0 - 2.0 * 0.1 - 400 * 0.2 + link)
    assert found["z_rate"] == pytest.approx((-0.3 * (-0.3 - 0.1) - 100 * 0.3) / 0.2)
    assert system.observed == ("x", "z_rate")
    assert system.defaults == {"system.k1": 400.0}
    assert [p.name for p in system.ports] == ["coupling", "x", "z"]
    model = seed_model(system)
    assert {*model.active} == {"system.k1", "system.c1"}
    assert not failed(check_system(spiral.system(file)))


def test_the_rate_of_an_input_is_known(tmp_path):
    """A mass on a moving base, as equations and as a function; the input itself has no port."""
    file = tmp_path / "base.yaml"
    text = (
        "equations: [\"m*x'' + c*(x' - z') + k*(x - z) = 0\"]\nstates: {x: m}\ninputs: {z: m}\n"
        "parameters: {m: 2 kg, c: 3 N*s/m, k: 400 N/m}\nobserved: [x]\n"
    )
    file.write_text(text, encoding="utf-8")

    def rate(t, x, u, p):
        (z,) = u
        return [x.v, -(p.c * (x.v - u.z_rate) + p.k * (x.x - z)) / p.m]

    function = spiral.system(
        rate, states={"x": "m", "v": "m/s"}, inputs={"z": "m"}, observed=["x"],
        parameters={"m": (2.0, "kg"), "c": (3.0, "N*s/m"), "k": (400.0, "N/m")},
    )  # fmt: skip
    given = {"z": 0.5, "z_rate": -2.0, "time": 0.0}
    due = -(3 * (0.1 + 2.0) + 400 * (0.2 - 0.5)) / 2
    for system, speed in ((spiral.system(file), "x_rate"), (function, "v")):
        assert system.inputs[0].derivative
        assert not system.driven
        found = rates(system, (), {}, {"x": 0.2, speed: 0.1}, given)
        assert found[speed] == pytest.approx(due)
    file.write_text(text + "ports: {mount: x - z}\n", encoding="utf-8")
    with pytest.raises(SpiralError, match="port mount: 'z'"):
        spiral.system(file)


def test_equations_that_share_accelerations_may_stand_in_any_order(tmp_path):
    """Each has both accelerations; one order of them alone has a symmetric mass matrix."""
    both = ("m1*(x'' - z'') + c1*(x' - z') + k1*(x - z) = F",
            "m1*(z'' - x'') + m2*z'' + c1*(z' - x') + k1*(z - x) = 0")  # fmt: skip
    found = []
    for i, (one, other) in enumerate((both, both[::-1])):
        file = tmp_path / f"order_{i}.yaml"
        file.write_text(
            f"equations:\n  - {one}\n  - {other}\nstates: {{x: m, z: m}}\ninputs: {{F: N}}\n"
            "parameters: {m1: 1 kg, m2: 2 kg, c1: 3 N*s/m, k1: 400 N/m}\nobserved: [x]\n",
            encoding="utf-8",
        )
        states = {"x": 0.2, "z": 0.5, "x_rate": 0.1, "z_rate": -0.3}
        found.append(rates(spiral.system(file), (), {}, states, {"F": 7.0, "time": 0.0}))
    link = 3 * 0.4 - 400 * 0.3
    assert found[0] == found[1]
    assert found[0]["z_rate"] == pytest.approx(7.0 / 2)
    assert found[0]["x_rate"] == pytest.approx(7.0 / 2 + 7.0 - link)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("k1*x -", "kk*x -", ["equation 1", "'kk'", "parameters: {kk: UNIT}"]),
        ("2*k2*", "2*c2*", ["equation 2", "c2 * (z - x)", "beside", "kg*m/s^2"]),
        ("m2: [0.2, kg]", "m2: 200 g", ["equation 2", "m2 in g", "all SI"]),
        ("c2*(z' - x')", "c2*(z' - x')*os.x", ["equation 1", "nothing has a dot"]),
        ("z - x}", "z - w}", ["port coupling: 'w'", "x, z"]),
        ("{x: m, z: m}", "{x: m, z: m", ["line", "YAML"]),
        ("free:", "fre:", ["fre", "did you mean 'free'"]),
        ("m1*x''", "m1*x''**2", ["equation 1", "not linear in x''"]),
        ("m1*x''", "m1*x'' + m2*z''", ["not symmetric"]),
        ("N, interpolation: band_limited", "N, interpolation: lines", ["zero_order"]),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_at_its_place(tmp_path, old, new, said):
    assert old in TWO_MASSES
    file = tmp_path / "two.yaml"
    file.write_text(TWO_MASSES.replace(old, new), encoding="utf-8")
    with pytest.raises(SpiralError) as caught:
        spiral.system(file)
    for words in (*said, *(["two.yaml"] if "YAML" not in said else [])):
        assert words in str(caught.value)


def test_effects_may_act_between_any_two_coordinates_of_one_unit():
    """Two masses have a place between them; a carriage and an angle have none."""

    def two(t, x, u, p):
        return [x.va, x.vb, (u.F - p.k * x.a) / p.m, -p.k * x.b / p.m]

    units = {"a": "m", "b": "m", "va": "m/s", "vb": "m/s"}
    given = {"inputs": {"F": "N"}, "parameters": {"m": "1 kg", "k": "9 N/m"}, "observed": ["a"]}
    names = [p.name for p in spiral.system(two, units, **given).ports]
    assert names == ["a", "b", "a_b"]
    named = spiral.system(two, units, **given, ports={"coupling": "a - b"})
    assert [p.name for p in named.ports] == ["coupling", "a", "b"]


def test_an_input_that_acts_in_part_is_no_mass():
    """Half of a force on the second mass: its inertia is m, so that springs pull both alike."""
    both = spiral.system(
        lambda t, x, u, p: [x.v, x.w, (u.F - p.k * x.a) / p.m, (0.5 * u.F - p.k * x.b) / p.m],
        states={"a": "m", "b": "m", "v": "m/s", "w": "m/s"},
        inputs={"F": "N"},
        observed=["a", "b"],
        parameters={"m": (2.0, "kg"), "k": (50.0, "N/m")},
    )
    assert both.mass(SimpleNamespace(a=0.0, b=0.0), SimpleNamespace(m=2.0, k=50.0)) == [
        [2.0, 0], [0, 2.0]
    ]  # fmt: skip


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


def test_a_candidate_that_stops_an_input_which_divides_is_asked_along_the_record():
    """x' = a (s / y - x): y is never zero, but in a dead zone as wide as one it is."""
    system = spiral.system(
        ["x' = a*(s/y - x)"], states={"x": "m"}, inputs={"y": "1"}, observed=["x"],
        parameters={"a": "0.06 1/s", "s": "1 m"}, free=["a"],
    )  # fmt: skip
    rng = np.random.default_rng(4)
    y = np.repeat(rng.uniform(0.5, 4.0, 40), 50)
    time = np.arange(y.size) * 0.5
    x = solve_ivp(
        lambda t, x: 0.05 * (1 / np.interp(t, time, y) - x), (0, time[-1]), [0.5],
        t_eval=time, max_step=0.5, rtol=1e-8,
    ).y[0]  # fmt: skip
    seen = x + 0.01 * x.std() * rng.normal(size=x.size)
    record = make_record(system, "divided", time, {"x": seen}, {"y": y})
    run = spiral.discover(record, system, candidates=["input_dead_zone", "constant_flow"])
    assert run.verdict == "nothing_missing"
    assert abs(run.estimates().loc[("system", "a"), "estimate"] - 0.05) < 1e-3
    assert run.question is not None
    curves = gather_curves(run.question, {"final": run.rounds[-1].comparison})
    measured, given = curves.get(0, "y"), curves.get_input(0, "y")  # the reading, and an input
    assert measured is not None
    assert given is not None
    assert measured.shape == (given.size, 1)
    assert measured[:, 0] == pytest.approx(seen[: given.size], rel=1e-6)


@pytest.mark.parametrize("unit", ["mL", "uL", "pmol/L", "mm"])
def test_terms_that_cancel_are_terms_of_one_unit(unit):
    """Numbers at which two terms are equal leave a rounding error, which says nothing of units."""
    rate, constants = f"({unit})/s", {"n": (1e-3, "1/s"), "base": (60.0, unit)}
    for equation in ("x' = -n*(x - base) + u", "x' + n*x - n*base = u", "x' = n*(base - x) + u"):
        spiral.system(
            [equation], states={"x": unit}, inputs={"u": rate}, parameters=constants, observed=["x"]
        )
    with pytest.raises(ConfigError, match="cannot be added"):
        spiral.system(
            ["x' = -n*(x - base) + u"], states={"x": unit}, inputs={"u": rate},
            parameters={**constants, "base": (60.0, {"mm": "m"}.get(unit, f"k{unit[1:]}"))},
            observed=["x"],
        )  # fmt: skip


def test_equations_are_told_in_python_as_in_a_file(tmp_path):
    equations = ["m*x'' + c*x' + k*x^3 = F"]
    rest = {
        "states": {"x": "m"}, "inputs": {"F": "N"}, "observed": ["x"], "free": ["c"],
        "parameters": {"m": "2 kg", "c": "3 N*s/m", "k": "400 N/m^3"},
    }  # fmt: skip
    file = tmp_path / "one.json"
    file.write_text(json.dumps({"equations": equations, **rest}))
    systems = [
        spiral.system(equations, **rest), spiral.system({"equations": equations, **rest}),
        spiral.system({"equations": equations, "states": rest["states"]},
                      **{k: v for k, v in rest.items() if k != "states"}),
        spiral.system(file),
    ]  # fmt: skip
    assert {s.observed for s in systems} == {("x",)}
    assert [[k.name for k in s.parameters if k.start is None] for s in systems] == [["c"]] * 4
    assert {tuple(map(str, trace(s, ()).rates)) for s in systems} == {
        tuple(map(str, trace(systems[3], ()).rates))
    }
    with pytest.raises(ConfigError, match="states, in the mapping and beside it"):
        spiral.system({"equations": equations, **rest}, states={"x": "m"})


@pytest.mark.parametrize("reading", ["x", "level = log(x/s)"])
def test_a_state_that_is_never_zero_may_divide_and_stand_under_a_logarithm(reading):
    """x' = a (u s / x - x): at zero it is no number, and a hidden state begins at zero."""
    system = spiral.system(
        ["x' = a*(u*s/x - x)"], states={"x": "kg/m^3"}, inputs={"u": "kg/m^3"},
        observed=[reading], parameters={"a": "0.06 1/s", "s": "1 kg/m^3"}, free=["a"],
    )  # fmt: skip
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(0.5, 4.0, 60), 50)
    time = np.arange(u.size) * 0.5

    def rate(t, x):
        return 0.05 * (np.interp(t, time, u) / x - x)

    x = solve_ivp(rate, (0, time[-1]), [1.5], t_eval=time, max_step=0.5, rtol=1e-8).y[0]
    channel = reading.split()[0]
    seen = x if channel == "x" else np.log(x)
    seen = seen + 0.01 * seen.std() * rng.normal(size=x.size)
    record = make_record(system, "never zero", time, {channel: seen}, {"u": u})
    found = spiral.compare(record, system).model.estimates()["system"]["a"]
    assert abs(found.estimate - 0.05) < 3 * found.se
