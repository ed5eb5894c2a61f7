"""Figures of where a model fails, over speed, order, frequency and state; residual correlations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.inference.where.orders import (
    correlations,
    noise_power,
    order_map,
    time_map,
)
from spiral.io.curves import FINAL, SEED, Curves
from spiral.view.report.motion import COLOURS, NAMES
from spiral.view.report.style import (
    CYCLE,
    RPM,
    axis_title,
    blank_figure,
    decade_ticks,
    decibel_map,
    decibels,
    draw_line,
    have_one_unit,
    scale_to_prefix,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = np.ndarray

_BINS = 24
_COORDINATES = 2  # over which the missing force is drawn, where its port measures no state
_LAGS = 60
_LOUD = 20.0  # dB over the noise, least top of the colour scale: noise alone stays dark
_OVER = "dB above the noise"


def first_model(curves: Curves) -> str:
    """The model that a run began with."""
    return SEED if SEED in curves.meta["models"] else FINAL


def free_run_error(curves: Curves, record: int, model: str) -> Array | None:
    """Measured minus free run (samples, channels); nothing where it is not finite."""
    y, free = curves.get(record, "y"), curves.get(record, model, "free")
    if y is None or free is None or not np.isfinite(free).all():
        return None
    return y - free


def where_map(curves: Curves, record: int, model: str) -> go.Figure | None:
    """Energy of the free-run error over time x frequency and speed x order, over the noise's."""
    left = free_run_error(curves, record, model)
    if left is None:
        return None
    about = curves.meta["records"][record]
    phase, speed = curves.get_input(record, "phase"), curves.get_input(record, "speed")
    left = left / np.array(list(about["sigma"].values()))
    orders = None
    if phase is not None and speed is not None:
        orders = order_map(left, phase, speed, about["dt"])
    figure = blank_figure(1, 2 if orders else 1, 420, horizontal_spacing=0.12)
    spectrogram = time_map(left, about["dt"])
    top = highest_frequency(spectrogram.axis, spectrogram.power.sum(axis=0))
    shown = spectrogram.axis <= top
    dt, channels = about["dt"], left.shape[1]
    level = decibels(spectrogram.power[:, shown].T / noise_power(spectrogram, dt, channels))
    turned = None
    if orders is not None:
        power = orders.power / noise_power(orders, dt, channels, turning=True)[:, None]
        turned = _average_over_speed(np.abs(orders.at) * RPM, power)
    top = max(_LOUD, level.max(), decibels(turned[1]).max() if turned else 0.0)
    first = decibel_map(spectrogram.at + about["start"], spectrogram.axis[shown], level, top, _OVER)
    first.showscale = turned is None  # both maps have one scale
    figure.add_trace(first, row=1, col=1)
    figure.update_xaxes(title_text="time (s)", row=1, col=1)
    figure.update_yaxes(title_text="frequency (Hz)", row=1, col=1)
    if orders is not None and turned is not None:
        second = decibel_map(turned[0], orders.axis, decibels(turned[1].T), top, _OVER)
        figure.add_trace(second, row=1, col=2)
        figure.update_xaxes(title_text="speed (rpm)", row=1, col=2)
        figure.update_yaxes(title_text="order", row=1, col=2, range=[0, 6], dtick=1)
    return figure


def highest_frequency(axis: Array, power: Array) -> float:
    """Upper end of a frequency axis: 1.6 times where 99.5 % of the power over its median ends."""
    above = np.maximum(power - np.median(power), 0.0)
    held = np.cumsum(above) / max(above.sum(), 1e-300)
    return float(1.6 * axis[int(np.searchsorted(held, 0.995))] + 5 * axis[1])


