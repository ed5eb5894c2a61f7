"""Forces that turn with the shaft."""

from __future__ import annotations

from spiral.math import cos, sin
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter


class Unbalance(ForceEffect):
    """Mass off the axis: F = U W^2 (cos t, sin t) + U W' (sin t, -cos t), t the phase."""

    axes = 2
    inputs = ("speed", "speed_rate", "phase")
    parameters = (Parameter("moment", "force*s^2"),)

    def force(self, at, u, p):
        """U W^2 (cos t, sin t) + U W' (sin t, -cos t)."""
        c, s = cos(u.phase), sin(u.phase)
        centripetal = u.speed * u.speed
        return [
            p.moment * (centripetal * c + u.speed_rate * s),
            p.moment * (centripetal * s - u.speed_rate * c),
        ]


def _rotating_force(p, angle):
    c, s = cos(angle), sin(angle)
    return [p.cosine * c - p.sine * s, p.cosine * s + p.sine * c]


class ShaftBow(ForceEffect):
    """A bent shaft: a force of constant size that turns once per turn.

    F = a (cos t, sin t) + b (-sin t, cos t), t the phase.
    """

    axes = 2
    inputs = ("phase",)
    parameters = (Parameter("cosine", "force"), Parameter("sine", "force"))

    def force(self, at, u, p):
        """(a cos t - b sin t, a sin t + b cos t)."""
        return _rotating_force(p, u.phase)


class Misalignment(ForceEffect):
    """Coupling misalignment: a force of constant size that turns twice per turn.

    F = a (cos 2t, sin 2t) + b (-sin 2t, cos 2t), t the phase.
    """

    axes = 2
    inputs = ("phase",)
    parameters = (Parameter("cosine", "force"), Parameter("sine", "force"))

    def force(self, at, u, p):
        """(a cos 2t - b sin 2t, a sin 2t + b cos 2t)."""
        return _rotating_force(p, 2 * u.phase)


class Crack(ForceEffect):
    """A crack that breathes, so stiffness differs between two axes of the shaft: F = -R(2t) q."""

    axes = 2
    inputs = ("phase",)
    parameters = (Parameter("cosine", "force/position"), Parameter("sine", "force/position"))

    def force(self, at, u, p):
        """R(2t) = k_c [[cos, sin], [sin, -cos]] + k_s [[-sin, cos], [cos, sin]] of 2t."""
        x, y = at.position
        c, s = cos(2 * u.phase), sin(2 * u.phase)
        return [
            -(p.cosine * (c * x + s * y) + p.sine * (-s * x + c * y)),
            -(p.cosine * (s * x - c * y) + p.sine * (c * x + s * y)),
        ]
