"""Processing of a rotor's series (pulse, run-out, probe angles), each step only on request.

Pulses become phase, run-out is subtracted, probes are turned to the axes; each step says in a note
what it did, so that a reader of the results knows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from spiral.io.readers.pulses import Edge, phase_from_pulses
from spiral.io.readers.sampling import FileSeries
from spiral.types.errors import ConfigError, InputError, did_you_mean
from spiral.types.invalid import clipping
from spiral.types.record import check_values
from spiral.types.system import System

Array = np.ndarray
Rotation = Literal["counterclockwise", "clockwise"]

_FLATTEST = 0.2  # sine of the smallest angle between two probes
_AGREE = 0.05  # largest difference of turns by phase and by speed, as a share
_FEWEST_TURNS = 2.0
_SLOW = 0.5  # highest speed of a slow roll, as a share of the record's


# --- phase and sense of rotation -----------------------------------------------------------------


def add_pulse_phase(
    system: System, series: FileSeries, column: str, level: float | None, edge: Edge | None
) -> FileSeries:
    """Phase from the series' once-per-turn pulse; speed too where it has none.

    Raises
    ------
    InputError : a system that does not turn, a phase given twice, or unusable pulses.
    """
    _check_is_rotor(system, f"record.pulse={column}")
    if "phase" in series.inputs:
        raise ConfigError(
            f"record.pulse={column} and a column of phase", "one of them", "leave one out"
        )
    assert series.pulse is not None
    turning_series = phase_from_pulses(column, series.time, series.pulse, level, edge)
    inputs = {**series.inputs, "phase": turning_series.phase}
    words = turning_series.words
    if "speed" not in inputs:
        inputs["speed"] = turning_series.speed
        words += "; speed from them too"
    return replace(series, inputs=inputs, pulse=None).with_note(words)


def unwrap_phase(series: FileSeries) -> FileSeries:
    """A phase that jumps back by a turn, made continuous: the angle is the same."""
    phase = series.inputs.get("phase")
    if phase is None:
        return series
    known = np.isfinite(phase)
    steps = np.diff(phase[known])
    if not len(steps) or not np.any(steps * np.sign(np.median(steps)) < -np.pi):
        return series
    continuous = phase.copy()
    continuous[known] = np.unwrap(phase[known])
    inputs = {**series.inputs, "phase": continuous}
    return replace(series, inputs=inputs).with_note(
        "phase made continuous where it jumps by a turn"
    )


def apply_rotation_sense(system: System, series: FileSeries, rotation: Rotation) -> FileSeries:
    """Speed and phase with the sign of the sense of rotation: positive turns x towards y.

    Raises
    ------
    InputError : a clockwise rotation of numbers that are negative already, or turns by phase and
        by speed that differ.
    """
    if rotation == "clockwise":
        _check_is_rotor(system, "record.rotation=clockwise")
        for name in ("speed", "phase"):
            if name in series.inputs and _angle_turned(series, name) < 0:
                raise InputError(
                    f"record.rotation=clockwise and a {name} that is negative already",
                    f"a positive {name}, or record.rotation left out",
                    "leave record.rotation out: the signs in the file are kept then",
                )
        inputs = {k: -v if k in ("speed", "phase") else v for k, v in series.inputs.items()}
        series = replace(series, inputs=inputs).with_note(
            "clockwise: speed and phase are negative, x follows y"
        )
    _check_turns_agree(series)
    return series


def _angle_turned(series: FileSeries, name: str) -> float:
    """Angle turned over the record in rad, by one of the inputs."""
    values = series.inputs[name]
    if name == "phase":
        return float(values[-1] - values[0])
    return float(np.trapezoid(values, series.time))


def _check_turns_agree(series: FileSeries) -> None:
    if not {"speed", "phase"} <= set(series.inputs):
        return
    by_phase, by_speed = (_angle_turned(series, n) / (2 * np.pi) for n in ("phase", "speed"))
    allowed = max(_AGREE * max(abs(by_phase), abs(by_speed)), 1.0)
    if np.isfinite(by_phase - by_speed) and abs(by_phase - by_speed) > allowed:
        raise InputError(
            f"{series.name}: {by_phase:.4g} turns by phase, {by_speed:.4g} by speed",
            "the same number of turns",
            "check units of speed and phase (record.units), one pulse per turn, and the signs",
        )


def _check_is_rotor(system: System, given: str) -> None:
    names = [i.name for i in system.inputs]
    if not {"speed", "phase"} <= set(names):
        raise ConfigError(
            f"{given} of system {system.plugin_name()!r}",
            "a system with inputs speed and phase, a rotor",
            f"leave it out; inputs here: {', '.join(names) or 'none'}",
        )


# --- run-out and probes --------------------------------------------------------------------------


def check_channels(series: FileSeries) -> FileSeries:
    """Check channels and note clipped ones, before they are rotated, filtered or resampled."""
    for key, values in series.channels.items():
        check_values(series.name, "channel", key, values, len(series.time))
    for note in filter(None, (clipping(k, v) for k, v in series.channels.items())):
        series = series.with_note(note)
    return series


def slow_roll_rows(series: FileSeries, low: float, high: float) -> Array:
    """Samples whose speed, sign left out, lies between two limits in rad/s."""
    if "speed" not in series.inputs:
        raise InputError(
            "record.slow_roll by speed, of a record without speed",
            "a column of speed, or of pulses",
            "record.inputs='{speed: COLUMN}', record.pulse=COLUMN, or slow_roll='{rows: [a, b]}'",
        )
    speed = np.abs(series.inputs["speed"])
    rows = np.flatnonzero((speed >= low) & (speed <= high))
    if not len(rows):
        raise InputError(
            f"record.slow_roll: no sample between {low:.6g} and {high:.6g} rad/s",
            f"a range that the record visits: {speed.min():.6g} to {speed.max():.6g} rad/s",
            "limits are in the file's unit of speed (record.units)",
        )
    return rows


def check_slow_roll_speed(slow: FileSeries, rows: Array, series: FileSeries) -> None:
    """Refuse a slow-roll stretch whose speed is not well below the record's highest."""
    if "speed" not in slow.inputs or "speed" not in series.inputs or not len(rows):
        return
    fast, top = (
        float(np.max(np.abs(v))) for v in (slow.inputs["speed"][rows], series.inputs["speed"])
    )
    if fast > _SLOW * top:
        raise InputError(
            f"record.slow_roll where the speed reaches {fast:.4g} rad/s, in a record up to "
            f"{top:.4g} rad/s",
            f"at most {_SLOW:.0%} of it: faster, the shaft bends, and its motion is subtracted",
            "name a slow stretch, or another file's: slow_roll='{path: FILE, rows: [a, b]}'",
        )


