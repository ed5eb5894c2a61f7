"""spiral: find the physics that a model is missing.

    import spiral

    record = spiral.read("bench.csv", "oscillator", time="t", units={"x": "mm"})
    run = spiral.discover(record, "oscillator")
    run.verdict, run.advice, run.estimates()
    spiral.plot.error_falling(run)

Everything heavy is imported where it is used first: ``import spiral`` takes a few milliseconds.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.former_names import accept
from spiral.types import kernel_cache
from spiral.version import __version__ as __version__

if TYPE_CHECKING:
    from spiral.api import (
        add,
        compare,
        diagnose,
        discover,
        estimate,
        export,
        identify,
        load,
        plan,
        read,
        report,
        simulate,
        simulate_batch,
    )
    from spiral.io.own_model import structure, system
    from spiral.io.registry import Registry
    from spiral.types.effect import Effect, FlowEffect, ForceEffect, SensorEffect
    from spiral.types.model import Model
    from spiral.types.parameter import Input, Parameter, State
    from spiral.types.port import Port
    from spiral.types.record import Record
    from spiral.types.run import Run
    from spiral.types.system import MechanicalSystem, System
    from spiral.view import plot


__all__ = [
    "Effect",
    "FlowEffect",
    "ForceEffect",
    "Input",
    "MechanicalSystem",
    "Model",
    "Parameter",
    "Port",
    "Record",
    "Registry",
    "Run",
    "SensorEffect",
    "State",
    "System",
    "add",
    "compare",
    "diagnose",
    "discover",
    "estimate",
    "export",
    "identify",
    "load",
    "plan",
    "plot",
    "read",
    "report",
    "simulate",
    "simulate_batch",
    "structure",
    "system",
]

_HOMES = {
    **dict.fromkeys(("Effect", "FlowEffect", "ForceEffect", "SensorEffect"), "types.effect"),
    **dict.fromkeys(("Input", "Parameter", "State"), "types.parameter"),
    **dict.fromkeys(("MechanicalSystem", "System"), "types.system"),
    "Model": "types.model",
    "Port": "types.port",
    "Record": "types.record",
    "Registry": "io.registry",
    "Run": "types.run",
    "SpiralError": "types.errors",
    "structure": "io.own_model",
    "system": "io.own_model",
}
"""Where names are defined (``SpiralError`` too, what every error of this package is); the other
functions are in ``spiral.api``."""

accept()
kernel_cache.provide(Path(__file__).parent)


def __getattr__(name: str) -> Any:
    if name not in __all__ and name not in _HOMES:
        raise AttributeError(f"module 'spiral' has no attribute {name!r}")
    if name == "plot":
        return import_module("spiral.view.plot")
    return getattr(import_module(f"spiral.{_HOMES.get(name, 'api')}"), name)


def __dir__() -> list[str]:
    return sorted({*__all__, "SpiralError"})
