"""Physics in no catalog: its state is named, its curve covered, and admitting it is enough."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.interpolate import CubicSpline
from spiral_plugins.systems.oscillator import Oscillator

from experiments.unknown_physics.cases import CASES, coverage, problem
from spiral.inference.diagnose import diagnose
from spiral.inference.discover import add, discover
from spiral.inference.evidence.comparison import prepare_study
from spiral.inference.unknown.forcecurve import residual_projection
from spiral.inference.unknown.shape import _seed_state_with_curves
from spiral.physics.learned import COUNT, KNOTS, basis
from tests.scenes import admitted, effect, registry


def _problem(name, seed=0, **settings):
    return problem(name, registry(), seed, **settings)


def _brief(asked):
    """The first 4 of the 10 s of its records."""
    records, test = (
        tuple(r.part(0, 4000, r.name) for r in given) for given in (asked.records, asked.test)
    )
    return replace(asked, records=records, test=test)


def test_the_basis_is_that_of_natural_cubic_splines():
    """Against SciPy's natural spline through the knots, straight outside them."""
    z = np.linspace(-1.6, 1.6, 401)
    heights = np.random.default_rng(0).normal(size=COUNT)
    weights = np.linalg.solve(np.array(basis(np.array(KNOTS))).T, heights)
    spline = CubicSpline(KNOTS, heights, bc_type="natural")
    inside = np.clip(z, KNOTS[0], KNOTS[-1])
    expected = spline(inside) + spline(inside, 1) * (z - inside)
    np.testing.assert_allclose(np.array(basis(z)).T @ weights, expected, atol=1e-9)


def test_the_basis_has_its_slope_as_an_expression():
    z = sp.Symbol("z", real=True)
    middle = basis(z)[COUNT // 2]
    slope = sp.lambdify(z, sp.diff(middle, z))
    step = 1e-6
    value = sp.lambdify(z, middle)
    for at in (-0.2, -0.05, 0.0, 0.01, 0.13, 0.2):
        assert slope(at) == pytest.approx((value(at + step) - value(at - step)) / 2e-6, abs=1e-6)


def test_a_curve_beside_a_spring_is_what_is_orthogonal_to_it():
    at, weight = np.linspace(-1, 1, 81), np.full(81, 1 / 81)
    left = residual_projection(at[:, None], weight)
    np.testing.assert_allclose(left @ (3 * at), 0, atol=1e-12)
    assert weight @ (at * (left @ at**3)) == pytest.approx(0, abs=1e-12)
    np.testing.assert_allclose(left @ at**2, at**2, atol=1e-12)


def test_a_learned_effect_is_no_candidate_unless_asked_for():
    labels = {e.label for e in registry().candidates(Oscillator())}
    known = {e.label for e in registry().dictionary(Oscillator())}
    assert known == {
        "learned_spring", "learned_friction", "learned_damping", "learned_dry_friction"
    }  # fmt: skip
    assert not labels & known


@pytest.fixture(scope="module")
def friction():
    return discover(_brief(_problem("friction", learned=True)))


@pytest.mark.slow
def test_friction_that_depends_on_place_is_named_covered_and_admitted(friction):
    unknown = friction.unknown
    assert unknown["effect"] == "learned_dry_friction"
    assert unknown["state"] == "x"
    assert unknown["smooth"]
    assert coverage(CASES["friction"], unknown).whole >= 0.95
    assert "learned_dry_friction" in friction.model.labels
    assert friction.final.test_error <= 1.5 * friction.final.noise_floor


def test_a_curve_is_admitted_by_hand_as_any_effect():
    before, after, run = add(_problem("tanh"), (effect("learned_spring"),))
    assert after.test_error <= 1.5 * after.noise_floor < before.test_error
    assert "learned_spring" in run.model.labels


def test_without_asking_the_shape_is_told_and_nothing_learned_is_admitted():
    told = diagnose(replace(_brief(_problem("tanh")), candidates=()))
    assert told.verdict == "unknown_structure"
    assert told.unknown is not None
    assert told.unknown["effect"] == "learned_spring"
    assert told.unknown["parity"] == "odd"
    assert "learned_spring" in told.advice
    assert coverage(CASES["tanh"], told.unknown).whole >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["sine", "tanh", "friction"])
def test_each_hidden_shape_is_named_covered_and_admitted(name, seed):
    """Without the preloaded spring, whose two slopes are as good as a tanh to 1 % of the noise."""
    asked = _problem(name, seed, learned=True)
    others = tuple(c for c in asked.candidates if c.label != "preload")
    run = discover(replace(asked, candidates=others))
    assert run.unknown["effect"] == CASES[name].learned
    assert CASES[name].learned in admitted(run)
    assert coverage(CASES[name], run.unknown).whole >= 0.95
    assert run.final.test_error <= 1.5 * run.final.noise_floor


def test_starting_afresh_keeps_a_curve_that_was_admitted():
    """The seed begins anew; of the rest only the curve stays, with the values that it had."""
    known = (effect("learned_spring"), effect("quadratic_damping"))
    assembly, fit_state = prepare_study(replace(_problem("tanh"), candidates=known))
    labels = {v.original.label: v.label for v in assembly.variants}
    spring, drag = labels["learned_spring"], labels["quadratic_damping"]
    place = [assembly.study.index(k) for k in (f"{spring}.c3", f"{drag}.damping")]
    values = fit_state.values.copy()
    values[:, place] = 0.5
    kept = (*fit_state.labels, spring)
    wide = replace(fit_state, values=values, labels=(*kept, drag))
    found = _seed_state_with_curves(assembly, wide, kept)
    assert found.labels == kept
    assert found.values[0, place].tolist() == [0.5, 0.0]
