"""A disk on a soft shaft in bearings of unequal stiffness: the bearing is measured."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness
from spiral_plugins.effects.rotating import Unbalance
from spiral_plugins.systems.rotor import ROTOR_INPUTS, turn_phase

from spiral.types.parameter import Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem

_NAMES = ("x", "y", "bearing_x", "bearing_y")
_AXES = ("x", "y")


class AnisotropicRotor(MechanicalSystem):
    """m q'' = -k_s (q - b) + unbalance, m_b b'' = k_s (q - b) - K b - C b': a Jeffcott rotor.

    q is the disk's displacement, b that of the bearing housing, K = diag(k_x, k_y) (Friswell et
    al., Dynamics of Rotating Machines, ch. 6).
    """

    coordinates = tuple(State(n, "m") for n in _NAMES)
    observed = ("bearing_x", "bearing_y")
    inputs = ROTOR_INPUTS
    injections = tuple(State(n, "N") for n in _NAMES)
    parameters = (
        Parameter("phase_origin", "rad", start=0.0, scope="record"),
        Parameter("disk_mass", "kg", lower=0.0, start=1.0),
        Parameter("housing_mass", "kg", lower=0.0, start=0.2),
    )
    ports = (
        Port("disk", _AXES, lambda q, p: [q.x, q.y], "m", "N"),
        Port("shaft", _AXES, lambda q, p: [q.x - q.bearing_x, q.y - q.bearing_y], "m", "N"),
        Port("bearing", _AXES, lambda q, p: [q.bearing_x, q.bearing_y], "m", "N"),
    )
    seed = (
        LinearDamping(),
        Unbalance(),
        LinearStiffness(port="shaft"),
        LinearStiffness(port="bearing"),
        LinearDamping(port="bearing"),
    )

    def seen(self, u, p):
        """Effects see the phase turned by the record's origin."""
        return turn_phase(u, p)

    def mass(self, q, p):
        """Disk and housing, kg."""
        masses = (p.disk_mass, p.disk_mass, p.housing_mass, p.housing_mass)
        return [[m if i == j else 0 for j in range(4)] for i, m in enumerate(masses)]

    def force(self, q, v, u, p):
        """None of its own."""
        return [0, 0, 0, 0]
