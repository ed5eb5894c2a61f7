"""Where an effect helps: the error of two free runs over time, without it and with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from spiral.io.curves import FINAL, Curves
from spiral.view.report.style import AFTER, BEFORE, GREEN, VERMILION, blank, faint, scaled, titled

if TYPE_CHECKING:
    import plotly.graph_objects as go

_PARTS = 120  # of the test record, each with one rms
_NAMES = ("without it", "with it")


def helped(before: Curves, after: Curves) -> go.Figure | None:
    """Rms of each channel's residual, part by part of the test record, of two models.

    Green where the second predicts better, red where worse; dotted the sensor's noise. Nothing
    where a free run is not finite.
    """
    record = after.tested
    y = after.get(record, "y")
    runs = [c.get(record, FINAL, "free") for c in (before, after)]
    if y is None or any(f is None or f.shape != y.shape or not np.isfinite(f).all() for f in runs):
        return None
    first = min(after.meta["records"][record]["settled"], len(y) - 2)
    edges = np.unique(np.linspace(first, len(y), min(_PARTS, len(y) - first) + 1).astype(int))
    time = after.time(record)[(edges[:-1] + edges[1:] - 1) // 2]
    channels = after.meta["channels"]
    figure = blank(len(channels), 1, 70 + 130 * len(channels), shared_xaxes=True,
                   vertical_spacing=0.08)  # fmt: skip
    for j, channel in enumerate(channels):
        left = [_rms((y - f)[:, j], edges) for f in runs if f is not None]
        factor, unit = scaled(channel["unit"], *left)
        old, new = (factor * v for v in left)
        for high, colour in ((old, GREEN), (new, VERMILION)):
            _fill(figure, time, np.minimum(old, new), high, faint(colour), j + 1)
        for name, values, colour in zip(_NAMES, (old, new), (BEFORE, AFTER), strict=True):
            figure.add_scatter(x=time, y=values, name=name, mode="lines", showlegend=j == 0,
                               line={"color": colour, "width": 1.6}, row=j + 1, col=1)  # fmt: skip
        sigma = factor * after.meta["records"][record]["sigma"][channel["name"]]
        figure.add_hline(sigma, line={"color": "#555", "width": 1, "dash": "dot"}, row=j + 1, col=1)
        figure.update_yaxes(title_text=titled(f"{channel['name']} error", unit), rangemode="tozero",
                            title_font_size=12, row=j + 1, col=1)  # fmt: skip
    figure.update_xaxes(title_text="time (s)", title_font_size=12, row=len(channels), col=1)
    figure.update_layout(font_size=12, margin={"l": 50, "r": 8, "t": 30, "b": 40})
    return figure


def _rms(left: np.ndarray, edges: np.ndarray) -> np.ndarray:
    squares = np.add.reduceat(left**2, edges[:-1])
    squares[-1] = np.sum(left[edges[-2] : edges[-1]] ** 2)
    return np.sqrt(squares / np.diff(edges))


def _fill(
    figure: go.Figure, time: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str, row: int
) -> None:
    """The area between two curves."""
    figure.add_scatter(
        x=np.concatenate([time, time[::-1]]), y=np.concatenate([high, low[::-1]]), fill="toself",
        fillcolor=colour, line={"width": 0}, mode="lines", hoverinfo="skip", showlegend=False,
        row=row, col=1,
    )  # fmt: skip
