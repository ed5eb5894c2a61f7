"""What two displacement sensors see of a rotor."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness
from spiral_plugins.effects.rotating import Unbalance
from spiral_plugins.systems.rotor import ROTOR_INPUTS, turn_phase

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class PlanarRotor(MechanicalSystem):
    """x'' + c x' + k x = U W^2 cos(phase), per unit mass: what two displacement sensors see.

    The observable seed of the paper (eq. seed_rotor).
    """

    position_unit: str = "m"

    @property
    def coordinates(self):
        """Displacements x and y of the disk."""
        return (State("x", self.position_unit), State("y", self.position_unit))

    @property
    def injections(self):
        """Forces per unit mass."""
        return (State("x", f"{self.position_unit}/s^2"), State("y", f"{self.position_unit}/s^2"))

    @property
    def observed(self):
        """Both displacements."""
        return ("x", "y")

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Speed, and phase where it is measured."""
        return ROTOR_INPUTS

    @property
    def parameters(self):
        """The angle of the unbalance at zero phase."""
        return (Parameter("phase_origin", "rad", start=0.0, scope="record"),)

    @property
    def ports(self):
        """The disk."""
        unit = self.position_unit
        return (Port("disk", ("x", "y"), lambda q, p: [q.x, q.y], unit, f"{unit}/s^2"),)

    @property
    def seed(self):
        """Stiffness and damping of each axis, and the unbalance; nothing else."""
        return (LinearStiffness(), LinearDamping(), Unbalance())

    def seen(self, u, p):
        """Effects see the phase turned by the record's origin."""
        return turn_phase(u, p)

    def mass(self, q, p):
        """The identity: all is per unit mass."""
        return [[1, 0], [0, 1]]

    def force(self, q, v, u, p):
        """None of its own."""
        return [0, 0]
