"""Machine code against the symbolic expressions that it was made from, and their derivatives."""

import numpy as np
import psutil
import pytest
import sympy as sp
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.pendulum import Pendulum
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.physics import compile as compile_module
from spiral.physics.compile import compile_model
from spiral.physics.trace import TracedModel, trace
from spiral.types.errors import PluginError
from tests.scenes import registry

SYSTEMS = (PlanarRotor(), TiltingRotor(), Oscillator(), Pendulum(), CascadedTanks())
X, Y, K = (sp.Symbol(name, real=True) for name in ("x0", "x1", "p0"))


def symbolic(traced, name):
    """Value and Jacobians (by states, by parameters) as NumPy functions."""
    given = [*traced.x, *traced.u, *traced.p]
    values = sp.Matrix([sp.sympify(e) for e in getattr(traced, name)])
    by_x, by_p = (getattr(traced, f"{name}_{k}") for k in ("x", "p"))
    return [sp.lambdify(given, m, "scipy") for m in (values, by_x, by_p)]


def compiled_at(function, value, rows, x, u, p):
    f, g = np.zeros(rows), np.zeros(rows)
    a, b = np.zeros((rows, len(x))), np.zeros((rows, len(p)))
    function(x, u, p, f, a, b)
    value(x, u, p, g)
    np.testing.assert_array_equal(f, g)
    return f, a, b


def same(traced, seed=0, points=5):
    compiled = compile_model(traced)
    rng = np.random.default_rng(seed)
    for name in ("rate", "output"):
        parts = symbolic(traced, name)
        rows = len(getattr(traced, name))
        for _ in range(points):
            x, u, p = (rng.uniform(0.1, 1.0, len(g)) for g in (traced.x, traced.u, traced.p))
            found = compiled_at(getattr(compiled, name), getattr(compiled, f"{name}_value"), rows,
                                x, u, p)  # fmt: skip
            with np.errstate(all="ignore"):
                wanted = [np.array(f(*x, *u, *p), dtype=float) for f in parts]
            for mine, theirs in zip(found, wanted, strict=True):
                theirs = theirs.reshape(mine.shape)
                scale = np.abs(theirs).max(initial=1e-300)
                np.testing.assert_allclose(mine, theirs, rtol=1e-10, atol=1e-12 * scale)


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.plugin_name())
def test_every_effect_computes_what_it_says(system):
    """All effects that fit, at once: values and both Jacobians to 1e-10."""
    seed = {s.label for s in system.seed}
    others = [e for e in registry().candidates(system) if e.label not in seed]
    same(trace(system, (*system.seed, *others)))


def test_slopes_along_a_motion_are_those_of_its_samples():
    """In any order of the columns, which is how a fit asks for them."""
    compiled = compile_model(trace(Oscillator(), Oscillator().seed))
    traced, rng = compiled.traced, np.random.default_rng(0)
    x, u = (rng.uniform(0.1, 1.0, (7, len(g))) for g in (traced.x, traced.u))
    p = rng.uniform(0.1, 1.0, len(traced.p))
    columns = list(range(len(p)))[::-1]
    found = compiled.rate.parameter_slopes(x, u, p, columns)
    for row in range(len(x)):
        _, _, b = compiled_at(compiled.rate, compiled.rate_value, x.shape[1], x[row], u[row], p)
        np.testing.assert_array_equal(found[row], b[:, columns])
    assert np.abs(found).max() > 0


def alone(*rates):
    """A model of two states and one parameter with these rates."""
    return TracedModel(("x", "y"), (), (), ("p",), (), (X, Y), (), (K,), rates, (), (), ())


def test_code_of_many_models_takes_little_memory_and_lives_as_long_as_it_is_kept():
    """One engine each would hold some 0.9 MB beside the code."""
    kept, me = [compile_model(alone(K * X, Y))], psutil.Process()
    before = me.memory_info().rss
    kept += [compile_model(alone(K * X**n, X * Y + n)) for n in range(2, 102)]
    assert me.memory_info().rss - before < 100 * 0.4e6
    for n, one in zip((1, *range(2, 102)), kept, strict=True):
        found = np.zeros(2)
        one.rate_value(np.array([1.1, 2.0]), np.zeros(0), np.array([3.0]), found)
        assert found[0] == pytest.approx(3 * 1.1**n, rel=1e-13)


