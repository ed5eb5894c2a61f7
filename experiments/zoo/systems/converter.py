"""A step-down converter: output voltage measured, the coil's flux hidden."""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class Coil(FlowEffect):
    """A linear coil, i = f / L: its wire's drop f' = -(r / L) f, its current v' = f / (L C)."""

    channels = ("coil_flux", "output_voltage")
    parameters = (Parameter("drop", "1/s", lower=0.0), Parameter("charging", "1/s^2", lower=0.0))

    def flow(self, x, u, p):
        """-(r / L) f and f / (L C)."""
        return {
            "coil_flux": -p.drop * x.coil_flux,
            "output_voltage": p.charging * x.coil_flux,
        }


class ResistiveLoad(FlowEffect):
    """A resistor across the output: v' = -v / (R C)."""

    channels = ("output_voltage",)
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-v / (R C)."""
        return {"output_voltage": -p.rate * x.output_voltage}


class CoilSaturation(FlowEffect):
    """A core that saturates draws more current: v' = s f^3."""

    channels = ("coil_flux", "output_voltage")
    parameters = (Parameter("charging", "1/s^2/(V*s)^2"),)

    def flow(self, x, u, p):
        """s f^3."""
        return {"output_voltage": p.charging * x.coil_flux**3}


class PowerLoad(FlowEffect):
    """A load that draws more at a higher voltage: v' = -g v^2."""

    channels = ("output_voltage",)
    parameters = (Parameter("rate", "1/s/V"),)

    def flow(self, x, u, p):
        """-g v^2."""
        return {"output_voltage": -p.rate * x.output_voltage**2}


class LoadCurrent(FlowEffect):
    """A constant current drawn beside the resistor: v' = -j / C."""

    channels = ("output_voltage",)
    parameters = (Parameter("rate", "V/s"),)

    def flow(self, x, u, p):
        """-j / C."""
        return {"output_voltage": -p.rate}


class Converter(System):
    """f' = d V - v - (r / L) f, v' = f / (L C) - v / (R C): averaged over a switching period.

    d is the duty ratio (Erickson, Maksimovic, Fundamentals of Power Electronics, ch. 7).
    """

    states = (State("coil_flux", "V*s"), State("output_voltage", "V"))
    observed = ("output_voltage",)
    inputs = (Input("duty", "", "zero_order"),)
    injections = (State("coil_flux", "V"), State("output_voltage", "V/s"))
    parameters = (Parameter("supply", "V", lower=0.0, start=24.0),)
    ports = (Port("output", ("voltage",), lambda x, p: [x.output_voltage], "V", "V/s"),)
    seed = (Coil(), ResistiveLoad())

    def rate(self, x, u, p, injected):
        """The voltage across the coil, and what flows into the capacitor."""
        across = p.supply * u.duty - x.output_voltage
        return {
            "coil_flux": across + injected["coil_flux"],
            "output_voltage": injected["output_voltage"],
        }
