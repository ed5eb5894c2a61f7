"""A force that no effect with a name explains: its curve, or its loop where it has memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.view.report.style import (
    BLUE,
    GREY,
    ORANGE,
    SKY,
    axis_title,
    blank_figure,
    scale_to_prefix,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go


def force_curves(result: Mapping[str, Any]) -> go.Figure | None:
    """What is missing over what it follows, with its simultaneous 95 % band; a panel an axis."""
    shape = result.get("unknown")
    if not shape:
        return None
    panels = shape["curves"]
    what = str(shape.get("quantity", "force"))
    figure = blank_figure(1, len(panels), 430, horizontal_spacing=0.12)
    wide, state_unit = scale_to_prefix(shape["state_unit"], *(np.array(c["at"]) for c in panels))
    high, force_unit = scale_to_prefix(shape["force_unit"], *(np.array(c["force"]) for c in panels))
    for column, c in enumerate(panels, 1):
        shown = column == 1
        at, force, band = wide * np.array(c["at"]), high * np.array(c["force"]), np.array(c["band"])
        top, low = force + high * band, force - high * band
        size = 0.25 * (top.max() - low.min()) / max(c["visited"])
        figure.add_bar(
            x=at, y=[size * v for v in c["visited"]], base=low.min(), marker_color=GREY,
            opacity=0.35, name="visited", showlegend=shown, hoverinfo="skip", row=1, col=column,
        )  # fmt: skip
        figure.add_scatter(
            x=[*at, *at[::-1]], y=[*top, *low[::-1]], fill="toself", fillcolor=SKY,
            opacity=0.35, line={"width": 0}, name="95 % band", showlegend=shown, hoverinfo="skip",
            row=1, col=column,
        )  # fmt: skip
        figure.add_scatter(
            x=at, y=force, name=what, line={"color": BLUE, "width": 3},
            showlegend=shown, row=1, col=column,
        )  # fmt: skip
        name = c["state"].replace("_rate", "'")
        figure.update_xaxes(title_text=axis_title(name, state_unit), row=1, col=column)
    figure.update_yaxes(title_text=axis_title(what, force_unit), row=1, col=1)
    return figure


def force_loops(result: Mapping[str, Any]) -> go.Figure | None:
    """A missing force with memory over position, in order of time, one panel for each axis.

    Where the position grows the line is drawn in another colour than where it falls; the two meet
    where the motion turns, and a ring marks where the line begins.
    """
    memory = result.get("memory")
    if not memory:
        return None
    panels = memory["loops"]
    figure = blank_figure(1, len(panels), 430, horizontal_spacing=0.12)
    wide, unit = scale_to_prefix(
        memory["position_unit"], *(np.array(c["position"]) for c in panels)
    )
    high, force_unit = scale_to_prefix(memory["unit"], *(np.array(c["force"]) for c in panels))
    for column, c in enumerate(panels, 1):
        at, force = wide * np.array(c["position"]), high * np.array(c["force"])
        grows = np.diff(at) > 0  # from each point to the next
        for name, color, shown in (("position grows", BLUE, grows),
                                   ("position falls", ORANGE, ~grows)):  # fmt: skip
            x, y = _line_with_gaps(at, force, shown)
            figure.add_scatter(
                x=x, y=y, name=name, mode="lines", line={"color": color, "width": 2},
                showlegend=column == 1, row=1, col=column,
            )  # fmt: skip
        figure.add_scatter(
            x=at[:1], y=force[:1], name="begins here", mode="markers", showlegend=column == 1,
            marker={"color": "rgba(0,0,0,0)", "size": 11, "line": {"color": GREY, "width": 2}},
            row=1, col=column,
        )  # fmt: skip
        figure.update_xaxes(title_text=axis_title(c["axis"], unit), row=1, col=column)
    figure.update_yaxes(title_text=axis_title("force", force_unit), row=1, col=1)
    return figure


def _line_with_gaps(
    x: np.ndarray, y: np.ndarray, shown: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part of a path (samples) whose steps (samples - 1) are shown, as one line with gaps."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], shown, [0]])))
    pieces = [np.append(np.arange(a, b + 1), -1) for a, b in edges.reshape(-1, 2)]
    at = np.concatenate(pieces) if pieces else np.array([], int)
    return np.where(at < 0, np.nan, x[at]), np.where(at < 0, np.nan, y[at])
