"""Damped Gauss-Newton over windows, the initial states eliminated at every step."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.sensitivities import Reduction, reduce_windows
from spiral.engine.study import CompiledStudy, Layouts, ParameterColumns, Point
from spiral.types.label import owner_of
from spiral.types.record import Array

_ITERATIONS = 30
_ENOUGH = 0.02  # predicted fall of the sum of squares (in sigma^2) below which a fit has converged
_RELATIVE = 1e-6  # the same as a share of the sum of squares


@dataclass(frozen=True)
class WindowFit:
    """Result of one fit: where it ended and whether it converged; failing is a value."""

    point: Point
    cost: float
    samples: int
    nuisances: int
    converged: bool
    iterations: int
    reduction: Reduction | None

    @classmethod
    def from_reduction(
        cls, point: Point, reduction: Reduction, converged: bool, iterations: int
    ) -> WindowFit:
        """The result at a point, with its pass."""
        return cls(
            point, reduction.cost, reduction.samples, reduction.nuisances, converged, iterations,
            reduction,
        )  # fmt: skip

    @property
    def chi2_per_dof(self) -> float:
        """Sum of squares in sigma^2 over degrees of freedom."""
        free = self.nuisances + (0 if self.reduction is None else len(self.reduction.triangle) - 1)
        return self.cost / max(self.samples - free, 1)


def fit(
    study: CompiledStudy,
    layouts: Layouts,
    point: Point,
    columns: ParameterColumns,
    bounds: tuple[Array, Array],
    iterations: int = _ITERATIONS,
) -> WindowFit:
    """Minimise the weighted squared prediction error over columns and window starts.

    Each step solves min |R d - z|^2 + damping |S d|^2 with R the reduced triangle and S its column
    norms (Levenberg-Marquardt, scaled), then moves every window's start by its own linear map.
    """
    damping = 1e-6
    reduction = reduce_windows(study, layouts, point, columns)
    held = _hold_loose_columns(study, layouts, columns, reduction)
    if held is not columns:
        columns, reduction = held, reduce_windows(study, layouts, point, held)
    if not reduction.finite:
        return WindowFit(point, np.inf, reduction.samples, reduction.nuisances, False, 0, None)
    for iteration in range(1, iterations + 1):
        cost = reduction.cost
        worth = max(_ENOUGH, _RELATIVE * cost)
        better, trial, promised = None, point, np.inf
        for _ in range(8):
            step, promised = damped_step(reduction, columns, point, bounds, damping)
            if promised < worth:
                return WindowFit.from_reduction(point, reduction, True, iteration)
            trial = _move_point(point, columns, reduction, step)
            reached = reduce_windows(study, layouts, trial, columns)
            if reached.cost <= cost:
                better = reached
                break
            damping = max(damping * 10.0, 1e-4)
        if better is None:
            return WindowFit.from_reduction(point, reduction, promised < 10 * worth, iteration)
        point, reduction = trial, better
        damping = max(damping / 10.0, 1e-12)
        if cost - reduction.cost < worth:
            return WindowFit.from_reduction(point, reduction, True, iteration)
    return WindowFit.from_reduction(point, reduction, False, iterations)


def _hold_loose_columns(
    study: CompiledStudy, layouts: Layouts, columns: ParameterColumns, reduction: Reduction
) -> ParameterColumns:
    """The columns with a weak Gaussian prior at zero on ``loose`` ones (coefficients of a curve).

    Of an effect whose best seen coefficient moves the response by s (in sigma, for one unit), each
    is held at zero with the standard deviation |y| / s.
    """
    keys, known = study.keys, study.compiled.traced.parameters
    loose = [c for c, i in enumerate(columns.index) if i < len(keys) and known[i].loose]
    if not loose or not reduction.finite:
        return columns
    weighted = [
        s.weight(layout.mask) * s.y for s, layout in zip(study.series, layouts, strict=True)
    ]
    whole = float(np.sqrt(sum(np.sum(w**2) for w in weighted)))
    norms = np.linalg.norm(reduction.triangle[:-1, :-1], axis=0)
    width = np.full(columns.count, np.inf)
    owners = [owner_of(keys[columns.index[c]]) for c in loose]
    for owner in set(owners):
        own = [c for c, o in zip(loose, owners, strict=True) if o == owner]
        best = float(norms[own].max())
        width[own] = whole / best if best > 0 else np.inf
    return replace(columns, width=width)


def damped_step(
    reduction: Reduction,
    columns: ParameterColumns,
    point: Point,
    bounds: tuple[Array, Array],
    damping: float,
) -> tuple[Array, float]:
    """The damped step, kept inside the bounds, and the fall of the cost that it promises."""
    free = reduction.cost - float(reduction.triangle[-1, -1] ** 2)
    count = columns.count
    if count == 0:
        return np.zeros(0), free
    triangle, target = reduction.triangle[:-1, :-1], reduction.triangle[:-1, -1]
    scale = np.linalg.norm(triangle, axis=0)
    scale[scale == 0] = 1.0
    matrix = np.concatenate([triangle / scale, np.sqrt(damping) * np.eye(count)])
    now = columns.current(point.values)
    held = np.zeros(count, dtype=bool)
    step = np.zeros(count)
    for _ in range(count + 1):
        rest = np.concatenate([target - triangle[:, held] @ step[held], np.zeros(count)])
        moving = ~held
        solution, *_ = np.linalg.lstsq(matrix[:, moving], rest, rcond=1e-12)
        step[moving] = solution / scale[moving]
        low, high = now + step < bounds[0], now + step > bounds[1]
        outside = (low | high) & moving
        if not outside.any():
            break
        step = np.where(low & moving, bounds[0] - now, step)
        step = np.where(high & moving, bounds[1] - now, step)
        held |= outside
    return step, free


def _move_point(
    point: Point, columns: ParameterColumns, reduction: Reduction, step: Array
) -> Point:
    starts = tuple(
        x + e[:, :, -1] - e[:, :, :-1] @ step
        for x, e in zip(point.starts, reduction.elimination, strict=True)
    )
    return Point(columns.apply_step(point.values, step), starts)


def standard_deviations(fitted: WindowFit) -> Array:
    """Square roots of the covariance's diagonal; infinite for a column that nothing depends on."""
    if fitted.reduction is None:
        return np.zeros(0)
    spread = np.sqrt(np.maximum(np.diag(covariance(fitted)), 0.0))
    seen = np.linalg.norm(fitted.reduction.triangle[:-1, :-1], axis=0) > 0
    return np.where(seen, spread, np.inf)


def covariance(fitted: WindowFit) -> Array:
    """Covariance of the columns, sigma as declared: (R^T R)^-1, pseudo-inverse where deficient."""
    if fitted.reduction is None:
        return np.zeros((0, 0))
    triangle = fitted.reduction.triangle[:-1, :-1]
    scale = np.linalg.norm(triangle, axis=0)
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv(triangle / scale, rcond=1e-12)
    return (inverse @ inverse.T) / np.outer(scale, scale)
