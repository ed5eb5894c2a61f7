"""A building of five storeys that the ground shakes: sensors on the second floor and the roof."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem

_STOREYS = tuple(f"storey_{i}" for i in (1, 2, 3, 4, 5))


class ShearBuilding(MechanicalSystem):
    """m (x_i'' + a) = storey forces: displacements x_i against the ground, which accelerates by a.

    The shear-frame model (Chopra, Dynamics of Structures, ch. 9).
    """

    coordinates = tuple(State(f"floor_{i}", "m") for i in (1, 2, 3, 4, 5))
    observed = ("floor_2", "floor_5")
    inputs = (Input("ground", "m/s^2", "band_limited"),)
    injections = tuple(State(f"floor_{i}", "N") for i in (1, 2, 3, 4, 5))
    parameters = (Parameter("mass", "kg", lower=0.0, start=3e4),)
    ports = (
        Port("storey_1", ("x",), lambda q, p: [q.floor_1], "m", "N"),
        Port("storey_2", ("x",), lambda q, p: [q.floor_2 - q.floor_1], "m", "N"),
        Port("storey_3", ("x",), lambda q, p: [q.floor_3 - q.floor_2], "m", "N"),
        Port("storey_4", ("x",), lambda q, p: [q.floor_4 - q.floor_3], "m", "N"),
        Port("storey_5", ("x",), lambda q, p: [q.floor_5 - q.floor_4], "m", "N"),
    )
    seed = (
        LinearStiffness(),
        LinearDamping(),
        *(LinearStiffness(port=k) for k in _STOREYS[1:]),
        *(LinearDamping(port=k) for k in _STOREYS[1:]),
    )

    def mass(self, q, p):
        """m times the identity, kg."""
        return [[p.mass if i == j else 0 for j in range(5)] for i in range(5)]

    def force(self, q, v, u, p):
        """-m a on every floor, N."""
        return [-p.mass * u.ground] * 5
