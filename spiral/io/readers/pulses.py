"""A once-per-turn pulse as phase: each pulse is a mark on the shaft passing a fixed sensor.

Times of the pulses t_n carry phase 2 pi n. A sampled pulse is late by up to one sample interval, so
the marks scatter about the shaft's angle, which a heavy rotor turns smoothly: phase is a smoothing
spline through the marks, its smoothness chosen by generalised cross-validation (Craven and Wahba,
1979), on top of a polynomial, so that a steady run-down is not bent straight at its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spiral.types.errors import InputError

Array = np.ndarray
Edge = Literal["rising", "falling"]

MINIMUM_PULSES = 8
_TREND = 5  # degree of the polynomial below the spline
_WIDEST = 1.6  # an interval longer than its neighbours' median by this hides a missed pulse
_NARROWEST = 0.6  # one shorter than this comes from a pulse too many
_ARMED = 0.25  # hysteresis to either side of the threshold, as a share of the pulse's height
_MOSTLY_HIGH = 0.6  # a channel above the threshold for a larger share of time pulses downwards


@dataclass(frozen=True)
class ShaftMotion:
    """Phase in rad and speed in rad/s, (samples,) each, and in words what they were taken from."""

    phase: Array
    speed: Array
    words: str


def phase_from_pulses(
    column: str,
    time: Array,
    values: Array,
    level: float | None = None,
    edge: Edge | None = None,
) -> ShaftMotion:
    """Phase and speed of a shaft that gives one pulse per turn; 2 pi n at the pulses.

    Parameters
    ----------
    column : the channel's name, for messages.
    time : (samples,) in s, increasing. values : (samples,) of the pulse channel, any unit.
    level : threshold in the channel's unit; half way between its two usual levels where left out.
    edge : which edge counts; where left out, the one that enters the shorter of the two levels.

    Raises
    ------
    InputError : too few pulses, an interval that hides a missed pulse or holds one too many, or
        a start or end of the record that no pulse marks.
    """
    threshold, height = _threshold(column, values, level)
    if edge is None:
        edge = "falling" if np.mean(values > threshold) > _MOSTLY_HIGH else "rising"
    sign = 1.0 if edge == "rising" else -1.0
    marks = _crossing_times(time, sign * values, sign * threshold, _ARMED * height)
    _check_marks(column, time, marks)
    phase, speed, scatter = smooth_phase(marks, time)
    rates = np.sort(1.0 / np.diff(marks))
    words = (
        f"phase from {len(marks)} pulses of {column!r} ({edge} edge at {threshold:.4g}), "
        f"{rates[0]:.4g} to {rates[-1]:.4g} turns/s; their scatter of {scatter:.2g} rad smoothed"
    )
    return ShaftMotion(phase, speed, words)


def _threshold(column: str, values: Array, level: float | None) -> tuple[float, float]:
    """The threshold, and the height that its hysteresis is a share of."""
    lowest, highest = float(values.min()), float(values.max())
    if lowest == highest:
        raise InputError(
            f"record.pulse={column} is constant ({lowest:.6g})",
            "one pulse for each turn",
            "check the sensor and the column's name",
        )
    middle = (lowest + highest) / 2
    low, high = (
        float(np.median(values[values <= middle])),
        float(np.median(values[values > middle])),
    )
    if level is None:
        return (low + high) / 2, high - low
    if not lowest < level < highest:
        raise InputError(
            f"record.pulse_level={level:.6g} of {column!r}",
            f"between its extremes, {lowest:.6g} and {highest:.6g}",
            f"record.pulse_level={(low + high) / 2:.4g}, or leave it out",
        )
    return level, max(min(high - low, 2 * (level - low), 2 * (high - level)), 0.0)


def _crossing_times(time: Array, values: Array, threshold: float, armed: float) -> Array:
    """Times of upward crossings, interpolated, each armed by a visit to the lower level."""
    state = np.where(values >= threshold + armed, 1, np.where(values <= threshold - armed, -1, 0))
    known = np.flatnonzero(state)
    reached = known[1:][(state[known][1:] == 1) & (state[known][:-1] == -1)]
    upward = np.flatnonzero((values[:-1] < threshold) & (values[1:] >= threshold))
    at = upward[np.searchsorted(upward, reached) - 1]
    share = (threshold - values[at]) / (values[at + 1] - values[at])
    return time[at] + share * (time[at + 1] - time[at])


def _check_marks(column: str, time: Array, marks: Array) -> None:
    from scipy.ndimage import median_filter

    if len(marks) < MINIMUM_PULSES:
        raise InputError(
            f"record.pulse={column}: {len(marks)} pulses",
            f"at least {MINIMUM_PULSES}, one for each turn",
            "check the column, or set the threshold with record.pulse_level",
        )
    steps = np.diff(marks)
    usual = median_filter(steps, 5, mode="mirror")
    long, short = steps > _WIDEST * usual, steps < _NARROWEST * usual
    for bad, what in ((long, "a pulse is missing"), (short, "a pulse too many")):
        if np.any(bad):
            i = int(np.argmax(bad))
            row = int(np.searchsorted(time, marks[i]))
            raise InputError(
                f"record.pulse={column}: {what} between {marks[i]:.6g} and {marks[i + 1]:.6g} s "
                f"(after row {row}): {steps[i]:.4g} s where {usual[i]:.4g} s are usual",
                "one pulse for each turn, intervals that change slowly",
                "set the threshold with record.pulse_level, or cut the place out with record.rows",
            )
    ends = ((marks[0] - time[0], steps[0], "first"), (time[-1] - marks[-1], steps[-1], "last"))
    for wait, interval, which in ends:
        if wait > _WIDEST * interval:
            first, last = np.searchsorted(time, (marks[0], marks[-1]))
            raise InputError(
                f"record.pulse={column}: no pulse in the {which} {wait:.4g} s of the record, "
                f"where one comes every {interval:.4g} s",
                "pulses from its start to its end",
                f"cut the record to them: rows {first} to {last} of those read (record.rows)",
            )


def smooth_phase(marks: Array, time: Array) -> tuple[Array, Array, float]:
    """Phase, speed, and the rms distance of the marks from the phase, in rad."""
    from scipy.interpolate import make_smoothing_spline

    count = len(marks)
    turns = 2 * np.pi * np.arange(count)
    centre, half = (marks[0] + marks[-1]) / 2, (marks[-1] - marks[0]) / 2
    scale = (count - 1) / 2  # the spline's argument runs by about one from mark to mark

    def argument(at: Array) -> Array:
        return (at - centre) / half

    trend = np.polynomial.Polynomial.fit(argument(marks), turns, min(_TREND, count // 4))
    # A mark's error is one of time; in rad it grows with speed.
    rate = np.gradient(turns, marks)
    weights = (np.mean(rate) / rate) ** 2
    left = turns - trend(argument(marks))
    spline = make_smoothing_spline(scale * argument(marks), left, w=weights)

    z = argument(time)
    phase = trend(z) + spline(scale * z)
    speed = (trend.deriv()(z) + scale * spline.derivative()(scale * z)) / half
    scatter = left - spline(scale * argument(marks))
    return phase, speed, float(np.sqrt(np.mean(scatter**2)))
