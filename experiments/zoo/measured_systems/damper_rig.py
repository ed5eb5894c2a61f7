"""A damper between a shaker and a load cell: motion imposed and known, force measured.

A sensor of this project reports a state, so the force is one: the load cell's filter.
"""

from __future__ import annotations

from spiral.math import length, tanh
from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class ViscousPart(FlowEffect):
    """Oil through the piston's holes: F = c v."""

    channels = ("damper_force",)
    inputs = ("stroke_rate",)
    parameters = (Parameter("damping", "N*s/mm", lower=0.0),)

    def flow(self, x, u, p):
        """The viscous force, N."""
        return {"damper_force": p.damping * u.stroke_rate}


class GasSpring(FlowEffect):
    """The accumulator's gas: F = k s + f."""

    channels = ("damper_force",)
    inputs = ("stroke",)
    parameters = (Parameter("stiffness", "N/mm"), Parameter("preload", "N"))

    def flow(self, x, u, p):
        """Spring and preload, N."""
        return {"damper_force": p.stiffness * u.stroke + p.preload}


class DahlFriction(FlowEffect):
    """Friction that builds up over a distance: F = f w, w' = r (v - |v| w) (Dahl 1968)."""

    channels = ("damper_force",)
    inputs = ("stroke_rate",)
    states = (State("deflection", ""),)
    parameters = (
        Parameter("level", "N", lower=0.0),
        Parameter("stiffness", "1/mm", lower=0.0, role="shape", start=1.0, grid=(1.0, 3.0, 10.0)),
    )

    def flow(self, x, u, p):
        """The friction, N."""
        return {"damper_force": p.level * x.own.deflection}

    def rate(self, at, u, p):
        """How far it has built up."""
        speed = length([u.stroke_rate])
        return {"deflection": p.stiffness * (u.stroke_rate - speed * at.own.deflection)}


class DryPart(FlowEffect):
    """Dry friction: F = f tanh(v / w)."""

    channels = ("damper_force",)
    inputs = ("stroke_rate",)
    parameters = (
        Parameter("level", "N", lower=0.0),
        Parameter("width", "mm/s", lower=0.0, role="shape", start=3.0, grid=(1.0, 3.0, 10.0)),
    )

    def flow(self, x, u, p):
        """The friction, N."""
        return {"damper_force": p.level * tanh(u.stroke_rate / p.width)}


class TurbulentPart(FlowEffect):
    """Turbulent flow through the holes: F = d |v| v."""

    channels = ("damper_force",)
    inputs = ("stroke_rate",)
    parameters = (Parameter("damping", "N*s^2/mm^2"),)

    def flow(self, x, u, p):
        """The drag, N."""
        return {"damper_force": p.damping * length([u.stroke_rate]) * u.stroke_rate}


class DamperRig(System):
    """T y' = F(s, v) - y: the load cell y follows the damper's force within T."""

    states = (State("damper_force", "N"),)
    observed = ("damper_force",)
    inputs = (Input("stroke", "mm"), Input("stroke_rate", "mm/s"))
    injections = (State("damper_force", "N"),)
    parameters = (Parameter("filter", "s", lower=0.0, start=0.01),)
    ports = (Port("cell", ("force",), lambda x, p: [x.damper_force], "N", "N"),)
    seed = (ViscousPart(), GasSpring())

    def rate(self, x, u, p, injected):
        """The load cell follows."""
        return {"damper_force": (injected["damper_force"] - x.damper_force) / p.filter}
