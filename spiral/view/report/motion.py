"""Figures over time: measured against model, orbit, missing force, hidden states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.io.curves import FINAL, SEED, Curves
from spiral.view.report.style import (
    AFTER,
    BEFORE,
    CYCLE,
    MEASURED,
    SKY,
    Span,
    axis_title,
    blank_figure,
    draw_band,
    draw_line,
    have_one_unit,
    scale_to_prefix,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

NAMES = {SEED: "model before", FINAL: "model"}
COLOURS = {SEED: BEFORE, FINAL: AFTER}


def measured_against_model(
    curves: Curves, record: int, model: str = FINAL, span: Span = None
) -> go.Figure | None:
    """Each channel measured and predicted freely, and the residual below on the same scale."""
    y, free = curves.get(record, "y"), curves.get(record, model, "free")
    if y is None or free is None or not np.isfinite(free).all():
        return None
    channels, time = curves.meta["channels"], curves.time(record)
    rows = 2 * len(channels)
    heights = [0.62, 0.38] * len(channels)
    figure = blank_figure(
        rows,
        1,
        90 + 300 * len(channels),
        shared_xaxes=True,
        vertical_spacing=0.045,
        row_heights=heights,
    )
    for j, channel in enumerate(channels):
        factor, unit = scale_to_prefix(channel["unit"], y[:, j])
        top = 2 * j + 1
        draw_line(figure, time, factor * y[:, j], "measured", MEASURED, top, span=span)
        draw_line(figure, time, factor * free[:, j], NAMES[model], COLOURS[model], top, width=1.1,
             span=span)  # fmt: skip
        left = factor * (y[:, j] - free[:, j])
        draw_line(figure, time, left, "residual", CYCLE[2], top + 1, width=1, span=span)
        sigma = factor * curves.meta["records"][record]["sigma"][channel["name"]]
        for side in (-1.96 * sigma, 1.96 * sigma):
            figure.add_hline(side, line={"color": "#555", "width": 1, "dash": "dot"},
                             row=top + 1, col=1)  # fmt: skip
        figure.update_yaxes(title_text=axis_title(channel["name"], unit), row=top, col=1)
        figure.update_yaxes(title_text=axis_title("residual", unit), row=top + 1, col=1)
    settled = curves.meta["records"][record]["settled"]
    if settled:
        end = float(time[min(settled, len(time) - 1)])
        figure.add_vrect(float(time[0]), end, fillcolor="#DDDDDD", opacity=0.45, line_width=0)
    figure.update_xaxes(title_text="time (s)", row=rows, col=1)
    return figure


def orbit(curves: Curves, record: int) -> go.Figure | None:
    """y over x in the turns of largest motion: the shaft's path, measured and modelled."""
    y, free = curves.get(record, "y"), curves.get(record, FINAL, "free")
    channels = curves.meta["channels"]
    phase = curves.get_input(record, "phase")
    if y is None or free is None or not np.isfinite(free).all():
        return None
    if len(channels) != 2 or not have_one_unit(channels):
        return None
    size = np.convolve(np.sum((y - y.mean(axis=0)) ** 2, axis=1), np.ones(64), "same")
    middle = int(np.argmax(size))
    part = _turns_around(phase, middle, len(y), 5)
    factor, unit = scale_to_prefix(channels[0]["unit"], y[part])
    figure = blank_figure(height=470)
    draw_line(figure, factor * y[part, 0], factor * y[part, 1], "measured", MEASURED, width=3)
    draw_line(figure, factor * free[part, 0], factor * free[part, 1], NAMES[FINAL], SKY)
    if phase is not None:
        _draw_phase_marks(figure, phase[part], factor * y[part])
    figure.update_xaxes(title_text=axis_title(channels[0]["name"], unit), constrain="domain")
    figure.update_yaxes(title_text=axis_title(channels[1]["name"], unit), scaleanchor="x")
    return figure


def _turns_around(phase: Any, middle: int, samples: int, count: int) -> slice:
    """A few turns about a sample; 200 samples where no phase is known."""
    if phase is None:
        return slice(max(middle - 100, 0), min(middle + 100, samples))
    half = np.pi * count
    near = np.flatnonzero(np.abs(phase - phase[middle]) <= half)
    return slice(int(near[0]), int(near[-1]) + 1)


def _draw_phase_marks(figure: Any, phase: Any, path: Any) -> None:
    """Where the once-per-turn mark passes."""
    import plotly.graph_objects as go

    at = np.flatnonzero(np.diff(np.floor(phase / (2 * np.pi))) != 0)
    figure.add_trace(
        go.Scatter(x=path[at, 0], y=path[at, 1], mode="markers", name="mark, once per turn",
                   marker={"color": CYCLE[4], "size": 9, "line": {"color": "#222", "width": 1}})
    )  # fmt: skip


def missing_force(curves: Curves) -> go.Figure | None:
    """The latent force of each model on each axis with its 95 % band, in the force's own unit."""
    models = {m: a for m, a in curves.meta["models"].items() if "record" in a}
    if not models:
        return None
    about = next(iter(models.values()))
    axes = about["axes"]
    forces = {m: (curves.get(a["record"], m, "force"), curves.get(a["record"], m, "force_sd"))
             for m, a in models.items()}  # fmt: skip
    factor, unit = scale_to_prefix(
        about["force_unit"], *(f for f, _ in forces.values() if f is not None)
    )
    figure = blank_figure(
        len(axes), 1, 90 + 220 * len(axes), shared_xaxes=True, vertical_spacing=0.06
    )
    for model, (force, spread) in forces.items():
        if force is None or spread is None:
            continue
        first = models[model]["first"]
        time = curves.time(models[model]["record"])[first : first + len(force)]
        for j in range(len(axes)):
            name = f"lacking in the {NAMES[model]}"
            draw_band(
                figure,
                time,
                factor * force[:, j],
                factor * spread[:, j],
                name,
                COLOURS[model],
                j + 1,
            )
    for j, axis in enumerate(axes):
        figure.update_yaxes(title_text=axis_title(f"force on {axis}", unit), row=j + 1, col=1)
    figure.update_xaxes(title_text="time (s)", row=len(axes), col=1)
    return figure


def hidden_states(curves: Curves) -> go.Figure | None:
    """States that no sensor sees, smoothed, with their 95 % bands."""
    about = curves.meta["models"].get(FINAL, {})
    about = about.get("hidden", about)
    hidden = [(i, s) for i, s in enumerate(curves.meta["states"]) if s["hidden"]]
    if "record" not in about or not hidden:
        return None
    states = curves.get(about["record"], FINAL, "states")
    spread = curves.get(about["record"], FINAL, "states_sd")
    assert states is not None
    assert spread is not None
    time = curves.time(about["record"])[about["first"] : about["first"] + len(states)]
    shown = hidden[:6]
    figure = blank_figure(
        len(shown), 1, 90 + 180 * len(shown), shared_xaxes=True, vertical_spacing=0.05
    )
    for row, (i, state) in enumerate(shown, 1):
        factor, unit = scale_to_prefix(state["unit"], states[:, i])
        name = state["name"].replace("_rate", "'")
        draw_band(
            figure, time, factor * states[:, i], factor * spread[:, i], "smoothed", AFTER, row
        )
        figure.update_yaxes(title_text=axis_title(name, unit), row=row, col=1)
    figure.update_xaxes(title_text="time (s)", row=len(shown), col=1)
    return figure
