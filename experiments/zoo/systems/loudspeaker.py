"""A loudspeaker: voltage in, the cone's displacement out (a laser), the current hidden."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class Loudspeaker(MechanicalSystem):
    """m x'' + c x' + k x = B i, L i' + R i + B x' = voltage, with the current i = q'.

    The charge q is taken as a coordinate (the electromechanical analogy), so that the coil is a
    mass L on a damper R, and the shipped springs and dampers act on both sides.
    """

    coordinates = (State("cone", "m"), State("charge", "C"))
    observed = ("cone",)
    inputs = (Input("voltage", "V", "band_limited"),)
    injections = (State("cone", "N"), State("charge", "V"))
    parameters = (
        Parameter("moving_mass", "kg", lower=0.0, start=0.02),
        Parameter("inductance", "H", lower=0.0, start=2e-3),
        Parameter("force_factor", "N/A", lower=0.0, start=7.0),
    )
    ports = (
        Port("cone", ("x",), lambda q, p: [q.cone], "m", "N"),
        Port("coil", ("charge",), lambda q, p: [q.charge], "C", "V"),
    )
    seed = (LinearStiffness(), LinearDamping(), LinearDamping(port="coil"))

    def mass(self, q, p):
        """Moving mass, kg, and inductance, H."""
        return [[p.moving_mass, 0], [0, p.inductance]]

    def force(self, q, v, u, p):
        """B i on the cone, N; voltage less the one induced, V."""
        return [p.force_factor * v.charge, u.voltage - p.force_factor * v.cone]
