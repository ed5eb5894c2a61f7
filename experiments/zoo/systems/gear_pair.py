"""A pinion and a gear with a sprung (split) pinion: the pinion's angle is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class GearPair(MechanicalSystem):
    """J1 a'' = T - r1 F - p a - d a', J2 b'' = r2 F - b b', F = k s + c s'.

    The springs of the split pinion carry the mesh, s = r1 a - r2 b; beyond their travel the teeth
    touch. A controller holds the pinion like a spring p and a damper d.
    """

    coordinates = (State("pinion", "rad"), State("gear", "rad"))
    observed = ("pinion",)
    inputs = (Input("torque", "N*m", "band_limited"),)
    injections = (State("pinion", "N*m"), State("gear", "N*m"))
    parameters = (
        Parameter("pinion_inertia", "kg*m^2", lower=0.0, start=1e-3),
        Parameter("gear_inertia", "kg*m^2", lower=0.0, start=8e-3),
        Parameter("pinion_radius", "m", lower=0.0, start=0.03),
        Parameter("gear_radius", "m", lower=0.0, start=0.06),
    )
    ports = (
        Port("pinion", ("angle",), lambda q, p: [q.pinion], "rad", "N*m"),
        Port("gear", ("angle",), lambda q, p: [q.gear], "rad", "N*m"),
        Port(
            "mesh", ("slip",),
            lambda q, p: [p.pinion_radius * q.pinion - p.gear_radius * q.gear], "m", "N",
        ),
    )  # fmt: skip
    seed = (
        LinearStiffness(),
        LinearDamping(),
        LinearDamping(port="gear"),
        LinearStiffness(port="mesh"),
        LinearDamping(port="mesh"),
    )

    def mass(self, q, p):
        """The inertias, kg m^2."""
        return [[p.pinion_inertia, 0], [0, p.gear_inertia]]

    def force(self, q, v, u, p):
        """The torque on the pinion, N m."""
        return [u.torque, 0]
