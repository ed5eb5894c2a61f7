"""Figures of a turn in one tab of the browser; a zoom is kept, and reloads its stretch densely."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from nicegui import run, ui

from spiral.app import frame
from spiral.app.address import View
from spiral.app.drawing import SKETCH
from spiral.app.session import Session
from spiral.app.study import turn_folder
from spiral.types.errors import SpiralError

Span = tuple[float, float]
Closer = Callable[[Span | None], list[Any]]
"""x and y of every trace of a figure, dense between two moments; empty where there is no more."""

_AXIS = re.compile(r"([xy]axis\d*)\.(range\[[01]\]|autorange)")


@dataclass
class Figures:
    """The figures of a study; what was zoomed in one is so again when it is drawn anew.

    ``moved`` is told when a zoom has changed.
    """

    session: Session
    ident: str
    moved: Callable[[], None] = lambda: None
    views: dict[str, View] = field(default_factory=dict)
    asked: dict[str, int] = field(default_factory=dict)

    def show_figure(self, serial: int, name: str, heading: str, caption: str) -> None:
        """Draw a figure from its file, with what it says."""
        folder = turn_folder(self.session.out, self.ident, serial)
        ui.html(f"<h3 class='figure-head'>{escape(heading)}</h3>", sanitize=False)
        data = frame.load_figure(folder / "figures" / f"{name}.json")
        if data is None:
            ui.html("<p class='soft'>This figure is not there any more.</p>", sanitize=False)
            return

        def read_traces(looked_at: Span | None) -> list[Any]:
            return dense_traces(folder / "free", name, looked_at)

        self.draw_figure(data, name, f"{heading}. {caption}", read_traces)
        ui.html(f"<p class='caption'>{escape(caption)}</p>", sanitize=False)

    def draw_model_sketch(self, serial: int) -> None:
        """The sketch of a step's model."""
        file = turn_folder(self.session.out, self.ident, serial) / "figures" / SKETCH
        try:
            frame.draw_sketch(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, RecursionError):
            return  # of an earlier version

    def draw_figure(self, data: Mapping[str, Any], name: str, said: str, closer: Closer) -> None:
        """Draw a figure as it was looked at last; a zoom is kept, and filled with its samples."""
        view = self.views.setdefault(name, {})
        plot = frame.draw_plot(restore_view(data, view), name, said)

        async def on_relayout(event: Any) -> None:
            moved = {k: v for k, v in event.args.items() if _AXIS.fullmatch(k)}
            if not moved:
                return
            before = time_span(view)
            update_view(view, moved)
            self.moved()
            if time_span(view) != before:
                await self._refine_traces(plot, name, closer)

        plot.on("plotly_relayout", on_relayout)
        if time_span(view):
            ui.timer(0.3, lambda: self._refine_traces(plot, name, closer), once=True)

    async def _refine_traces(self, plot: ui.plotly, name: str, closer: Closer) -> None:
        """Replace the thinned traces of a zoomed figure by all samples of the visible stretch."""
        mine = self.asked[name] = self.asked.get(name, 0) + 1
        rows = await run.io_bound(closer, time_span(self.views[name]))
        if not rows or mine != self.asked[name] or plot.is_deleted:
            return
        x, y = ([list(map(float, row[i])) for row in rows] for i in (0, 1))
        plot.run_plot_method("restyle", {"x": x, "y": y}, list(range(len(rows))))


def dense_traces(folder: Path, name: str, looked_at: Span | None) -> list[Any]:
    """x and y of every trace of a figure of a series, dense between two moments."""
    from spiral.io.curves import read_curves
    from spiral.view.report.html import zoomed_figure

    try:
        curves = read_curves(folder)
    except SpiralError:
        return []
    figure = None if curves is None else zoomed_figure(curves, name, looked_at)
    return [] if figure is None else [(t.x, t.y) for t in figure.data]


def update_view(view: View, moved: Mapping[str, Any]) -> None:
    """Take over the ranges that Plotly tells; an axis that is whole again is forgotten."""
    for key, value in moved.items():
        axis, what = _AXIS.fullmatch(key).groups()  # type: ignore[union-attr]
        if what == "autorange":
            for end in (0, 1):
                view.pop(f"{axis}.range[{end}]", None)
        else:
            view[key] = value


def time_span(view: View) -> Span | None:
    """The visible stretch of time, as (first, last); ``None`` where all of it is shown."""
    starts = [k for k in view if k.startswith("x") and k.endswith("[0]")]
    ends = [(view[k], view.get(k.replace("[0]", "[1]"))) for k in starts]
    whole = [(float(a), float(b)) for a, b in ends if isinstance(b, int | float)]
    return whole[0] if whole else None


def restore_view(data: Mapping[str, Any], view: View) -> dict[str, Any]:
    """A figure's data with the axis ranges of the last view."""
    layout = json.loads(json.dumps(data["layout"]))
    for key, value in view.items():
        axis, _, end = key.partition(".range")
        limits = layout.setdefault(axis, {}).setdefault("range", [None, None])
        limits[int(end[1])] = value
        layout[axis]["autorange"] = False
    return {**data, "layout": layout}
