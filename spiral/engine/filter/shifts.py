"""Common shifts of states that change neither rates nor readings.

A train whose speed and couplings are measured has no place of its own: x -> x + s d leaves
x' = f(x, u, p) and y = h(x, u, p) as they are, whatever s,

    f_x d = 0,    h_x d = 0.

No reading ever tells s. A filter that begins with a variance of it, kilometres, has to take
differences of large numbers for all that it is asked, a coupling that gives by millimetres, and
loses its digits. So such a filter begins with one state of d where it is, and counts the others
from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.physics.compile import CompiledModel
from spiral.types.record import Array

_POINTS = 8  # random states, inputs and values at which slopes are zero, if they are everywhere
_ZERO = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class Shifts:
    """``directions`` (n, shifts), and of each its anchor, a state that no other direction moves."""

    directions: Array
    anchors: tuple[int, ...]

    def tied_deviations(self, states: Array) -> Array:
        """(n,) largest first standard deviations, along a motion ``states`` (samples, n).

        Zero of the anchors, of the others that are moved those of their motion relative to them,
        infinite of all others.
        """
        moved, relative = np.any(self.directions != 0, axis=1), states.copy()
        for anchor, direction in zip(self.anchors, self.directions.T, strict=True):
            relative -= np.outer(states[:, anchor], direction)
        apart = relative.std(axis=0)
        tied = np.where(moved & (apart > 0), apart, np.inf)
        tied[list(self.anchors)] = 0.0
        return tied


def common_shifts(compiled: CompiledModel, values: Array, inputs: Array, scales: Array) -> Shifts:
    """The directions d of two states and more along which a model does not change.

    Parameters
    ----------
    values : (parameters,) and inputs : (inputs,) about which points are drawn; parameters at zero,
        as of an effect that is tried, count as not zero. scales : (n,) of the states.
    """
    n, rng = len(scales), np.random.default_rng(0)
    wide, rows = np.where(scales > 0, scales, 1.0), []
    for _ in range(_POINTS):
        p = np.where(values == 0, 1.0, values) * rng.uniform(0.5, 1.5, len(values))
        u = inputs + rng.normal(size=len(inputs)) * np.where(inputs == 0, 1.0, np.abs(inputs))
        slopes = np.concatenate(slopes_by_states(compiled, wide * rng.normal(size=n), u, p))
        rows += [_unit(r) for r in slopes * wide if np.isfinite(r).all() and r.any()]
    if not rows:
        return Shifts(np.zeros((n, 0)), ())
    _, sizes, right = np.linalg.svd(np.array(rows))
    still = right[np.append(sizes, np.zeros(n - len(sizes))) <= _ZERO * sizes[0]].T
    return _reduce_to_anchors(still * wide[:, None])


def _unit(row: Array) -> Array:
    """A row of length one; squares of very large or small numbers are no numbers."""
    row = row / np.abs(row).max()
    return row / np.linalg.norm(row)


def slopes_by_states(compiled: CompiledModel, x: Array, u: Array, p: Array) -> tuple[Array, Array]:
    """f_x (n, n) and h_x (channels, n) at one point."""
    n, m = len(x), len(compiled.traced.channels)
    a, c, d = np.zeros((n, n)), np.zeros((m, n)), np.zeros((max(n, m), len(p)))
    with np.errstate(all="ignore"):
        compiled.rate(x, u, p, np.empty(n), a, d[:n])
        compiled.output(x, u, p, np.empty(m), c, d[:m])
    return a, c


def _reduce_to_anchors(basis: Array) -> Shifts:
    """The same directions, each with one in a state that no other has; those of a state alone go.

    By Gauss and Jordan, with pivots.
    """
    kept, anchors = basis.copy(), []
    for column in range(kept.shape[1]):
        anchors.append(int(np.argmax(np.abs(kept[:, column]))))
        kept[:, column] /= kept[anchors[-1], column]
        for other in (j for j in range(kept.shape[1]) if j != column):
            kept[:, other] -= kept[anchors[-1], other] * kept[:, column]
    kept = np.where(np.abs(kept) < _ZERO, 0.0, kept)
    several = np.flatnonzero(np.count_nonzero(kept, axis=0) > 1)
    return Shifts(kept[:, several], tuple(anchors[j] for j in several))
