"""Damped steps of a linear least-squares problem that is given by its triangle."""

from __future__ import annotations

import numpy as np

from spiral.engine.leastsquares import Fit, solve_triangle
from spiral.types.record import Array

_STRONGEST = 1e6  # damping from which no step is another one
_OTHER = 0.3  # share of a step that the next one tried differs by


def next_damped_step(
    upper: Array, sizes: Array, damping: float, strain: float, last: Array | None
) -> tuple[Array, float]:
    """A damped step that differs from the last one (with more damping if need be); its damping.

    Where damping is far below the smallest eigenvalue of the unit columns' products, ten times as
    much changes nothing.

    Parameters
    ----------
    upper : R (k + 1, k + 1) of [X | e]. sizes : (k,) norms of X's columns. strain : factor by which
        damping grows. last : the step tried before, if any.
    """
    step = damped_solution(upper, sizes, damping)
    if last is None:
        return step, damping
    with np.errstate(over="ignore", invalid="ignore"):  # slopes of a model that runs away
        least = _OTHER * float(np.linalg.norm(sizes * last))
        while np.linalg.norm(sizes * (step - last)) < least and damping < _STRONGEST:
            damping *= strain
            step = damped_solution(upper, sizes, damping)
    return step, damping


def drop_bounded_columns(
    upper: Array, solved: Fit, values: Array, limits: Array
) -> tuple[Array, float]:
    """The triangle with columns of values that press on a bound set to zero; its step's gain.

    Parameters
    ----------
    solved : of ``upper``. values : (m,) of the first m columns. limits : (m, 2) of them.
    """
    low, high = limits.reshape(-1, 2).T
    while len(values):
        step = solved.b[: len(values)]
        out = ((values <= low) & (step < 0)) | ((values >= high) & (step > 0))
        if not out.any():
            break
        upper = upper.copy()
        upper[:, np.flatnonzero(out)] = 0.0
        solved = solve_triangle(upper, solved.rows)
    return upper, 0.5 * (float(np.sum(upper[:, -1] ** 2)) - solved.rss)


def damped_solution(upper: Array, sizes: Array, damping: float) -> Array:
    """Least squares with unit columns held at zero by ``damping``, and those of zeros at zero."""
    scale = np.where(sizes > 0, sizes, 1.0)
    k = len(scale)
    matrix = np.vstack([upper[:, :-1] / scale, np.sqrt(damping) * np.eye(k)])
    target = np.concatenate([upper[:, -1], np.zeros(k)])
    solution = np.linalg.lstsq(matrix, target, rcond=1e-12)[0] / scale
    return np.where(sizes > 0, solution, 0.0)  # not a rounding error beside a bound
