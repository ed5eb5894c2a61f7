"""A magnet that holds a float with a sprung payload, under a controller: the gap is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class Levitator(MechanicalSystem):
    """m z'' = (m + m_p) g - C (i / (gap + z))^2, i = i0 + kp z + kd z' + command.

    z and w are the float's and the payload's deviations downwards from where they hang at rest;
    without its controller the float falls.
    """

    coordinates = (State("float", "m"), State("payload", "m"))
    observed = ("float",)
    inputs = (Input("command", "A", "band_limited"),)
    injections = (State("float", "N"), State("payload", "N"))
    parameters = (
        Parameter("float_mass", "kg", lower=0.0, start=0.5),
        Parameter("payload_mass", "kg", lower=0.0, start=0.1),
        Parameter("magnet", "N*m^2/A^2", lower=0.0, start=4.0875e-4),
        Parameter("gap", "m", lower=0.0, start=0.01),
        Parameter("current", "A", lower=0.0, start=1.2),
        Parameter("proportional", "A/m", start=240.0),
        Parameter("derivative", "A*s/m", start=1.5),
        Parameter("gravity", "m/s^2", start=9.81),
    )
    ports = (
        Port("float", ("z",), lambda q, p: [q.float], "m", "N"),
        Port("hanger", ("stretch",), lambda q, p: [q.payload - q.float], "m", "N"),
    )
    seed = (LinearStiffness(port="hanger"), LinearDamping(port="hanger"))

    def mass(self, q, p):
        """Float and payload, kg."""
        return [[p.float_mass, 0], [0, p.payload_mass]]

    def force(self, q, v, u, p):
        """Weight of both less the magnet's pull, on the float, N."""
        current = p.current + p.proportional * q.float + p.derivative * v.float + u.command
        pull = p.magnet * (current / (p.gap + q.float)) ** 2
        return [(p.float_mass + p.payload_mass) * p.gravity - pull, 0]
