"""Run the compiled extended filter on a task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.filter.long_steps import long_steps_of
from spiral.engine.filter.observer import Reconstruction
from spiral.engine.filter.task import FilterInput
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
    walk of variance ``wander`` per sample; ``correlation`` (tracked, tracked) of what is doubted of
    them, none where it is empty. ``second_order``: the paper's transition. ``volume`` is
    1/2 log(|P'| / |P|), P' the ``covariance`` and P that of the machine's own motion: added to the
    log-likelihood, so that a filter with a narrowed initial covariance P' compares with one that
    begins with P (Laplace).
    """

    process: Array
    noise: Array
    start: Array
    covariance: Array
    tracked: tuple[str, ...] = ()
    doubt: Array = field(default_factory=lambda: np.zeros(0))
    wander: Array = field(default_factory=lambda: np.zeros(0))
    correlation: Array = field(default_factory=lambda: np.zeros((0, 0)))
    second_order: bool = False
    volume: float = 0.0

    @property
    def first_covariance(self) -> Array:
        """(N, N) of states and tracked parameters before the first sample."""
        full = block_diagonal(self.covariance, self.doubt**2)
        if self.correlation.size:
            n = len(self.covariance)
            full[n:, n:] = self.correlation * np.outer(self.doubt, self.doubt)
        return full


Settings = FilterSettings
"""The former name of ``FilterSettings``, which users' observers may import."""

FilterInputs = tuple[tuple[FilterInput, FilterSettings], ...]
"""For each record of one machine: its filter input, and settings without process noise."""


@dataclass(frozen=True)
class FilterPass:
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


def tracked_indices(task: FilterInput, names: tuple[str, ...]) -> Array:
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


def filter_record(
    task: FilterInput, settings: FilterSettings, keep: bool = False, samples: int | None = None
) -> FilterPass:
    """Filter the record, or its first ``samples``; ``keep`` what a smoother needs."""
    from spiral.engine.filter.kernel import EXACT, SECOND_ORDER, extended_filter
    from spiral.engine.filter.long_steps_kernel import advance_long

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
    likelihood, done = extended_filter(
        flow.advance, compiled.rate, flow.output, advance_long,
        *long_steps_of(task, settings.tracked, ()).fields,
        np.concatenate([settings.start, task.values[tracked]]),
        settings.first_covariance,
        task.values.copy(), tracked, task.inputs, task.series.substeps, task.series.dt,
        SECOND_ORDER if second else EXACT, np.ascontiguousarray(y),
        settings.noise, block_diagonal(settings.process, settings.wander), *arrays,
    )  # fmt: skip
    return FilterPass(*arrays, float(likelihood), int(done))


def smooth_run(run: FilterPass) -> FilterPass:
    """Smooth a run kept whole: x_s = x - P l, P_s = P - P L P; innovations stay the filter's."""
    from spiral.engine.filter.smoother import smooth_record

    smooth_record(
        run.means, run.covariances, run.innovations, run.spreads, run.transitions,
        run.gains, run.slopes,
    )  # fmt: skip
    return replace(run, variances=np.diagonal(run.covariances, axis1=1, axis2=2).copy())


def block_diagonal(matrix: Array, tail: Array) -> Array:
    """The matrix with a diagonal appended."""
    n, extra = len(matrix), len(tail)
    full = np.zeros((n + extra, n + extra))
    full[:n, :n] = matrix
    full[n:, n:] = np.diag(tail)
    return full


def as_reconstruction(
    task: FilterInput,
    settings: FilterSettings,
    run: FilterPass,
    levels: Mapping[str, float],
    seconds: float,
    tuning_seconds: float,
) -> Reconstruction:
    """The arrays of a run as the result of an observer."""
    return Reconstruction(
        names=(*task.states, *settings.tracked),
        means=run.means,
        deviations=np.sqrt(np.maximum(run.variances, 0.0)),
        innovations=run.innovations,
        spreads=run.spreads,
        covariances=run.covariances,
        log_likelihood=run.log_likelihood,
        done=run.done,
        levels=dict(levels),
        seconds=seconds,
        tuning_seconds=tuning_seconds,
    )


filtered = filter_record
"""The former name of ``filter_record``, which users' observers may import."""
