"""Terminal output on a system: its quantities, parameters, and the places where effects act."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text

from spiral.types.formatting import join_words, number
from spiral.types.port import Port, place_name
from spiral.types.system import System, has_coordinates
from spiral.types.units import short_form
from spiral.view.terminal.parts import ruled_table

_LISTED = 12  # places of one kind


def print_system(console: Console, system: System) -> None:
    """States, readings and inputs with units, parameters with first values, seed, and places."""
    _print_quantities(console, system)
    _print_system_parameters(console, system)
    console.print()
    if system.seed:
        console.print(Text(f"seed: {', '.join(e.label for e in system.seed)}"))
    for what, names in _places(system).items():
        more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
        if names:
            console.print(Text(f"{what}: {', '.join(names[:_LISTED])}{more}"))
    console.print(
        Text(
            "written NAME@PLACE; forces and effects on inputs act at the first where none is named",
            "dim",
        )
    )


def _print_quantities(console: Console, system: System) -> None:
    """What is measured, hidden and known of a system."""
    console.print()
    table = ruled_table("quantity", "unit", "")
    for name, unit, told in system.quantities():
        table.add_row(Text(name, style="bold"), Text(unit), Text(told))
    console.print(table)


def _print_system_parameters(console: Console, system: System) -> None:
    """Parameters of the equations: unit, bounds, and the value that is given or begun with."""
    if not system.parameters:
        return
    console.print()
    table = ruled_table("parameter", "unit", "least", "most", "value", "")
    for one in system.parameters:
        value = one.start if one.start is not None else system.defaults.get(f"system.{one.name}")
        shown = ("" if v is None else number(v, 6) for v in (one.lower, one.upper, value))
        told = "known unless free" if one.start is not None else "found by the fit"
        each = "; one for each record" if one.scope == "record" else ""
        table.add_row(
            Text(one.name, style="bold"),
            Text(short_form(one.unit) or "1"),
            *shown,
            Text(told + each),
        )
    console.print(table)


def _places(system: System) -> dict[str, list[str]]:
    """The places of each kind of effect, as effects name them."""
    forces = [p.name for p in (*system.ports, *system.planes)] if has_coordinates(system) else []
    sensed = _named(system.sensed) if len(system.sensed) > 1 else list(system.observed)
    followed = join_words([*dict.fromkeys(p.against for p in system.varied)])
    example = next((place_name(p) for p in reversed(system.varied)), "")
    return {
        "forces act at": forces,
        "flows act on": _named(system.filled),
        "inputs": _named(system.driven),
        "sensors": sensed,
        "any parameter may follow": [f"{followed} ({example}, for instance)"] if example else [],
    }


def _named(ports: tuple[Port, ...]) -> list[str]:
    return list(dict.fromkeys(place_name(port) for port in ports))
