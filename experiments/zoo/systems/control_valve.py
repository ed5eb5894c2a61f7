"""A pneumatic control valve: the stem's position is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class ControlValve(MechanicalSystem):
    """m x'' + c x' + k x = S p: stem on a spring, moved by the pressure p on a diaphragm S.

    The physical valve model (Garcia, Control Engineering Practice 16, 2008).
    """

    coordinates = (State("stem", "m"),)
    observed = ("stem",)
    inputs = (Input("pressure", "Pa", "zero_order"),)
    injections = (State("stem", "N"),)
    parameters = (
        Parameter("mass", "kg", lower=0.0, start=1.6),
        Parameter("area", "m^2", lower=0.0, start=0.0445),
    )
    ports = (Port("stem", ("x",), lambda q, p: [q.stem], "m", "N"),)
    seed = (LinearStiffness(), LinearDamping())

    def mass(self, q, p):
        """[[m]], kg."""
        return [[p.mass]]

    def force(self, q, v, u, p):
        """The diaphragm's force, N."""
        return [p.area * u.pressure]
