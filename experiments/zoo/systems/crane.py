"""A trolley that carries a swinging load: the trolley's position is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping

from spiral.math import cos, sin
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class Crane(MechanicalSystem):
    """(M + m) x'' + m l (cos a a'' - sin a a'^2) = F, m l (cos a x'' + l a'' + g sin a) = 0.

    The rope hangs at the angle a from the vertical, positive where the load leads the trolley.
    """

    coordinates = (State("trolley", "m"), State("sway", "rad"))
    observed = ("trolley",)
    inputs = (Input("force", "N", "band_limited"),)
    injections = (State("trolley", "N"), State("sway", "N*m"))
    parameters = (
        Parameter("trolley_mass", "kg", lower=0.0, start=20.0),
        Parameter("load_mass", "kg", lower=0.0, start=10.0),
        Parameter("rope", "m", lower=0.0, start=1.5),
        Parameter("gravity", "m/s^2", lower=0.0, start=9.81),
    )
    ports = (
        Port("trolley", ("x",), lambda q, p: [q.trolley], "m", "N"),
        Port("hook", ("x",), lambda q, p: [q.trolley + p.rope * sin(q.sway)], "m", "N"),
        Port("hoist", ("angle",), lambda q, p: [q.sway], "rad", "N*m"),
    )
    seed = (LinearDamping(), LinearDamping(port="hoist"))

    def mass(self, q, p):
        """[[M + m, m l cos a], [m l cos a, m l^2]]."""
        coupling = p.load_mass * p.rope * cos(q.sway)
        return [[p.trolley_mass + p.load_mass, coupling], [coupling, p.load_mass * p.rope**2]]

    def force(self, q, v, u, p):
        """The drive's force and the swing's centrifugal one, N; the weight's moment, N m."""
        moment = p.load_mass * p.rope
        return [
            u.force + moment * sin(q.sway) * v.sway**2,
            -moment * p.gravity * sin(q.sway),
        ]
