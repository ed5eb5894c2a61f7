"""Units by pint: one registry, conversions, and the unit check of physics.

Speed is converted explicitly: pint would take 1 Hz as 1 rad/s.
"""

from __future__ import annotations

import math
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from spiral.effect import Effect, FlowEffect, ForceEffect, SensorEffect
from spiral.errors import InputError, PluginError
from spiral.port import At, Port
from spiral.system import System

_PER_TURN = {"rpm": 2 * math.pi / 60, "hz": 2 * math.pi, "rps": 2 * math.pi, "1/s": 2 * math.pi}


@lru_cache(maxsize=1)
def registry() -> Any:
    """The unit registry, its parsed definitions cached on disk."""
    import pint

    try:
        return pint.UnitRegistry(cache_folder=":auto:")
    except OSError:
        return pint.UnitRegistry()


@lru_cache(maxsize=512)
def short_form(unit: str) -> str:
    """A compact way to write a unit: ``(m/s^2)/(m)`` -> ``1/s^2``; empty where dimensionless."""
    if not unit:
        return ""
    found = _parse(unit)
    if found.dimensionless:
        return "rad" if unit.strip() == "rad" else ""
    text = f"{found:~C}" if hasattr(found, "__format__") else str(found)
    return text.replace("**", "^")


def _parse(unit: str) -> Any:
    import pint

    try:
        return registry().Unit(unit.replace("^", "**").replace("1*", "") or "")
    except (pint.UndefinedUnitError, pint.errors.DefinitionSyntaxError, ValueError, TypeError):
        return registry().parse_expression(unit.replace("^", "**")).units


def factor(given: str, wanted: str, what: str) -> float:
    """Multiply values in ``given`` by this to have them in ``wanted``.

    Raises
    ------
    InputError : an unknown unit, or one of another dimension.
    """
    import pint

    if wanted == "rad/s" and given.strip().lower() in _PER_TURN:
        return _PER_TURN[given.strip().lower()]
    try:
        return float(registry().Quantity(1.0, given.replace("^", "**")).to(wanted).magnitude)
    except pint.UndefinedUnitError as error:
        raise InputError(
            f"unit {given!r} of {what}",
            f"a unit of {wanted!r}",
            "write it as in 'um', 'mm/s', 'rpm', 'Hz', 'V'",
        ) from error
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError) as error:
        raise InputError(
            f"unit {given!r} of {what}",
            f"a unit that converts to {wanted!r}",
            f"correct record.units, or give a column measured in {wanted!r}",
        ) from error
    except Exception as error:  # pint's parser raises what Python's tokenizer does
        raise InputError(f"unit {given!r} of {what}", f"a unit such as {wanted!r}") from error


def check_units(system: System, effect: Effect) -> None:
    """Evaluate an effect's equation on quantities with units.

    Raises
    ------
    PluginError : the units do not fit; the message names the effect and both units.
    """
    import pint

    port = system.port(effect.port)
    try:
        values, expected = _evaluated(system, effect, port)
        for value in values:
            _must_fit(effect, value, expected)
    except (pint.DimensionalityError, pint.errors.OffsetUnitCalculusError) as error:
        raise PluginError(
            f"effect {effect.label!r} at port {port.name!r}: {error}",
            "an equation whose units fit",
            "check the units of its parameters",
        ) from error


def units_fit(system: System, effect: Effect) -> bool:
    """Whether an effect's units fit a system (sin of a length does not)."""
    try:
        check_units(system, effect)
    except PluginError:
        return False
    return True


def _quantity(unit: str, size: float = 1.25) -> Any:
    return registry().Quantity(size, _parse(unit) if unit else "")


def _evaluated(system: System, effect: Effect, port: Port) -> tuple[list[Any], str]:
    count = len(port.axes)
    position = tuple(_quantity(port.position_unit, 1.0 + 0.25 * i) for i in range(count))
    velocity = tuple(_quantity(f"({port.position_unit})/s", 0.5 + 0.25 * i) for i in range(count))
    own = SimpleNamespace(
        **{
            s.name: tuple(_quantity(port.unit(s.unit)) for _ in range(count))
            if s.per_axis
            else _quantity(port.unit(s.unit))
            for s in effect.states
        }
    )
    u = SimpleNamespace()
    for item in system.inputs:
        setattr(u, item.name, _quantity(item.unit))
        setattr(u, f"{item.name}_rate", _quantity(f"({item.unit})/s"))
    p = SimpleNamespace(
        **{
            q.name: tuple(_quantity(port.unit(q.unit)) for _ in range(count))
            if q.per_axis
            else _quantity(port.unit(q.unit))
            for q in effect.parameters
        }
    )
    at = At(position, velocity, own)
    if isinstance(effect, ForceEffect):
        return list(effect.force(at, u, p)), port.force_unit
    if isinstance(effect, SensorEffect):
        return list(effect.reading(list(position), at, u, p)), port.position_unit
    if isinstance(effect, FlowEffect):
        x = SimpleNamespace(**{s.name: _quantity(s.unit) for s in system.states})
        units = {i.name: i.unit for i in system.injections}
        flows = effect.flow(x, u, p)
        for name, value in flows.items():
            _must_fit(effect, value, units[name])
        return [], ""
    return [], ""


def _must_fit(effect: Effect, value: Any, expected: str) -> None:
    quantity = registry().Quantity(value) if not hasattr(value, "dimensionality") else value
    if quantity.dimensionality != _parse(expected).dimensionality:
        raise PluginError(
            f"effect {effect.label!r} gives {quantity.units:~C}",
            f"{expected}",
            "check the units of its parameters",
        )
