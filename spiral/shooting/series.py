"""A record prepared for the engine: arrays on the integrator's grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.record import Array, Record
from spiral.system import System

_SPEED_RATE_KNOTS = 64  # samples between the knots of the smooth curve a rate is taken from


@dataclass(frozen=True)
class Series:
    """Arrays of one record.

    ``y`` (samples, channels), ``sigma`` (channels,), ``inputs`` ((samples - 1) * 2 * substeps + 1,
    input columns) on the half-step grid of the integrator, ``dt`` in s.
    """

    record: Record
    y: Array
    sigma: Array
    inputs: Array
    dt: float
    substeps: int

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.y.shape[0]

    def weight(self, mask: Array | None) -> Array:
        """(samples, channels): 1/sigma where the mask holds, else 0."""
        weight = np.broadcast_to(1.0 / self.sigma, self.y.shape).copy()
        if mask is not None:
            weight[~mask] = 0.0
        return weight


def prepare(system: System, record: Record, substeps: int) -> Series:
    """Make the arrays of a record; inputs are interpolated as the system's ``Input`` says."""
    sigma = record.sigma()
    return Series(
        record=record,
        y=np.column_stack([record.channels[c] for c in system.observed]),
        sigma=np.array([sigma[c] for c in system.observed]),
        inputs=half_step_inputs(system, record, substeps),
        dt=record.dt,
        substeps=substeps,
    )


def half_step_inputs(system: System, record: Record, substeps: int) -> Array:
    """Inputs at every half step of the integrator; columns as in ``trace.input_columns``."""
    count = (record.samples - 1) * 2 * substeps + 1
    if not system.inputs:
        return np.zeros((count, 0))
    coarse = np.arange(record.samples, dtype=float)
    fine = np.arange(count) / (2.0 * substeps)
    columns = [
        _interpolated(record.inputs[i.name], coarse, fine, i.interpolation, substeps)
        for i in system.inputs
    ]
    columns += [
        _rate(record.inputs[i.name], coarse, fine) / record.dt
        for i in system.inputs
        if i.derivative
    ]
    return np.ascontiguousarray(np.column_stack(columns))


def _interpolated(values: Array, coarse: Array, fine: Array, how: str, substeps: int) -> Array:
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample_poly

    if how == "zero_order":
        return values[np.minimum(fine.astype(int), len(values) - 1)]
    if how == "band_limited":
        dense = resample_poly(values, 2 * substeps, 1, window=("kaiser", 8.0), padtype="line")
        return dense[: len(fine)]
    return CubicSpline(coarse, values)(fine)


def _rate(values: Array, coarse: Array, fine: Array) -> Array:
    """Rate per sample of a least-squares cubic spline with knots about 64 samples apart."""
    from scipy.interpolate import make_lsq_spline

    pieces = max(1, len(values) // _SPEED_RATE_KNOTS)
    inner = np.linspace(coarse[0], coarse[-1], pieces + 1)[1:-1]
    knots = np.concatenate([[coarse[0]] * 4, inner, [coarse[-1]] * 4])
    return make_lsq_spline(coarse, values, knots, k=3).derivative()(fine)
