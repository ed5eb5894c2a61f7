"""Springs: forces that depend on position."""

from __future__ import annotations

from spiral.math import cos, length, ramp, sin, tanh, where
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter

WIDTH = Parameter("width", "position", lower=0.0, start=0.0, role="shape", grid=(0.02,), most=0.25)
"""Half the stretch over which a corner is rounded: 2 % of the largest motion while a candidate.

A corner that is rounded over more than half of the motion, w above a quarter of it, is none.
"""


COUNT = Parameter(
    "count", "", lower=0.0, role="shape", grid=tuple(map(float, range(1, 25))), repeats=True
)
"""How often a wave over an angle repeats in a turn, N."""


def wave(angle, p):
    """a cos(N q) + b sin(N q)."""
    return p.cosine * cos(p.count * angle) + p.sine * sin(p.count * angle)


def excess_over_gap(value, gap, width):
    """What of a value lies beyond +-gap, with its sign; corners are rounded over +-w."""
    return ramp(value - gap, width) - ramp(-value - gap, width)


class LinearStiffness(ForceEffect):
    """Linear spring: F_i = -k_i q_i."""

    parameters = (Parameter("stiffness", "force/position", per_axis=True),)

    def force(self, at, u, p):
        """-k_i q_i per axis."""
        return [-k * q for k, q in zip(p.stiffness, at.position, strict=True)]


class StiffnessDrift(ForceEffect):
    """Stiffness that changes along a record: F_i = -r_i t q_i, t from the record's first sample.

    Every record begins with the spring as the model has it, as where a machine warms up from cold
    each time: rubber, oil, a shaft, a preload that thermal growth takes up. What wears on from one
    record to the next is another stiffness in each. Where the speed runs down in step with time,
    ``speed_stiffness`` looks much the same.
    """

    inputs = ("time",)
    parameters = (Parameter("rate", "force/position/s", per_axis=True),)

    def force(self, at, u, p):
        """-r_i t q_i per axis."""
        return [-r * u.time * q for r, q in zip(p.rate, at.position, strict=True)]


class QuadraticStiffness(ForceEffect):
    """Stiffness that differs between pull and push: F_i = -k_i q_i^2."""

    parameters = (Parameter("stiffness", "force/position^2", per_axis=True),)

    def force(self, at, u, p):
        """-k_i q_i^2 per axis."""
        return [-k * q * q for k, q in zip(p.stiffness, at.position, strict=True)]


class AsymmetricStiffness(ForceEffect):
    """A spring of two slopes that meet at zero: F = -k |q|, beside the seed's spring.

    k stiffer on the positive side, k softer on the other: a joint that opens, a breathing crack in
    a beam (Chu and Shen, AIAA J. 30, 1992), a rope that goes slack.
    """

    axes = 1
    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        """-k |q|."""
        return [-p.stiffness * length(at.position)]


class CubicStiffness(ForceEffect):
    """Stiffness that grows with amplitude: F = -k |q|^2 q (isotropic Duffing spring)."""

    parameters = (Parameter("stiffness", "force/position^3"),)

    def force(self, at, u, p):
        """-k |q|^2 q."""
        r2 = sum(q * q for q in at.position)
        return [-p.stiffness * r2 * q for q in at.position]


class Clearance(ForceEffect):
    """A second spring that engages after a gap: F_i = -k (|q_i| - g)_+ sign q_i.

    The corner of (.)_+ is rounded over +-w (``spiral.math.ramp``).
    """

    special = ("linear_stiffness",)
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0),
        Parameter("gap", "position", lower=0.0, role="shape", grid=(0.2, 0.4, 0.6, 0.8, 0.9)),
        WIDTH,
    )

    def force(self, at, u, p):
        """-k (|q_i| - g)_+ sign q_i per axis."""
        return [-p.stiffness * excess_over_gap(q, p.gap, p.width) for q in at.position]


class Stop(ForceEffect):
    """A stop on one side: F_i = -k (q_i - g)_+, or k (g - q_i)_+ where g lies below zero.

    A bump stop, a valve's seat, one wall of a clearance. The corner of (.)_+ is rounded over +-w.
    """

    parameters = (
        Parameter("stiffness", "force/position", lower=0.0),
        Parameter("gap", "position", role="shape", grid=(0.4, 0.7, 0.9, -0.4, -0.7, -0.9)),
        WIDTH,
    )

    def force(self, at, u, p):
        """-k (q_i - g)_+ or k (g - q_i)_+ per axis."""
        return [
            p.stiffness * where(p.gap > 0, -ramp(q - p.gap, p.width), ramp(p.gap - q, p.width))
            for q in at.position
        ]


