"""What is in a file that was dropped: columns, first numbers, and a picture before all else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.io.readers.files import Table
from spiral.io.readers.readers import read_table
from spiral.io.writing import finite, write_whole
from spiral.types.errors import InputError

if TYPE_CHECKING:
    from spiral.inference.problem import Problem
    from spiral.types.model import Model
    from spiral.types.system import System

PICTURE = "columns.json"
READING = "reading.json"
_DRAWN = 6  # columns in the picture
_FIRST = 3  # numbers that are shown of each
_MOST = 200  # columns that are listed


Order = Mapping[str, Any]
Tell = Callable[[str, Mapping[str, Any]], None]


def describe_file(order: Order, tell: Tell) -> None:
    """Read a file, tell its columns and the systems there are, and draw it.

    Raises
    ------
    InputError : a file that cannot be read, or in which there is no column of numbers.
    """
    tell("progress", {"words": "reading the file"})
    table = read_table(order["path"], order.get("separator"), order.get("decimal"))
    numbers = {n: v for n in table.columns[:_MOST] if (v := _numbers(table, n)) is not None}
    if not numbers:
        name, found = Path(order["path"]).name, ", ".join(table.columns[:9])
        _first_text(table)
        raise InputError(
            f"{name}: no column of numbers among {found}",
            "columns of numbers, one row for each sample", "export it with a row of names",
        )  # fmt: skip
    columns = [
        {"name": n, "unit": table.units.get(n, ""), "first": finite(v[:_FIRST]),
         "lowest": finite(float(np.nanmin(v))), "highest": finite(float(np.nanmax(v)))}
        for n, v in numbers.items()
    ]  # fmt: skip
    rows = max(len(v) for v in numbers.values())
    _draw(numbers, table, Path(order["folder"]) / PICTURE)
    tell("columns", {"columns": columns, "rows": rows, "systems": _systems(order.get("plugins")),
                     "drawn": True})  # fmt: skip


def _first_text(table: Table) -> None:
    """Say where a column of numbers has its first text, where some have numbers too."""
    for name in table.columns[:_MOST]:
        values = table.values[name]
        if any(isinstance(v, str) and _is_number(v) for v in values[:_FIRST]):
            table.column(name, name, 0, len(values), missing=True)


def _is_number(text: str) -> bool:
    try:
        return np.isfinite(float(text))
    except ValueError:
        return False


def _numbers(table: Table, name: str) -> Any:
    """A column's numbers; nothing where it holds text, or none at all."""
    try:
        rows = len(table.values[name])
        found = table.column(name, name, 0, rows, missing=True)
    except (InputError, TypeError):
        return None
    return found if np.isfinite(found).any() else None


def _draw(numbers: Mapping[str, Any], table: Table, target: Path) -> None:
    """The first columns over row number, thinned."""
    from spiral.view.report.style import CYCLE, blank, hovering, line, titled

    shown = list(numbers)[:_DRAWN]
    figure = blank(len(shown), 1, 70 + 120 * len(shown), shared_xaxes=True, vertical_spacing=0.045)
    for row, name in enumerate(shown, 1):
        values = numbers[name]
        line(figure, np.arange(len(values)), values, name, CYCLE[(row - 1) % len(CYCLE)], row,
             width=1.1, showlegend=False)  # fmt: skip
        said = "" if name.rstrip().endswith(("]", ")")) else table.units.get(name, "")
        title = titled(name[:18], said).replace(" (", "<br>(")
        figure.update_yaxes(title_text=title, title_font_size=13, row=row, col=1)
    figure.update_xaxes(title_text="row", row=len(shown), col=1)
    figure.update_layout(margin={"t": 12})
    write_whole(target, hovering(figure).to_json())


def _systems(plugins: str | None) -> list[dict[str, Any]]:
    """Every system that has a usual form, with what it needs to be told; none that is a file."""
    from spiral.io.registry import load_registry
    from spiral.io.system_files import PLUGINS

    registry = load_registry(plugins)
    names = [n for n in registry.names("system") if n not in PLUGINS.values()]
    return [_described(registry.make("system", n), n) for n in names]


def _described(system: System, name: str) -> dict[str, Any]:
    """A system with what it needs to be told; ``name`` is what the command line calls it."""
    channels = [{"name": c, "unit": system.unit_of(c)} for c in system.observed]
    inputs = [
        {"name": i.name, "unit": i.unit, "required": i.derived_from is None} for i in system.inputs
    ]
    return {"name": name, "meaning": system.meaning(), "channels": channels, "inputs": inputs}


def read_equations(order: Order, tell: Tell) -> None:
    """Read a file of equations and tell the system that it makes.

    Raises
    ------
    ConfigError : equations that cannot be read, or units that do not go together.
    """
    from spiral.io.registry import load_registry
    from spiral.physics.formulas.equations import equations_of

    path = order["path"]
    system: Any = load_registry(None).make("system", "equations", {"path": path})
    found = _described(system, path)
    said = equations_of(system.text).definition.title
    tell("system", {"system": {**found, "meaning": said, "own": True}})


def compare_reading(order: Order, source: Any, problem: Problem, tell: Tell) -> None:
    """Draw what reading changes in a file's numbers, and tell which series and how, in words."""
    from spiral.io.readers.as_written import as_written, changed, changes
    from spiral.view.report.reading import read_so
    from spiral.view.report.style import hovering

    if not changes(source):
        return
    system = problem.model.system
    before, record = as_written(source, system), source.load(system)[0]
    names = changed(before, record)[:_DRAWN]
    if names:
        figure = read_so(before, record, names, {n: system.unit_of(n) for n in names})
        write_whole(Path(order["folder"]) / READING, hovering(figure).to_json())
    tell("reading", {"reading": {"series": names, "notes": list(record.notes)}})


def described_model(model: Model) -> dict[str, Any]:
    """The effects of a system's seed with their meanings, all parameters, and what couples."""
    from spiral.physics.couplings import couplings_of

    told = model.estimates()
    active = set(model.active)
    rows = []
    for key, parameter in model.pairs:
        owner, name = key.rsplit(".", 1)
        if parameter.scope == "record":
            continue
        found = told.get(owner, {}).get(name)
        value = model.values.get(key, parameter.start)
        rows.append({
            "key": key, "owner": owner, "name": name, "lower": parameter.lower,
            "upper": parameter.upper, "unit": parameter.unit if found is None else found.unit,
            "value": value, "free": key in active,
        })  # fmt: skip
    seed = [{"label": e.label, "meaning": e.meaning()} for e in model.system.seed]
    return {"seed": seed, "parameters": rows, "sketch": asdict(couplings_of(model))}
