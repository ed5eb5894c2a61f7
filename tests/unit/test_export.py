"""The model as text says what is integrated."""

import re

import numpy as np
import pytest
import sympy as sp

import spiral
from spiral.io.export.equation import equation_latex, equation_text, flatten_cases, model_equations
from spiral.io.mathml import mathml
from spiral.io.registry import load_registry
from spiral.physics.trace import trace
from spiral.types.model import Model, seed_model

REGISTRY = load_registry()
ROTOR = REGISTRY.make("system", "planar_rotor")
OSCILLATOR = REGISTRY.make("system", "oscillator")


def with_all(system):
    seeded = [e.label for e in system.seed]
    more = tuple(e for e in REGISTRY.candidates(system) if e.label not in seeded)
    model = seed_model(system, more)
    values = {k: 0.37 * (i + 1) for i, (k, _) in enumerate(model.pairs)}
    return Model(system, model.effects, values=values)


def test_the_oscillator_reads_like_its_equation():
    values = {
        "system.mass": 2.0,
        "linear_stiffness.stiffness": 100.0,
        "linear_damping.damping": 0.5,
        "cubic_stiffness.stiffness": 3e9,
    }
    model = seed_model(OSCILLATOR, (REGISTRY.effect_from_label("cubic_stiffness"),), values=values)
    lines = [re.sub(r" {2,}", " | ", line.strip()) for line in equation_text(model).splitlines()]
    assert lines == [
        "x'' = 0.5 force | system",
        "- 50 x | linear_stiffness",
        "- 0.25 x' | linear_damping",
        "- 1.5e9 x³ | cubic_stiffness",
    ]


@pytest.mark.parametrize("system", [ROTOR, OSCILLATOR], ids=lambda s: s.plugin_name())
def test_terms_add_up_to_what_is_integrated(system):
    model = with_all(system)
    found, whole = model_equations(model)
    traced = trace(system, model.effects)
    rng = np.random.default_rng(0)
    numbers = {n: float(v) for n, v in zip(
        (*traced.states, *traced.inputs), rng.normal(size=60), strict=False)}  # fmt: skip
    at = dict(zip(traced.p, [model.values[k] for k in traced.keys], strict=True))
    at.update({s: numbers[n] for n, s in zip(traced.states, traced.x, strict=True)})
    at.update({s: numbers[n] for n, s in zip(traced.inputs, traced.u, strict=True)})
    named = {sp.Symbol(n, real=True): v for n, v in numbers.items()}
    for item in found:
        name = item.left.removesuffix("'").removeprefix("reading of ")
        rows = traced.output if "reading" in item.left else traced.rate
        names = whole.channels if "reading" in item.left else whole.states
        exact = float(rows[names.index(name)].xreplace(at))
        total = sum(float(t.value.xreplace(named)) for t in item.terms)
        assert total == pytest.approx(exact, rel=1e-9)


TWO_CLOCKS = {
    "equations": [
        "m*l^2*a'' + m*l*cos(a)*x'' + m*g*l*sin(a) = 0",
        "(M + m)*x'' + m*l*cos(a)*a'' - m*l*a'^2*sin(a) + k*x = F",
        "tau*q' = F - q",
    ],
    "states": {"a": "rad", "x": "m", "q": "N"}, "inputs": {"F": "N"},
    "constants": {"g": "9.81 m/s^2"},
    "parameters": {"m": "1.5 kg", "l": "0.4 m", "M": "12 kg", "k": "1700 N/m", "tau": "0.2 s"},
    "observed": ["a", "x"],
}  # fmt: skip


def test_coupled_accelerations_are_shown_as_a_balance_of_forces():
    system = spiral.system(TWO_CLOCKS)
    model = seed_model(system, (REGISTRY.effect_from_label("coulomb_friction@a"),), values={
        "coulomb_friction@a.level": 0.03, "coulomb_friction@a.width": 0.1})  # fmt: skip
    lines = [re.sub(r" {2,}", " | ", line.strip()) for line in equation_text(model).splitlines()]
    assert lines == [
        "0.24 a'' + 0.6 x'' cos(a)", "= - 5.886 sin(a) | system",
        "- 0.03 tanh(10 a') | coulomb_friction@a",
        "13.5 x'' + 0.6 a'' cos(a)", "= F - 1700 x + 0.6 a'² sin(a) | system",
        "q' = 5 F - 5 q | system",
    ]  # fmt: skip
    assert r"0.24\,\ddot{a} + 0.6\,\ddot{x}\,\cos{\left(a \right)} &=" in equation_latex(model)
    assert mathml(model)[0]["left"].count("¨") == 2


