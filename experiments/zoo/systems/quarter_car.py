"""A quarter of a car on a rough road: the body's height is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class QuarterCar(MechanicalSystem):
    """m_b b'' = F, m_w w'' = -F + k_t (road - w), F = k (w - b) + c (w' - b')."""

    coordinates = (State("body", "m"), State("wheel", "m"))
    observed = ("body",)
    inputs = (Input("road", "m", "band_limited"),)
    injections = (State("body", "N"), State("wheel", "N"))
    parameters = (
        Parameter("body_mass", "kg", lower=0.0, start=300.0),
        Parameter("wheel_mass", "kg", lower=0.0, start=40.0),
        Parameter("tyre_stiffness", "N/m", lower=0.0, start=1.8e5),
    )
    ports = (
        Port("suspension", ("travel",), lambda q, p: [q.body - q.wheel], "m", "N"),
        Port("body", ("height",), lambda q, p: [q.body], "m", "N"),
    )
    seed = (LinearStiffness(), LinearDamping())

    def mass(self, q, p):
        """Body and wheel, kg."""
        return [[p.body_mass, 0], [0, p.wheel_mass]]

    def force(self, q, v, u, p):
        """The tyre's force on the wheel, N."""
        return [0, p.tyre_stiffness * (u.road - q.wheel)]
