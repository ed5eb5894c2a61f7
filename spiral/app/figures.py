"""The figures of a turn in one tab of the browser: a zoom stays, and shows the samples in it."""

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
from spiral.app.study import turn_place
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

    def show(self, serial: int, name: str, heading: str, caption: str) -> None:
        """Draw a figure from its file, with what it says."""
        folder = turn_place(self.session.out, self.ident, serial)
        ui.html(f"<h3 class='figure-head'>{escape(heading)}</h3>", sanitize=False)
        data = frame.figure_of(folder / "figures" / f"{name}.json")
        if data is None:
            ui.html("<p class='soft'>This figure is not there any more.</p>", sanitize=False)
            return

        def closer(looked_at: Span | None) -> list[Any]:
            return samples(folder / "free", name, looked_at)

        self.put(data, name, f"{heading}. {caption}", closer)
        ui.html(f"<p class='caption'>{escape(caption)}</p>", sanitize=False)

    def model(self, serial: int) -> None:
        """The sketch of a step's model."""
        file = turn_place(self.session.out, self.ident, serial) / "figures" / SKETCH
        try:
            frame.sketched(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError, RecursionError):
            return  # of an earlier version

    def put(self, data: Mapping[str, Any], name: str, said: str, closer: Closer) -> None:
        """Draw a figure as it was looked at last; a zoom is kept, and filled with its samples."""
        view = self.views.setdefault(name, {})
        plot = frame.plot(seen(data, view), name, said)

        async def looked(event: Any) -> None:
            moved = {k: v for k, v in event.args.items() if _AXIS.fullmatch(k)}
            if not moved:
                return
            before = span(view)
            remember(view, moved)
            self.moved()
            if span(view) != before:
                await self._closer(plot, name, closer)

        plot.on("plotly_relayout", looked)
        if span(view):
            ui.timer(0.3, lambda: self._closer(plot, name, closer), once=True)

    async def _closer(self, plot: ui.plotly, name: str, closer: Closer) -> None:
        """Put the samples of what is looked at in the place of the thinned ones."""
        mine = self.asked[name] = self.asked.get(name, 0) + 1
        rows = await run.io_bound(closer, span(self.views[name]))
        if not rows or mine != self.asked[name] or plot.is_deleted:
            return
        x, y = ([list(map(float, row[i])) for row in rows] for i in (0, 1))
        plot.run_plot_method("restyle", {"x": x, "y": y}, list(range(len(rows))))


def samples(folder: Path, name: str, looked_at: Span | None) -> list[Any]:
    """x and y of every trace of a figure of a series, dense between two moments."""
    from spiral.io.curves import read_curves
    from spiral.view.report.page import closer

    try:
        curves = read_curves(folder)
    except SpiralError:
        return []
    figure = None if curves is None else closer(curves, name, looked_at)
    return [] if figure is None else [(t.x, t.y) for t in figure.data]


def remember(view: View, moved: Mapping[str, Any]) -> None:
    """Take over the ranges that Plotly tells; an axis that is whole again is forgotten."""
    for key, value in moved.items():
        axis, what = _AXIS.fullmatch(key).groups()  # type: ignore[union-attr]
        if what == "autorange":
            for end in (0, 1):
                view.pop(f"{axis}.range[{end}]", None)
        else:
            view[key] = value


def span(view: View) -> Span | None:
    """From where to where of time is looked at; all of it with ``None``."""
    starts = [k for k in view if k.startswith("x") and k.endswith("[0]")]
    ends = [(view[k], view.get(k.replace("[0]", "[1]"))) for k in starts]
    whole = [(float(a), float(b)) for a, b in ends if isinstance(b, int | float)]
    return whole[0] if whole else None


def seen(data: Mapping[str, Any], view: View) -> dict[str, Any]:
    """A figure as it was looked at last."""
    layout = json.loads(json.dumps(data["layout"]))
    for key, value in view.items():
        axis, _, end = key.partition(".range")
        limits = layout.setdefault(axis, {}).setdefault("range", [None, None])
        limits[int(end[1])] = value
        layout[axis]["autorange"] = False
    return {**data, "layout": layout}
