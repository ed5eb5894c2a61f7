"""A hydraulic cylinder that moves a sprung load: position measured, speed and pressure hidden.

Not a mechanical system for this project, because the oil's pressure is a state without a rate of
its own; so what acts are flows into ``piston_speed`` (accelerations) and ``oil_pressure``.
"""

from __future__ import annotations

from spiral.math import length, tanh
from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class OilColumn(FlowEffect):
    """The pressure pushes the piston, whose speed relieves it: s' = a p, p' = -b s."""

    channels = ("piston_speed", "oil_pressure")
    parameters = (
        Parameter("push", "m/s^2/MPa", lower=0.0),
        Parameter("relief", "MPa/m", lower=0.0),
    )

    def flow(self, x, u, p):
        """a p into the speed, -b s into the pressure."""
        return {
            "piston_speed": p.push * x.oil_pressure,
            "oil_pressure": -p.relief * x.piston_speed,
        }


class ServoValve(FlowEffect):
    """The valve fills one chamber: p' = g u."""

    channels = ("oil_pressure",)
    inputs = ("valve",)
    parameters = (Parameter("gain", "MPa/s/V", lower=0.0),)

    def flow(self, x, u, p):
        """g u."""
        return {"oil_pressure": p.gain * u.valve}


class PistonLeakage(FlowEffect):
    """Laminar leakage past the piston: p' = -l p."""

    channels = ("oil_pressure",)
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-l p."""
        return {"oil_pressure": -p.rate * x.oil_pressure}


class LoadSpring(FlowEffect):
    """The load's spring and damper: s' = -k x - d s, per unit mass."""

    channels = ("piston", "piston_speed")
    parameters = (Parameter("stiffness", "1/s^2"), Parameter("damping", "1/s"))

    def flow(self, x, u, p):
        """-k x - d s."""
        return {"piston_speed": -p.stiffness * x.piston - p.damping * x.piston_speed}


class SealFriction(FlowEffect):
    """Dry friction of the seals: s' = -f tanh(s / w), per unit mass."""

    channels = ("piston_speed",)
    parameters = (
        Parameter("level", "m/s^2", lower=0.0),
        Parameter("width", "m/s", lower=0.0, role="shape", start=0.01),
    )

    def flow(self, x, u, p):
        """-f tanh(s / w)."""
        return {"piston_speed": -p.level * tanh(x.piston_speed / p.width)}


class OrificeLeakage(FlowEffect):
    """Turbulent leakage through an orifice: p' = -l |p| p."""

    channels = ("oil_pressure",)
    parameters = (Parameter("rate", "1/s/MPa", lower=0.0),)

    def flow(self, x, u, p):
        """-l |p| p."""
        return {"oil_pressure": -p.rate * length([x.oil_pressure]) * x.oil_pressure}


class EndCushion(FlowEffect):
    """A load spring that hardens towards the ends: s' = -k x^3, per unit mass."""

    channels = ("piston", "piston_speed")
    parameters = (Parameter("stiffness", "1/s^2/m^2"),)

    def flow(self, x, u, p):
        """-k x^3."""
        return {"piston_speed": -p.stiffness * x.piston**3}


class HydraulicCylinder(System):
    """x' = s, s' = a p - k x - d s, p' = g u - b s - l p.

    Merritt, Hydraulic Control Systems, ch. 6.
    """

    states = (State("piston", "m"), State("piston_speed", "m/s"), State("oil_pressure", "MPa"))
    observed = ("piston",)
    inputs = (Input("valve", "V", "zero_order"),)
    injections = (State("piston_speed", "m/s^2"), State("oil_pressure", "MPa/s"))
    parameters = ()
    ports = (Port("rod", ("x",), lambda x, p: [x.piston], "m", "m/s"),)
    seed = (OilColumn(), ServoValve(), PistonLeakage(), LoadSpring())

    def rate(self, x, u, p, injected):
        """The position follows the speed."""
        return {"piston": x.piston_speed, **injected}
