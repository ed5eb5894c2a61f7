"""A file's numbers on a time grid: gaps bridged and rates changed, only where that is asked for."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np

from spiral.types.clock import JITTER, MINIMUM_SAMPLES
from spiral.types.errors import InputError
from spiral.types.parameter import HELD
from spiral.types.system import System

Array = np.ndarray
Bridge = Callable[[Array], Array]
"""What puts values in the place of those that are missing."""

_FINEST = 20000  # largest denominator of a change of rate
_TAPS = 10  # half length of the anti-alias filter, in samples of the lower rate
_KAISER = 5.0
_MADE_UP = 0.1  # of an input (rms), made up: as little as an effect that counts (Settings.smallest)
_CONTEXT, _TRIED = 8, 100  # samples beside a bridge, and places at which its length is tried
_LISTED = 5  # stretches between gaps that are named
_SKIP = 1.5  # a step longer than the usual one by this skips at least one sample


@dataclass(frozen=True)
class FileSeries:
    """One file's numbers in the system's units, before they are checked as a record.

    Parameters
    ----------
    name : for messages. time : (samples,) in s.
    channels : as the probes read them. inputs : as given or derived from pulses.
    noise : declared standard deviation of channels. notes : what was done, in words.
    pulse : (samples,) of a once-per-turn pulse, where there is one, until it has become phase.
    filled : channel -> (samples,) True where a value was put in the place of a reading.
    """

    name: str
    time: Array
    channels: Mapping[str, Array]
    inputs: Mapping[str, Array]
    noise: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    pulse: Array | None = None
    filled: Mapping[str, Array] = field(default_factory=dict)

    def with_note(self, words: str) -> FileSeries:
        """The same numbers with one more note."""
        return replace(self, notes=(*self.notes, words))

    def transform_series(self, change: Callable[[str, Array], Array]) -> FileSeries:
        """Every channel and input, and the pulse, changed by a function of its name and values."""
        channels = {k: change(k, v) for k, v in self.channels.items()}
        inputs = {k: change(k, v) for k, v in self.inputs.items()}
        pulse = None if self.pulse is None else change("pulse", self.pulse)
        return replace(self, channels=channels, inputs=inputs, pulse=pulse)


# --- gaps ----------------------------------------------------------------------------------------


def interpolate_gaps(
    series: FileSeries, longest: int, leave_out: bool = False, first: int = 0,
    held: Collection[str] = (),
) -> FileSeries:  # fmt: skip
    """Missing values and missing rows bridged by Akima interpolation, up to ``longest`` in a row.

    What is put in the place of a sensor's reading is none: it is ``filled``. With ``leave_out``
    missing cells of a channel may be as many as they will. ``first`` is the file's row of the
    first sample. Inputs that are ``held`` keep the level on either side up to the middle of a gap.

    Raises
    ------
    InputError : a longer gap, one at the start or end, or one over which an input cannot be told;
        the message names the place.
    """
    opened, absent = _insert_missing_rows(series, longest)
    counts = {}

    def bridge(key: str, values: Array) -> Array:
        gaps = _true_runs(~np.isfinite(values))
        if not gaps:
            return values
        if not (leave_out and key in opened.channels):
            _check_gaps(opened, key, gaps, longest)
        counts[key] = gaps
        across = _hold_missing if key in held else _interpolate_missing
        bridged = across(values)
        if key in opened.inputs:
            _check_bridges(series, opened.time, key, bridged, gaps, first, across)
        return bridged

    bridged = opened.transform_series(bridge)
    if not counts:
        return series
    values = sum(stop - start for gaps in counts.values() for start, stop in gaps)
    worst = max(stop - start for gaps in counts.values() for start, stop in gaps)
    rows = f" ({absent} rows that the file lacks)" if absent else ""
    filled = {k: ~np.isfinite(v) for k, v in opened.channels.items() if k in counts}
    left = f"; no readings of {', '.join(filled)} are taken from there" if filled else ""
    return replace(bridged, filled=filled).with_note(
        f"gaps filled by interpolation in {', '.join(counts)}: {values} values{rows}, "
        f"at most {worst} in a row{left}"
    )


def _insert_missing_rows(series: FileSeries, longest: int) -> tuple[FileSeries, int]:
    """Insert rows of NaN where time skips a whole number of steps; also returns their number."""
    steps = np.diff(series.time)
    usual = float(np.median(steps)) if len(steps) else 1.0
    missing = np.where(steps > _SKIP * usual, np.rint(steps / usual) - 1, 0).astype(int)
    if not missing.any():
        return series, 0
    at = int(np.argmax(missing))
    if missing[at] > longest:
        raise _long_gap_error(
            series, "time", int(missing[at]), at + 1, float(series.time[at]), longest
        )
    position = np.concatenate([[0], np.cumsum(1 + missing)])
    time = np.interp(np.arange(position[-1] + 1), position, series.time)

    def insert_rows(key: str, values: Array) -> Array:
        spread = np.full(len(time), np.nan)
        spread[position] = values
        return spread

    return replace(series.transform_series(insert_rows), time=time), int(missing.sum())


def _true_runs(bad: Array) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _check_gaps(series: FileSeries, key: str, gaps: list[tuple[int, int]], longest: int) -> None:
    samples = len(series.time)
    for start, stop in gaps:
        if stop - start > longest:
            at = float(series.time[start])
            raise _long_gap_error(series, repr(key), stop - start, start, at, longest)
        if start == 0 or stop == samples:
            end = "start" if start == 0 else "end"
            raise InputError(
                f"{series.name}: a gap at the {end} of {key!r} ({stop - start} values)",
                "a number on either side of a gap",
                f"cut it off with record.rows; {samples - (stop - start)} rows remain",
            )


def _check_bridges(
    series: FileSeries, time: Array, key: str, values: Array, gaps: list[tuple[int, int]],
    first: int, across: Bridge,
) -> None:  # fmt: skip
    """Refuse gaps of an input over which bridges of that length tell too little of it.

    What drives the machine is then made up there, and looks like a force that nobody knows.
    """
    start, stop = max(gaps, key=lambda gap: gap[1] - gap[0])
    lost = sum(b - a for a, b in gaps) / len(values)
    lengths = [b - a for a, b in gaps]
    misses = {n: _bridging_error(values, gaps, n, across) for n in set(lengths)}
    if not sum(n * misses[n] ** 2 for n in lengths) > _MADE_UP**2 * len(values):
        return
    missed = misses[stop - start]
    raise InputError(
        f"{series.name}: input {key!r} is missing for {lost:.2g} of the time, up to "
        f"{_samples(stop - start)} in a row (at {time[start]:.6g} s); where it is known, a bridge "
        f"of that length misses {missed:.0%} of it",
        "gaps over which an input can be told",
        _suggest_stretches(series, time, gaps, first),
    )


def _suggest_stretches(
    series: FileSeries, time: Array, gaps: list[tuple[int, int]], first: int
) -> str:
    """Advice: the rows between the gaps that are long enough for a record, the longest first."""
    ends, half = [0, *(i for gap in gaps for i in gap), len(time)], 0.5 * (time[1] - time[0])

    def row(sample: int) -> int:
        return first + int(np.searchsorted(series.time, time[sample] - half))

    between = zip(ends[::2], ends[1::2], strict=True)
    rows = [(row(a), row(b - 1) + 1) for a, b in between if b > a]
    rows = [(a, b) for a, b in rows if b - a >= MINIMUM_SAMPLES]
    if not rows:
        return "a record in which this input has fewer gaps"
    longest = sorted(sorted(rows, key=lambda ab: ab[0] - ab[1])[:_LISTED])
    told = ", ".join(f"[{a}, {b}]" for a, b in longest)
    what = "what is between the gaps" if len(longest) > 1 else "the longest stretch without any"
    return f"record.rows='[{told}]' takes {what}, each stretch as a record of its own"


def _bridging_error(
    values: Array, gaps: list[tuple[int, int]], length: int, across: Bridge
) -> float:
    """What bridges of so many samples miss where values are known, over their deviation (rms).

    Shorter ones are tried where so many are nowhere known in a row.
    """
    known = np.ones(len(values), dtype=bool)
    for start, stop in gaps:
        known[start:stop] = False
    spread = float(values[known].std()) if known.any() else 0.0
    while length and spread > 0:
        reach = length + 2 * _CONTEXT
        whole = np.flatnonzero(np.convolve(known, np.ones(reach), "valid") == reach)
        if len(whole):
            places = whole[np.linspace(0, len(whole) - 1, _TRIED).astype(int)]
            missed = [_bridge_miss(values[at : at + reach], across) for at in places]
            return float(np.sqrt(np.mean(np.square(missed)))) / spread
        length //= 2
    return 1.0 if spread > 0 else 0.0


def _bridge_miss(values: Array, across: Bridge) -> Array:
    """What a bridge over all but ``_CONTEXT`` values at either end misses."""
    part = values.copy()
    part[_CONTEXT:-_CONTEXT] = np.nan
    return (across(part) - values)[_CONTEXT:-_CONTEXT]


def _samples(count: int) -> str:
    return f"{count} sample" if count == 1 else f"{count} samples"


def _long_gap_error(
    series: FileSeries, what: str, count: int, row: int, at: float, longest: int
) -> InputError:
    return InputError(
        f"{series.name}: a gap of {_samples(count)} in {what} at {at:.6g} s (row {row})",
        f"gaps of at most {_samples(longest)} (record.fill_gaps={longest})",
        "cut the record there with record.rows, or give its parts as several records",
    )


def _interpolate_missing(values: Array) -> Array:
    from scipy.interpolate import Akima1DInterpolator

    known = np.isfinite(values)
    rows = np.arange(len(values))
    filled = values.copy()
    filled[~known] = Akima1DInterpolator(rows[known], values[known])(rows[~known])
    return filled


def _hold_missing(values: Array) -> Array:
    """The level before a gap up to its middle, then the one behind it."""
    rows, known = np.arange(len(values)), np.flatnonzero(np.isfinite(values))
    behind = np.clip(np.searchsorted(known, rows), 0, len(known) - 1)
    before = np.clip(np.searchsorted(known, rows, "right") - 1, 0, len(known) - 1)
    nearer = rows - known[before] <= known[behind] - rows
    return values[np.where(nearer, known[before], known[behind])]


# --- rates ---------------------------------------------------------------------------------------


def held_inputs_of(system: System) -> tuple[str, ...]:
    """The inputs that a system declares to be held between their samples."""
    return tuple(i.name for i in system.inputs if i.interpolation in HELD)


def resample_series(system: System, series: FileSeries, rate: float) -> FileSeries:
    """Another, uniform rate: interpolation where steps differ, then an anti-alias filter.

    Signals pass a linear-phase low-pass (Kaiser window) at half the new rate; what the system calls
    smooth (speed, phase) is interpolated by a cubic spline. The ends that the filter cannot fill
    are left out. Declared noise shrinks as white noise does in that filter. Where the rate stays,
    inputs that are held jump at the same moments as before.

    Raises
    ------
    InputError : a rate above the file's own, or a gap.
    """
    from scipy.interpolate import CubicSpline

    steps = np.diff(series.time)
    own = float(len(steps) / (series.time[-1] - series.time[0]))
    _check_rate(series, steps, own, rate)
    even = bool(np.max(np.abs(steps - 1 / own)) <= JITTER / own)
    up, down, grid = _resampling_ratio(series.time, own, rate, even)
    smooth = {i.name for i in system.inputs if i.interpolation == "smooth"}
    taps = _low_pass_taps(up, down)
    edge = 0 if up == down == 1 else _TAPS
    count = -(-len(grid) * up // down)
    step = (grid[1] - grid[0]) * down / up
    time = (grid[0] + step * np.arange(count))[edge : count - edge]

    held = held_inputs_of(system) if up == down == 1 else ()

    def resample_values(key: str, values: Array) -> Array:
        if key in held:
            halfway = (series.time[1:] + series.time[:-1]) / 2  # a stamp may be a little late
            return values[np.searchsorted(halfway, time)]
        if key in smooth:
            return CubicSpline(series.time, values)(time)
        level = values if even else CubicSpline(series.time, values)(grid)
        return _polyphase_filter(level, up, down, taps)[edge : count - edge]

    filled = {k: np.interp(time, series.time, v) > 0 for k, v in series.filled.items()}
    gain = float(np.sqrt(up * np.sum(taps**2)))
    noise = {k: gain * v for k, v in series.noise.items()}
    steps_word = "" if even else f", uneven steps of {steps.min():.4g} to {steps.max():.4g} s"
    changed = series.transform_series(resample_values)
    return replace(changed, time=time, noise=noise, filled=filled).with_note(
        f"resampled from {own:.6g} to {1 / step:.6g} Hz{steps_word}"
        + ("" if edge == 0 else f", anti-alias filter, {edge} samples less at each end")
    )


def _check_rate(series: FileSeries, steps: Array, own: float, rate: float) -> None:
    if rate > own * (1 + 1e-3):
        raise InputError(
            f"record.resample={rate:g} of {series.name}",
            f"at most its own rate, {own:.6g} samples per s",
            "more samples than were measured hold nothing new, and their noise is not white",
        )
    lowest = (MINIMUM_SAMPLES + 2 * _TAPS) / float(series.time[-1] - series.time[0])
    if rate < min(lowest, own * (1 - 1e-3)):
        raise InputError(
            f"record.resample={rate:g} of {series.name}",
            f"at least {lowest:.6g} samples per s: {MINIMUM_SAMPLES} samples, and the "
            f"{2 * _TAPS} at the ends that the anti-alias filter cannot fill",
            "a higher rate, or a longer record",
        )
    usual = float(np.median(steps))
    at = int(np.argmax(steps))
    if steps[at] > (_SKIP + 1) * usual:
        missing = int(np.rint(steps[at] / usual)) - 1
        raise InputError(
            f"{series.name}: a gap of {steps[at]:.6g} s after {series.time[at]:.6g} s (row {at}), "
            f"where steps of {usual:.4g} s are usual",
            "steps that may be uneven, but no gaps",
            f"record.fill_gaps={missing} as well, or cut the record there with record.rows",
        )


def _resampling_ratio(time: Array, own: float, rate: float, even: bool) -> tuple[int, int, Array]:
    """(up, down, grid): resampling factors, and the uniform grid that they start from."""
    if even:
        share = Fraction(rate / own).limit_denominator(_FINEST)
        return share.numerator, share.denominator, time
    down = max(int(np.ceil(own / rate - 1e-3)), 1)
    step = 1 / (rate * down)
    count = int(np.floor((time[-1] - time[0]) / step * (1 + 1e-12))) + 1
    return 1, down, time[0] + step * np.arange(count)


def _low_pass_taps(up: int, down: int) -> Array:
    """Unit-gain filter for a change of rate by up/down, at the rate times ``up``."""
    from scipy.signal import firwin

    widest = max(up, down)
    if widest == 1:
        return np.ones(1)
    window: Any = ("kaiser", _KAISER)
    return np.asarray(firwin(2 * _TAPS * widest + 1, 1 / widest, window=window))


def _polyphase_filter(values: Array, up: int, down: int, taps: Array) -> Array:
    from scipy.signal import resample_poly

    return values if up == down == 1 else resample_poly(values, up, down, window=taps)
