"""A learned change of a parameter in a form with a name."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.evidence.enlarge import make_variant
from spiral.inference.problem import silent
from spiral.inference.strategies.likelihood.named_curves import _lay_through, _nearest_forms
from spiral.types.record import make_record
from tests.scenes import registry

AT = np.linspace(-1.0, 3.0, 13)
VISITED = np.linspace(1.0, 2.0, 13)
LAWS = {
    "linear_change": ({"slope": 0.2}, lambda v: 1 + 0.2 * v),
    "exponential_change": ({"rate": -0.5}, lambda v: np.exp(-0.5 * v)),
    "inverse_quadratic_change": ({"curvature": 0.7}, lambda v: 1 / (1 + 0.7 * v * v)),
    "saturating_change": ({"change": 0.6, "scale": 0.8}, lambda v: 1 + 0.6 * np.tanh(v / 0.8)),
}
SHAPES = {
    "saturating_change": {"scale": 1.5, "reference": 0.0},
    "peak_change": {"point": 0.5, "width": 1.0, "reference": 0.0},
    "switched_change": {"point": 0.5, "width": 0.1, "reference": 0.0},
}


def form(name):
    effect = registry().make("effect", name, {"port": "q-E"})
    return make_variant(effect, "", SHAPES.get(name, {}))


def shape_of(law):
    """What a curve looks like: shares of its mean over what was visited."""
    factor = law(AT)
    share = factor / (VISITED @ factor / VISITED.sum()) - 1
    curve = {"at": AT, "force": share, "visited": VISITED / VISITED.sum()}
    return SimpleNamespace(as_dict=lambda: {"curves": [curve]})


@pytest.mark.parametrize("name", LAWS)
def test_a_form_through_its_own_curve_has_its_own_values(name):
    """Exactly, with c the mean over what was visited."""
    values, law = LAWS[name]
    found = _lay_through(form(name), AT, law(AT), np.sqrt(VISITED / VISITED.sum()))
    assert found.distance < 1e-12
    assert found.factor == pytest.approx(1, rel=1e-4)
    assert {k: found.values[k] for k in values} == pytest.approx(values, rel=1e-3)


@pytest.mark.parametrize("name", LAWS)
def test_the_nearest_form_of_a_curve_is_its_law(name):
    """Among those that are fitted, and as near as can be; others may hold it as a special case."""
    names = [*LAWS, "peak_change", "switched_change", "power_change"]
    nearest = _nearest_forms([form(n) for n in names], shape_of(LAWS[name][1]))
    told = {f.variant.original.plugin_name(): f.distance for f in nearest}
    assert told[name] < 1e-9
    assert len(told) == 4


FERMENTER = """
equations:
  - X' = Y*q*S/(K + S)*X - d*X
  - S' = -q*S/(K + S)*X + F
  - E' = P*q*S/(K + S)*X - D*E
states: {X: {unit: kg/m^3, start: 0.6}, S: {unit: kg/m^3, start: 150}, E: {unit: kg/m^3, start: 2}}
inputs:
  F: {unit: kg/(m^3*h), interpolation: zero_order}
  D: {unit: 1/h, interpolation: zero_order}
parameters: {q: 1.5 1/h, K: 17 kg/m^3, Y: 0.034, P: 0.45, d: 0.003 1/h}
free: [q, K, d]
observed: [S, E]
"""


@pytest.mark.slow
def test_an_inhibition_that_leads_the_values_astray_is_named():
    """q (1 - E / 100): beside a large random flow the values are far off, and no change is seen."""
    rng, system = np.random.default_rng(2), registry().make(
        "system", "equations", {"text": FERMENTER}
    )  # fmt: skip
    hours = np.arange(900) / 3
    feed, drawn = (np.repeat(rng.uniform(0, top, 30), 30) for top in (1.5, 0.01))

    def rates(t, s):
        k = min(int(3 * t + 1e-9), 899)
        made = 1.7 * (1 - s[2] / 100) * s[1] / (14 + s[1]) * s[0]
        return [0.036 * made - 0.0035 * s[0], feed[k] - made, 0.45 * made - drawn[k] * s[2]]

    moved = solve_ivp(rates, (0, hours[-1]), [0.6, 150, 2], t_eval=hours, max_step=0.1).y
    seen = moved[1:] + 0.01 * moved[1:].std(axis=1, keepdims=True) * rng.normal(size=(2, 900))
    record = make_record(
        system, "vat", hours * 3600, {"S": seen[0], "E": seen[1]},
        {"F": feed / 3600, "D": drawn / 3600},
    )  # fmt: skip
    run = spiral.discover(record, system, progress=silent)
    assert run.missing == ("linear_change@q-E",)
