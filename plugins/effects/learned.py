"""Curves for a force that is in no catalog; tried where no effect with a name explains a record."""

from __future__ import annotations

from spiral.learned import COUNT, LearnedForce, coefficients, curve
from spiral.math import tanh
from spiral.parameter import Parameter


def _curves(states, span, p):
    """B(s_i / S) of every axis."""
    values = [getattr(p, f"c{k}") for k in range(COUNT)]
    return [curve(s / span, [c[i] for c in values]) for i, s in enumerate(states)]


class LearnedSpring(LearnedForce):
    """A force that follows displacement by a curve: F_i = B_i(q_i / S)."""

    follows = "position"
    parameters = coefficients("force", "position")

    def force(self, at, u, p):
        """B_i(q_i / S) per axis."""
        return _curves(at.position, p.span, p)


class LearnedFriction(LearnedForce):
    """A force that follows velocity by a curve: F_i = B_i(v_i / S)."""

    follows = "velocity"
    parameters = coefficients("force", "velocity")

    def force(self, at, u, p):
        """B_i(v_i / S) per axis."""
        return _curves(at.velocity, p.span, p)


class LearnedDamping(LearnedForce):
    """A damper that depends on displacement by a curve: F_i = B_i(q_i / S) v_i."""

    follows = "position"
    times = "velocity"
    parameters = coefficients("force/velocity", "position")

    def force(self, at, u, p):
        """B_i(q_i / S) v_i per axis."""
        found = _curves(at.position, p.span, p)
        return [c * v for c, v in zip(found, at.velocity, strict=True)]


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
        found = _curves(at.position, p.span, p)
        return [c * tanh(v / p.width) for c, v in zip(found, at.velocity, strict=True)]
