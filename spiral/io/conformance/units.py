"""Units of a plugin: each parses, and equations give what their place asks for."""

from __future__ import annotations

from collections.abc import Sequence

from spiral.types.effect import Effect
from spiral.types.errors import PluginError
from spiral.types.rates import per_second
from spiral.types.system import System, has_coordinates
from spiral.types.units import (
    check_rate_units,
    check_reading_units,
    check_system_units,
    check_units,
    short_form,
)


def parse_units(units: dict[str, str]) -> str:
    """Names with their units as they are written; those that follow from others in short."""
    parsed = []
    for name, unit in units.items():
        try:
            short = short_form(unit) or "1"  # of one that follows from others
            parsed.append(f"{name} in {short if '(' in unit or short == '1' else unit}")
        except Exception as error:
            raise PluginError(f"unit {unit!r} of {name!r}", "a unit that parses") from error
    return ", ".join(parsed) or "none"


def check_equation_units(system: System, effects: Sequence[Effect]) -> str:
    """The equations give forces (readings, flows) in the unit of their port."""
    for effect in effects:
        check_units(system, effect)
    return ", ".join(short_form(system.place(e).force_unit) for e in effects) or "none"


def check_declared_units(system: System) -> str:
    """Units of states, inputs, parameters, injections and ports parse."""
    parse_units({i.name: i.unit for i in system.injections})
    for port in system.ports:
        parse_units({f"position at {port.name}": port.position_unit})
        parse_units({f"force at {port.name}": port.force_unit})
    return parse_units(
        {i.name: i.unit for i in (*system.states, *system.inputs, *system.parameters)}
    )


def check_system_equations(system: System) -> str:
    """Units fit in readings, in M q'' and the own force, or in the rates of first order."""
    check_reading_units(system)
    if not system.balanced:
        return "inside the program"
    if not has_coordinates(system):
        check_rate_units(system)
        return ", ".join(short_form(per_second(s.unit)) for s in system.states)
    check_system_units(system)
    return ", ".join(short_form(i.unit) for i in system.injections)
