"""Share of the innovations that motion and inputs explain, beyond the innovations' own past.

Noise that is modelled imperfectly is predictable from its own past alone; what a model lacks
depends on the motion (correlation tests of residuals: Ljung, System Identification, 1999, 16.6).
With e the whitened misses of a channel and s the predicted readings and the inputs, each in
standard deviations from its mean,

    e_t = sum_k a_k e_(t-k) + r_t                               of all channels, k to ``_PAST``
    e_t = sum_k a_k e_(t-k) + sum_j b_j f_j(s_t, s_(t-1), ...) + r'_t

f being s at a few lags, its square, cube and a rounded sign. The share of e that f explains beside
the past is 1 - |r'|^2 / |r|^2, less what as many columns explain by chance.
"""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.predict import Prediction
from spiral.engine.series import sample_inputs
from spiral.inference.likelihood.fitting import LikelihoodFit
from spiral.types.invalid import bridged
from spiral.types.placement import TIME
from spiral.types.record import Array

_PAST = 20  # samples of the misses' own past
_LAGS = (0, 1, 2, 4, 8)
_SHARP = 5.0  # of the rounded sign tanh(5 s)
_READINGS = 20  # for each column, at least


def motion_explained_share(fit: LikelihoodFit) -> float:
    """Share of whitened innovations that predicted readings and inputs explain beyond their past.

    The largest over channels; infinite where records are too short to tell.
    """
    at = fit.estimate
    rows = [
        _regression_rows(task, part)
        for (task, _), part in zip(at.prepared, at.predictions, strict=True)
    ]
    misses, past, moved = (np.concatenate(x) for x in zip(*rows, strict=True))
    if not len(misses) > _READINGS * (past.shape[1] + moved.shape[1]):
        return np.inf
    return max(_channel_explained_share(column, past, moved) for column in misses.T)


def _channel_explained_share(miss: Array, past: Array, moved: Array) -> float:
    seen = miss != 0.0  # readings that are missing have none
    if not seen.any():
        return 0.0
    x, y = np.column_stack([past, moved])[seen], miss[seen]
    before, after = (least_squares(a, y) for a in (past[seen], x))
    chance = (after.parameters - before.parameters) / len(y)
    return max(1.0 - after.rss / before.rss - chance, 0.0) if before.rss > 0 else 0.0


def _regression_rows(task: FilterInput, part: Prediction) -> tuple[Array, Array, Array]:
    """(samples, ...) misses, their past and what moves, from the sample that has all of it on."""
    first, last = max(_PAST, *_LAGS), len(part.misses)
    names = task.compiled.traced.inputs
    inputs = sample_inputs(task.inputs, task.series.substeps)[:last]
    inputs = inputs[:, [i for i, n in enumerate(names) if n != TIME]]
    gone = part.spreads == 0
    read = [bridged(y, g) for y, g in zip((task.series.y - part.misses).T, gone.T, strict=True)]
    s = np.column_stack([*read, inputs])
    sizes = s.std(axis=0)  # what does not change in this record is nothing in it
    s = (s - s.mean(axis=0)) / np.where(sizes > 0, sizes, 1.0)
    e = part.whitened

    def delayed_by(values: Array, lag: int) -> Array:
        return values[first - lag : last - lag]

    bent = (s**2, s**3, np.tanh(_SHARP * s))
    moved = [*(delayed_by(s, k) for k in _LAGS), *(delayed_by(b, 0) for b in bent)]
    past = [np.ones((last - first, 1)), *(delayed_by(e, k) for k in range(1, _PAST + 1))]
    return e[first:last], np.column_stack(past), np.column_stack(moved)
