"""One mass on a spring."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class Oscillator(MechanicalSystem):
    """m x'' + c x' + k x = force: one mass, position measured, velocity hidden."""

    position_unit: str = "m"
    force_unit: str = "N"

    @property
    def coordinates(self):
        """The position x."""
        return (State("x", self.position_unit),)

    @property
    def injections(self):
        """The force on the mass."""
        return (State("x", self.force_unit),)

    @property
    def observed(self):
        """Position only."""
        return ("x",)

    @property
    def inputs(self):
        """The applied force."""
        return (Input("force", self.force_unit, interpolation="band_limited"),)

    @property
    def parameters(self):
        """The mass; stiffness and damping belong to the seed's effects."""
        return (Parameter("mass", f"({self.force_unit})*s^2/({self.position_unit})", lower=0.0),)

    @property
    def ports(self):
        """The mass itself."""
        return (Port("mass", ("x",), lambda q, p: [q.x], self.position_unit, self.force_unit),)

    @property
    def seed(self):
        """Spring and damper."""
        return (LinearStiffness(), LinearDamping())

    def mass(self, q, p):
        """[[m]]."""
        return [[p.mass]]

    def force(self, q, v, u, p):
        """The applied force."""
        return [u.force]
