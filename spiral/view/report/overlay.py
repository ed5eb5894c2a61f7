"""Several models on one record: predictions over the measurement, and what each misses below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from spiral.io.curves import FINAL, Curves
from spiral.view.report.style import (
    CYCLE,
    MEASURED,
    Span,
    axis_title,
    blank_figure,
    draw_line,
    scale_to_prefix,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go


def overlay_models(models: Sequence[tuple[str, Curves]], span: Span = None) -> go.Figure | None:
    """Each channel of the test record with the free runs of named models, and their residuals.

    A model whose free run is not finite, or is of another record, is left out; nothing where none
    is left.
    """
    known = [(n, c, _finite_free_run(c)) for n, c in models]
    shown = [(n, c, f) for n, c, f in known if f is not None]
    if not shown:
        return None
    first = shown[0][1]
    record = first.tested
    y, time = first.get(record, "y"), first.time(record)
    assert y is not None
    shown = [(n, c, f) for n, c, f in shown if f.shape == y.shape]
    channels = first.meta["channels"]
    figure = blank_figure(2 * len(channels), 1, 90 + 300 * len(channels), shared_xaxes=True,
                   vertical_spacing=0.045, row_heights=[0.6, 0.4] * len(channels))  # fmt: skip
    for j, channel in enumerate(channels):
        factor, unit = scale_to_prefix(channel["unit"], y[:, j])
        top = 2 * j + 1
        draw_line(figure, time, factor * y[:, j], "measured", MEASURED, top, span=span)
        for number, (name, _, free) in enumerate(shown):
            colour = CYCLE[number % (len(CYCLE) - 1)]
            draw_line(figure, time, factor * free[:, j], name, colour, top, width=1.2, span=span)
            draw_line(figure, time, factor * (y - free)[:, j], name, colour, top + 1, width=1.1,
                 showlegend=False, span=span)  # fmt: skip
        figure.update_yaxes(title_text=axis_title(channel["name"], unit), row=top, col=1)
        figure.update_yaxes(title_text=axis_title("residual", unit), row=top + 1, col=1)
    figure.update_xaxes(title_text="time (s)", row=2 * len(channels), col=1)
    return figure


def _finite_free_run(curves: Curves) -> np.ndarray | None:
    """The free run on the test record, where it is finite."""
    free_run, y = (curves.get(curves.tested, *key) for key in ((FINAL, "free"), ("y",)))
    usable = free_run is not None and y is not None and bool(np.isfinite(free_run).all())
    return free_run if usable else None
