"""Figures of a trial of an effect: where it helps, and its force beside the missing one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from spiral.io.curves import FINAL, Curves
from spiral.view.report.style import (
    AFTER,
    BEFORE,
    BLACK,
    GREEN,
    VERMILION,
    axis_title,
    blank_figure,
    draw_band,
    draw_line,
    scale_to_prefix,
    transparent_colour,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

_PARTS = 120  # of the test record, each with one rms
_BINS, _FEW = 40, 5  # of a state, and samples under which a bin is left out
_NAMES = ("without it", "with it")


def residual_comparison(before: Curves, after: Curves) -> go.Figure | None:
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
    figure = blank_figure(len(channels), 1, 70 + 130 * len(channels), shared_xaxes=True,
                   vertical_spacing=0.08)  # fmt: skip
    for j, channel in enumerate(channels):
        left = [_part_rms((y - f)[:, j], edges) for f in runs if f is not None]
        factor, unit = scale_to_prefix(channel["unit"], *left)
        old, new = (factor * v for v in left)
        for high, colour in ((old, GREEN), (new, VERMILION)):
            _fill_between(
                figure, time, np.minimum(old, new), high, transparent_colour(colour), j + 1
            )
        for name, values, colour in zip(_NAMES, (old, new), (BEFORE, AFTER), strict=True):
            figure.add_scatter(x=time, y=values, name=name, mode="lines", showlegend=j == 0,
                               line={"color": colour, "width": 1.6}, row=j + 1, col=1)  # fmt: skip
        sigma = factor * after.meta["records"][record]["sigma"][channel["name"]]
        figure.add_hline(sigma, line={"color": "#555", "width": 1, "dash": "dot"}, row=j + 1, col=1)
        figure.update_yaxes(
            title_text=axis_title(f"{channel['name']} error", unit),
            rangemode="tozero",
            title_font_size=12,
            row=j + 1,
            col=1,
        )
    figure.update_xaxes(title_text="time (s)", title_font_size=12, row=len(channels), col=1)
    figure.update_layout(font_size=12, margin={"l": 50, "r": 8, "t": 30, "b": 40})
    return figure


def missing_force_comparison(
    time: np.ndarray,
    missing: np.ndarray,
    deviation: np.ndarray,
    alone: np.ndarray,
    refitted: np.ndarray,
    axes: Sequence[str],
    unit: str,
    states: Mapping[str, tuple[str, np.ndarray]],
) -> go.Figure:
    """The force that a model lacks, (samples, axes), and what an effect pushes with instead.

    Over time, and below over the state (name -> unit, values) that the missing force follows best.
    """
    factor, said = scale_to_prefix(unit, missing)
    figure = blank_figure(2 * len(axes), 1, 60 + 380 * len(axes), vertical_spacing=0.2 / len(axes))
    curves = ((alone, "alone", GREEN, "dot"), (refitted, "with its refit", AFTER, None))
    for j, axis in enumerate(axes):
        row = 2 * j + 1
        draw_band(
            figure, time, factor * missing[:, j], factor * deviation[:, j], "missing", BLACK, row
        )
        name = max(states, key=lambda n, j=j: _share_following_state(states[n][1], missing[:, j]))
        size, word = scale_to_prefix(*states[name])
        at, mean = _bin_means(states[name][1], missing[:, j])
        draw_line(figure, size * at, factor * mean, "missing", BLACK, row + 1, width=2.4)
        for force, title, colour, dash in curves:
            draw_line(figure, time, factor * force[:, j], title, colour, row, dash=dash)
            at, mean = _bin_means(states[name][1], force[:, j])
            draw_line(figure, size * at, factor * mean, title, colour, row + 1, dash=dash, width=2)
        figure.update_yaxes(
            title_text=axis_title(f"force on {axis}", said), title_font_size=12, row=row
        )
        figure.update_yaxes(title_text=axis_title("mean", said), title_font_size=12, row=row + 1)
        figure.update_xaxes(title_text="time (s)", title_font_size=12, row=row)
        figure.update_xaxes(title_text=axis_title(name.replace("_rate", "'"), word),
                            title_font_size=12, row=row + 1)  # fmt: skip
    figure.update_layout(font_size=12, margin={"l": 50, "r": 8, "t": 44, "b": 40})
    return figure


def _bin_means(x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles of bins of a state and the mean of the values in each, of bins with some samples."""
    low, high = np.quantile(x, (0.002, 0.998))
    edges = np.linspace(low, high, _BINS + 1)
    place = np.digitize(x, edges) - 1
    inside = (place >= 0) & (place < _BINS)
    count = np.bincount(place[inside], minlength=_BINS)
    total = np.bincount(place[inside], values[inside], minlength=_BINS)
    shown = count >= _FEW
    return (0.5 * (edges[:-1] + edges[1:]))[shown], total[shown] / count[shown]


def _share_following_state(x: np.ndarray, force: np.ndarray) -> float:
    """The share of a force that its mean over a state explains."""
    if not np.ptp(x) > 0:
        return 0.0
    at, mean = _bin_means(x, force)
    if len(at) < 2:
        return 0.0
    left = force - np.interp(x, at, mean)
    return 1.0 - float(left.var() / (force.var() or 1.0))


def _part_rms(left: np.ndarray, edges: np.ndarray) -> np.ndarray:
    squares = np.add.reduceat(left**2, edges[:-1])
    squares[-1] = np.sum(left[edges[-2] : edges[-1]] ** 2)
    return np.sqrt(squares / np.diff(edges))


def _fill_between(
    figure: go.Figure, time: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str, row: int
) -> None:
    """The area between two curves."""
    figure.add_scatter(
        x=np.concatenate([time, time[::-1]]), y=np.concatenate([high, low[::-1]]), fill="toself",
        fillcolor=colour, line={"width": 0}, mode="lines", hoverinfo="skip", showlegend=False,
        row=row, col=1,
    )  # fmt: skip
