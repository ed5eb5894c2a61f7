"""Preview of an uploaded file: its columns, their first numbers, and a figure of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.io.readers.formats import read_table
from spiral.io.readers.table import Table
from spiral.io.writing import replace_nonfinite, write_whole
from spiral.types.errors import InputError
from spiral.types.label import split_key

if TYPE_CHECKING:
    from spiral.inference.problem import Problem
    from spiral.io.registry import Registry
    from spiral.types.model import Model
    from spiral.types.system import System

PICTURE = "columns.json"
READING = "reading.json"
_DRAWN = 6  # columns in the picture
_FIRST = 3  # numbers that are shown of each
_MOST = 200  # columns that are listed
_MARKS = 300  # rows without a value that are marked in the picture of a column


Order = Mapping[str, Any]
Tell = Callable[[str, Mapping[str, Any]], None]


def describe_file(order: Order, tell: Tell) -> None:
    """Read a file, tell its columns and the systems there are, and draw it.

    Raises
    ------
    InputError : a file that cannot be read, or in which there is no column of numbers.
    """
    tell("progress", {"words": "reading the file"})
    name = Path(order["path"]).name
    table = read_table(order["path"], order.get("separator"), order.get("decimal"))
    numbers, left_out = _read_columns(replace(table, name=name))
    if not numbers:
        if left_out:
            raise left_out[0]
        raise InputError(
            f"{name}: no column of numbers among {', '.join(table.columns[:9])}",
            "columns of numbers, one row for each sample", "export it with a row of names",
        )  # fmt: skip
    columns = [
        {
            "name": n,
            "unit": table.units.get(n, ""),
            "first": replace_nonfinite(v[:_FIRST]),
            "lowest": replace_nonfinite(float(np.nanmin(v))),
            "highest": replace_nonfinite(float(np.nanmax(v))),
            "missing": int(np.isnan(v).sum()),
        }
        for n, v in numbers.items()
    ]
    rows = max(len(v) for v in numbers.values())
    _write_columns_figure(numbers, table, Path(order["folder"]) / PICTURE)
    tell(
        "columns",
        {
            "columns": columns,
            "rows": rows,
            "left_out": [error.as_dict() for error in left_out],
            "systems": _describe_systems(order.get("plugins")),
            "drawn": True,
        },
    )


def _read_columns(table: Table) -> tuple[dict[str, Any], list[InputError]]:
    """Numbers by column; what is wrong with columns that begin with a number and hold a text."""
    numbers, wrong = {}, []
    for name in table.columns[:_MOST]:
        cells = table.values[name]
        try:
            values = table.column(name, name, 0, len(cells), missing=True)
        except InputError as error:
            if any(isinstance(cell, str) and _is_number(cell) for cell in cells[:_FIRST]):
                wrong.append(error)
        except TypeError:
            continue
        else:
            if np.isfinite(values).any():
                numbers[name] = values
    return numbers, wrong


def _is_number(text: str) -> bool:
    try:
        return np.isfinite(float(text))
    except ValueError:
        return False


def _write_columns_figure(numbers: Mapping[str, Any], table: Table, target: Path) -> None:
    """The first columns over row number, thinned."""
    from spiral.view.report.style import CYCLE, add_hover_text, axis_title, blank_figure, draw_line

    shown = list(numbers)[:_DRAWN]
    figure = blank_figure(
        len(shown), 1, 70 + 120 * len(shown), shared_xaxes=True, vertical_spacing=0.045
    )
    for row, name in enumerate(shown, 1):
        values = numbers[name]
        draw_line(figure, np.arange(len(values)), values, name, CYCLE[(row - 1) % len(CYCLE)], row,
             width=1.1, showlegend=False)  # fmt: skip
        _mark_missing(figure, values, row)
        said = "" if name.rstrip().endswith(("]", ")")) else table.units.get(name, "")
        title = axis_title(name[:18], said).replace(" (", "<br>(")
        figure.update_yaxes(title_text=title, title_font_size=13, row=row, col=1)
    figure.update_xaxes(title_text="row", row=len(shown), col=1)
    figure.update_layout(margin={"t": 12})
    write_whole(target, add_hover_text(figure).to_json())


def _mark_missing(figure: Any, values: Any, row: int) -> None:
    """A mark below the curve at each row that lacks its value, at most ``_MARKS`` of them."""
    import plotly.graph_objects as go

    from spiral.view.report.style import BLACK

    missing = np.flatnonzero(np.isnan(values))
    if not len(missing):
        return
    lowest, highest = np.nanmin(values), np.nanmax(values)
    shown = missing[np.unique(np.linspace(0, len(missing) - 1, _MARKS).astype(int))]
    below = np.full(len(shown), lowest - 0.06 * ((highest - lowest) or 1.0))
    marker = {"symbol": "triangle-up", "size": 9, "color": BLACK}
    trace = go.Scatter(x=shown.astype(np.float32), y=below.astype(np.float32), mode="markers",
                       name="no value", marker=marker, showlegend=False,
                       hovertemplate="<b>no value</b><br>row: %{x:.0f}<extra></extra>")  # fmt: skip
    figure.add_trace(trace, row=row, col=1)


def _describe_systems(plugins: str | None) -> list[dict[str, Any]]:
    """Every system known by name, with its channels and inputs.

    Those that a file defines are left out, and one that is a function of Python: nothing that is
    clicked or typed on the page makes it more than its example.
    """
    from spiral.io.registry import load_registry
    from spiral.io.system_files import PLUGINS

    registry = load_registry(plugins)
    shown = [
        n for n in registry.names("system")
        if n not in PLUGINS.values() and not hasattr(registry.entry("system", n).plugin, "function")
    ]  # fmt: skip
    return [_describe_system(registry.make("system", n), n) for n in shown]


def _describe_system(system: System, name: str) -> dict[str, Any]:
    """A system's meaning, channels and inputs; ``name`` is its name on the command line."""
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
    description = _describe_system(system, path)
    said = equations_of(system.text).definition.title
    tell("system", {"system": {**description, "meaning": said, "own": True}})


