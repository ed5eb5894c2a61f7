"""Libraries: units, the span of the paper's table, and the projection of a hidden tilt."""

import numpy as np
import pytest
from spiral_plugins.effects.rotating import Unbalance
from spiral_plugins.libraries.core import Core
from spiral_plugins.libraries.paper import Paper
from spiral_plugins.libraries.projection import Projection
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.physics.trace import trace
from spiral.types.effect import ForceEffect
from spiral.types.errors import ConfigError, PluginError
from spiral.types.library import Library, Term, terms_of
from spiral.types.parameter import Parameter
from tests.scenes import PROJECTION


def columns(terms, system, seed=0):
    """Accelerations (points, equations, terms) at random states."""
    import sympy as sp

    effects = tuple({t.effect.label: t.effect for t in terms}.values())
    traced = trace(system, effects)
    symbols = [traced.p[traced.keys.index(t.key)] for t in terms]
    rows = [e for n, e in zip(traced.states, traced.rate, strict=True) if n.endswith("_rate")]
    function = sp.lambdify([*traced.x, *traced.u, *traced.p], sp.Matrix(rows).jacobian(symbols))
    rng = np.random.default_rng(seed)
    known = sum(name != "time" for name in traced.inputs)
    zeros = np.zeros(len(traced.u) - known + len(traced.p))
    return np.array(
        [
            function(*rng.normal(size=len(traced.x)), *rng.normal(size=known), *zeros)
            for _ in range(80)
        ],
        dtype=float,
    )


def test_the_table_has_ten_categories_and_the_closure():
    terms = terms_of(Paper(), PlanarRotor())
    assert len({t.category for t in terms}) == 10
    assert Paper.closure
    assert len(terms) == 49  # with the origin of the phase, 2 x 25 basis functions of the table


def test_the_table_is_spanned_term_by_term():
    """Every basis function of the table in each equation is a combination of the terms."""
    terms = terms_of(Paper(), PlanarRotor())
    matrix = columns(terms, PlanarRotor()).reshape(-1, len(terms))
    assert np.linalg.matrix_rank(matrix) == len(terms)
    rng = np.random.default_rng(0)
    points = [(rng.normal(size=4), rng.normal(size=3)) for _ in range(80)]
    for function in _TABLE:
        for equation in (0, 1):
            wanted = np.zeros((80, 2))
            wanted[:, equation] = [function(x, u) for x, u in points]
            wanted = wanted.ravel()
            left = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]
            assert np.linalg.norm(left) < 1e-8 * np.linalg.norm(wanted)


# x, y, x', y' and speed, phase, speed's rate; the forcing is not in the list, because the seed's
# unbalance carries the rate of the speed too
_TABLE = (
    lambda x, u: 1.0,
    *(lambda x, u, i=i: x[i] for i in range(4)),
    *(lambda x, u, i=i, j=j: x[i] * x[j] for i in range(4) for j in range(i, 4)),
    *(lambda x, u, i=i: u[0] * x[i] for i in range(4)),
    *(lambda x, u, i=i: (x[0] ** 2 + x[1] ** 2) * x[i] for i in range(4)),
)


def test_the_core_is_six_terms_in_three_pairs():
    terms = terms_of(Core(), PlanarRotor())
    assert len(terms) == 6
    matrix = columns(terms, PlanarRotor())
    assert all(np.any(matrix[:, e, k]) for e in (0, 1) for k in range(6))


def test_the_projection_gives_the_oracle():
    """Design, fact 3: leading order, per unit mass."""
    found = {t.key: t for t in terms_of(Projection(), PlanarRotor())}
    for key, value in {**PROJECTION, "cross_damping.damping": 0.07}.items():
        assert found[key].predicted == pytest.approx(value, rel=7e-3 if "damping" in key else 1e-3)
    assert "1.778*polar_inertia/mass" in found["gyroscopic.coefficient"].mechanism
    assert "through the hidden states alone" in found["gyroscopic.coefficient"].mechanism
    assert set(found) == {
        *PROJECTION, "cross_damping.damping", "linear_damping.damping_x",
        "linear_damping.damping_y",
    }  # fmt: skip


