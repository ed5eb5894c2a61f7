"""A sample of a model with many states in few steps: its linear part exactly, the rest implicitly.

    x' = A x + r(x_S, u, p),  r of few states S (``physics.linear_part``)

Over a step h the rest is a straight line through its values at c = 1/3 and 1 of the step, to which
the linear part answers exactly:

    X_i = exp(c_i h A) x + sum_j G_ij r(X_j),   G_ij = int_0^{c_i h} exp((c_i h - s) A) l_j(s) ds,

l_j the lines that are 1 at one of these points and 0 at the other. With A = 0 that is the Runge-
Kutta method Radau IIA of order three (Hairer and Wanner, Solving ODEs II, IV.5), which bears what
is as stiff as dry friction; with r = 0 it is exact, however fast a mode is. Only the states S at
both points are unknown: Newton's method in these. Slopes are

    dX_i = exp(c_i h A) S + sum_j G_ij (r_x dX_j + [0 | f_p]),

those of the map itself, but by parameters of A: f_p, the slopes of all of x' by the parameters, is
a line between the two points as r is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import types

from spiral.engine.filter.task import FilterInput
from spiral.physics.compile import MODEL_FUNCTION
from spiral.physics.linear_part import LinearPart, linear_part
from spiral.types.record import Array

FIRST_POINT = 1 / 3
"""c_1, of a step; c_2 is its end."""
MANY_STATES = 16
"""States from which transitions over a sample are worth other ways than short steps."""
_STEPS = 8
"""Long steps a sample."""
_SHORTEST = 12
"""Runge-Kutta steps a sample, beyond which long ones take their place: they cost as much."""

_F3, _F4 = types.float64[:, :, ::1], types.float64[:, :, :, ::1]
LONG_STEPS = (
    MODEL_FUNCTION, MODEL_FUNCTION, types.Tuple((types.int64[::1], _F3, _F4, _F4, types.int64)),
)  # fmt: skip
"""Types of ``LongSteps.fields``."""


@dataclass(frozen=True)
class LongSteps:
    """What ``advance_long`` needs of a model, or nothing of it where there are no steps.

    Fields
    ------
    rest, sources, moving : as in ``LinearPart``, with S states that move r.
    flows : (count + 2, n, n) exp(l h A) for l from 0 to the number of steps, then exp(c_1 h A).
    heads : (2, count, S, n) the rows S of exp(c_i h A) exp(l h A).
    gains : (2, 2, n, n) G_ij.
    count : steps a sample.
    """

    rest: Any
    sources: Any
    moving: Array
    flows: Array
    heads: Array
    gains: Array
    count: int = 0

    @property
    def fields(self) -> tuple[Any, Any, tuple[Any, ...]]:
        """``rest``, ``sources``, and a tuple of the others in their order."""
        others = (self.moving, self.flows, self.heads, self.gains, self.count)
        return self.rest, self.sources, others


def no_long_steps(function: Any) -> LongSteps:
    """None; ``function`` stands for those that nobody calls."""
    none = np.zeros((0, 0, 0))
    return LongSteps(function, function, np.zeros(0, dtype=np.int64), none, none[None], none[None])


def long_steps_of(task: FilterInput, tracked: Sequence[str], moved: tuple[str, ...]) -> LongSteps:
    """Long steps of a model with many states of which few stand in what is not linear.

    None where nothing is (then its transition is made once), where a parameter is ``tracked``, or
    where an input that changes moves the linear part. Slopes are by the parameters ``moved``.
    """
    traced, series = task.compiled.traced, task.series
    count = long_step_count(series.substeps)
    if not count or len(task.states) < MANY_STATES or tracked:
        return no_long_steps(task.compiled.output)
    part = linear_part(traced, moved)
    if part is None or not part.names.isdisjoint(series.changing_inputs(traced.inputs)):
        return no_long_steps(task.compiled.output)
    matrix = part.matrix(len(task.states), task.inputs[0], task.values)
    return long_steps(part, matrix, series.dt, count)


def long_step_count(substeps: int) -> int:
    """How many long steps take the place of so many Runge-Kutta steps a sample; 0 for none."""
    return _STEPS if substeps > _SHORTEST else 0


def long_steps(part: LinearPart, matrix: Array, dt: float, count: int) -> LongSteps:
    """Steps that are so many in a sample of ``dt``, with the linear part's ``matrix``."""
    flows, gains = _step_matrices(np.ascontiguousarray(matrix).tobytes(), dt / count, count)
    heads = np.stack([first[part.moving] @ flows[:count] for first in (flows[-1], flows[1])])
    return LongSteps(part.rest, part.sources, part.moving, flows, heads, gains, count)


@lru_cache(maxsize=16)
def _step_matrices(data: bytes, h: float, count: int) -> tuple[Array, Array]:
    """``flows`` and ``gains`` of ``LongSteps``; ``data`` the matrix A."""
    n = math.isqrt(len(data) // 8)
    a = np.frombuffer(data).reshape(n, n)
    points, gains = np.empty((2, n, n)), np.empty((2, 2, n, n))
    for i, c in enumerate((FIRST_POINT, 1.0)):
        points[i], constant, line = _integrals(a, c * h)
        line = c * line  # of s / h in place of s / (c h)
        gains[i, 0] = (constant - line) / (1 - FIRST_POINT)
        gains[i, 1] = (line - FIRST_POINT * constant) / (1 - FIRST_POINT)
    flows = [np.eye(n)]
    for _ in range(count):
        flows.append(flows[-1] @ points[1])
    return np.stack([*flows, points[0]]), gains


def _integrals(a: Array, h: float) -> tuple[Array, Array, Array]:
    """exp(h A), int_0^h exp((h - s) A) ds, and the same of exp((h - s) A) s / h (Van Loan 1978)."""
    from scipy.linalg import expm

    n, eye = len(a), np.eye(len(a))
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n], block[:n, n : 2 * n], block[n : 2 * n, 2 * n :] = a * h, eye, eye
    whole = expm(block)[:n]
    return whole[:, :n], h * whole[:, n : 2 * n], h * whole[:, 2 * n :]
