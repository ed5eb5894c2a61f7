"""A rotor on a flexible foundation: proximity probes see the rotor against the foundation."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness
from spiral_plugins.effects.rotating import Unbalance
from spiral_plugins.systems.rotor import ROTOR_INPUTS, turn_phase

from spiral.types.parameter import Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem

_NAMES = ("x", "y", "base_x", "base_y")
_AXES = ("x", "y")


class FoundationRotor(MechanicalSystem):
    """m (r'' + b'') = -k r - c r' + unbalance, m (r'' + b'') + m_b b'' = -K b - C b'.

    r is the rotor's displacement against the foundation, b the foundation's own, which is hidden.
    """

    coordinates = tuple(State(n, "m") for n in _NAMES)
    observed = ("x", "y")
    inputs = ROTOR_INPUTS
    injections = tuple(State(n, "N") for n in _NAMES)
    parameters = (
        Parameter("phase_origin", "rad", start=0.0, scope="record"),
        Parameter("rotor_mass", "kg", lower=0.0, start=2.0),
        Parameter("base_mass", "kg", lower=0.0, start=10.0),
    )
    ports = (
        Port("clearance", _AXES, lambda q, p: [q.x, q.y], "m", "N"),
        Port("rotor", _AXES, lambda q, p: [q.x + q.base_x, q.y + q.base_y], "m", "N"),
        Port("base", _AXES, lambda q, p: [q.base_x, q.base_y], "m", "N"),
    )
    seed = (
        LinearStiffness(),
        LinearDamping(),
        Unbalance(port="rotor"),
        LinearStiffness(port="base"),
        LinearDamping(port="base"),
    )

    def seen(self, u, p):
        """Effects see the phase turned by the record's origin."""
        return turn_phase(u, p)

    def mass(self, q, p):
        """[[m, m], [m, m + m_b]] for each axis, kg."""
        m, total = p.rotor_mass, p.rotor_mass + p.base_mass
        return [[m, 0, m, 0], [0, m, 0, m], [m, 0, total, 0], [0, m, 0, total]]

    def force(self, q, v, u, p):
        """None of its own."""
        return [0, 0, 0, 0]
