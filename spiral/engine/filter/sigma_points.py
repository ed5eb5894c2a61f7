"""Run the compiled unscented filter on a task."""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.extended import (
    FilterPass,
    FilterSettings,
    block_diagonal,
    tracked_indices,
)
from spiral.engine.filter.task import FilterInput
from spiral.types.record import Array


def sigma_weights(size: int, alpha: float, beta: float, kappa: float) -> tuple[float, Array]:
    """sqrt(N + lambda), and weights (2, 2 N + 1) of mean and covariance (van der Merwe 2004)."""
    total = alpha**2 * (size + kappa)
    table = np.full((2, 2 * size + 1), 0.5 / total)
    table[0, 0] = (total - size) / total
    table[1, 0] = table[0, 0] + 1.0 - alpha**2 + beta
    return float(np.sqrt(total)), table


def filter_sigma_points(
    task: FilterInput,
    settings: FilterSettings,
    shape: tuple[float, float, float],
    keep: bool = False,
) -> FilterPass:
    """Filter the record; ``shape`` is (alpha, beta, kappa); ``keep`` the covariances."""
    from spiral.engine.filter.unscented import unscented_filter

    tracked = tracked_indices(task, settings.tracked)
    y = task.series.y
    count, m = y.shape
    size = len(settings.start) + len(tracked)
    spread, table = sigma_weights(size, *shape)
    arrays = (
        np.full((count, size), np.nan), np.full((count, size), np.nan),
        np.full((count, m), np.nan), np.full((count, m, m), np.nan),
        np.empty((count if keep else 0, size, size)),
    )  # fmt: skip
    likelihood, done = unscented_filter(
        task.compiled.rate_value, task.compiled.output_value,
        np.concatenate([settings.start, task.values[tracked]]),
        settings.first_covariance,
        task.values.copy(), tracked, task.inputs, task.series.substeps, task.series.dt,
        spread, table, y, settings.noise, block_diagonal(settings.process, settings.wander),
        *arrays,
    )  # fmt: skip
    none = np.empty((0, size, size))
    return FilterPass(*arrays, none, none, none, float(likelihood), int(done))
