"""A motor that drives a fan by a belt: the motor's angle is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class BeltDrive(MechanicalSystem):
    """J1 a'' = T - r1 F - b1 a', J2 b'' = r2 F - b2 b', F = k s + c s', s = r1 a - r2 b."""

    coordinates = (State("motor", "rad"), State("fan", "rad"))
    observed = ("motor",)
    inputs = (Input("torque", "N*m", "band_limited"),)
    injections = (State("motor", "N*m"), State("fan", "N*m"))
    parameters = (
        Parameter("motor_inertia", "kg*m^2", lower=0.0, start=0.01),
        Parameter("fan_inertia", "kg*m^2", lower=0.0, start=0.04),
        Parameter("motor_radius", "m", lower=0.0, start=0.05),
        Parameter("fan_radius", "m", lower=0.0, start=0.1),
    )
    ports = (
        Port("motor", ("angle",), lambda q, p: [q.motor], "rad", "N*m"),
        Port("fan", ("angle",), lambda q, p: [q.fan], "rad", "N*m"),
        Port(
            "belt", ("stretch",),
            lambda q, p: [p.motor_radius * q.motor - p.fan_radius * q.fan], "m", "N",
        ),
    )  # fmt: skip
    seed = (
        LinearDamping(),
        LinearDamping(port="fan"),
        LinearStiffness(port="belt"),
        LinearDamping(port="belt"),
    )

    def mass(self, q, p):
        """The inertias, kg m^2."""
        return [[p.motor_inertia, 0], [0, p.fan_inertia]]

    def force(self, q, v, u, p):
        """The motor's torque, N m."""
        return [u.torque, 0]