def test_the_projection_is_the_schur_complement():
    """Order 0 of a linear system: K_oo - K_oh K_hh^-1 K_ho, by matrices."""
    l1 = np.array([[0.75, 0, 0, 0.1875], [0, 0.75, -0.1875, 0]])
    l2 = np.array([[0.25, 0, 0, -0.1875], [0, 0.25, 0.1875, 0]])
    k1 = np.array([[2e4, 3e3], [3e3, 1.5e4]])
    k2 = np.array([[1e4, -1e3], [-1e3, 3e4]])
    k = l1.T @ k1 @ l1 + l2.T @ k2 @ l2
    schur = (k[:2, :2] - k[:2, 2:] @ np.linalg.solve(k[2:, 2:], k[2:, :2])) / 1.15
    values = {}
    for i, m in ((1, k1), (2, k2)):
        values[f"linear_stiffness@bearing_{i}.stiffness_x"] = m[0, 0]
        values[f"linear_stiffness@bearing_{i}.stiffness_y"] = m[1, 1]
        values[f"cross_stiffness@bearing_{i}.stiffness"] = m[0, 1]
    found = {t.key: t.predicted for t in Projection(values=values, order=0).terms(PlanarRotor())}
    assert found["linear_stiffness.stiffness_x"] == pytest.approx(schur[0, 0], rel=1e-12)
    assert found["linear_stiffness.stiffness_y"] == pytest.approx(schur[1, 1], rel=1e-12)
    assert found["cross_stiffness.stiffness"] == pytest.approx(schur[0, 1], rel=1e-12)


def test_the_second_order_is_the_hidden_inertia():
    """Added mass T^T I_d T with T = (4/3) J: the static coefficients over m + (16/9) I_d."""
    share = 1.15 / (1.15 + 16 / 9 * 1.5532e-3)
    first = {t.key: t.predicted for t in Projection().terms(PlanarRotor())}
    second = {t.key: t.predicted for t in Projection(order=2).terms(PlanarRotor())}
    for key in ("linear_stiffness.stiffness_x", "cubic_stiffness.stiffness", "unbalance.moment"):
        assert second[key] == pytest.approx(first[key] * share, rel=1e-4)
    assert second["speed_stiffness.coefficient"] < 0


def test_the_third_order_is_the_low_frequency_limit_of_the_tilt():
    """Gyroscopic: W T^T G T (1 + 2 w^2 I_d/K_hh) per unit of m + T^T I_d T, w^2 the stiffness/m.

    For a rotor of one stiffness in both axes, where T = (4/3) J and everything is a number.
    """
    values, k, inertia, polar, m = {}, 2e4, 1.5532e-3, 3.1063e-3, 1.15
    for i in (1, 2):
        values |= {f"linear_stiffness@bearing_{i}.stiffness_{a}": k for a in "xy"}
        values |= {f"linear_damping@bearing_{i}.damping_{a}": 0.0 for a in "xy"}
        values[f"cross_stiffness@bearing_{i}.stiffness"] = 0.0
        values[f"cross_damping@bearing_{i}.damping"] = 0.0
    found = {t.key: t.predicted for t in Projection(values=values, order=3).terms(PlanarRotor())}
    hidden = 2 * k * 0.1875**2  # K_hh; K_oo - K_oh T = k/2 (both bearings move by half of x)
    square = 0.5 * k / m
    leading = 16 / 9 * polar / m
    expected = leading * (1 + 2 * square * inertia / hidden - 16 / 9 * inertia / m)
    assert found["gyroscopic.coefficient"] == pytest.approx(expected, rel=1e-9)


def test_a_projection_needs_something_hidden():
    with pytest.raises(ConfigError, match="some left to hide"):
        Projection(system=PlanarRotor()).terms(PlanarRotor())
    with pytest.raises(ConfigError, match="order"):
        Projection(order=4).terms(PlanarRotor())
    assert Projection(system=TiltingRotor()).order == 1


class Sloppy(ForceEffect):
    """A cubic spring whose coefficient claims to be linear: F = -k x^3."""

    bare = True
    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        return [-p.stiffness * q**3 for q in at.position]


class Inadmissible(Library):
    """A term whose unit is not that of the equation."""

    def terms(self, system):
        return (Term(Sloppy(), "sloppy.stiffness", "none", "none"),)


class Mistaken(Library):
    """A term without such an amplitude."""

    def terms(self, system):
        return (Term(Unbalance(), "unbalance.angle", "none", "none"),)


class Empty(Library):
    """No terms."""

    def terms(self, system):
        return ()


def test_terms_are_checked_when_the_library_is_built():
    with pytest.raises(PluginError, match="sloppy"):
        terms_of(Inadmissible(), Oscillator())
    with pytest.raises(PluginError, match="an amplitude of its effect"):
        terms_of(Mistaken(), PlanarRotor())
    with pytest.raises(ConfigError, match="with terms"):
        terms_of(Empty(), PlanarRotor())
