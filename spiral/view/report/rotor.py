"""Rotor figures: Bode and polar plots, cascades of spectra, the Campbell diagram."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.inference.where.orders import Spectrogram, first_order, full_spectrum, time_map
from spiral.io.curves import FINAL, Curves
from spiral.view.report.maps import highest_frequency
from spiral.view.report.motion import COLOURS, NAMES
from spiral.view.report.style import (
    CYCLE,
    GREY,
    MEASURED,
    RPM,
    axis_title,
    blank_figure,
    draw_line,
    have_one_unit,
    scale_to_prefix,
)

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = np.ndarray

_CASCADE = 45  # slices of a cascade
_TURNS, _FEW = 4, 2  # of a slice of the first order, over speed and as a vector
_RIDGE = 9.0  # height of the largest peak of a cascade, in distances of two slices
_NAMED = 12  # speeds that are written on a polar plot
_LINES, _WEAK = 3, 0.03  # measured lines of a slice; share of the record's largest that counts


def bode(curves: Curves, record: int) -> go.Figure | None:
    """Amplitude and phase lag of the first order over speed, measured and modelled."""
    y = curves.get(record, "y")
    phase, speed = (curves.get_input(record, k) for k in ("phase", "speed"))
    free = curves.get(record, FINAL, "free")
    if y is None or phase is None or speed is None or np.ptp(speed) < 1e-3 * np.abs(speed).max():
        return None
    channels = curves.meta["channels"]
    figure = blank_figure(2, len(channels), 520, shared_xaxes=True, vertical_spacing=0.06,
                   horizontal_spacing=0.12)  # fmt: skip
    factor, unit = scale_to_prefix(channels[0]["unit"], y)
    given = [("measured", y, MEASURED, 3.2), (NAMES[FINAL], free, COLOURS[FINAL], 1.5)]
    for name, values, colour, width in given:
        if values is None or not np.isfinite(values).all():
            continue
        harmonic = first_order(values, phase, speed, turns=_TURNS)
        if harmonic is None:
            return None
        rpm = np.abs(harmonic.speed) * RPM
        for j in range(len(channels)):
            size, lag = factor * np.abs(harmonic.amplitude[:, j]), harmonic.lag[:, j]
            lag = lag - 360 * np.floor(lag[int(np.argmax(rpm))] / 360)
            draw_line(figure, rpm, size, name, colour, 1, j + 1, width=width)
            draw_line(figure, rpm, lag, name, colour, 2, j + 1, width=width)
            figure.update_xaxes(title_text="speed (rpm)", row=2, col=j + 1)
    for j, channel in enumerate(channels, 1):
        name = f"{channel['name']}, 1X peak"
        figure.update_yaxes(title_text=axis_title(name, unit), row=1, col=j, rangemode="tozero")
        figure.update_yaxes(title_text=f"phase lag of {channel['name']} (°)", row=2, col=j)
    figure.update_yaxes(autorange="reversed", dtick=90, row=2)
    return figure


def polar(curves: Curves, record: int) -> go.Figure | None:
    """The first order's vector of each channel as the speed changes: A (cos lag, -sin lag)."""
    y = curves.get(record, "y")
    phase, speed = (curves.get_input(record, k) for k in ("phase", "speed"))
    if y is None or phase is None or speed is None or np.ptp(speed) < 1e-3 * np.abs(speed).max():
        return None
    channels, free = curves.meta["channels"], curves.get(record, FINAL, "free")
    figure = blank_figure(1, len(channels), 470, horizontal_spacing=0.13)
    factor, unit = scale_to_prefix(channels[0]["unit"], y)
    for name, values, colour, width in (
        ("measured", y, MEASURED, 3.2), (NAMES[FINAL], free, COLOURS[FINAL], 1.5)
    ):  # fmt: skip
        if values is None or not np.isfinite(values).all():
            continue
        harmonic = first_order(values, phase, speed, turns=_FEW)
        if harmonic is None:
            return None
        size, lag = factor * np.abs(harmonic.amplitude), np.deg2rad(harmonic.lag)
        for j in range(len(channels)):
            x, up = size[:, j] * np.cos(lag[:, j]), -size[:, j] * np.sin(lag[:, j])
            draw_line(figure, x, up, name, colour, 1, j + 1, width=width)
            if name == "measured":
                _label_speeds(figure, x, up, np.abs(harmonic.speed) * RPM, j + 1)
    for j, channel in enumerate(channels, 1):
        title = axis_title(f"{channel['name']}, 1X in phase with the mark", unit)
        figure.update_xaxes(title_text=title, constrain="domain", row=1, col=j)
        anchor = "x" if j == 1 else f"x{j}"
        figure.update_yaxes(title_text=axis_title("90° ahead of it", unit), scaleanchor=anchor,
                            row=1, col=j)  # fmt: skip
    return figure


