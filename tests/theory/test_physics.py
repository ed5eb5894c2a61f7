"""The traced physics against differences, units, energy and symmetry."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.pendulum import Pendulum
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.inference.simulate import with_defaults
from spiral.io.testing import check_effect, failed
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.errors import PluginError
from spiral.types.model import Model, seed_model
from spiral.types.parameter import Input, Parameter, State
from spiral.types.units import check_system_units, units_fit
from tests.scenes import registry

SYSTEMS = (
    PlanarRotor(),
    TiltingRotor(),
    Oscillator(position_unit="rad", force_unit="N*m"),
    Pendulum(),
)
LABELS = registry().names("effect")


def _cases():
    return list(_each())


def _each():
    for system in SYSTEMS:
        fitting = {e.label for e in registry().candidates(system)}
        for label in LABELS:
            if label in fitting:
                yield pytest.param(system, label, id=f"{system.plugin_name()}-{label}")


@pytest.mark.parametrize(("system", "label"), _cases())
def test_an_effect_keeps_its_contract(system, label):
    """Units; Jacobians to 1e-5; finite at rest; linear and absent to 1e-12 (spiral.io.testing)."""
    checks = check_effect(registry().effect_from_label(label, {}), system)
    assert not failed(checks)
    names = {c.name for c in checks}
    assert {"units", "jacobians", "finite at rest", "linear in amplitudes"} <= names
    assert "absent at zero" in names


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


class _Coil(Oscillator):
    """An oscillator whose force is a current's, which lags a voltage; no effect acts on that."""

    others = (State("current", "A"),)
    inputs = (Input("voltage", "V", interpolation="band_limited"),)

    @property
    def parameters(self):
        own = {"constant": ("N/A", 3.0), "resistance": ("ohm", 2.0), "inductance": ("H", 0.1)}
        more = (Parameter(name, unit, start=start) for name, (unit, start) in own.items())
        return (*super().parameters, *more)

    def force(self, q, v, u, p):
        return [p.constant * q.current]

    def flows(self, q, v, u, p):
        return {"current": (u.voltage - p.resistance * q.current) / p.inductance}


class _WrongCoil(_Coil):
    def flows(self, q, v, u, p):
        return {"current": u.voltage - p.resistance * q.current}


def test_a_state_beside_the_coordinates_needs_no_injection():
    """Its flow has its unit per second, which is checked."""
    check_system_units(_Coil())
    with pytest.raises(PluginError, match="rate of 'current'"):
        check_system_units(_WrongCoil())
