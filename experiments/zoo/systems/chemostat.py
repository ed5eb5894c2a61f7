"""Cells that grow on a substrate in a stirred vessel: the biomass is measured."""

from __future__ import annotations

from spiral.types.effect import FlowEffect
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import System

_HALF = Parameter("half_saturation", "g/l", lower=0.0, role="shape", start=0.3)


class MonodGrowth(FlowEffect):
    """Growth and uptake: X' = mu S X / (K + S), S' = -c S X / (K + S) (Monod 1949)."""

    channels = ("biomass", "substrate")
    parameters = (
        Parameter("growth", "1/s", lower=0.0),
        Parameter("uptake", "1/s", lower=0.0),
        _HALF,
    )

    def flow(self, x, u, p):
        """mu S X / (K + S) and -c S X / (K + S)."""
        eaten = x.biomass * x.substrate / (p.half_saturation + x.substrate)
        return {"biomass": p.growth * eaten, "substrate": -p.uptake * eaten}


class CellDecay(FlowEffect):
    """Cells that die: X' = -d X."""

    channels = ("biomass", "substrate")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-d X."""
        return {"biomass": -p.rate * x.biomass}


class Maintenance(FlowEffect):
    """Substrate eaten without growth: S' = -m X."""

    channels = ("biomass", "substrate")
    parameters = (Parameter("rate", "1/s", lower=0.0),)

    def flow(self, x, u, p):
        """-m X."""
        return {"substrate": -p.rate * x.biomass}


class SubstrateInhibition(FlowEffect):
    """Much substrate slows growth: X' = -i S X, to leading order (Haldane)."""

    channels = ("biomass", "substrate")
    parameters = (Parameter("rate", "l/g/s", lower=0.0),)

    def flow(self, x, u, p):
        """-i S X."""
        return {"biomass": -p.rate * x.substrate * x.biomass}


class WallGrowth(FlowEffect):
    """Cells that detach from the wall: X' = w."""

    channels = ("biomass", "substrate")
    parameters = (Parameter("flow", "g/l/s", lower=0.0),)

    def flow(self, x, u, p):
        """w."""
        return {"biomass": p.flow}


class Chemostat(System):
    """X' = (mu(S) - D) X, S' = D (F - S) - c(S) X: dilution D is set, the feed F is known."""

    states = (State("biomass", "g/l"), State("substrate", "g/l"))
    observed = ("biomass",)
    inputs = (Input("dilution", "1/s", "zero_order"),)
    injections = (State("biomass", "g/l/s"), State("substrate", "g/l/s"))
    parameters = (Parameter("feed", "g/l", lower=0.0, start=10.0),)
    ports = (Port("vessel", ("biomass",), lambda x, p: [x.biomass], "g/l", "g/l/s"),)
    seed = (MonodGrowth(),)

    def rate(self, x, u, p, injected):
        """What is pumped in and out, and what grows."""
        return {
            "biomass": injected["biomass"] - u.dilution * x.biomass,
            "substrate": injected["substrate"] + u.dilution * (p.feed - x.substrate),
        }
