"""The model as text says what is integrated."""

import re

import numpy as np
import pytest
import sympy as sp

from spiral.io.export.equation import equation_latex, equation_text, model_equations
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