FORMS = (
    X**3 * Y, X**7, X**-2 / Y, sp.sqrt(X + Y**2), X**K, K**X, sp.exp(-X * Y), sp.log(X + K),
    sp.sin(X * Y) * sp.cos(K), sp.tan(X), sp.tanh(3 * X), sp.sinh(X), sp.cosh(X * K),
    sp.atan(X / Y),
    sp.asin(X / 2), sp.acos(X / 2), sp.asinh(X), sp.acosh(1 + X), sp.atanh(X / 2), sp.erf(X),
    sp.atan2(X, Y), sp.Abs(X - Y), sp.sign(X - Y) * X, sp.Max(X, Y, K), sp.Min(X * K, Y),
    sp.Piecewise((X**2, X > Y), (K * Y, True)), X * sp.pi,
    sp.Piecewise((X, sp.And(X > Y, K < Y)), (Y, sp.Or(X < 0.3, sp.Not(K > 0.5))), (X * Y, True)),
    sp.floor(3 * X) * X, sp.Rational(1, 3) * X - sp.E,
)  # fmt: skip


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_functions_and_their_slopes_are_exact(form):
    traced = alone(form, Y)
    compiled = compile_model(traced)
    rng = np.random.default_rng(1)
    value = sp.lambdify((X, Y, K), form, "scipy")
    for _ in range(20):
        x, p = rng.uniform(0.1, 1.0, 2), rng.uniform(0.1, 1.0, 1)
        f, a, b = np.zeros(2), np.zeros((2, 2)), np.zeros((2, 1))
        compiled.rate(x, np.zeros(0), p, f, a, b)
        assert f[0] == pytest.approx(float(value(*x, *p)), rel=1e-13)
        point = [*x, *p]
        for j, slope in enumerate((*a[0], *b[0])):
            h = 1e-6
            above, below = ([v + s * h * (i == j) for i, v in enumerate(point)] for s in (1, -1))
            numeric = (float(value(*above)) - float(value(*below))) / (2 * h)
            assert slope == pytest.approx(numeric, rel=1e-6, abs=1e-8)


def test_columns_of_parameters_not_asked_for_are_left_alone():
    system = Oscillator()
    traced = trace(system, system.seed)
    wanted = traced.keys[1]
    compiled = compile_model(traced, (wanted,))
    n, count = len(traced.x), len(traced.keys)
    rng = np.random.default_rng(2)
    x, u, p = (rng.uniform(0.1, 1.0, len(g)) for g in (traced.x, traced.u, traced.p))
    f, a, b = np.zeros(n), np.zeros((n, n)), np.full((n, count), np.nan)
    compiled.rate(x, u, p, f, a, b)
    assert np.isnan(np.delete(b, 1, axis=1)).all()
    assert np.isfinite(b[:, 1]).any()


@pytest.mark.parametrize(
    ("expression", "named"),
    [(sp.gamma(X), "gamma"), (sp.besselj(1, X), "besselj"), (sp.Heaviside(X), "Heaviside"),
     (sp.Symbol("own") * X, "own"), (sp.I * X, "ImaginaryUnit"),
     (sp.Piecewise((X, sp.Xor(X > 0, Y > 0)), (0, True)), "Xor")],
)  # fmt: skip
def test_what_has_no_machine_code_is_named(expression, named):
    with pytest.raises(PluginError, match=named) as caught:
        compile_model(alone(expression, Y))
    assert "spiral.math" in caught.value.try_


def test_a_shape_of_zero_gives_no_number_rather_than_an_exception():
    """tanh(v / w) at w = 0, where a freed width may come to stand: its slope is not finite."""
    system = PlanarRotor()
    traced = trace(system, (*system.seed, registry().effect_from_label("coulomb_friction", {})))
    compiled = compile_model(traced)
    p = np.array([0.0 if key.endswith(".width") else 1.0 for key in traced.keys])
    f, by_x, by_p = np.zeros(4), np.zeros((4, 4)), np.zeros((4, len(p)))
    compiled.rate(np.full(4, 0.1), np.zeros(len(traced.u)), p, f, by_x, by_p)
    assert np.isfinite(f).all()  # the friction itself stays at its level
    assert not np.isfinite(by_p).all()


def test_nothing_of_a_model_is_written_to_disk(tmp_path, monkeypatch):
    """A compiled model is a program: one that is read from a disk may be anyone's."""
    for name in ("HOME", "TMPDIR", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    compile_model.__wrapped__(alone(sp.sin(X) * sp.Float(0.12345), Y))
    assert not list(tmp_path.rglob("*"))


def test_code_that_is_compiled_plainly_is_the_same_function(monkeypatch):
    """Registers and order apart: what a long model gets in place of an optimised one."""
    traced = trace(PlanarRotor(), PlanarRotor().seed)
    usual = compile_model(traced)
    monkeypatch.setattr(compile_module, "_LONG", 0)
    rng = np.random.default_rng(0)
    x, u, p = (rng.uniform(0.5, 1.5, k) for k in (len(traced.x), len(traced.u), len(traced.p)))
    for name in ("rate", "output"):
        rows = len(getattr(traced, name))
        results = [
            compiled_at(getattr(c, name), getattr(c, f"{name}_value"), rows, x, u, p)
            for c in (usual, compile_module.compile_model.__wrapped__(traced))
        ]
        for one, other in zip(*results, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
