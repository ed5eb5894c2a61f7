"""A lithium cell under a current profile: terminal voltage measured, charge and overvoltage hidden.

A sensor of this project reports a state, so the terminal voltage is one: the voltmeter's filter.
"""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class Polarisation(FlowEffect):
    """Charge transfer as a resistor beside a capacitor: w' = i / C - w / (R C)."""

    channels = ("overvoltage",)
    inputs = ("current",)
    parameters = (Parameter("rise", "V/A/s", lower=0.0), Parameter("decay", "1/s", lower=0.0))

    def flow(self, x, u, p):
        """i / C - w / (R C)."""
        return {"overvoltage": p.rise * u.current - p.decay * x.overvoltage}


class OhmicDrop(FlowEffect):
    """The resistance of electrolyte and leads, behind the voltmeter's filter: y' = R i / T."""

    channels = ("terminal",)
    inputs = ("current",)
    parameters = (Parameter("rise", "V/A/s", lower=0.0),)

    def flow(self, x, u, p):
        """R i / T."""
        return {"terminal": p.rise * u.current}


class ChargeTransfer(FlowEffect):
    """Charge transfer that eases at high overvoltage (Butler, Volmer): w' = -g w^3."""

    channels = ("overvoltage",)
    parameters = (Parameter("rate", "1/s/V^2"),)

    def flow(self, x, u, p):
        """-g w^3."""
        return {"overvoltage": -p.rate * x.overvoltage**3}


class SelfDischarge(FlowEffect):
    """A cell that loses charge by itself: z' = -l z."""

    channels = ("charge_state",)
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-l z."""
        return {"charge_state": -p.rate * x.charge_state}


class CoulombLoss(FlowEffect):
    """A current that is counted wrongly: z' = e i."""

    channels = ("charge_state",)
    inputs = ("current",)
    parameters = (Parameter("error", "1/A/s"),)

    def flow(self, x, u, p):
        """e i."""
        return {"charge_state": p.error * u.current}


class BatteryCell(System):
    """z' = i / Q, w' = i / C - w / (R C), y' = (E(z) + w + R0 i - y) / T.

    E(z) = 3.3 + 0.7 z + 0.2 z^3 in V, charging counted positive (Plett, Battery Management
    Systems, vol. 1, ch. 2).
    """

    states = (State("charge_state", ""), State("overvoltage", "V"), State("terminal", "V"))
    observed = ("terminal",)
    inputs = (Input("current", "A", "zero_order"),)
    injections = (
        State("charge_state", "1/s"),
        State("overvoltage", "V/s"),
        State("terminal", "V/s"),
    )
    parameters = (
        Parameter("capacity", "A*s", lower=0.0, start=9000.0),
        Parameter("filter", "s", lower=0.0, start=2.0),
        Parameter("empty", "V", start=3.3),
        Parameter("slope", "V", start=0.7),
        Parameter("bend", "V", start=0.2),
    )
    ports = (Port("clamps", ("voltage",), lambda x, p: [x.terminal], "V", "V/s"),)
    seed = (Polarisation(), OhmicDrop())

    def rate(self, x, u, p, injected):
        """The charge counts the current, the voltmeter follows the clamps."""
        rest = p.empty + p.slope * x.charge_state + p.bend * x.charge_state**3
        clamps = (rest + x.overvoltage - x.terminal) / p.filter
        return {
            "charge_state": u.current / p.capacity + injected["charge_state"],
            "overvoltage": injected["overvoltage"],
            "terminal": clamps + injected["terminal"],
        }
