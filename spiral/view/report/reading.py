"""A file's series before and after reading: whole, and closer where reading changes most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from spiral.io.readers.sampling import FileSeries
from spiral.types.record import Record
from spiral.view.report.style import (
    AFTER,
    ORANGE,
    axis_title,
    blank_figure,
    draw_line,
    scale_to_prefix,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

_CLOSE = 40  # samples of the file beside which a change is seen sample by sample


def reading_figure(
    before: FileSeries, record: Record, names: Sequence[str], units: Mapping[str, str]
) -> go.Figure:
    """Each series as the file has it and as it was read; at the right where it changes most."""
    figure = blank_figure(len(names), 2, 70 + 150 * len(names), column_widths=[0.6, 0.4],
                   horizontal_spacing=0.09, vertical_spacing=0.3 / len(names))  # fmt: skip
    for row, name in enumerate(names, 1):
        old = {**before.channels, **before.inputs}[name]
        new = {**record.channels, **record.inputs}[name]
        factor, unit = scale_to_prefix(units[name], old, new)
        low, high = _largest_change_span(before.time, old, record.time, new)
        for column, span in ((1, None), (2, (low, high))):
            for time, values, title, colour, width, size in (
                (before.time, old, "in the file", ORANGE, 2.4, 8),
                (record.time, new, "as it is read", AFTER, 1.2, 4),
            ):
                part = slice(None) if span is None else slice(*np.searchsorted(time, span))
                draw_line(figure, time[part], factor * values[part], title, colour, row, column,
                     width=width, mode="lines" if span is None else "lines+markers",
                     marker_size=size)  # fmt: skip
        figure.update_yaxes(title_text=axis_title(name, unit), title_font_size=12, row=row, col=1)
    for column, title in ((1, "time (s)"), (2, "closer: time (s)")):
        figure.update_xaxes(title_text=title, title_font_size=12, row=len(names), col=column)
    figure.update_layout(font_size=12, margin={"l": 56, "r": 10, "t": 40, "b": 44})
    return figure


def _largest_change_span(
    time: np.ndarray, old: np.ndarray, read: np.ndarray, new: np.ndarray
) -> tuple[float, float]:
    """Span around a series' first gap, else around the largest change that reading made."""
    gaps = ~np.isfinite(old)
    if gaps.any():
        at = float(time[np.argmax(gaps)])
    else:
        moved = np.abs(np.interp(read, time, old) - new)
        at = float(read[np.argmax(moved)])
    half = 0.5 * _CLOSE * float(np.median(np.diff(time)))
    return at - half, at + half
