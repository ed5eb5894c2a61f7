"""Laws with a closed form: right as effects, and named where the catalog does not know them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from spiral_plugins.strategies.likelihood import Likelihood

import spiral
from experiments.laws.bench import asked, records_of
from experiments.laws.truth import CASES, draw, motion
from spiral.inference.evidence.fit_state import half_masks
from spiral.inference.likelihood.fitting import WARM, fit_by_likelihood
from spiral.inference.problem import silent
from spiral.inference.strategies.likelihood.laws import PromisingChanges, find_named_law
from spiral.io.problem_setup import pose_problem
from spiral.io.storage import model_data, rebuild_model
from spiral.io.testing import check_effect, failed
from spiral.physics.formulas.laws import FLOWS, FRICTIONS, SPRINGS, laws_of
from spiral.physics.trace import trace
from spiral.types.model import Model, seed_model
from spiral.types.port import At
from spiral.types.units import check_units
from tests.scenes import registry
from tests.swept_oscillator import TRUTH, record_of

OSCILLATOR = registry().make("system", "oscillator")
VESSEL = records_of("hill", 1, 1.0)[0]
EVERY = [(OSCILLATOR, e) for e in laws_of(OSCILLATOR)] + [(VESSEL, e) for e in laws_of(VESSEL)]


@pytest.mark.parametrize(("system", "law"), EVERY, ids=lambda x: getattr(x, "label", ""))
def test_every_law_passes_what_every_effect_does(system, law):
    check_units(system, law)
    assert not failed(check_effect(law, system))


def test_every_law_stands_at_every_place_that_its_units_fit():
    names = {law.name for law in (*SPRINGS, *FRICTIONS)}
    assert {e.plugin_name() for e in laws_of(OSCILLATOR)} == names
    assert {e.label for e in laws_of(VESSEL)} == {f"{law.name}_s@s" for law in FLOWS}


def _value(name, q, v=0.0, **values):
    law = next(e for e in laws_of(OSCILLATOR) if e.plugin_name() == name)
    (found,) = law.force(At((q,), (v,), SimpleNamespace()), STILL, _given(law, values))
    return found


def _given(law, values):
    return SimpleNamespace(**{p.name: values[p.name] for p in law.parameters})


STILL = SimpleNamespace(force=0.0, time=0.0)
Q = np.linspace(-0.9, 0.9, 37)
FORCES = [
    ("power_law", {"a": 2.0, "l": 0.5, "n": 1.5}, -2 * np.sign(Q) * np.abs(Q / 0.5) ** 1.5, 4e-3),
    ("dead_zone_law", {"a": 2.0, "l": 0.3}, -2 * np.sign(Q) * np.clip(np.abs(Q) - 0.3, 0, 9), 0),
    ("saturation_law", {"a": 2.0, "l": 0.3}, -2 * np.clip(Q, -0.3, 0.3), 1e-15),
    ("inverse_square_law", {"a": 2.0, "l": 1.3}, 2 / (1 - Q / 1.3) ** 2 - 2, 1e-13),
    ("one_sided_law", {"a": 2.0, "l": -0.2}, -2 * np.clip(Q + 0.2, 0, 9), 1e-15),
]


@pytest.mark.parametrize(("name", "values", "force", "within"), FORCES, ids=[f[0] for f in FORCES])
def test_a_law_is_its_closed_form(name, values, force, within):
    np.testing.assert_allclose(_value(name, Q, **values), force, atol=within)


def test_friction_falls_from_rest_to_sliding():
    v = np.array([-2.0, -0.05, 0.05, 2.0])
    found = _value("stribeck_law", 0 * v, v, a=1.0, b=0.5, c=0.2, l=0.001)
    expected = -(1 + 0.5 * np.exp(-((v / 0.2) ** 2))) * np.sign(v)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_a_machine_without_its_law_moves_as_the_model_says(name):
    """The truth, written by hand, and the system that a user gives have the same rates."""
    case, (drawn, rng) = CASES[name], draw(name, 1)
    values = {k: v for k, (v, _) in case.values.items()}
    system = spiral.system(
        lambda t, x, u, p: case.known(list(x), u.force, {k: getattr(p, k) for k in values}),
        states=case.states, inputs={"force": case.force[3]}, observed=[next(iter(case.states))],
        parameters=case.values, free=case.free,
    )  # fmt: skip
    time, states, force = motion(case, drawn, 0.0, rng, 0.1)
    traced = trace(system, ())
    rates = sp.lambdify([traced.x, traced.u, traced.p], traced.rate)
    given = [values[k.split(".")[1]] for k in traced.keys]
    found = np.array([
        rates(x, [u, *[0.0] * (len(traced.u) - 1)], given)
        for x, u in zip(states, force, strict=True)
    ])  # fmt: skip
    by_hand = np.gradient(states, time, axis=0, edge_order=2)
    error = np.abs(by_hand - found)[5:-5].max(axis=0) / np.abs(found).max(axis=0)
    assert np.all(error < 0.05)


@pytest.mark.slow
def test_the_sine_of_a_double_angle_is_named_in_closed_form():
    run = asked("double_angle", 3)
    assert run.missing == ("sine_law",)
    found = run.model.estimates()["sine_law"]
    assert abs(found["l"].estimate - 0.5) < 3 * found["l"].se
    truth = draw("double_angle", 3)[0]["a"]
    assert abs(found["a"].estimate + truth) < 3 * found["a"].se
    assert run.final.test_error < 1.1 * run.final.noise_floor


@pytest.mark.slow
def test_a_law_that_a_candidate_explains_as_well_takes_its_name():
    """Asked for laws at once, a machine with a clearance: the dead zone is the same function."""
    truth = {"clearance.stiffness": 3000.0, "clearance.gap": 0.03, "clearance.width": 0.0}
    effect = registry().effect_from_label("clearance")
    record = record_of(3, 2000, 0.01, (effect,), truth)
    known = tuple(TRUTH)  # else a spring that yields beside a stiffer one is the same function
    model = replace(seed_model(OSCILLATOR, values=TRUTH), fixed=known)
    problem = pose_problem(registry(), model, (replace(record, noise={}),), None,
                  candidates=("clearance", "cubic_stiffness"))  # fmt: skip
    begun, options = Likelihood().begin(problem, silent), Likelihood()
    masks = half_masks(begun.assembly)
    base = fit_by_likelihood(
        begun.assembly, begun.fit_state, masks=masks[0], steps=WARM, rough=True
    )
    changes = PromisingChanges(begun.assembly, masks[0])
    law = find_named_law(options, begun.assembly, begun.fit_state, base, False, begun.comparison,
                         masks, 0.01, changes, silent)  # fmt: skip
    assert changes.beside(base) is changes.beside(base)
    assert law is not None
    assert law.effect.label == "clearance"
    assert "dead_zone_law" in law.aliases
    found = law.refitted.comparison.model.values
    assert found["clearance.gap"] == pytest.approx(0.03, rel=0.02)


def test_a_law_is_saved_with_its_formula_and_read_again():
    law = next(e for e in laws_of(OSCILLATOR) if e.label == "power_law")
    values = {"power_law.a": 2.0, "power_law.l": 0.01, "power_law.n": 1.5}
    model = Model(OSCILLATOR, (*OSCILLATOR.seed, law), values)
    again = rebuild_model(model_data(model), registry())
    assert again.labels == model.labels
    assert again.values == model.values
    assert trace(again.system, again.effects).rate == trace(model.system, model.effects).rate