class Preload(ForceEffect):
    """A spring set under load against a stop at zero: F_i = -f_i tanh(q_i / w).

    It has to be overcome before anything moves away from rest: a throttle's limp-home position, a
    centring spring, a detent.
    """

    special = ("linear_stiffness",)
    parameters = (
        Parameter("force", "force", lower=0.0, per_axis=True),
        Parameter("width", "position", lower=0.0, role="shape", grid=(0.02, 0.1)),
    )

    def force(self, at, u, p):
        """-f_i tanh(q_i / w) per axis."""
        return [-f * tanh(q / p.width) for f, q in zip(p.force, at.position, strict=True)]


class ConstantLoad(ForceEffect):
    """Constant force (weight, misaligned support): F_i = f_i."""

    parameters = (Parameter("force", "force", per_axis=True),)

    def force(self, at, u, p):
        """f_i per axis."""
        return list(p.force)


class GravityTorque(ForceEffect):
    """Weight of a pendulum: torque = -g sin q."""

    axes = 1
    parameters = (Parameter("torque", "force"),)

    def force(self, at, u, p):
        """-g sin q."""
        return [-p.torque * sin(at.position[0])]


class Cogging(ForceEffect):
    """A torque that repeats N times in a turn: F = a cos(N q) + b sin(N q), q in rad.

    Magnets against teeth (Hanselman, Brushless Permanent Magnet Motor Design, ch. 5), a detent, a
    gear's tooth passing. N is tried from 1 to 24 and, where the record shows it, beyond; once a
    turn it is also a weight off the axis.
    """

    axes = 1
    parameters = (
        Parameter("cosine", "force"),
        Parameter("sine", "force"),
        COUNT,
    )

    def force(self, at, u, p):
        """a cos(N q) + b sin(N q)."""
        return [wave(at.position[0], p)]


class CrossStiffness(ForceEffect):
    """Symmetric coupling of the axes, direct or mediated by a hidden tilt: F = -k (y, x).

    Turned principal axes of the support, a tilt that no sensor sees and a probe pair turned by a
    small angle all look like this; displacements alone do not separate them.
    """

    axes = 2
    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        """-k (y, x)."""
        x, y = at.position
        return [-p.stiffness * y, -p.stiffness * x]


class CrossCoupledStiffness(ForceEffect):
    """Circulatory coupling (seals, fluid film), which drives whirl: F = -k (y, -x).

    Between the axes of a plane or any two coordinates of one unit: flutter (bending and twist of a
    blade), a follower force, a brake that squeals. It has no potential (Ziegler, Principles of
    Structural Stability, ch. 1), so a spring between the two is something else.
    """

    axes = 2
    pairs = True
    parameters = (Parameter("stiffness", "force/position"),)

    def force(self, at, u, p):
        """-k (y, -x)."""
        x, y = at.position
        return [-p.stiffness * y, p.stiffness * x]


class SpeedStiffness(ForceEffect):
    """Stiffness that grows with the square of speed: F = -k W^2 q."""

    inputs = ("speed",)
    parameters = (Parameter("coefficient", "force/position*s^2"),)

    def force(self, at, u, p):
        """-k W^2 q."""
        return [-p.coefficient * u.speed * u.speed * q for q in at.position]


class Rub(ForceEffect):
    """Contact with a round stator after a gap: F = -k (|q| - g)_+ q / |q|.

    The corner of (.)_+ is rounded over +-w (``spiral.math.ramp``).
    """

    axes = 2
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0),
        Parameter("gap", "position", lower=0.0, role="shape", grid=(0.2, 0.4, 0.6, 0.8, 0.9)),
        WIDTH,
    )

    def force(self, at, u, p):
        """-k (|q| - g)_+ q / |q|."""
        radius = length(at.position)
        depth = ramp(radius - p.gap, p.width)
        return [-p.stiffness * depth * q / radius for q in at.position]
