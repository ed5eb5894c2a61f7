"""Dampers and friction: forces that depend on velocity."""

from __future__ import annotations

from spiral.math import exp, length, tanh
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter


class LinearDamping(ForceEffect):
    """Viscous damper: F_i = -c_i v_i."""

    parameters = (Parameter("damping", "force/velocity", per_axis=True),)

    def force(self, at, u, p):
        """-c_i v_i per axis."""
        return [-c * v for c, v in zip(p.damping, at.velocity, strict=True)]


class QuadraticDamping(ForceEffect):
    """Drag of a turbulent flow: F = -c |v| v."""

    parameters = (Parameter("damping", "force/velocity^2"),)

    def force(self, at, u, p):
        """-c |v| v."""
        speed = length(at.velocity)
        return [-p.damping * speed * v for v in at.velocity]


class AmplitudeDamping(ForceEffect):
    """Damping that grows with amplitude: F = -c |q|^2 v."""

    parameters = (Parameter("damping", "force/velocity/position^2"),)

    def force(self, at, u, p):
        """-c |q|^2 v."""
        r2 = sum(q * q for q in at.position)
        return [-p.damping * r2 * v for v in at.velocity]


class CoulombFriction(ForceEffect):
    """Dry friction, constant in size and against the motion: F_i = -F_c,i tanh(v_i / w)."""

    special = ("linear_damping",)
    parameters = (
        Parameter("level", "force", lower=0.0, per_axis=True),
        Parameter("width", "velocity", lower=0.0, role="shape", grid=(0.003, 0.02, 0.1)),
    )

    def force(self, at, u, p):
        """-F_i tanh(v_i / w) per axis."""
        return [-level * tanh(v / p.width) for level, v in zip(p.level, at.velocity, strict=True)]


class StribeckFriction(ForceEffect):
    """Drop of dry friction as motion sets in: F_i = -f_i exp(-(v_i / s)^2) tanh(v_i / w).

    The difference of static and kinetic friction in a lubricated contact (Stribeck 1902; Armstrong,
    Dupont and Canudas de Wit, Automatica 30, 1994), beside ``coulomb_friction``, the kinetic part.
    """

    special = ("coulomb_friction",)
    parameters = (
        Parameter("level", "force", lower=0.0, per_axis=True),
        Parameter("speed", "velocity", lower=0.0, role="shape", grid=(0.05, 0.2)),
        Parameter("width", "velocity", lower=0.0, role="shape", grid=(0.01,)),
    )

    def force(self, at, u, p):
        """-f_i exp(-(v_i / s)^2) tanh(v_i / w) per axis."""
        return [
            -level * exp(-(v / p.speed) * (v / p.speed)) * tanh(v / p.width)
            for level, v in zip(p.level, at.velocity, strict=True)
        ]


class PositionFriction(ForceEffect):
    """Dry friction that grows with deflection: F = -f |q| tanh(v / w).

    A wedge, a pre-loaded spline, a leaf spring pressed together; structural damping in Reid's form
    (Aeronautical Quarterly 7, 1956), whose loss in a cycle does not depend on speed.
    """

    axes = 1
    parameters = (
        Parameter("slope", "force/position", lower=0.0),
        Parameter("width", "velocity", lower=0.0, role="shape", grid=(0.005, 0.03)),
    )

    def force(self, at, u, p):
        """-f |q| tanh(v / w)."""
        (q,), (v,) = at.position, at.velocity
        return [-p.slope * length([q]) * tanh(v / p.width)]


class AsymmetricDamping(ForceEffect):
    """A damper that resists one way more than the other: F = -c |v|, beside the seed's damper.

    c more towards positive velocity, c less towards negative: rebound and compression of a shock
    absorber, a check valve (Dixon, The Shock Absorber Handbook, ch. 1).
    """

    axes = 1
    parameters = (Parameter("damping", "force/velocity"),)

    def force(self, at, u, p):
        """-c |v|."""
        return [-p.damping * length(at.velocity)]


class CrossDamping(ForceEffect):
    """Symmetric coupling of the axes by dampers: F = -c (y', x')."""

    axes = 2
    parameters = (Parameter("damping", "force/velocity"),)

    def force(self, at, u, p):
        """-c (y', x')."""
        vx, vy = at.velocity
        return [-p.damping * vy, -p.damping * vx]


class AntisymmetricDamping(ForceEffect):
    """Coupling like a gyroscope of constant speed: F = -c (y', -x').

    A spinning wheel in a gimbal, Coriolis forces in a turning frame, a wire in a magnetic field,
    between the axes of a plane or any two coordinates of one unit. It does no work
    (Meirovitch, Analytical Methods in Vibrations, ch. 3).
    """

    axes = 2
    pairs = True
    parameters = (Parameter("damping", "force/velocity"),)

    def force(self, at, u, p):
        """-c (y', -x')."""
        vx, vy = at.velocity
        return [-p.damping * vy, p.damping * vx]


class Gyroscopic(ForceEffect):
    """Gyroscopic coupling of a turning disk, transmitted by the tilt: F = -g W (y', -x')."""

    axes = 2
    inputs = ("speed",)
    parameters = (Parameter("coefficient", "force/velocity*s"),)
    leaves = ("cross_damping", "speed_stiffness")  # of a tilt that nobody measures

    def force(self, at, u, p):
        """-g W (y', -x')."""
        vx, vy = at.velocity
        return [-p.coefficient * u.speed * vy, p.coefficient * u.speed * vx]


class InternalDamping(ForceEffect):
    """Damping in the rotating parts (fits, couplings): F = -c (x' + W y, y' - W x)."""

    axes = 2
    inputs = ("speed",)
    parameters = (Parameter("damping", "force/velocity", lower=0.0),)

    def force(self, at, u, p):
        """-c (x' + W y, y' - W x)."""
        x, y = at.position
        vx, vy = at.velocity
        return [-p.damping * (vx + u.speed * y), -p.damping * (vy - u.speed * x)]
