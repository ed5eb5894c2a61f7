"""The traced physics against differences, units, energy and symmetry."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.compile import compile_model
from spiral.model import Model, seed_model
from spiral.simulate import with_defaults
from spiral.trace import trace
from spiral.units import check_units, units_fit
from tests.scenes import registry

SYSTEMS = (PlanarRotor(), TiltingRotor(), Oscillator(position_unit="rad", force_unit="N*m"))
LABELS = registry().names("effect")


def _cases():
    return list(_each())


def _each():
    for system in SYSTEMS:
        fitting = {e.label for e in registry().candidates(system)}
        for label in LABELS:
            if label in fitting:
                yield pytest.param(system, label, id=f"{system.plugin_name()}-{label}")


def _functions(system, label):
    effect = registry().effect_from_label(label, {})
    compiled = compile_model(trace(system, (effect,)))
    n, count = len(compiled.traced.states), len(compiled.traced.keys)

    def rate(x, u, p):
        f, a, b = np.zeros(n), np.zeros((n, n)), np.zeros((n, count))
        compiled.rate(x, u, p, f, a, b)
        return f, a, b

    return compiled, rate


@pytest.mark.parametrize(("system", "label"), _cases())
def test_jacobians_agree_with_central_differences(system, label):
    compiled, rate = _functions(system, label)
    rng = np.random.default_rng(1)
    step = 1e-6
    for _ in range(3):
        x = rng.normal(size=len(compiled.traced.states))
        u = rng.normal(size=len(compiled.traced.inputs))
        p = rng.uniform(0.3, 0.9, size=len(compiled.traced.keys))
        f, a, b = rate(x, u, p)
        for i in range(len(x)):
            d = step * np.eye(len(x))[i]
            slope = (rate(x + d, u, p)[0] - rate(x - d, u, p)[0]) / (2 * step)
            np.testing.assert_allclose(a[:, i], slope, rtol=1e-5, atol=1e-5 * np.abs(f).max())
        for i in range(len(p)):
            d = step * np.eye(len(p))[i]
            slope = (rate(x, u, p + d)[0] - rate(x, u, p - d)[0]) / (2 * step)
            np.testing.assert_allclose(b[:, i], slope, rtol=1e-5, atol=1e-5 * np.abs(f).max())


@pytest.mark.parametrize(("system", "label"), _cases())
def test_an_effect_is_finite_at_rest_and_with_zero_amplitude(system, label):
    compiled, rate = _functions(system, label)
    x, u = np.zeros(len(compiled.traced.states)), np.zeros(len(compiled.traced.inputs))
    parameters = compiled.traced.parameters
    for amplitude in (0.0, 1.0):
        p = np.array([amplitude if q.role == "amplitude" else 0.5 for q in parameters])
        own = [k.startswith("system.") for k in compiled.traced.keys]
        p[own] = 0.5
        for part in rate(x, u, p):
            assert np.isfinite(part).all()


@pytest.mark.parametrize(("system", "label"), _cases())
def test_an_effect_is_linear_in_its_amplitudes_and_absent_at_zero(system, label):
    compiled, rate = _functions(system, label)
    rng = np.random.default_rng(2)
    x = rng.normal(size=len(compiled.traced.states))
    u = rng.normal(size=len(compiled.traced.inputs))
    own = [
        k.startswith(label) and q.role == "amplitude"
        for k, q in zip(compiled.traced.keys, compiled.traced.parameters, strict=False)
    ]
    base = rng.uniform(0.3, 0.9, size=len(own))
    one, two, none = base.copy(), base.copy(), base.copy()
    two[own] *= 2.0
    none[own] = 0.0
    f0, f1, f2 = (rate(x, u, p)[0] for p in (none, one, two))
    np.testing.assert_allclose(f2 - f0, 2 * (f1 - f0), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("system", "label"), _cases())
def test_units_of_every_effect_fit(system, label):
    check_units(system, registry().effect_from_label(label, {}))


def test_a_sine_of_a_length_does_not_fit():
    assert not units_fit(Oscillator(), registry().effect_from_label("gravity_torque", {}))


def _tilting_rate(values, speed):
    model = with_defaults(seed_model(TiltingRotor(), values=values))
    compiled = compile_model(trace(model.system, model.effects))
    p = np.array([model.values.get(k, q.start) for k, q in model.pairs], dtype=float)
    u = np.array([speed, 0.0, 0.0])

    def rate(x):
        f = np.zeros(8)
        compiled.rate_value(np.ascontiguousarray(x), u, p, f)
        return f

    return compiled, p, u, rate


def test_the_tilting_rotor_has_the_paper_appendix_stiffness():
    compiled, p, u, _ = _tilting_rate({}, 0.0)
    f, a, b = np.zeros(8), np.zeros((8, 8)), np.zeros((8, len(p)))
    compiled.rate(np.zeros(8), u, p, f, a, b)
    mass = np.diag([1.15, 1.15, 1.5532e-3, 1.5532e-3])
    stiffness = -mass @ a[4:, :4]
    paper = [
        [11622.4461, 1589.0063, -238.3509, 1743.3669],
        [1589.0063, 13903.8052, -2085.5708, 238.3509],
        [-238.3509, -2085.5708, 1564.1781, -178.7632],
        [1743.3669, 238.3509, -178.7632, 1307.5252],
    ]
    np.testing.assert_allclose(stiffness, paper, rtol=1e-6)
    damping = -mass @ a[4:, 4:]
    np.testing.assert_allclose(np.diag(damping), [5.0, 3.0, 0.3375, 0.5625], rtol=1e-9)


def test_the_gyroscopic_matrix_is_skew_and_does_no_work():
    _, p, u, _ = _tilting_rate({}, 0.0)
    slopes = []
    for speed in (0.0, 1.0):
        compiled, p, u, _ = _tilting_rate({}, speed)
        f, a, b = np.zeros(8), np.zeros((8, 8)), np.zeros((8, len(p)))
        compiled.rate(np.zeros(8), u, p, f, a, b)
        slopes.append(a[4:, 4:])
    mass = np.diag([1.15, 1.15, 1.5532e-3, 1.5532e-3])
    gyroscopic = -mass @ (slopes[1] - slopes[0])
    np.testing.assert_allclose(gyroscopic, -gyroscopic.T, atol=1e-15)
    assert gyroscopic[2, 3] == pytest.approx(3.1063e-3)


def test_energy_is_conserved_without_damping_and_forcing():
    none = dict.fromkeys(
        [
            f"{kind}@{bearing}.{name}"
            for bearing in ("bearing_1", "bearing_2")
            for kind, name in (
                ("linear_damping", "damping_x"),
                ("linear_damping", "damping_y"),
                ("cross_damping", "damping"),
            )
        ],
        0.0,
    )
    _, _, _, rate = _tilting_rate({**none, "unbalance.moment": 0.0}, 2 * np.pi * 30)
    start = np.array([2e-4, -1e-4, 2e-4, 3e-4, 0.01, 0.02, -0.02, 0.01])
    solution = solve_ivp(
        lambda t, x: rate(x), (0.0, 0.2), start, method="DOP853", rtol=2.3e-14, atol=1e-18
    )

    def energy(x):
        q, v = x[:4], x[4:]
        kinetic = 0.5 * v @ np.diag([1.15, 1.15, 1.5532e-3, 1.5532e-3]) @ v
        potential = 0.0
        for share, arm in ((0.75, 0.25), (0.25, -0.75)):
            r = share * np.array([q[0] + arm * q[3], q[1] - arm * q[2]])
            k = 1.6 * np.array([[11622.4461, 1589.0063], [1589.0063, 13903.8052]])
            cubic = 1e11 / (0.75**4 + 0.25**4)
            potential += 0.5 * r @ k @ r + 0.25 * cubic * (r @ r) ** 2
        return kinetic + potential

    first = energy(solution.y[:, 0])
    drift = max(abs(energy(x) - first) for x in solution.y.T) / first
    assert drift < 1e-12


def test_a_model_refuses_the_same_effect_twice():
    base = seed_model(PlanarRotor())
    with pytest.raises(Exception, match="once at a port"):
        Model(base.system, (*base.effects, base.effects[0]))
