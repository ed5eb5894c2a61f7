"""Gauss-Newton with a line search, for whole records, where full steps may be too long.

Parameters and window starts move together by a share of the Gauss-Newton step. The direction is
always one of descent, so that some share lowers the cost; the damped fit of ``fit`` moves the
starts by their full step whatever the damping, which on a long window may only raise it.

Parameters may be *mixed*: theta = theta_0 + T s with T (columns, k), one common scale for instance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.elimination import triangle_of
from spiral.engine.fit import WindowFit, damped_step
from spiral.engine.sensitivities import Reduction, reduce_windows
from spiral.engine.study import CompiledStudy, Layouts, ParameterColumns, Point
from spiral.types.record import Array

_SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
_DAMPINGS = (1e-6, 1e-3, 1e-1)
_ENOUGH, _RELATIVE = 0.02, 1e-6  # promised fall (sigma^2; share of the cost) not worth a step
_ITERATIONS = 40


@dataclass(frozen=True)
class ColumnMix:
    """Columns that move together: ``matrix`` (columns, k); empty columns move alone."""

    matrix: Array

    def mix_columns(self, reduction: Reduction) -> Reduction:
        """The pass as one over the k mixed columns."""
        triangle = reduction.triangle
        rows = np.column_stack([triangle[:, :-1] @ self.matrix, triangle[:, -1]])
        return replace(reduction, triangle=triangle_of(rows))


def descend(
    study: CompiledStudy,
    layouts: Layouts,
    point: Point,
    columns: ParameterColumns,
    bounds: tuple[Array, Array],
    mix: ColumnMix | None = None,
    iterations: int = _ITERATIONS,
) -> WindowFit:
    """Minimise the weighted squared prediction error; converged where no step promises a fall."""
    reduction = reduce_windows(study, layouts, point, columns)
    if not reduction.finite:
        return WindowFit(point, np.inf, reduction.samples, reduction.nuisances, False, 0, None)
    for iteration in range(iterations):
        worth = max(_ENOUGH, _RELATIVE * reduction.cost)
        seen = mix.mix_columns(reduction) if mix else reduction
        promised = reduction.cost - float(seen.triangle[-1, -1] ** 2)
        if promised < worth:
            return WindowFit.from_reduction(point, reduction, True, iteration)
        better = _find_descent_step(study, layouts, point, columns, bounds, reduction, mix)
        if better is None:
            return WindowFit.from_reduction(point, reduction, promised < 10 * worth, iteration)
        fall = reduction.cost - better[1].cost
        point, reduction = better
        if fall < 0.1 * worth:
            return WindowFit.from_reduction(point, reduction, promised < 10 * worth, iteration)
    return WindowFit.from_reduction(point, reduction, False, iterations)


def _find_descent_step(
    study: CompiledStudy,
    layouts: Layouts,
    point: Point,
    columns: ParameterColumns,
    bounds: tuple[Array, Array],
    reduction: Reduction,
    mix: ColumnMix | None,
) -> tuple[Point, Reduction] | None:
    """The first share of the first damped step that lowers the cost."""
    for damping in _DAMPINGS:
        step = _damped_direction(point, columns, bounds, reduction, mix, damping)
        for share in _SHARES:
            starts = tuple(
                x + share * (e[:, :, -1] - e[:, :, :-1] @ step)
                for x, e in zip(point.starts, reduction.elimination, strict=True)
            )
            trial = Point(columns.apply_step(point.values, share * step), starts)
            reached = reduce_windows(study, layouts, trial, columns)
            if reached.cost < reduction.cost:
                return trial, reached
    return None


def _damped_direction(
    point: Point,
    columns: ParameterColumns,
    bounds: tuple[Array, Array],
    reduction: Reduction,
    mix: ColumnMix | None,
    damping: float,
) -> Array:
    if mix is None:
        return damped_step(reduction, columns, point, bounds, damping)[0]
    triangle = mix.mix_columns(reduction).triangle
    matrix, target = triangle[:-1, :-1], triangle[:-1, -1]
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    stacked = np.concatenate([matrix / scale, np.sqrt(damping) * np.eye(len(scale))])
    rest = np.concatenate([target, np.zeros(len(scale))])
    solution, *_ = np.linalg.lstsq(stacked, rest, rcond=1e-12)
    return mix.matrix @ (solution / scale)
