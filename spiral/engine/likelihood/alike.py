"""Transitions over samples in which a model's slopes are those of an earlier sample.

Within a gap, or where dry friction slides, the slopes f_x of the rates are constant, and so is the
transition over a sample. A few transitions are kept with the slopes that they were made of; where a
sample has the slopes of one of them all along (``spiral.physics.slope_bounds``), to ``_SAME`` of
the largest that each had so far, only x and the slopes by parameters are integrated.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from spiral.physics.lanes import INNER

KEPT = 4
"""Transitions that are kept: inside a gap and on either side, at rest and sliding."""
_SAME = 1e-9
_TRIED, _FEW = 64, 4  # samples after which nobody asks any more if one in four had no use of it
USED, NEXT, ASKED, FOUND = range(4)


@nb.njit(cache=True, nogil=True)
def memory_of_transitions(n, varying):
    """Kept transitions (KEPT, n, n), their slopes; range and scale of slopes; counts; room."""
    slopes, bounds = np.zeros((KEPT, varying)), np.zeros((3, varying))
    return np.zeros((KEPT, n, n)), slopes, bounds, np.zeros(4, dtype=np.int64), np.zeros(n)


@nb.njit(**INNER)
def is_worth_asking(varying, counts):
    """Whether samples are asked for their slopes: not where few had those of another."""
    often = counts[FOUND] * _FEW >= counts[ASKED]
    return varying > 0 and (counts[ASKED] < _TRIED or often)


@nb.njit(**INNER)
def find_alike(bounds, slopes, counts):
    """The place of the transition that was made of a sample's slopes; -1 for none, -2 if they vary.

    ``bounds`` : least, largest, and the largest size so far of every slope.
    """
    counts[ASKED] += 1
    constant = True
    for v in range(bounds.shape[1]):
        low, high = bounds[0, v], bounds[1, v]
        if not (low <= high and np.isfinite(low) and np.isfinite(high)):
            return -2
        bounds[2, v] = max(bounds[2, v], abs(low), abs(high))
        constant = constant and high - low <= _SAME * bounds[2, v]
    if not constant:
        return -2
    for place in range(counts[USED]):
        same = True
        for v in range(bounds.shape[1]):
            same = same and abs(bounds[0, v] - slopes[place, v]) <= _SAME * bounds[2, v]
        if same:
            counts[FOUND] += 1
            return place
    return -1


@nb.njit(**INNER)
def keep_transition(f, kept, bounds, slopes, counts):
    """Keep the transition of a sample with its slopes, in place of the oldest."""
    n, place = kept.shape[1], counts[NEXT]
    for i in range(n):
        for j in range(n):
            kept[place, i, j] = f[i, j]
    for v in range(bounds.shape[1]):
        slopes[place, v] = bounds[0, v]
    counts[NEXT] = (place + 1) % KEPT
    counts[USED] = max(counts[USED], place + 1)
