"""Models as equations, in a file or in Python: what they become, and what is refused."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

import spiral
from spiral.io.compute_curves import gather_curves
from spiral.io.config import build_system, compose
from spiral.io.conformance.declared import describe_declarations
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.testing import check_system, failed
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError, SpiralError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.compiled_rates import rates

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
        ("m2: [0.2, kg]", "m2: 0.2 s", ["equation 2", "beside"]),
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
            ["x' = -n*(x - base)*1000 + u"], states={"x": unit}, inputs={"u": rate},
            parameters={**constants, "base": (60.0, {"mm": "m"}.get(unit, f"k{unit[1:]}"))},
            observed=["x"],
        )  # fmt: skip


GROWTH = {
    "equations": ["A' = r*A*(1 - A/K) - a*A*Z - D*A", "Z' = 0.5*a*A*Z - m*Z"],
    "states": {"A": "mg/l", "Z": {"unit": "mg/l", "start": 9}}, "inputs": {"D": "1/d"},
    "parameters": {"r": {"value": 0.85, "unit": "1/d", "lower": 0.1, "upper": 3}, "K": "42 mg/l",
                   "a": [0.055, "l/mg/d"], "m": "0.17 1/d"},
    "free": ["r"], "observed": ["A"],
}  # fmt: skip


def test_a_books_rates_per_day_become_rates_per_second():
    """Only the time is converted where that is enough: states stay in mg/l."""
    day = 86400.0
    found = spiral.system(GROWTH)
    by_hand = {**GROWTH, "inputs": {"D": "1/s"}, "parameters": {
        "r": {"value": 0.85 / day, "unit": "1/s"}, "K": "42 mg/l", "a": [0.055 / day, "l/mg/s"],
        "m": [0.17 / day, "1/s"]}}  # fmt: skip
    values, states = {"r": 0.85 / day}, {"A": 16.0, "Z": 9.0}
    one, other = (
        rates(s, (), {f"system.{k}": v for k, v in values.items()}, states, {"D": 1e-6, "time": 0})
        for s in (found, spiral.system(by_hand))
    )
    assert one == pytest.approx(other, rel=1e-12)
    first = found.parameters[0]
    assert (first.unit, first.lower, first.upper) == ("1/s", 0.1 / day, 3 / day)
    assert {s.name: (s.unit, s.start) for s in found.states}["Z"] == ("mg/l", 9)
    assert dict(found.form.definition.converted)["r"] == "0.85 1/d"
    assert "r from 0.85 1/d" in describe_declarations(found)
    assert spiral.system(yaml.safe_load(found.text)).form.units == found.form.units


def test_a_table_without_units_has_those_of_the_definition():
    """Also where the equations are in SI by now: 1.2 per day is not 1.2 per second."""
    model, time = spiral.system(GROWTH), np.arange(80.0)
    table = {"time": time, "A": 16 + np.sin(time), "D": 1.2 + 0.1 * np.cos(time)}
    record = spiral.read(table, model)
    assert record.inputs["D"] == pytest.approx(table["D"] / 86400.0)
    assert "D from 'D' in 1/d" in " ".join(record.notes)
    same = spiral.read({**table, "D": table["D"] / 86400.0}, model, units={"D": "1/s"})
    assert same.inputs["D"] == pytest.approx(record.inputs["D"])


def test_data_sheets_in_units_of_other_sizes_become_si():
    given = {"equations": ["C*T' = P - G*(T - Ta)"], "states": {"T": "degC"}, "observed": ["T"],
             "inputs": {"P": "kW", "Ta": "degC"},
             "parameters": {"C": "31 kJ/K", "G": "2.5 W/K"}}  # fmt: skip
    made = spiral.system(given)
    assert {i.name: i.unit for i in made.inputs} == {"P": "W", "Ta": "degC"}
    assert {p.name: (p.start, p.unit) for p in made.parameters} == {
        "C": (31000.0, "J/K"), "G": (2.5, "W/K")}  # fmt: skip


@pytest.mark.parametrize("number", ["1440", "0.001", "86400", "3.6"])
def test_beside_a_number_that_may_convert_nothing_is_converted(number):
    changed = {**GROWTH, "equations": [f"A' = r*A/{number} - D*A", GROWTH["equations"][1]]}
    with pytest.raises(ConfigError, match="numbers without a unit that convert"):
        spiral.system(changed)


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


def test_constants_are_told_in_python_and_not_beside_a_function():
    pendulum = spiral.system(
        ["x'' = -g*sin(x)/l + u"], states={"x": "rad"}, inputs={"u": "rad/s^2"}, observed=["x"],
        parameters={"l": (1.0, "m")}, constants={"g": "9.81 m/s^2"},
    )  # fmt: skip
    assert "g: 9.81 m/s^2" in pendulum.text
    with pytest.raises(spiral.SpiralError, match="beside a function"):
        spiral.system(
            lambda t, x, u, p: [-x.a], {"a": "m"}, observed=["a"], constants={"g": "9.81 m/s^2"}
        )


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
    result = spiral.compare(record, system)
    found = result.model.estimates()["system"]["a"]
    assert abs(found.estimate - 0.05) < 3 * found.se
    assert not result.contradictions  # its time is in s


def test_a_free_parameter_in_no_equation_is_refused():
    """Not one that a reading alone holds."""
    given = {"states": {"x": "m"}, "inputs": {"F": "N"}, "free": ["k", "mu"],
             "parameters": {"m": "1 kg", "k": "2 N/m", "mu": "0.3"}}  # fmt: skip
    rows = ["m*x'' + k*x = F"]
    with pytest.raises(SpiralError, match="free: mu, which is in no equation"):
        spiral.system(rows, observed=["x"], **given)
    spiral.system(rows, observed=["x", "pull = mu*k*x"], **given)


def test_coupled_coils_pass_their_check():
    """L l - m^2 divides; parameters of one size would make it zero."""
    coils = {
        "equations": ["L*i' + m*e' = v - R*i", "l*e' + m*i' = -r*e"],
        "states": {"i": "A", "e": "A"}, "inputs": {"v": "V"}, "observed": ["i"],
        "parameters": {"L": "1e-3 H", "l": "2e-4 H", "m": "1.5e-4 H", "R": "1 ohm", "r": "1 ohm"},
    }  # fmt: skip
    system = load_registry(NO_FOLDER).make("system", "equations", {"text": json.dumps(coils)})
    assert not failed(check_system(system))
