"""A record prepared for the engine: arrays on the integrator's grid."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from spiral.types.noise import estimate_noise
from spiral.types.parameter import HELD, Interpolation
from spiral.types.record import Array, Record
from spiral.types.system import System

SPEED_RATE_KNOTS = 64  # samples between the knots of the curve that a rate is taken from, at most


_MOST_PIECES = 60
MOST_SUBSTEPS = 32
MOST_STABLE = 512  # the same where a mode would else be unstable
_LASTING = 1 / 3  # of a motion, which every quarter of the record has that goes on
_ADVANCE = 0.3  # rad, largest advance of a mode per integration step
_STABLE_ADVANCE = 1.0  # the same of modes that need be stable only
_LARGEST_ADVANCE = 2.0  # the same beyond ``MOST_SUBSTEPS``
_ROUNDING = 1e-12  # of an input's size, by which it may differ where it is one value
_SMOOTH = 11  # samples of the local cubics that say how large a reading is


@dataclass(frozen=True)
class Splines:
    """B-splines of a phase correction: at each half step the first one and the weights of four.

    ``count`` is the number of splines; 0 means that the record has no correction.
    """

    first: Array
    weights: Array
    count: int

    def value(self, coefficients: Array) -> Array:
        """The correction on the half-step grid, rad."""
        at = self.first[:, None] + np.arange(self.weights.shape[1])
        return np.sum(self.weights * coefficients[at], axis=1)


@dataclass(frozen=True)
class Series:
    """Arrays of one record.

    ``y`` (samples, channels), ``sigma`` (channels,), ``inputs`` as of ``stage_inputs``, ``dt`` in
    s. ``seen`` (samples, channels) is False where a reading is no measurement (``y`` is bridged
    there), or nothing where all are; ``loudness`` by channel is the variance of this record's noise
    over that of all; ``growth`` by channel is (centre, height, mean) of a noise
    variance that grows with the reading (``grown``).
    """

    record: Record
    y: Array
    sigma: Array
    inputs: Array
    dt: float
    substeps: int
    splines: Splines
    seen: Array | None = None
    growth: tuple[tuple[float, float, float] | None, ...] = ()
    loudness: tuple[float, ...] = ()

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.y.shape[0]

    def smooth_readings(self, window: int) -> tuple[Array, ...]:
        """Local cubics through the readings: value, first and second derivative.

        The last window's are kept, because one fit after another begins with them.
        """
        from scipy.signal import savgol_filter

        if window not in self._smoothed:
            degree = min(3, window - 2)
            self._smoothed.clear()
            self._smoothed[window] = tuple(
                np.asarray(savgol_filter(self.y, window, degree, deriv=k, delta=self.dt, axis=0))
                for k in range(3)
            )
        return self._smoothed[window]

    @cached_property
    def _smoothed(self) -> dict[int, tuple[Array, ...]]:
        return {}

    @cached_property
    def is_lasting(self) -> bool:
        """Whether readings go on moving: in every quarter by a third of what they do in all.

        What only decays, or grows from where it began, does not.
        """
        least = _LASTING * self.deviations
        return all(np.all(y.std(axis=0) >= least) for y in np.array_split(self.y, 4))

    @cached_property
    def deviations(self) -> Array:
        """(channels,) standard deviation of the readings."""
        return np.array([np.std(column) for column in self.y.T])

    @cached_property
    def mean_inputs(self) -> Array:
        """(input columns,) their mean over the record."""
        return self.inputs.mean(axis=0) if self.inputs.size else np.zeros(self.inputs.shape[1])

    def changing_inputs(self, names: Sequence[str]) -> tuple[str, ...]:
        """Those of the input columns that do not stay as they are all along the record."""
        return tuple(n for n, held in zip(names, self._held_inputs, strict=True) if not held)

    @cached_property
    def _held_inputs(self) -> list[bool]:
        """By input column, whether it is one value, but for the rounding of its interpolation."""
        spread = np.ptp(self.inputs, axis=0)
        return list(spread <= _ROUNDING * np.abs(self.inputs).max(axis=0))

    @cached_property
    def grown(self) -> Array | None:
        """(samples, channels) factors of the noise variance: loudness (1 + ((y - c) / h)^2) / m."""
        if not any(self.growth) and set(self.loudness) <= {1.0}:
            return None
        shares = np.ones_like(self.y) * (self.loudness or 1.0)
        if not any(self.growth):
            return shares
        smooth = self.smooth_readings(min(_SMOOTH, self.samples))[0]
        for j, growth in enumerate(self.growth):
            if growth is not None:
                centre, height, mean = growth
                shares[:, j] *= (1 + ((smooth[:, j] - centre) / height) ** 2) / mean
        return shares

    def weight(self, mask: Array | None) -> Array:
        """(samples, channels): 1/sigma where the mask holds, else 0."""
        weight = np.broadcast_to(1.0 / self.sigma, self.y.shape).copy()
        if mask is not None:
            weight[~mask] = 0.0
        if self.seen is not None:
            weight[~self.seen] = 0.0
        return weight


def prepare_series(system: System, record: Record, substeps: int, knot: float = 0.0) -> Series:
    """The arrays of a record; inputs between samples as the record says, else as the system does.

    ``knot`` (s) spaces the knots of a smooth phase correction, which a record gets where its phase
    was integrated from a measured speed; 0 makes none. Cached: a series that is still in use, or a
    small one among the last 16, is not built again.
    """
    key = (id(record), system.observed, system.inputs, substeps, knot)
    known = _IN_USE.get(key)
    if known is None or known.record is not record:
        known = _IN_USE[key] = _build_series(system, record, substeps, knot)
        if known.inputs.size <= _SMALL:
            _LAST.append(known)
    return known


_IN_USE: WeakValueDictionary[Any, Series] = WeakValueDictionary()
"""Cache of series by their arguments, as long as something refers to them."""
_LAST: deque[Series] = deque(maxlen=16)
_SMALL = 2**20  # input values up to which a series stays in _LAST: 8 MB each, 128 MB in all


def _build_series(system: System, record: Record, substeps: int, knot: float) -> Series:
    derived = [i.name for i in system.inputs if i.derived_from in record.measured]
    wanted = knot > 0 and "phase" in derived and "phase" not in record.measured
    sigma = record.sigma()
    return Series(
        record=record,
        y=np.column_stack([record.reading(c) for c in system.observed]),
        sigma=np.array([sigma[c] for c in system.observed]),
        inputs=stage_inputs(system, record, substeps),
        dt=record.dt,
        substeps=substeps,
        splines=correction_splines(record, substeps, knot if wanted else 0.0),
        seen=measured_mask(record, system.observed),
        growth=tuple(record.growth.get(c) for c in system.observed),
        loudness=tuple(record.loudness.get(c, 1.0) for c in system.observed),
    )


def measured_mask(record: Record, channels: Sequence[str]) -> Array | None:
    """(samples, channels) False where a reading is no measurement; nothing where all are."""
    gone = [record.gone(c) for c in channels]
    if all(g is None for g in gone):
        return None
    none = np.zeros(record.samples, dtype=bool)
    return ~np.column_stack([none if g is None else g for g in gone])


def correction_splines(record: Record, substeps: int, knot: float) -> Splines:
    """Cubic B-splines on the half-step grid, knots about ``knot`` seconds apart (at most 60)."""
    from scipy.interpolate import BSpline

    count = (record.samples - 1) * 2 * substeps + 1
    if knot <= 0:
        return Splines(np.zeros(count, dtype=np.int64), np.zeros((count, 0)), 0)
    duration = (record.samples - 1) * record.dt
    pieces = int(np.clip(round(duration / knot), 1, _MOST_PIECES))
    inner = np.linspace(0.0, duration, pieces + 1)
    knots = np.concatenate([[0.0] * 3, inner, [duration] * 3])
    time = np.linspace(0.0, duration, count)
    matrix = BSpline.design_matrix(time, knots, 3)
    first = matrix.indices[matrix.indptr[:-1]].astype(np.int64)
    return Splines(first, np.ascontiguousarray(matrix.data.reshape(count, 4)), pieces + 3)


def steps_per_sample(eigenvalues: Array, dt: float, exact_to: float = np.inf) -> int:
    """Runge-Kutta steps per sample for modes of a model with these eigenvalues, 1/s.

    A mode advances by 0.3 rad a step at most. Others have to be stable (2.8 is the limit of the
    classical method), not precise: one that is gone within a sample (real part below -1 / dt) and
    beyond what the samples can show (pi), which follows the others, and one above the frequency
    ``exact_to``, Hz, up to which a system's equations hold. Precision takes ``MOST_SUBSTEPS`` at
    most; stability of modes that decay (2 rad a step), as many as it needs.
    """
    advance = np.abs(eigenvalues) * dt
    precise, stable = advance / _ADVANCE, advance / _STABLE_ADVANCE
    gone = (np.real(eigenvalues) * dt < -1.0) & (advance > np.pi)
    seen = np.where(gone, np.maximum(np.pi / _ADVANCE, stable), precise)
    seen = np.where(np.abs(eigenvalues) > 2 * np.pi * exact_to, stable, seen)
    precise_steps = np.clip(np.ceil(np.max(seen, initial=0.0)), 1, MOST_SUBSTEPS)
    return int(max(precise_steps, stable_steps(eigenvalues, dt)))


def stable_steps(eigenvalues: Array, dt: float) -> int:
    """Runge-Kutta steps per sample without which a mode that decays or swings would grow."""
    swings = np.real(eigenvalues) <= 0
    fastest = np.max(np.abs(eigenvalues), where=swings, initial=0.0) * dt
    return int(np.clip(np.ceil(fastest / _LARGEST_ADVANCE), 1, MOST_STABLE))


def stage_inputs(system: System, record: Record, substeps: int) -> Array:
    """Inputs at the start, middle and end of every integration step, then at the last sample.

    (3 * steps + 1, columns), columns as in ``trace.input_columns``: sample k is row
    3 * substeps * k. A step does not share its end with the start of the next, since an input that
    is held jumps there: the step before ends with the old value, and the reading, like the step
    after, has the new one.
    """
    count = (record.samples - 1) * 2 * substeps + 1
    coarse = np.arange(record.samples, dtype=float)
    fine = np.arange(count) / (2.0 * substeps)
    columns = [
        interpolate_input(record.inputs[i.name], coarse, fine, record.between(i))
        for i in system.inputs
    ]
    columns += [
        rate_per_sample(record.inputs[i.name], coarse, fine) / record.dt
        for i in system.inputs
        if i.derivative
    ]
    columns.append(record.time[0] + fine * record.dt)
    held = [k for k, i in enumerate(system.inputs) if record.between(i) in HELD]
    return rows_at_stages(np.column_stack(columns), held)


def rows_at_stages(rows: Array, held: Sequence[int] = ()) -> Array:
    """Rows of the half-step grid at the stages of all integration steps (``stage_inputs``).

    Columns that are ``held`` end a step with the value that they have in it.
    """
    steps = len(rows) // 2
    stages = rows[np.append(2 * np.arange(steps)[:, None] + np.arange(3), 2 * steps)]
    for column in held:
        stages[2::3, column] = stages[1::3, column]
    return stages


def sample_inputs(stages: Array, substeps: int) -> Array:
    """(samples, columns) inputs at the samples, from those at the stages (``stage_inputs``).

    Where a held input jumps, the mean of both values: what acts about the sample, as in a rate that
    is taken across it. A reading at the sample has the new value.
    """
    rows = stages[:: 3 * substeps].copy()
    rows[1:] = 0.5 * (rows[1:] + stages[3 * substeps - 1 :: 3 * substeps])
    return rows


def interpolate_input(values: Array, coarse: Array, fine: Array, how: Interpolation) -> Array:
    """An input on a finer grid, run between its samples as ``Input.interpolation`` says."""
    if how in HELD:
        return values[np.maximum(fine.astype(np.int64) - HELD[how], 0)]
    if how == "linear":
        return np.interp(fine, coarse, values)
    if how == "band_limited":
        from scipy.signal import resample_poly

        finer = round((len(fine) - 1) / (len(values) - 1))
        dense = resample_poly(values, finer, 1, window=("kaiser", 8.0), padtype="line")
        return dense[: len(fine)]
    from scipy.interpolate import CubicSpline

    values = without_white_noise(values) if how == "denoised" else values
    return CubicSpline(coarse, values)(fine)


def without_white_noise(values: Array) -> Array:
    """Samples (samples, ...) without white noise of deviation s (``estimate_noise``).

    By the filter of Wiener (1949): of each frequency the share 1 - c s^2 / P(f) is kept, none where
    that is negative, P being Welch's estimate of the spectrum (white noise has s^2) and c two of
    its standard errors above one.
    """
    from scipy.signal import welch

    count = len(values)
    if count < 64:  # no spectrum to tell them apart by
        return values
    if values.ndim > 1:
        return np.stack([without_white_noise(v) for v in values.T], axis=-1)
    width = min(max(count // 32, 64), 1024)
    frequency, power = welch(values, nperseg=width)
    most = 2.0 * estimate_noise(values) ** 2 * (1.0 + 2.0 * np.sqrt(width / count))  # one-sided
    kept = np.clip(1.0 - most / np.maximum(power, np.finfo(float).tiny), 0.0, 1.0)
    kept[0] = 1.0
    before, after = values[width:0:-1], values[-2 : -width - 2 : -1]
    longer = np.concatenate([2 * values[0] - before, values, 2 * values[-1] - after])
    share = np.interp(np.fft.rfftfreq(len(longer)), frequency, kept)
    return np.fft.irfft(share * np.fft.rfft(longer), len(longer))[width : width + count]


def rate_per_sample(values: Array, coarse: Array, fine: Array) -> Array:
    """Rate per sample of a least-squares cubic spline with knots up to 64 samples apart.

    They are half as far apart, down to two samples, as long as the spline misses more of the
    values than twice their noise. Of values that even these miss (waves of a few samples with
    little noise) it is the rate of a spline of fifth order through them all.
    """
    return rates_per_sample(values[:, None], coarse, fine)[:, 0]


def rates_per_sample(values: Array, coarse: Array, fine: Array) -> Array:
    """``rate_per_sample`` of every column of values (samples, columns): (fine, columns)."""
    from scipy.interpolate import make_interp_spline, make_lsq_spline

    noise = np.array(  # the estimate is of high-order differences
        [estimate_noise(v) if len(coarse) > 12 else 0.0 for v in values.T]
    )
    most = np.maximum(2.0 * noise, 1e-6 * np.std(values, axis=0))
    spacing, rates = SPEED_RATE_KNOTS, np.empty((len(fine), values.shape[1]))
    left = np.arange(values.shape[1])
    while left.size and spacing > 1:
        inner = np.linspace(coarse[0], coarse[-1], max(1, len(coarse) // spacing) + 1)[1:-1]
        knots = np.concatenate([[coarse[0]] * 4, inner, [coarse[-1]] * 4])
        curve = make_lsq_spline(coarse, values[:, left], knots, k=3, method="norm-eq")
        missed = np.sqrt(np.mean((values[:, left] - curve(coarse)) ** 2, axis=0))
        done = missed <= most[left]
        if done.any():
            rates[:, left[done]] = curve.derivative()(fine)[:, done]
        left, spacing = left[~done], spacing // 2
    if left.size:
        order = min(5, len(coarse) - 1)
        through = make_interp_spline(coarse, values[:, left], k=order if order % 2 else order - 1)
        rates[:, left] = through.derivative()(fine)
    return rates