def _average_over_speed(rpm: Array, power: Array) -> tuple[Array, Array]:
    """Slices averaged into bins of speed, (bins, orders); empty bins take their neighbour's."""
    edges = np.linspace(rpm.min(), rpm.max(), min(60, max(len(rpm) // 2, 8)) + 1)
    at = np.clip(np.digitize(rpm, edges) - 1, 0, len(edges) - 2)
    middles = 0.5 * (edges[1:] + edges[:-1])
    rows = [power[at == k].mean(axis=0) if np.any(at == k) else None for k in range(len(middles))]
    filled = [i for i, r in enumerate(rows) if r is not None]
    near = [min(filled, key=lambda f: abs(f - i)) for i in range(len(rows))]
    return middles, np.array([rows[i] for i in near])


def amplitude_map(curves: Curves, record: int) -> go.Figure | None:
    """Rms error over the noise, against amplitude, against the rotor's angle, and per channel."""
    from spiral.inference.where.regions import envelope

    y, phase = curves.get(record, "y"), curves.get_input(record, "phase")
    models = [m for m in curves.meta["models"] if free_run_error(curves, record, m) is not None]
    if y is None or not models:
        return None
    channels = curves.meta["channels"]
    sigma = np.array(list(curves.meta["records"][record]["sigma"].values()))
    factor, unit = 1.0, "deviations"
    if have_one_unit(channels):
        factor, unit = scale_to_prefix(channels[0]["unit"], y)
    else:
        y = y / np.std(y, axis=0)
    columns = 3 if phase is not None else 2
    figure = blank_figure(1, columns, 360, horizontal_spacing=0.06, shared_yaxes=True)
    for model in models:
        left = free_run_error(curves, record, model)
        assert left is not None
        size = np.sqrt(np.mean((left / sigma) ** 2, axis=1))
        _draw_binned_rms(figure, factor * envelope(y), size, model, 1)
        if phase is not None:
            _draw_binned_rms(figure, np.degrees(phase) % 360, size, model, 2)
        _draw_channel_bars(figure, left / sigma, model, [c["name"] for c in channels], columns)
    figure.update_xaxes(title_text=axis_title("amplitude", unit), row=1, col=1)
    figure.update_yaxes(title_text="rms error / noise", row=1, col=1)
    drawn = np.concatenate([np.asarray(t.y, dtype=float) for t in figure.data])
    drawn = np.log10(drawn[drawn > 0])  # bars begin at the noise, or below the lowest curve
    span = [min(0.0, drawn.min() - 0.1), drawn.max() + 0.15]
    figure.update_yaxes(type="log", **decade_ticks(*span), range=span,
                        minor={"showgrid": True, "gridcolor": "rgba(0,0,0,0.047)"})  # fmt: skip
    if phase is not None:
        angle = {"dtick": 90, "range": [0, 360]}
        figure.update_xaxes(title_text="rotor angle (°)", **angle, row=1, col=2)
    figure.update_xaxes(title_text="channel", row=1, col=columns)
    return figure


def _draw_binned_rms(figure: Any, x: Array, size: Array, model: str, column: int) -> None:
    edges = np.linspace(x.min(), x.max(), _BINS + 1)
    at = np.clip(np.digitize(x, edges) - 1, 0, _BINS - 1)
    count = np.bincount(at, minlength=_BINS)
    power = np.bincount(at, size**2, _BINS)
    kept = count > 8
    middle = 0.5 * (edges[1:] + edges[:-1])
    rms = np.sqrt(power[kept] / count[kept])
    draw_line(figure, middle[kept], rms, NAMES[model], COLOURS[model], 1, column, width=2)


def _draw_channel_bars(
    figure: Any, noises: Array, model: str, names: list[str], column: int
) -> None:
    import plotly.graph_objects as go

    rms = np.sqrt(np.mean(noises**2, axis=0))
    figure.add_trace(
        go.Bar(x=names, y=rms, name=NAMES[model], marker_color=COLOURS[model],
               legendgroup=NAMES[model], showlegend=False),
        row=1, col=column,
    )  # fmt: skip


def force_surface(curves: Curves, model: str) -> go.Figure | None:
    """The missing force against displacement, velocity, the other axis and the rotor's angle.

    Mean of the smoothed force in bins of each state, and the middle half of it as a band: a
    restoring-force surface, state by state.
    """
    about = curves.meta["models"].get(model, {})
    if "record" not in about:
        return None
    number, first = about["record"], about["first"]
    force, states = curves.get(number, model, "force"), curves.get(number, model, "states")
    assert force is not None
    assert states is not None
    names = [s["name"] for s in curves.meta["states"]]
    units = {s["name"]: s["unit"] for s in curves.meta["states"]}
    axes = about["axes"]
    series = {n: states[:, names.index(n)] for n in _surface_states(axes, names)}
    phase = curves.get_input(number, "phase")
    if phase is not None:
        series["angle"], units["angle"] = np.degrees(phase[first : first + len(force)]) % 360, "°"
    if not axes or not series:
        return None
    factor, unit = scale_to_prefix(about["force_unit"], force)
    figure = blank_figure(len(axes), len(series), 80 + 230 * len(axes), horizontal_spacing=0.04,
                   vertical_spacing=0.09, shared_yaxes=True, shared_xaxes=True)  # fmt: skip
    reach: list[list[float]] = [[] for _ in axes]
    for column, (name, values) in enumerate(series.items(), 1):
        size, said = (1.0, "°") if name == "angle" else scale_to_prefix(units[name], values)
        for row in range(1, len(axes) + 1):
            reach[row - 1] += _draw_surface_panel(
                figure, size * values, factor * force[:, row - 1], row, column
            )
        title = axis_title(name.replace("_rate", "'"), said)
        figure.update_xaxes(title_text=title, row=len(axes), col=column)
    figure.update_xaxes(tickangle=0, nticks=4 if len(series) > 3 else 5)
    if phase is not None:
        figure.update_xaxes(tickvals=[0, 180, 360], range=[0, 360], col=len(series))
    for row, axis in enumerate(axes, 1):
        figure.update_yaxes(title_text=axis_title(f"force on {axis}", unit), row=row, col=1)
        low, high = min(reach[row - 1], default=-1.0), max(reach[row - 1], default=1.0)
        edge = 0.06 * (high - low or 1.0)
        figure.update_yaxes(range=[low - edge, high + edge], row=row)  # of all its panels
    return figure


def _surface_states(axes: Sequence[str], names: Sequence[str]) -> list[str]:
    """The states of a port's axes and their rates.

    What a port measures may be no state (the difference of two): the first coordinates then.
    """
    moving = [n for n in names if f"{n}_rate" in names][:_COORDINATES]
    own = [a for a in axes if a in names] or moving
    return [*own, *(f"{a}_rate" for a in own if f"{a}_rate" in names)]


def _draw_surface_panel(figure: Any, x: Array, force: Array, row: int, column: int) -> list[float]:
    """Draw one panel; returns all heights drawn."""
    import plotly.graph_objects as go

    low, high = np.quantile(x, (0.002, 0.998))
    edges = np.linspace(low, high, _BINS + 1)
    at = np.digitize(x, edges) - 1
    rows = [(0.5 * (edges[k] + edges[k + 1]), *np.quantile(force[at == k], (0.25, 0.75)),
             force[at == k].mean()) for k in range(_BINS) if np.sum(at == k) > 8]  # fmt: skip
    if not rows:
        return []
    middle, lower, upper, mean = np.array(rows).T
    figure.add_trace(
        go.Scatter(x=np.concatenate([middle, middle[::-1]]), mode="lines", line={"width": 0},
                   y=np.concatenate([upper, lower[::-1]]), fill="toself", hoverinfo="skip",
                   fillcolor="rgba(0,114,178,0.22)", name="middle half", legendgroup="half",
                   showlegend=row == column == 1), row=row, col=column,
    )  # fmt: skip
    draw_line(figure, middle, mean, "mean of the missing force", CYCLE[0], row, column, width=2.2)
    return [*lower, *upper, *mean]


def correlation(curves: Curves, record: int) -> go.Figure | None:
    """Autocorrelation of the residual and its cross-correlation with the input, 95 % bounds."""
    left = curves.get(record, FINAL, "left")
    if left is None or not np.isfinite(left).all():
        return None
    inputs = _oscillating_inputs(curves, record)
    names = [c["name"] for c in curves.meta["channels"]]
    figure = blank_figure(1, 2 if inputs else 1, 360, horizontal_spacing=0.13)
    counted = int(np.count_nonzero(left[:, 0]))
    lags = min(_LAGS, len(left) // 4)
    at = np.arange(-lags, lags + 1)
    for j, name in enumerate(names):
        own = correlations(left[:, j], left[:, j], lags)
        draw_line(figure, at[lags + 1 :], own[lags + 1 :], f"residual {name}", CYCLE[j], width=1.8)
        for text, values in inputs.items():
            cross = correlations(left[:, j], values, lags)
            dash = None if len(inputs) == 1 else "dot"
            draw_line(
                figure, -at, cross, f"residual {name} with {text}", CYCLE[j + 2], 1, 2, dash=dash
            )
    for column in range(1, 3 if inputs else 2):
        for side in (-1.96, 1.96):
            figure.add_hline(side / np.sqrt(max(counted, 1)), row=1, col=column,
                             line={"color": "#555", "dash": "dot", "width": 1})  # fmt: skip
        figure.update_xaxes(title_text="lag (samples)", row=1, col=column)
    figure.update_yaxes(title_text="autocorrelation", row=1, col=1)
    if inputs:
        figure.update_yaxes(title_text="cross-correlation", row=1, col=2)
    return figure


def _oscillating_inputs(curves: Curves, record: int) -> dict[str, Array]:
    """Inputs as oscillating signals: a phase by its cosine; the speed is left out."""
    signals: dict[str, Array] = {}
    for item in curves.meta["inputs"]:
        values: Any = curves.get_input(record, item["name"])
        if values is None or item["name"] == "speed":
            continue
        signals["cos θ" if item["name"] == "phase" else item["name"]] = (
            np.cos(values) if item["name"] == "phase" else values
        )
    return signals
