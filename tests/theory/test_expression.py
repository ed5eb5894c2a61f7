"""Effects by expression are the effects that a file would define; nothing else gets through."""

import pickle

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import spiral
from spiral.physics.formulas.expression import effect_from_expression
from spiral.physics.formulas.laws import laws_of
from spiral.physics.formulas.syntax import compute, names, read
from spiral.physics.rest import _AT_ZERO, _evaluate_traced_at_rest, _is_all_finite
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError
from spiral.types.units import check_units
from tests.scenes import effect, registry

OSCILLATOR = registry().make("system", "oscillator")
ROTOR = registry().make("system", "planar_rotor")
TANKS = registry().make("system", "cascaded_tanks")

# A plugin, the system it acts on, and the same equation as a text with what it needs.
RAMP = (
    "where(upper - rim >= width, upper - rim, where(upper - rim <= -width, 0,"
    " (upper - rim + width)**2/(4*width)))"
)
SAME = [
    ("cubic_stiffness", OSCILLATOR, "-stiffness*x**3", {}),
    ("cubic_stiffness", OSCILLATOR, "-stiffness*x^3", {}),
    ("cubic_stiffness", ROTOR, "-stiffness*(x**2 + y**2)*q", {}),
    ("linear_stiffness", ROTOR, "-stiffness*q", {"per_axis": ["stiffness"]}),
    ("cross_stiffness", ROTOR, {"x": "-stiffness*y", "y": "-stiffness*x"}, {}),
    ("speed_stiffness", ROTOR, "-coefficient*speed**2*q", {}),
    ("gyroscopic", ROTOR, ["-coefficient*speed*y_rate", "coefficient*speed*x_rate"], {}),
    ("coulomb_friction", OSCILLATOR, "-level*tanh(v/width)", {"shape": {"width": 1e-3}}),
    (
        "overflow", TANKS,
        {"upper": f"-(lost + caught)*{RAMP}", "lower": f"caught*{RAMP}"},
        {"grid": {"rim": [0.5, 0.9], "width": [0.02]}},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("label", "system", "text", "options"), SAME)
def test_an_expression_is_the_effect_of_a_file(label, system, text, options):
    """Equal equations, and the units found from the formula are those that the file declares."""
    plugin, own = effect(label), effect_from_expression("own", text, system, **options)
    check_units(system, own)
    by_file, by_text = trace(system, (plugin,)), trace(system, (own,))
    order = [k.rsplit(".", 1)[1] for k in by_file.keys]
    found = [k.rsplit(".", 1)[1] for k in by_text.keys]
    turned = dict(zip(by_text.p, (by_file.p[order.index(k)] for k in found), strict=True))
    for one, other in zip(by_file.rate, by_text.rate, strict=True):
        assert sp.simplify(one - other.subs(turned, simultaneous=True)) == 0
    port = system.port("")
    declared = {p.name: p for p in plugin.parameters}
    for parameter in own.parameters:
        same = declared[parameter.name]
        from spiral.physics.formulas.dimensions import dimension

        assert dimension(port.unit(parameter.unit)) == dimension(port.unit(same.unit))
        assert parameter.role == same.role
        assert parameter.per_axis == (same.per_axis and len(port.axes) > 1)


@pytest.mark.parametrize("name", ["sinh", "cosh", "tanh"])
def test_hyperbolic_functions_are_those_of_numbers_symbols_and_units(name):
    function, x = getattr(np, name), sp.Symbol("x")
    assert compute(f"{name}(x/w)", {"x": 0.7, "w": 2.0}) == pytest.approx(function(0.35))
    assert compute(f"{name}(x)", {"x": x}) == getattr(sp, name)(x)
    own = effect_from_expression("own", f"-k*{name}(x/w)", OSCILLATOR, shape={"w": 0.5})
    assert [p.unit for p in own.parameters] == ["force", "position"]
    check_units(OSCILLATOR, own)
    with pytest.raises(ConfigError, match=f"{name} of a value without a unit"):
        effect_from_expression("own", f"-k*{name}(x)", OSCILLATOR)


def test_a_grid_is_scaled_by_position_or_velocity():
    """The word in a shape's unit says what its shares are shares of."""
    gap = effect_from_expression(
        "gap", "-k*maximum(x - g, 0)", OSCILLATOR, grid={"g": [0.2, 0.5]}, lower={"k": 0}
    )
    width = effect_from_expression("w", "-F*tanh(v/w)", OSCILLATOR, grid={"w": [0.1]})
    assert [(p.unit, p.lower) for p in gap.parameters] == [
        ("force/position", 0),
        ("position", None),
    ]
    assert [p.unit for p in width.parameters] == ["force", "velocity"]


def test_what_is_finite_as_a_text_is_finite_at_rest():
    for text in (
        "-k*x*abs(x)", "-k*abs(x)**1.5", "-k*x/abs(x)", "-k*hypot(x, v/w)*v",
        "-k*x*(x**2 + w*w)**0.25",
    ):  # fmt: skip
        options = {"shape": {"w": 3.0}} if "w" in text else {}
        found = effect_from_expression("own", text, OSCILLATOR, **options)
        assert _is_all_finite(
            _evaluate_traced_at_rest(trace(OSCILLATOR, (*OSCILLATOR.seed, found)), {}, _AT_ZERO)
        )


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("x**3", {}, ["x**3", "m^3", "N", "k*(...)"]),
        ("-k*(x + x_rate)", {}, ["x in m", "x_rate in m/s", "one unit"]),
        ("-k*x - k*x_rate", {}, ["k * x", "k * x_rate", "one unit"]),
        ("-k*sin(x)", {}, ["sin of x", "in m", "sin(x/w)"]),
        ("-k*x", {"units": {"k": "N/m^3"}}, ["k*x", "N"]),
        ("-k*x", {"units": {"k": "N/mm"}}, ["'N/mm'", "N/m"]),
        ("-k*x", {"units": {"k": "furlogn"}}, ["furlogn"]),
        ("-a*b*x", {}, ["a and b", "open", "units="]),
        ("-a*b*x", {"units": {"a": "N"}}, ["a and b", "not linear", "shape="]),
        ("-F*tanh(v/w)", {}, ["F and w", "not linear", "shape='{w: VALUE}'"]),
        ("-k*x*t", {}, ["'t'", "known here: x, x_rate"]),
        ("-k*x", {"units": {"kk": "N/m"}}, ["'kk'", "did you mean 'k'?"]),
        ("-k*x**n", {}, ["the power n of what may be negative", "abs(x)**n"]),
        ("-k*x**99", {}, ["99", "12"]),
        ("-k*x**1.5", {}, ["may be negative", "abs(x)**0.5"]),
        ("-k*x**0.8", {}, ["may be negative", "abs(x)**0.8"]),
        ("-k*(x**2 - 1)**0.5", {}, ["may be negative", "a sum of squares"]),
        ("-k*sign(x)", {}, ["tanh(v/w)"]),
        ("-k*tan(x)", {}, ["tanh"]),
        ("-k*x/0", {}, ["infinite"]),
        ("-k*x +", {}, ["invalid syntax"]),
        ("k" * 2000, {}, ["2000 characters"]),
        ("-k*" + "(-" * 60 + "x" + ")" * 60, {}, ["40 levels"]),
        ({"z": "-k*x"}, {}, ["'z'", "an axis: x"]),
        (["-k*x", "-k*x"], {}, ["2 expressions", "1, one for each axis: x"]),
    ],
)
def test_what_does_not_fit_is_told_in_one_message(text, options, words):
    with pytest.raises(ConfigError) as caught:
        effect_from_expression("own", text, OSCILLATOR, **options)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')", "x.__class__", "().__class__.__bases__[0]",
        "(lambda: x)()", "[x for x in (1,)]", "x if x else y", "x and y", "f'{x}'", "'text'",
        "x := 3", "{x: 1}", "x[0]", "*x", "open('f')", "eval('1')", "exp(x, y)", "exp(value=x)",
        "exp(*x)", "getattr(x, y)", "exp.func(x)", "True", "None", "1j", "x < y < 3", "x < 3",
        "where(x, 1, 2)", "x @ y", "x // y", "x % y", "x << 3", "~x", "not x", "await x", "...",
        "exp", "1e999", "x; y", "",
    ],
)  # fmt: skip
def test_only_formulas_are_read(text):
    with pytest.raises(ConfigError):
        read(text)


