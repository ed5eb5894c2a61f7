"""Curves for what is in no catalog; tried where no effect with a name explains a record."""

from __future__ import annotations

from spiral.math import length, positive, tanh
from spiral.physics.learned import (
    COUNT,
    LearnedFlow,
    LearnedForce,
    LearnedParameterChange,
    LearnedStateFlow,
    coefficients,
    curve,
)
from spiral.types.parameter import Parameter


def _curve_per_axis(states, span, p):
    """B(s_i / S) of every axis."""
    values = [getattr(p, f"c{k}") for k in range(COUNT)]
    return [curve(s / span, [c[i] for c in values]) for i, s in enumerate(states)]


def _shared_curve(z, p):
    """B(z) of a curve that all axes share."""
    return curve(z, [getattr(p, f"c{k}") for k in range(COUNT)])


class LearnedSpring(LearnedForce):
    """A force that follows displacement by a curve: F_i = B_i(q_i / S)."""

    follows = "position"
    parameters = coefficients("force", "position")

    def force(self, at, u, p):
        """B_i(q_i / S) per axis."""
        return _curve_per_axis(at.position, p.span, p)


class LearnedFriction(LearnedForce):
    """A force that follows velocity by a curve: F_i = B_i(v_i / S)."""

    follows = "velocity"
    parameters = coefficients("force", "velocity")

    def force(self, at, u, p):
        """B_i(v_i / S) per axis."""
        return _curve_per_axis(at.velocity, p.span, p)


class LearnedDamping(LearnedForce):
    """A damper that depends on displacement by a curve: F_i = B_i(q_i / S) v_i."""

    follows = "position"
    times = "velocity"
    parameters = coefficients("force/velocity", "position")

    def force(self, at, u, p):
        """B_i(q_i / S) v_i per axis."""
        dampings = _curve_per_axis(at.position, p.span, p)
        return [c * v for c, v in zip(dampings, at.velocity, strict=True)]


class LearnedDryFriction(LearnedForce):
    """Dry friction that depends on displacement by a curve: F_i = B_i(q_i / S) tanh(v_i / w)."""

    follows = "position"
    times = "the direction of velocity"
    parameters = (
        *coefficients("force", "position"),
        Parameter("width", "velocity", lower=0.0, start=1.0, role="shape", grid=(0.02,)),
    )

    def force(self, at, u, p):
        """B_i(q_i / S) tanh(v_i / w) per axis."""
        levels = _curve_per_axis(at.position, p.span, p)
        return [c * tanh(v / p.width) for c, v in zip(levels, at.velocity, strict=True)]


class LearnedRadialSpring(LearnedForce):
    """A spring whose stiffness depends on the radius by a curve: F_i = B(|q| / S) q_i."""

    axes = 2
    follows = "radius"
    parameters = coefficients("force/position", "position", per_axis=False)

    def force(self, at, u, p):
        """B(|q| / S) q_i per axis."""
        stiffness = _shared_curve(length(at.position) / p.span, p)
        return [stiffness * q for q in at.position]


class LearnedLoss(LearnedStateFlow):
    """A flow out of any state of first order that follows it by a curve: x' = ... - B(x / S)."""

    parameters = coefficients("force", "position", per_axis=False)

    def flow(self, at, u, p):
        """-B(x / S)."""
        return [-_shared_curve(at.position[0] / p.span, p)]


class LearnedExchange(LearnedStateFlow):
    """A flow between two states that follows their difference by a curve.

    a' = ... - B((a - b) / S) and b' = ... + B((a - b) / S).
    """

    axes = 2
    parameters = coefficients("force", "position", per_axis=False)

    def flow(self, at, u, p):
        """What leaves the one enters the other."""
        a, b = at.position
        moved = _shared_curve((a - b) / p.span, p)
        return [-moved, moved]


class LearnedChange(LearnedParameterChange):
    """A parameter that follows a variable by a curve: value = p (1 + B(v/S) - B(0)).

    The factor is rounded above zero (``spiral.math.positive``).
    """

    parameters = coefficients("", "position", per_axis=False, count=COUNT - 1)

    def factor(self, at, u, p):
        """1 + B(v/S) - B(0)."""
        values = [*(getattr(p, f"c{k}") for k in range(COUNT - 1)), 0]
        return positive(1 + curve(at.position[0] / p.span, values) - curve(0.0, values))


class LearnedTransfer(LearnedFlow):
    """A flow from the upper tank into the lower one that follows the upper level by a curve.

    x1' = ... - B(2 x1 / S - 1) and x2' = ... + B(2 x1 / S - 1).
    """

    channels = ("upper", "lower")
    state, into = "upper", "lower"
    parameters = coefficients("position/s", "position", per_axis=False, extent=1.2)

    def flow(self, x, u, p):
        """What leaves the upper tank enters the lower one."""
        moved = _shared_curve(2 * x.upper / p.span - 1, p)
        return {"upper": -moved, "lower": moved}


class LearnedUpperFlow(LearnedFlow):
    """A flow into (negative: out of) the upper tank that follows its level by a curve.

    x1' = ... + B(2 x1 / S - 1).
    """

    channels = ("upper",)
    state = into = "upper"
    parameters = coefficients("position/s", "position", per_axis=False, extent=1.2)

    def flow(self, x, u, p):
        """B(2 x1 / S - 1)."""
        return {"upper": _shared_curve(2 * x.upper / p.span - 1, p)}


class LearnedLowerFlow(LearnedFlow):
    """A flow into (negative: out of) the lower tank that follows its level by a curve.

    x2' = ... + B(2 x2 / S - 1).
    """

    channels = ("lower",)
    state = into = "lower"
    parameters = coefficients("position/s", "position", per_axis=False)

    def flow(self, x, u, p):
        """B(2 x2 / S - 1)."""
        return {"lower": _shared_curve(2 * x.lower / p.span - 1, p)}
