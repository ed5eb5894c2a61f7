"""A spiking neuron under injected current: the membrane's voltage is measured."""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class MembraneCurrent(FlowEffect):
    """Fast excitation: v' = a v - b v^3."""

    channels = ("membrane",)
    parameters = (Parameter("excitation", "1/s"), Parameter("saturation", "1/s/mV^2"))

    def flow(self, x, u, p):
        """a v - b v^3."""
        return {"membrane": p.excitation * x.membrane - p.saturation * x.membrane**3}


class Recovery(FlowEffect):
    """Slow recovery: w' = c v + d - e w."""

    channels = ("membrane", "recovery")
    parameters = (
        Parameter("drive", "1/s^2"),
        Parameter("level", "mV/s^2"),
        Parameter("decay", "1/s"),
    )

    def flow(self, x, u, p):
        """c v + d - e w."""
        return {"recovery": p.drive * x.membrane + p.level - p.decay * x.recovery}


class RectifiedLeak(FlowEffect):
    """A channel that lets more through one way: v' = -g v^2."""

    channels = ("membrane", "recovery")
    parameters = (Parameter("rate", "1/s/mV"),)

    def flow(self, x, u, p):
        """-g v^2."""
        return {"membrane": -p.rate * x.membrane**2}


class RecoveryBend(FlowEffect):
    """A recovery that saturates: w' = -k w^3."""

    channels = ("membrane", "recovery")
    parameters = (Parameter("rate", "s/mV^2"),)

    def flow(self, x, u, p):
        """-k w^3."""
        return {"recovery": -p.rate * x.recovery**3}


class ConstantCurrent(FlowEffect):
    """A current that always flows: v' = j."""

    channels = ("membrane", "recovery")
    parameters = (Parameter("rate", "mV/s"),)

    def flow(self, x, u, p):
        """j."""
        return {"membrane": p.rate}


class Neuron(System):
    """v' = a v - b v^3 - w + I, w' = c v + d - e w (FitzHugh 1961, Nagumo 1962)."""

    states = (State("membrane", "mV"), State("recovery", "mV/s"))
    observed = ("membrane",)
    inputs = (Input("current", "mV/s", "zero_order"),)
    injections = (State("membrane", "mV/s"), State("recovery", "mV/s^2"))
    parameters = ()
    ports = (Port("soma", ("voltage",), lambda x, p: [x.membrane], "mV", "mV/s"),)
    seed = (MembraneCurrent(), Recovery())

    def rate(self, x, u, p, injected):
        """Recovery and injected current change the membrane."""
        return {
            "membrane": u.current - x.recovery + injected["membrane"],
            "recovery": injected["recovery"],
        }