def test_the_balance_of_forces_is_what_is_integrated():
    system = spiral.system(TWO_CLOCKS)
    damper = REGISTRY.effect_from_label("linear_damping@x")
    model = seed_model(system, (damper,), values={"linear_damping@x.damping": 0.3})
    found, traced = model_equations(model)
    rows = [item for item in found if item.inertia is not None]
    balance = [sum(t.value for t in item.terms) - item.inertia for item in rows]
    solved = sp.solve(
        balance, [sp.Symbol("a_rate_rate", real=True), sp.Symbol("x_rate_rate", real=True)]
    )
    pairs = [*zip(traced.states, traced.x, strict=True), *zip(traced.inputs, traced.u, strict=True)]
    numbers = {name: 0.2 * (i + 1) for i, (name, _) in enumerate(pairs)}
    named = {sp.Symbol(n, real=True): v for n, v in numbers.items()}
    values = {k: p.start for k, p in model.pairs} | dict(model.values)
    at = dict(zip(traced.p, [values[k] for k in traced.keys], strict=True))
    at |= {s: numbers[n] for n, s in pairs}
    for symbol, value in solved.items():
        exact = traced.rate[traced.states.index(symbol.name.removesuffix("_rate"))].xreplace(at)
        assert float(value.xreplace(named)) == pytest.approx(float(exact), rel=1e-9)


@pytest.mark.parametrize("width", [0.0, 0.1])
def test_cases_within_cases_are_one_list(width):
    """The corner of a contact is three cases, and two where it has no width."""
    label = "rub"
    values = {"rub.stiffness": 5.0, "rub.gap": 2.0, "rub.width": width}
    model = seed_model(ROTOR, (REGISTRY.effect_from_label(label),), values=values)
    latex, drawn = equation_latex(model), mathml(model)[0]["terms"][-1]
    assert drawn["owner"] == label
    assert drawn["math"].count("<mtable>") == 1
    assert drawn["math"].count("<mtr>") == (3 if width else 2)
    assert "piecewise" not in drawn["math"]
    assert latex.count(r"\begin{cases}") == 2  # one for each axis
    assert "infty" not in latex


def test_cases_as_one_list_have_the_value_of_the_nested_ones():
    x, a, b = sp.symbols("x a b", real=True)
    inner = sp.Piecewise((a, x < -1), (b, x < 0), (x, True), evaluate=False)
    nested = sp.Piecewise((inner, x < 1), (sp.Piecewise((1, x < 2), (2, True)), True),
                          evaluate=False)  # fmt: skip
    flat = flatten_cases(nested)
    assert not any(v.has(sp.Piecewise) for v, _ in flat.args)
    for at in (-2, -0.5, 0.5, 1.5, 3):
        assert flat.subs(x, at) == nested.subs(x, at)


def test_an_index_stands_below_its_letter():
    terms = mathml(seed_model(ROTOR, values={}))[0]["terms"]
    assert "<msub><mi>stiffness</mi><mi>x</mi></msub>" in terms[0]["math"]


def test_every_effect_has_its_line():
    model = with_all(ROTOR)
    text = equation_text(model)
    assert all(label in text for label in model.labels)
    assert "1e-200" not in text


def test_values_that_are_not_known_stay_names():
    assert "stiffness" in equation_text(seed_model(OSCILLATOR)).replace("linear_stiffness", "")


def test_latex_is_balanced():
    text = equation_latex(with_all(ROTOR))
    assert text.startswith(r"\begin{align*}")
    assert text.count("{") == text.count("}")
    assert text.count(r"\left") == text.count(r"\right")
    assert r"\ddot{x} &=" in text
    assert r"\Omega" in text


def test_a_difference_that_cannot_be_multiplied_out_stays_as_it_is(monkeypatch):
    """As of nested conditions of which SymPy makes one that compares nothing (choked flow)."""

    def expand(value):
        raise TypeError("Invalid NaN comparison")

    model = seed_model(OSCILLATOR)
    plain = equation_text(model)
    monkeypatch.setattr("sympy.expand", expand)
    assert equation_text(model).count("linear_stiffness") == plain.count("linear_stiffness") == 1