def test_a_tower_of_powers_ends_at_once():
    with pytest.raises(ConfigError, match="out of range"):
        compute("(((9**12)**12)**12)**12", {})


@settings(max_examples=60, deadline=None)
@given(st.text(alphabet="xk_.()[]{}'\"=:,;@ \n\\lambdeifor019*+-", max_size=40))
def test_any_text_is_a_formula_or_one_kind_of_error(text):
    try:
        found = names(text)
    except ConfigError:
        return
    assert all(name.isidentifier() for name in found)


def test_one_definition_is_one_class():
    """Two builds are equal and reach another process; another formula is another effect."""
    one = effect_from_expression("own", "-k*x**3", OSCILLATOR)
    same = effect_from_expression("own", "-k*x**3", OSCILLATOR)
    other = effect_from_expression("own", "-k*x**5", OSCILLATOR)
    assert one == same == pickle.loads(pickle.dumps(one))
    assert one != other


CART = {
    "equations": ["m*q'' + k*(q - w) = F", "M*w'' + k*(w - q) = c*v"],
    "states": {"q": "m", "w": "m"}, "inputs": {"F": "N", "v": "m/s"},
    "parameters": {"m": "2 kg", "M": "3 kg", "k": "400 N/m", "c": "5 N*s/m"},
    "observed": ["q", "w"],
}  # fmt: skip


def test_names_of_the_system_come_before_those_of_the_axis_at_hand():
    """A bicycle's speed v is an input; its laws of friction are laws of the rate all the same."""
    cart = spiral.system(CART)
    wind = effect_from_expression("wind", "-b*v", cart, port="w")
    drag = effect_from_expression("drag", "-b*axis_velocity", cart, port="w")
    assert (wind.inputs, drag.inputs) == (("v",), ())
    pushed = [trace(cart, (e,)) for e in (wind, drag)]
    speed, rate = pushed[0].u[1], pushed[0].x[3]
    b = pushed[0].p[-1]
    assert pushed[0].inputs[1] == "v"
    assert [t.rate[3].diff(b).free_symbols & {speed, rate} for t in pushed] == [{speed}, {rate}]
    laws = [law for law in laws_of(cart) if law.plugin_name() == "tanh_friction_law"]
    assert {text for law in laws for _, text in law.formulas} == {"-a*tanh(axis_velocity/l)"}