def _label_speeds(figure: Any, x: Array, y: Array, rpm: Array, column: int) -> None:
    """Speeds beside a polar plot, spread along the path, none close to another."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.searchsorted(length, np.linspace(0, length[-1], _NAMED))
    apart, placed = 0.13 * max(np.ptp(x), np.ptp(y)), []
    for k in at[at < len(x)]:
        if any(np.hypot(x[k] - x[i], y[k] - y[i]) < apart for i in placed):
            continue
        placed.append(k)
        away = np.sign([x[k], -y[k]])
        figure.add_annotation(
            x=float(x[k]), y=float(y[k]), text=f"{rpm[k]:.0f}", row=1, col=column, arrowhead=0,
            arrowwidth=1, arrowcolor=GREY, ax=16 * (away[0] or 1), ay=16 * (away[1] or 1),
            font={"size": 12},
        )  # fmt: skip


def waterfall(curves: Curves, record: int) -> go.Figure | None:
    """Spectra of every channel one behind the other, over speed (or time)."""
    y, speed = curves.get(record, "y"), curves.get_input(record, "speed")
    if y is None:
        return None
    channels, about = curves.meta["channels"], curves.meta["records"][record]
    figure = blank_figure(1, len(channels), 560, horizontal_spacing=0.13)
    for j, channel in enumerate(channels):
        factor, unit = scale_to_prefix(channel["unit"], y[:, j])
        spectrogram = _slice_spectra(y[:, j : j + 1], about["dt"])
        over = _slice_heights(spectrogram, about, speed)
        size = factor * np.sqrt(2 * spectrogram.power)
        shown = spectrogram.axis <= highest_frequency(
            spectrogram.axis, spectrogram.power.sum(axis=0)
        )
        _draw_ridges(figure, spectrogram.axis[shown], size[:, shown], over, 1, j + 1)
        top = float(spectrogram.axis[shown][-1])
        if speed is not None:
            _draw_order_lines(figure, over, (1, 2, 3), top, 1, j + 1)
        figure.update_xaxes(title_text="frequency (Hz)", range=[0, top], row=1, col=j + 1)
        name = "speed (rpm)" if speed is not None else "time (s)"
        peak = f"{channel['name']} up to {float(size.max()):.3g} {unit}"
        apart = np.ptp(over) / len(over)
        figure.update_yaxes(title_text=f"{name}; {peak}", row=1, col=j + 1,
                            range=[over.min() - apart, over.max() + _RIDGE * apart])  # fmt: skip
    return figure


def whirl(curves: Curves, record: int) -> go.Figure | None:
    """Full spectrum, and its cascade: forward whirl to the right, backward to the left."""
    y, speed = curves.get(record, "y"), curves.get_input(record, "speed")
    channels, about = curves.meta["channels"], curves.meta["records"][record]
    if y is None or len(channels) != 2 or not have_one_unit(channels) or speed is None:
        return None
    backward, dt = bool(np.mean(speed) < 0), about["dt"]
    factor, unit = scale_to_prefix(channels[0]["unit"], y)
    figure = blank_figure(2, 1, 860, row_heights=[0.36, 0.64], vertical_spacing=0.1)
    frequency = np.zeros(1)
    for name, values, colour in (
        ("measured", y, MEASURED), (NAMES[FINAL], curves.get(record, FINAL, "free"), COLOURS[FINAL])
    ):  # fmt: skip
        if values is None or not np.isfinite(values).all():
            continue
        frequency, size = full_spectrum(values[:, 0], values[:, 1], dt, backward)
        draw_line(figure, frequency, np.maximum(factor * size, 1e-12), name, colour, width=1.1)
    floor = factor * np.median(full_spectrum(y[:, 0], y[:, 1], dt)[1]) / 10
    limits = [np.log10(floor), np.log10(factor * np.ptp(y))]
    figure.update_yaxes(range=limits, title_text=axis_title("amplitude", unit), type="log",
                        exponentformat="power", row=1, col=1)  # fmt: skip
    top = min(float(frequency.max()), 6 * float(np.abs(speed).max()) / (2 * np.pi))
    top = _draw_whirl_cascade(figure, factor * y, speed, about, top)
    for row in (1, 2):
        figure.update_xaxes(title_text="backward whirl  ←  frequency (Hz)  →  forward whirl",
                            range=[-top, top], row=row, col=1)  # fmt: skip
    return figure


def _draw_whirl_cascade(figure: Any, y: Array, speed: Array, about: Any, top: float) -> float:
    """The cascade of full spectra in the second row; returns the frequency up to which it goes."""
    spectrogram = _slice_spectra(y, about["dt"])
    over = _slice_heights(spectrogram, about, speed)
    top = min(top, highest_frequency(spectrogram.axis, spectrogram.power.sum(axis=0)))
    length, rows, axis = _slice_length(len(y)), [], np.zeros(1)
    for at in spectrogram.at:
        first = max(round(at / about["dt"] - length / 2), 0)
        part = y[first : first + length]
        axis, size = full_spectrum(part[:, 0], part[:, 1], about["dt"], bool(np.mean(speed) < 0))
        order = np.argsort(axis)
        axis = axis[order]
        rows.append(size[order])
    shown = np.abs(axis) <= top
    _draw_ridges(figure, axis[shown], np.array(rows)[:, shown], over, 2, 1)
    _draw_order_lines(figure, over, (-2, -1, 1, 2), top, 2, 1)
    figure.update_yaxes(title_text="speed (rpm)", row=2, col=1)
    return top


def _slice_length(samples: int) -> int:
    return int(np.clip(samples // 10, 64, 4096))


def _slice_spectra(values: Array, dt: float) -> Spectrogram:
    return time_map(values - values.mean(axis=0), dt, _slice_length(len(values)), _CASCADE, 4)


def _slice_heights(spectrogram: Spectrogram, about: Any, speed: Array | None) -> Array:
    """Height at which each slice of a cascade is drawn: speed in rpm, else time in s."""
    if speed is None:
        return spectrogram.at + about["start"]
    return RPM * np.abs(np.interp(spectrogram.at, about["dt"] * np.arange(len(speed)), speed))


def _draw_ridges(figure: Any, axis: Array, size: Array, over: Array, row: int, column: int) -> None:
    """Draw spectra as ridges at their speeds or times, each hiding what lies behind it."""
    height = _RIDGE * np.ptp(over) / len(over) / max(float(size.max()), 1e-300)
    for k in np.argsort(over)[::-1]:
        draw_line(figure, axis, over[k] + height * size[k], f"{over[k]:.0f}", CYCLE[0], row, column,
             width=1.2, showlegend=False, fill="tozeroy", fillcolor="white")  # fmt: skip


def _draw_order_lines(
    figure: Any, over: Array, numbers: tuple[int, ...], top: float, row: int, column: int
) -> None:
    """Dotted lines of the orders; those of backward whirl are negative."""
    for number in numbers:
        rpm = np.array([over.min(), min(over.max(), 60 * top / abs(number))])
        draw_line(figure, number * rpm / 60, rpm, f"{number}X", GREY, row, column, dash="dot",
             width=1.5, showlegend=False)  # fmt: skip
        side = "right" if number > 0 else "left"
        figure.add_annotation(x=number * rpm[1] / 60, y=rpm[1], text=f"<b>{number}X</b>",
                              showarrow=False, xanchor=side, yanchor="bottom",
                              row=row, col=column)  # fmt: skip


def campbell(curves: Curves, record: int) -> go.Figure | None:
    """Natural frequencies and damping of the accepted model over speed, and what was measured."""
    speed, frequency = curves.get("modes.speed"), curves.get("modes.frequency")
    damping = curves.get("modes.damping")
    if speed is None or frequency is None or damping is None or not np.isfinite(frequency).any():
        return None
    if not curves.meta["models"].get("modes", {}).get("over_speed") or len(speed) < 2:
        return None
    rpm = speed * RPM
    figure = blank_figure(1, 2, 420, horizontal_spacing=0.12)
    for k in range(frequency.shape[1]):
        colour, name = CYCLE[k % len(CYCLE)], f"mode {k + 1}"
        draw_line(figure, rpm, frequency[:, k], name, colour, width=2.4)
        draw_line(figure, rpm, 100 * damping[:, k], name, colour, 1, 2, width=2.4)
    top = 1.25 * float(np.nanmax(frequency))
    _draw_measured_lines(figure, curves, record, float(rpm.max()), top)
    for number in (1, 2):
        draw_line(figure, rpm, number * rpm / 60, f"{number}X", GREY, dash="dot", width=1.5,
             showlegend=False)  # fmt: skip
        end = min(60 * top / number, float(rpm[-1]))
        figure.add_annotation(x=end, y=number * end / 60, text=f"<b>{number}X</b>", row=1, col=1,
                              showarrow=False, xanchor="left", yanchor="top")  # fmt: skip
    figure.update_yaxes(title_text="natural frequency (Hz)", range=[0, top], row=1, col=1)
    figure.update_yaxes(title_text="damping ratio (%)", row=1, col=2, rangemode="tozero")
    for column in (1, 2):
        figure.update_xaxes(title_text="speed (rpm)", row=1, col=column)
    return figure


def _draw_measured_lines(
    figure: Any, curves: Curves, record: int, fastest: float, top: float
) -> None:
    """The strongest lines of every slice of the measured record, the larger the stronger."""
    import plotly.graph_objects as go

    y, speed = curves.get(record, "y"), curves.get_input(record, "speed")
    if y is None or speed is None:
        return
    spectrogram = _slice_spectra(y, curves.meta["records"][record]["dt"])
    rpm = _slice_heights(spectrogram, curves.meta["records"][record], speed)
    size = np.sqrt(spectrogram.power)
    inner = size[:, 1:-1]
    peaks = (inner > size[:, :-2]) & (inner >= size[:, 2:]) & (inner > _WEAK * size.max())
    rows: list[tuple[Any, ...]] = []
    for k, slice_ in enumerate(np.where(peaks, inner, 0.0)):
        strongest = np.argsort(slice_)[::-1][:_LINES]
        rows += [(rpm[k], spectrogram.axis[i + 1], slice_[i]) for i in strongest if slice_[i] > 0]
    rows = [r for r in rows if r[0] <= fastest and r[1] <= top]
    if rows:
        at, frequency, strength = np.array(rows).T
        figure.add_trace(go.Scatter(
            x=at, y=frequency, mode="markers", name="measured lines",
            marker={"color": MEASURED, "opacity": 0.45,
                    "size": 4 + 10 * np.sqrt(strength / size.max())},
        ), row=1, col=1)  # fmt: skip
