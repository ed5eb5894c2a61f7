"""Integration error as a level of process noise: the least that can stand for zero.

Over one sample from states of the free run, steps and steps of half their length differ by 15/16 of
the former's error (Runge and Kutta's fourth order, its fifth power summed over twice the steps), so
that the error of a rate, and as a share of the rates' settled deviation a_i its level are

    r = 16/15 median |x_h - x_(h/2)| / (0.6745 dt),    level = max r_i / a_i
"""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.task import FilterInput, run_from_rest, with_finer_steps
from spiral.engine.filter.tuning import LOWEST
from spiral.engine.kernel import trajectories
from spiral.types.record import Array

_PLACES = 400  # at most, along the record
_SHARE = 16.0 / 15.0 / 0.6745  # a median, so that a transient at the start does not count
_FINE, _TIMES = 1e-8, 4  # level that finer steps are to reach, and the most of them
_LEAST = 1e-12  # the arithmetic's own


def rounding_level(task: FilterInput) -> float:
    """The level of process noise that stands for zero; the smallest tried where none is known."""
    states = run_from_rest(task.compiled, task.series, task.inputs, task.values)
    if states is None or task.inputs is not task.series.inputs:
        return LOWEST  # inputs that a fit has corrected belong to its steps
    first = np.arange(0, task.series.samples - 1, max(2, task.series.samples // _PLACES))
    usual, finer_steps = (
        _advance_one_sample(t, states[first], first) for t in (task, _multiply_steps(task, 2))
    )
    error = _SHARE * np.median(np.abs(usual - finer_steps), axis=0) / task.series.dt
    level = float(np.max(error / task.rates))
    return float(np.clip(level, _LEAST, LOWEST)) if np.isfinite(level) else LOWEST


def refine_steps(task: FilterInput) -> FilterInput:
    """The task with so many more steps that their error is a level of 1e-8; four times at most."""
    times = int(np.clip(np.ceil((rounding_level(task) / _FINE) ** 0.25), 1, _TIMES))
    return _multiply_steps(task, times) if task.inputs is task.series.inputs else task


def _multiply_steps(task: FilterInput, times: int) -> FilterInput:
    return with_finer_steps(task, times) if times > 1 else task


def _advance_one_sample(task: FilterInput, starts: Array, first: Array) -> Array:
    """(places, n) states one sample after ``first``."""
    states = np.full((task.series.samples, starts.shape[1]), np.nan)
    trajectories(
        task.compiled.rate_value, task.compiled.output_value, starts, first,
        np.full(len(first), 2), np.ascontiguousarray(task.values[None, :]), task.inputs,
        task.series.substeps, task.series.dt, states, np.empty_like(task.series.y),
    )  # fmt: skip
    return states[first + 1]
