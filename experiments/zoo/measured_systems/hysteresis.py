"""Hysteresis with a state of its own, which the shipped catalog does not have."""

from __future__ import annotations

from spiral.math import length
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter, State


class BoucWen(ForceEffect):
    """F = -a z, z' = v - b |v| z - d v |z| (Bouc 1967, Wen 1976, with the power one)."""

    states = (State("slip", "position", per_axis=True),)
    parameters = (
        Parameter("stiffness", "force/position", lower=0.0, per_axis=True),
        Parameter("fading", "1/position", role="shape", start=1000.0, grid=(300.0, 1000.0, 3000.0)),
        Parameter("pinching", "1/position", role="shape", start=0.0),
    )

    def force(self, at, u, p):
        """-a z."""
        return [-a * z for a, z in zip(p.stiffness, at.own.slip, strict=True)]

    def rate(self, at, u, p):
        """How the slip grows."""
        pairs = zip(at.velocity, at.own.slip, strict=True)
        return {
            "slip": [
                v - p.fading * length([v]) * z - p.pinching * v * length([z]) for v, z in pairs
            ]
        }