def slow_roll_vectors(series: FileSeries, rows: Array) -> dict[str, Array]:
    """Mean, cosine and sine of phase in each channel over slow rows, by least squares.

    y = m + a cos(theta) + b sin(theta): what a probe reads of a shaft that turns too slowly to
    bend, and so of its surface (API Standard 670).

    Raises
    ------
    InputError : no measured phase, or less than two turns.
    """
    if "phase" not in series.inputs:
        raise InputError(
            "record.slow_roll of a record without measured phase",
            "phase: what is subtracted turns with the shaft",
            "record.pulse=COLUMN, or record.inputs='{phase: COLUMN}'",
        )
    phase = series.inputs["phase"][rows]
    turns = float(np.ptp(phase)) / (2 * np.pi) if len(rows) else 0.0
    if turns < _FEWEST_TURNS:
        raise InputError(
            f"record.slow_roll: {turns:.2g} turns in {len(rows)} samples",
            f"at least {_FEWEST_TURNS:g} turns at low speed",
            "name a longer stretch",
        )
    basis = np.column_stack([np.ones(len(rows)), np.cos(phase), np.sin(phase)])
    return {k: np.linalg.lstsq(basis, v[rows], rcond=None)[0] for k, v in series.channels.items()}


def subtract_run_out(
    system: System, series: FileSeries, vectors: Mapping[str, Array]
) -> FileSeries:
    """The slow-roll vectors subtracted over the whole record, before probes are turned."""
    phase = series.inputs["phase"]
    channels, words = {}, []
    for key, values in series.channels.items():
        mean, cosine, sine = (float(c) for c in vectors[key])
        channels[key] = values - mean - cosine * np.cos(phase) - sine * np.sin(phase)
        angle = round(np.degrees(np.arctan2(sine, cosine))) % 360
        words.append(
            f"{key} {np.hypot(cosine, sine):.4g} {system.unit_of(key)} at {angle}° "
            f"on a mean of {mean:.4g}"
        )
    return replace(series, channels=channels).with_note("slow roll subtracted: " + ", ".join(words))