def compare_reading(order: Order, source: Any, problem: Problem, tell: Tell) -> None:
    """Draw the series that reading changes (offset, resampling ...), and send notes on how."""
    from spiral.io.readers.as_written import (
        altered_series_names,
        alters_numbers,
        unprocessed_series,
    )
    from spiral.view.report.reading import reading_figure
    from spiral.view.report.style import add_hover_text

    if not alters_numbers(source):
        return
    system = problem.model.system
    before, record = unprocessed_series(source, system), source.load(system)[0]
    names = altered_series_names(before, record)[:_DRAWN]
    if names:
        figure = reading_figure(before, record, names, {n: system.unit_of(n) for n in names})
        write_whole(Path(order["folder"]) / READING, add_hover_text(figure).to_json())
    tell("reading", {"reading": {"series": names, "notes": list(record.notes)}})


def describe_model(model: Model, registry: Registry) -> dict[str, Any]:
    """The effects of a system's seed with their meanings, all parameters, and what couples.

    ``addable`` are the effects that the model may begin with besides, with the ports where they
    fit.
    """
    from spiral.physics.couplings import couplings_of

    told = model.estimates()
    active = set(model.active)
    rows = []
    for key, parameter in model.pairs:
        owner, name = split_key(key)
        if parameter.scope == "record":
            continue
        estimate = told.get(owner, {}).get(name)
        value = model.values.get(key, parameter.start)
        rows.append({
            "key": key, "owner": owner, "name": name, "lower": parameter.lower,
            "upper": parameter.upper, "unit": parameter.unit if estimate is None else estimate.unit,
            "value": value, "free": key in active,
        })  # fmt: skip
    seed = [{"label": e.label, "meaning": e.meaning()} for e in model.system.seed]
    return {
        "seed": seed, "parameters": rows, "sketch": asdict(couplings_of(model)),
        "addable": _addable_effects(model.system, registry),
    }  # fmt: skip


def _addable_effects(system: System, registry: Registry) -> list[dict[str, Any]]:
    """Effects by name that fit a system: their meanings, and label -> port where each may act."""
    seeded = {e.label for e in system.seed}
    effects: dict[str, dict[str, Any]] = {}
    for effect in registry.candidates(system, everywhere=True):
        if effect.label not in seeded:
            said = {"name": effect.plugin_name(), "meaning": effect.meaning(), "ports": {}}
            about = effects.setdefault(effect.plugin_name(), said)
            about["ports"][effect.label] = effect.port or system.place(effect).name
    return list(effects.values())
