"""A counterflow heat exchanger in two cells: both outlets are measured, walls and middle hidden.

Temperatures are above that of the room.
"""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System

_STATES = ("hot_1", "hot_2", "shell_1", "shell_2", "cold_1", "cold_2")


class HotStream(FlowEffect):
    """The hot stream through both cells: h1' = a (T_in - h1), h2' = a (h1 - h2)."""

    channels = ("hot_1", "hot_2")
    inputs = ("hot_inlet",)
    parameters = (Parameter("exchange", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """a (T_in - h1) and a (h1 - h2)."""
        return {
            "hot_1": p.exchange * (u.hot_inlet - x.hot_1),
            "hot_2": p.exchange * (x.hot_1 - x.hot_2),
        }


class ColdStream(FlowEffect):
    """The cold stream the other way, from room temperature: c2' = -e w c2, c1' = e w (c2 - c1)."""

    channels = ("cold_1", "cold_2")
    inputs = ("cold_flow",)
    parameters = (Parameter("exchange", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-e w c2 and e w (c2 - c1)."""
        rate = p.exchange * u.cold_flow
        return {"cold_2": -rate * x.cold_2, "cold_1": rate * (x.cold_2 - x.cold_1)}


class HotTransfer(FlowEffect):
    """From the hot side into the wall: h' = -b (h - s), s' = c (h - s), in each cell."""

    channels = ("hot_1", "shell_1")
    parameters = (Parameter("cooling", "1/s", lower=0.0), Parameter("heating", "1/s", lower=0.0))

    def flow(self, x, u, p):
        """-b (h - s) and c (h - s)."""
        first, second = x.hot_1 - x.shell_1, x.hot_2 - x.shell_2
        return {
            "hot_1": -p.cooling * first, "shell_1": p.heating * first,
            "hot_2": -p.cooling * second, "shell_2": p.heating * second,
        }  # fmt: skip


class ColdTransfer(FlowEffect):
    """From the wall into the cold side: s' = -d (s - c), c' = f (s - c), in each cell."""

    channels = ("cold_1", "shell_1")
    parameters = (Parameter("cooling", "1/s", lower=0.0), Parameter("heating", "1/s", lower=0.0))

    def flow(self, x, u, p):
        """-d (s - c) and f (s - c)."""
        first, second = x.shell_1 - x.cold_1, x.shell_2 - x.cold_2
        return {
            "shell_1": -p.cooling * first, "cold_1": p.heating * first,
            "shell_2": -p.cooling * second, "cold_2": p.heating * second,
        }  # fmt: skip


class ShellLoss(FlowEffect):
    """The wall loses heat to the room: s' = -l s."""

    channels = ("shell_1", "shell_2")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-l s in each cell."""
        return {"shell_1": -p.rate * x.shell_1, "shell_2": -p.rate * x.shell_2}


class ColdLoss(FlowEffect):
    """The cold stream loses heat to the room: c' = -l c."""

    channels = ("cold_1", "cold_2")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-l c in each cell."""
        return {"cold_1": -p.rate * x.cold_1, "cold_2": -p.rate * x.cold_2}


class FlowTransfer(FlowEffect):
    """Transfer that grows with the cold flow: c' = g (w - 1) (s - c)."""

    channels = ("cold_1", "shell_1")
    inputs = ("cold_flow",)
    parameters = (Parameter("rate", "1/s"),)

    def flow(self, x, u, p):
        """g (w - 1) (s - c) in each cell."""
        rate = p.rate * (u.cold_flow - 1)
        return {
            "cold_1": rate * (x.shell_1 - x.cold_1),
            "cold_2": rate * (x.shell_2 - x.cold_2),
        }


class HeatExchanger(System):
    """h_i' = flow + transfer, s_i' = transfer, c_i' = flow + transfer for the cells i = 1, 2.

    Hot stream, wall and cold stream in counterflow (Kakac, Liu, Heat Exchangers, ch. 2).
    """

    states = tuple(State(n, "K") for n in _STATES)
    observed = ("hot_2", "cold_1")
    inputs = (Input("hot_inlet", "K", "zero_order"), Input("cold_flow", "", "zero_order"))
    injections = tuple(State(n, "K/s") for n in _STATES)
    parameters = ()
    ports = (Port("streams", ("temperature",), lambda x, p: [x.cold_1], "K", "K/s"),)
    seed = (HotStream(), ColdStream(), HotTransfer(), ColdTransfer())

    def rate(self, x, u, p, injected):
        """Each temperature changes by what flows in."""
        return dict(injected)
