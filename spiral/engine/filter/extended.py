"""Run the compiled extended filter on a task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.filter.observer import Reconstruction
from spiral.engine.filter.task import Task
from spiral.physics.compile import compile_model
from spiral.physics.flow import compile_flow
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.record import Array


@dataclass(frozen=True)
class FilterSettings:
    """Numbers of one run of the filter.

    ``process`` (n, n) covariance of the process noise per sample; ``noise`` (channels,) variances;
    ``start`` (n,) and ``covariance`` (n, n) before the first sample. ``tracked`` parameters are
    estimated as states, from their present value with standard deviation ``doubt`` and a random
    walk of variance ``wander`` per sample. ``second_order``: the paper's transition. ``volume`` is
    the logarithm of the share of a machine's first states that ``covariance`` looks among.
    """

    process: Array
    noise: Array
    start: Array
    covariance: Array
    tracked: tuple[str, ...] = ()
    doubt: Array = field(default_factory=lambda: np.zeros(0))
    wander: Array = field(default_factory=lambda: np.zeros(0))
    second_order: bool = False
    volume: float = 0.0


Settings = FilterSettings
"""The name by which observers of version 0.1 import it."""


@dataclass(frozen=True)
class Pass:
    """Raw arrays of one run; those for a smoother are empty unless asked for."""

    means: Array
    variances: Array
    innovations: Array
    spreads: Array
    covariances: Array
    transitions: Array
    gains: Array
    slopes: Array
    log_likelihood: float
    done: int


def tracked_indices(task: Task, names: tuple[str, ...]) -> Array:
    """Positions of parameters that are estimated as states.

    Raises
    ------
    ConfigError : a name that is no parameter of the model.
    """
    for name in names:
        if name not in task.keys:
            raise ConfigError(
                f"track={name}", "a parameter of the model", did_you_mean(name, task.keys)
            )
    return np.array([task.keys.index(n) for n in names], dtype=np.int64)


def filtered(
    task: Task, settings: FilterSettings, keep: bool = False, samples: int | None = None
) -> Pass:
    """Filter the record, or its first ``samples``; ``keep`` what a smoother needs."""
    from spiral.engine.filter.kernel import EXACT, SECOND_ORDER, extended

    tracked = tracked_indices(task, settings.tracked)
    traced = task.compiled.traced
    second = settings.second_order
    compiled = compile_model(traced, settings.tracked) if second else task.compiled
    flow = compile_flow(traced, (*settings.tracked, *task.moved))
    y = task.series.y if samples is None else task.series.y[:samples]
    count, m = y.shape
    size = len(settings.start) + len(tracked)
    kept = count if keep else 0
    arrays = (
        np.full((count, size), np.nan), np.full((count, size), np.nan),
        np.full((count, m), np.nan), np.full((count, m, m), np.nan),
        np.empty((kept, size, size)), np.empty((kept, size, size)),
        np.empty((kept, size, m)), np.empty((kept, m, size)),
    )  # fmt: skip
    likelihood, done = extended(
        flow.advance, compiled.rate, flow.output,
        np.concatenate([settings.start, task.values[tracked]]),
        block_diagonal(settings.covariance, settings.doubt**2),
        task.values.copy(), tracked, task.inputs, task.series.substeps, task.series.dt,
        SECOND_ORDER if second else EXACT, np.ascontiguousarray(y),
        settings.noise, block_diagonal(settings.process, settings.wander), *arrays,
    )  # fmt: skip
    return Pass(*arrays, float(likelihood), int(done))


def smoothed(found: Pass) -> Pass:
    """A run kept whole, every sample judged by all of the record; innovations stay the filter's."""
    from spiral.engine.filter.smoother import smooth

    smooth(
        found.means, found.covariances, found.innovations, found.spreads, found.transitions,
        found.gains, found.slopes,
    )  # fmt: skip
    return replace(found, variances=np.diagonal(found.covariances, axis1=1, axis2=2).copy())


def block_diagonal(matrix: Array, tail: Array) -> Array:
    """The matrix with a diagonal appended."""
    n, extra = len(matrix), len(tail)
    full = np.zeros((n + extra, n + extra))
    full[:n, :n] = matrix
    full[n:, n:] = np.diag(tail)
    return full


def as_reconstruction(
    task: Task,
    settings: FilterSettings,
    found: Pass,
    levels: Mapping[str, float],
    seconds: float,
    tuning_seconds: float,
) -> Reconstruction:
    """The arrays of a run as the result of an observer."""
    return Reconstruction(
        names=(*task.states, *settings.tracked),
        means=found.means,
        deviations=np.sqrt(np.maximum(found.variances, 0.0)),
        innovations=found.innovations,
        spreads=found.spreads,
        covariances=found.covariances,
        log_likelihood=found.log_likelihood,
        done=found.done,
        levels=dict(levels),
        seconds=seconds,
        tuning_seconds=tuning_seconds,
    )
