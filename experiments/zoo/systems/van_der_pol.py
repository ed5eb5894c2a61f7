"""A self-excited oscillator (a valve circuit, a violin string) that is disturbed from outside."""

from __future__ import annotations

from spiral_plugins.effects.dissipative import AmplitudeDamping, LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness

from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem


class VanDerPol(MechanicalSystem):
    """m x'' - c x' (1 - x^2 / a^2) + k x = F (van der Pol 1926): a limit cycle of amplitude 2 a."""

    coordinates = (State("x", "m"),)
    observed = ("x",)
    inputs = (Input("force", "N", "band_limited"),)
    injections = (State("x", "N"),)
    parameters = (Parameter("mass", "kg", lower=0.0, start=1.0),)
    ports = (Port("mass", ("x",), lambda q, p: [q.x], "m", "N"),)
    seed = (LinearStiffness(), LinearDamping(), AmplitudeDamping())

    def mass(self, q, p):
        """[[m]], kg."""
        return [[p.mass]]

    def force(self, q, v, u, p):
        """The force from outside, N."""
        return [u.force]
