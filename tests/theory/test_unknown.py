"""Physics in no catalog: its state is named, its curve covered, and admitting it is enough."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.interpolate import BSpline
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.systems.oscillator import Oscillator

from spiral.diagnose import diagnose
from spiral.discover import add, discover
from spiral.effect import ForceEffect
from spiral.forcecurve import beside
from spiral.learned import COUNT, SPACING, basis
from spiral.math import sin, tanh
from spiral.model import seed_model
from spiral.parameter import Parameter
from tests.scenes import admitted, effect, planar_problem, registry

SHAPE = Parameter("length", "position", role="shape", start=1.0)


class SineSpring(ForceEffect):
    """F = -a sin(q / l)."""

    parameters = (Parameter("size", "force"), SHAPE)

    def force(self, at, u, p):
        return [-p.size * sin(q / p.length) for q in at.position]


class TanhBearing(ForceEffect):
    """F = -a tanh(q / l)."""

    parameters = (Parameter("size", "force"), SHAPE)

    def force(self, at, u, p):
        return [-p.size * tanh(q / p.length) for q in at.position]


class PlaceFriction(ForceEffect):
    """F = -a (1 + sin(q / l)) tanh(v / w): dry friction of a bearing worn in places."""

    parameters = (
        Parameter("size", "force"),
        SHAPE,
        Parameter("width", "velocity", role="shape", start=1.0),
    )

    def force(self, at, u, p):
        rows = zip(at.position, at.velocity, strict=True)
        return [-p.size * (1 + sin(q / p.length)) * tanh(v / p.width) for q, v in rows]


BASE = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e4, "linear_damping.damping": 20.0}
HIDDEN = {
    "sine": (SineSpring(), {"size": 0.5, "length": 4e-5}, "learned_spring"),
    "tanh": (TanhBearing(), {"size": 0.6, "length": 3e-5}, "learned_spring"),
    "friction": (
        PlaceFriction(), {"size": 0.2, "length": 6e-5, "width": 1e-3}, "learned_dry_friction"
    ),
}  # fmt: skip


def _problem(name, seed=0, **settings):
    hidden, values, _ = HIDDEN[name]
    source = Simulation(
        system=Oscillator(),
        effects=(hidden,),
        values={**BASE, **{f"{hidden.label}.{k}": v for k, v in values.items()}},
        inputs={"force": {"noise": 1.0, "band": [5, 60]}},
        duration=10.0,
        rate=1000.0,
        noise_level=0.02,
        seed=seed,
    )
    record, test = (s.load(Oscillator())[0] for s in (source, source.as_test()))
    found = planar_problem(record, test, seed_model(Oscillator()), **settings)
    return replace(found, dictionary=registry().dictionary(Oscillator()))


def _truth(name, at, v):
    """The hidden force along the state; of a friction the part that turns with the velocity."""
    _, p, _ = HIDDEN[name]
    if name == "sine":
        return -p["size"] * np.sin(at / p["length"])
    if name == "tanh":
        return -p["size"] * np.tanh(at / p["length"])
    return -p["size"] * (1 + np.sin(at / p["length"])) * np.tanh(v / p["width"])


def _covered(name, unknown):
    """Share of the visited values at which the band holds the true curve, beside the seed."""
    curve = unknown["curves"][0]
    at, force, band, visited = (np.array(curve[k]) for k in ("at", "force", "band", "visited"))
    taken = np.ones_like(at) if unknown["times"] else at  # by the damper; by the spring
    left = beside(taken[:, None], visited)
    truth = left @ _truth(name, at, curve["speed"])
    return float(np.sum(visited[np.abs(force - truth) <= band]))


def test_the_basis_is_that_of_cubic_splines():
    """Against SciPy's B-splines; it reproduces every cubic on |z| <= 1."""
    z = np.linspace(-1, 1, 401)
    found = np.array(basis(z)).T
    knots = SPACING * (np.arange(COUNT + 4) - COUNT // 2 - 2)
    np.testing.assert_allclose(found, BSpline.design_matrix(z, knots, 3).toarray(), atol=1e-9)
    for power in range(4):
        fitted = found @ np.linalg.lstsq(found, z**power, rcond=None)[0]
        np.testing.assert_allclose(fitted, z**power, atol=1e-9)


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
    left = beside(at[:, None], weight)
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
    return discover(_problem("friction", learned=True))


def test_friction_that_depends_on_place_is_named_covered_and_admitted(friction):
    unknown = friction.unknown
    assert unknown["effect"] == "learned_dry_friction"
    assert unknown["state"] == "x"
    assert unknown["smooth"]
    assert _covered("friction", unknown) >= 0.95
    assert "learned_dry_friction" in friction.model.labels
    assert friction.final.test_error <= 1.5 * friction.final.noise_floor


def test_a_curve_is_admitted_by_hand_as_any_effect():
    problem = _problem("tanh")
    before, after, run = add(problem, (effect("learned_spring"),))
    assert after.test_error <= 1.5 * after.noise_floor < before.test_error
    assert "learned_spring" in run.model.labels


def test_without_asking_the_shape_is_told_and_nothing_learned_is_admitted():
    problem = replace(_problem("tanh"), candidates=())
    told = diagnose(problem)
    assert told.verdict == "unknown_structure"
    assert told.unknown is not None
    assert told.unknown["effect"] == "learned_spring"
    assert told.unknown["parity"] == "odd"
    assert "learned_spring" in told.advice
    assert _covered("tanh", told.unknown) >= 0.95


SHORT = pytest.mark.xfail(
    strict=False, reason="a catalog effect stands in first and is kept; 10.7 and 36 noise floors"
)
EVERY = [
    pytest.param(name, seed, marks=[SHORT] if (name, seed) in {("sine", 1), ("tanh", 2)} else [])
    for name in HIDDEN
    for seed in range(3)
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_each_hidden_shape_is_named_covered_and_admitted(name, seed):
    run = discover(_problem(name, seed, learned=True))
    label = HIDDEN[name][2]
    assert run.unknown["effect"] == label
    assert label in admitted(run)
    assert _covered(name, run.unknown) >= 0.95
    assert run.final.test_error <= 1.5 * run.final.noise_floor
