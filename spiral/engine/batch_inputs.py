"""Inputs of many simulations, laid out so that a device interpolates them between samples.

Between two samples an input is a polynomial in s, from 0 at the one to 1 at the next:

    u(s) = c_0                              held
    u(s) = c_0 + c_1 s                      straight lines, time itself
    u(s) = c_0 + c_1 s + c_2 s^2 + c_3 s^3  a cubic spline

so that a sample needs a few numbers, where the stages of its integration steps are many
(``series.stage_inputs``). What is no such polynomial (a band-limited input, a rate) is given at the
stages themselves.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from spiral.engine.series import rates_per_sample, without_white_noise
from spiral.types.parameter import HELD, Input
from spiral.types.placement import input_columns
from spiral.types.record import Array, integrate_derived_inputs
from spiral.types.system import System


@dataclass(frozen=True)
class InputColumn:
    """One input of all simulations between all samples.

    ``parts`` are (samples,) where simulations share it, else (samples, simulations): coefficients
    of a polynomial in rising order, or values at the half steps 0, 1/2m, ... 1 where ``stepped``;
    none where no equation has the input. Past the last sample it keeps its value.
    """

    parts: tuple[Array, ...]
    stepped: bool = False

    def stage(self, parts: tuple[Any, ...], half_step: int, half_steps: int) -> Any:
        """Its value at a half step after a sample, from that sample's parts."""
        if self.stepped:
            return parts[half_step]
        total, s = 0.0, half_step / half_steps
        for part in reversed(parts):
            total = part + s * total if half_step else part
        return total

    @property
    def layout(self) -> tuple[bool, tuple[bool, ...]]:
        """Whether it is stepped, and of each part whether simulations differ in it."""
        return self.stepped, tuple(p.ndim == 2 for p in self.parts)

    @property
    def first(self) -> Array | float:
        """Its value at the first sample, (simulations,) or one for all."""
        return self.parts[0][0] if self.parts else 0.0


def lay_out_inputs(
    system: System, time: Array, inputs: Mapping[str, Array], substeps: int, used: Collection[str]
) -> tuple[InputColumn, ...]:
    """The columns of ``trace.input_columns`` for many simulations.

    Parameters
    ----------
    time : (samples,) s. inputs : by name, (samples,) or (simulations, samples).
    substeps : integration steps per sample. used : columns that equations have.
    """
    known = integrate_derived_inputs(system, time, inputs)
    step = (time[-1] - time[0]) / (len(time) - 1)
    rows = {name: np.ascontiguousarray(np.moveaxis(v, -1, 0)) for name, v in known.items()}
    columns = {i.name: _between_samples(i, rows[i.name], substeps) for i in system.inputs}
    for item in system.inputs:
        if item.derivative and item.rate.name in used:
            columns[item.rate.name] = _rate_column(rows[item.name], step, substeps)
    clock = (time[0] + step * np.arange(len(time)), np.full(len(time), step))
    clock[1][-1] = 0.0
    columns[input_columns(system)[-1]] = InputColumn(clock)
    unused = InputColumn(())
    return tuple(columns[n] if n in used else unused for n in input_columns(system))


def _between_samples(item: Input, rows: Array, substeps: int) -> InputColumn:
    """An input (samples, ...) as it runs between its samples."""
    if item.interpolation in HELD:
        at = np.maximum(np.arange(len(rows)) - HELD[item.interpolation], 0)
        return InputColumn((rows[at],))
    if item.interpolation == "linear":
        return InputColumn((rows, np.diff(rows, axis=0, append=rows[-1:])))
    if item.interpolation == "band_limited":
        from scipy.signal import resample_poly

        finer = 2 * substeps
        dense = resample_poly(rows, finer, 1, axis=0, window=("kaiser", 8.0), padtype="line")
        return _stepped_column(dense[: (len(rows) - 1) * finer + 1], substeps)
    from scipy.interpolate import CubicSpline

    rows = without_white_noise(rows) if item.interpolation == "denoised" else rows
    pieces = CubicSpline(np.arange(len(rows), dtype=float), rows, axis=0).c[::-1]
    ends = [rows[-1:], *(np.zeros_like(rows[-1:]) for _ in pieces[1:])]
    return InputColumn(tuple(np.concatenate(pair) for pair in zip(pieces, ends, strict=True)))


def _rate_column(rows: Array, step: float, substeps: int) -> InputColumn:
    coarse = np.arange(len(rows), dtype=float)
    fine = np.arange((len(rows) - 1) * 2 * substeps + 1) / (2.0 * substeps)
    flat = rates_per_sample(rows.reshape(len(rows), -1), coarse, fine) / step
    return _stepped_column(flat.reshape(len(fine), *rows.shape[1:]), substeps)


def _stepped_column(fine: Array, substeps: int) -> InputColumn:
    """Values on the half-step grid (half steps, ...) by sample."""
    each = 2 * substeps
    padded = np.concatenate([fine, np.repeat(fine[-1:], each, axis=0)])
    last = len(padded) - 1
    return InputColumn(
        tuple(np.ascontiguousarray(padded[j : j + last : each]) for j in range(each + 1)), True
    )