def rotate_to_axes(system: System, series: FileSeries, angles: Mapping[str, float]) -> FileSeries:
    """Readings of two probes turned to the system's axes.

    A probe at angle a from the first axis towards the second reads p = x cos a + y sin a; the two
    equations are solved for x and y. Declared noise follows by the same matrix.

    Raises
    ------
    InputError : not two channels with one unit, or probes nearly in line.
    """
    first, second = _probe_axes(system, angles)
    radians = np.radians([angles[first], angles[second]])
    readings = np.column_stack([np.cos(radians), np.sin(radians)])
    apart = float(np.linalg.det(readings))
    if abs(apart) < _FLATTEST:
        raise InputError(
            f"record.probe_angles: {first} at {angles[first]:g}°, {second} at {angles[second]:g}°",
            "two directions well apart, usually by 90°",
            "angles are in degrees from the first axis towards the second",
        )
    inverse = np.linalg.inv(readings)
    turned = inverse @ np.stack([series.channels[first], series.channels[second]])
    noise = dict(series.noise)
    declared = [n for n in (first, second) if n in noise]
    if len(declared) == 1:
        raise InputError(
            f"record.noise of {declared[0]!r} alone, with record.probe_angles",
            "the noise of both probes, or of none",
            "left out, it is estimated",
        )
    if declared:
        spread = np.sqrt(inverse**2 @ np.square([noise[first], noise[second]]))
        noise.update({first: float(spread[0]), second: float(spread[1])})
    channels = {**series.channels, first: turned[0], second: turned[1]}
    probes = [series.filled[n] for n in (first, second) if n in series.filled]
    filled = dict(series.filled)
    if probes:  # either is part of both axes
        filled |= dict.fromkeys((first, second), np.logical_or.reduce(probes))
    words = (
        f"probes {first} at {angles[first]:g}° and {second} at {angles[second]:g}° "
        "turned to the axes"
    )
    if abs(abs(apart) - 1) > 1e-6:
        words += "; not at right angles, so their noise is correlated afterwards"
    return replace(series, channels=channels, noise=noise, filled=filled).with_note(words)


def _probe_axes(system: System, angles: Mapping[str, float]) -> tuple[str, str]:
    for name, angle in angles.items():
        if name not in system.observed:
            raise InputError(
                f"record.probe_angles names {name!r}",
                f"measured channels of {system.plugin_name()!r}: {', '.join(system.observed)}",
                did_you_mean(name, system.observed),
            )
        if not np.isfinite(angle):
            raise InputError(f"record.probe_angles of {name!r}: {angle}", "degrees")
    names = [n for n in system.observed if n in angles]
    units = {system.unit_of(n) for n in names}
    if len(names) != 2 or len(units) != 1:
        raise InputError(
            f"record.probe_angles of {', '.join(names) or 'no channel'}",
            "two channels with one unit, the axes of one plane",
            "for instance record.probe_angles='{x: 45, y: 135}'",
        )
    return names[0], names[1]
