"""Two motors, a belt and a pulley on a spring; a pulse counter tells speed without its sign."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.math import length
from spiral.types.effect import SensorEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class RectifiedReading(SensorEffect):
    """A pulse counter is blind to the sign: reading = y + s (|y| - y), s = 1 wholly blind."""

    channels = ("pulley_rate",)
    parameters = (Parameter("share", "", lower=0.0, upper=1.0),)

    def reading(self, y, at, u, p):
        """y + s (|y| - y)."""
        return [value + p.share * (length([value]) - value) for value in y]


class CoupledDrives(MechanicalSystem):
    """J a'' = voltage - k (a - b) - c a', b'' = k (a - b) - d b': motors and pulley (Wigren 2010).

    In units of the counter: J and all coefficients are per unit of the motors' torque constant.
    """

    coordinates = (State("motor", "rad"), State("pulley", "rad"))
    observed = ("pulley_rate",)
    inputs = (Input("voltage", "V", "zero_order"),)
    injections = (State("motor", "V"), State("pulley", "V"))
    parameters = (
        Parameter("motor_inertia", "V*s^2/rad", lower=0.0),
        Parameter("pulley_inertia", "V*s^2/rad", lower=0.0),
    )
    ports = (
        Port("motor", ("angle",), lambda q, p: [q.motor], "rad", "V"),
        Port("belt", ("stretch",), lambda q, p: [q.motor - q.pulley], "rad", "V"),
        Port("pulley", ("angle",), lambda q, p: [q.pulley], "rad", "V"),
    )
    seed = (LinearDamping(), LinearStiffness(port="belt"), LinearDamping(port="belt"))

    def mass(self, q, p):
        """Both inertias."""
        return [[p.motor_inertia, 0], [0, p.pulley_inertia]]

    def force(self, q, v, u, p):
        """The motors' torque."""
        return [u.voltage, 0]
