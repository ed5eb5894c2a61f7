"""Share of the innovations that motion and inputs explain, beyond the innovations' own past.

Noise that is modelled imperfectly is predictable from its own past alone; what a model lacks
depends on the motion (correlation tests of residuals: Ljung, System Identification, 1999, 16.6).
With e the whitened misses of a channel and s the readings of a free run and the inputs, each in
standard deviations from its mean,

    e_t = sum_k a_k e_(t-k) + r_t                               of all channels, k to ``_PAST``
    e_t = sum_k a_k e_(t-k) + sum_j b_j f_j(s_t, s_(t-1), ...) + r'_t

f being s at a few lags, its square, cube and a rounded sign, inputs of a sample before: a
controller answers to the noise of the same sample. The share of e that f explains beside
the past is (|r|^2 - |r'|^2) / |e|^2, less what as many columns explain by chance. It is one of e,
as that of the past is: of noise behind a sharp filter next to nothing is left beside its past, and
what motion explains of that is no effect.

A free run knows nothing of the noise. Readings that a filter predicts have all past noise in them,
and tell of it what a few past misses do not: they stand for the motion only where the free run
misses too much of it.
"""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.predict import Prediction
from spiral.engine.series import sample_inputs
from spiral.inference.evidence.free_run import FreeRun
from spiral.inference.likelihood.fitting import LikelihoodFit
from spiral.types.invalid import bridged
from spiral.types.placement import TIME
from spiral.types.record import Array

_PAST = 20  # samples of the misses' own past
_LAGS = (0, 1, 2, 4, 8)
_SHARP = 5.0  # of the rounded sign tanh(5 s)
_HALF = 0.5  # of the motion, which a free run that stands for it misses at most
_READINGS = 20  # for each column, at least


def motion_explained_share(fit: LikelihoodFit, motion: FreeRun) -> Array:
    """(channels,) share of whitened innovations that motion and inputs explain beyond their past.

    Infinite where records are too short to tell. ``motion`` : the free run of the fitted records.
    """
    at = fit.estimate
    rows = [
        _regression_rows(task, part, _told_motion(motion, r))
        for r, ((task, _), part) in enumerate(zip(at.prepared, at.predictions, strict=True))
    ]
    misses, past, moved = (np.concatenate(x) for x in zip(*rows, strict=True))
    if not len(misses) > _READINGS * (past.shape[1] + moved.shape[1]):
        return np.full(misses.shape[1], np.inf)
    return np.array([_channel_explained_share(column, past, moved) for column in misses.T])


def _told_motion(run: FreeRun, record: int) -> Array | None:
    """(samples, channels) readings of a free run; nothing where it misses half of them or more."""
    miss, spread = run.misses()[record], run.deviations()
    with np.errstate(all="ignore"):
        off = np.sqrt(np.nanmean(miss**2, axis=0))
    predicted = run.predicted[record]
    told = bool(np.all(off < _HALF * spread)) and bool(np.all(np.isfinite(predicted)))
    return predicted if told else None


def _channel_explained_share(miss: Array, past: Array, moved: Array) -> float:
    seen = miss != 0.0  # readings that are missing have none
    if not seen.any():
        return 0.0
    x, y = np.column_stack([past, moved])[seen], miss[seen]
    before, after = (least_squares(a, y) for a in (past[seen], x))
    chance = (after.parameters - before.parameters) / len(y) * before.rss
    total = float(y @ y)
    return max((before.rss - after.rss - chance) / total, 0.0) if total > 0 else 0.0


def _regression_rows(
    task: FilterInput, part: Prediction, motion: Array | None = None
) -> tuple[Array, Array, Array]:
    """(samples, ...) misses, their past and what moves, from the sample that has all of it on.

    ``motion`` : readings of a free run; left out, those that the filter predicts.
    """
    first, last = max(_PAST, *_LAGS), len(part.misses)
    names = task.compiled.traced.inputs
    inputs = sample_inputs(task.inputs, task.series.substeps)[:last]
    inputs = inputs[:, [i for i, n in enumerate(names) if n != TIME]]
    inputs = np.concatenate([inputs[:1], inputs[:-1]])  # a controller has seen the reading
    gone = part.spreads == 0
    predicted = task.series.y - part.misses
    read = [bridged(y, g) for y, g in zip(predicted.T, gone.T, strict=True)]
    read = read if motion is None else list(motion[:last].T)
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
