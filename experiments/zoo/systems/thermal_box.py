"""A heated box: the air's temperature is measured, the wall's is hidden; both above the room's."""

from __future__ import annotations

from spiral.math import length, sqrt
from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System


class Heater(FlowEffect):
    """The heater warms the air: a' = P / C_a."""

    channels = ("box_air",)
    inputs = ("heating",)
    parameters = (Parameter("gain", "K/J", lower=0.0),)

    def flow(self, x, u, p):
        """P / C_a."""
        return {"box_air": p.gain * u.heating}


class WallTransfer(FlowEffect):
    """Air and wall exchange heat: a' = -h (a - s), s' = j (a - s)."""

    channels = ("box_air", "box_wall")
    parameters = (Parameter("cooling", "1/s", lower=0.0), Parameter("heating", "1/s", lower=0.0))

    def flow(self, x, u, p):
        """-h (a - s) and j (a - s)."""
        difference = x.box_air - x.box_wall
        return {"box_air": -p.cooling * difference, "box_wall": p.heating * difference}


class WallLoss(FlowEffect):
    """The wall loses heat to the room: s' = -l s."""

    channels = ("box_wall",)
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-l s."""
        return {"box_wall": -p.rate * x.box_wall}


class WallRadiation(FlowEffect):
    """The wall radiates: s' = -r ((T + s)^4 - T^4), T the room's temperature."""

    channels = ("box_wall",)
    parameters = (
        Parameter("rate", "1/s/K^3", lower=0.0),
        Parameter("room", "K", lower=0.0, role="shape", start=293.0),
    )

    def flow(self, x, u, p):
        """-r ((T + s)^4 - T^4)."""
        return {"box_wall": -p.rate * ((p.room + x.box_wall) ** 4 - p.room**4)}


class FreeConvection(FlowEffect):
    """Air that rises along the wall: s' = -f |s|^(1/4) s."""

    channels = ("box_wall",)
    parameters = (Parameter("rate", "1/s/K^0.25", lower=0.0),)

    def flow(self, x, u, p):
        """-f |s|^(1/4) s."""
        return {"box_wall": -p.rate * sqrt(sqrt(length([x.box_wall]))) * x.box_wall}


class AirLeak(FlowEffect):
    """A gap in the door: a' = -l a."""

    channels = ("box_air",)
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-l a."""
        return {"box_air": -p.rate * x.box_air}


class ThermalBox(System):
    """a' = P / C_a - h (a - s), s' = j (a - s) - l s: air and wall, two heat capacities."""

    states = (State("box_air", "K"), State("box_wall", "K"))
    observed = ("box_air",)
    inputs = (Input("heating", "W", "zero_order"),)
    injections = (State("box_air", "K/s"), State("box_wall", "K/s"))
    parameters = ()
    ports = (Port("box", ("temperature",), lambda x, p: [x.box_air], "K", "K/s"),)
    seed = (Heater(), WallTransfer(), WallLoss())

    def rate(self, x, u, p, injected):
        """Each temperature changes by what flows in."""
        return dict(injected)
