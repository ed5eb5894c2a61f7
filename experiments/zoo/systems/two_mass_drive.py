"""A motor, a soft shaft and a load: the motor's encoder is all that is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class TwoMassDrive(MechanicalSystem):
    """J1 a'' = T + k (b - a) + c (b' - a') - p a - d a', J2 b'' = -k (b - a) - c (b' - a').

    The position controller acts on the motor like a spring p and a damper d.
    """

    coordinates = (State("motor", "rad"), State("load", "rad"))
    observed = ("motor",)
    inputs = (Input("torque", "N*m", "band_limited"),)
    injections = (State("motor", "N*m"), State("load", "N*m"))
    parameters = (
        Parameter("motor_inertia", "kg*m^2", lower=0.0, start=0.02),
        Parameter("load_inertia", "kg*m^2", lower=0.0, start=0.05),
    )
    ports = (
        Port("motor", ("angle",), lambda q, p: [q.motor], "rad", "N*m"),
        Port("shaft", ("twist",), lambda q, p: [q.load - q.motor], "rad", "N*m"),
        Port("load", ("angle",), lambda q, p: [q.load], "rad", "N*m"),
    )
    seed = (
        LinearStiffness(),
        LinearDamping(),
        LinearStiffness(port="shaft"),
        LinearDamping(port="shaft"),
    )

    def mass(self, q, p):
        """The inertias, kg m^2."""
        return [[p.motor_inertia, 0], [0, p.load_inertia]]

    def force(self, q, v, u, p):
        """The motor's torque, N m."""
        return [u.torque, 0]
