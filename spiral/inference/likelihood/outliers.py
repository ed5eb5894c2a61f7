"""Single readings that only their sensor's fault explains: found by the filter, and left out.

Whether a spike in a force or an acceleration is the sensor's or the machine's the signal does not
tell. The one-step prediction misses a reading by e_k, whitened and over the robust deviation of its
channel (1.48 times the median). It is doubted where |e_k| is above ``_OUT`` and larger than those
of the samples beside it, and where it is as far from its neighbours: r_k of ``types.invalid`` is at
least three quarters of the miss (half of it after a step of the signal).

The filter then runs without all that are doubted. One of them is the machine's where that has moved
otherwise since: where over the next ``_AFTER`` samples the mean square of what all sensors miss is
above all but ``_RARE`` of those after other readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import Prediction, predict_cases
from spiral.inference.evidence.assembly import Assembly, with_records
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.fitting import LikelihoodFit, prepare_filter_tasks
from spiral.inference.likelihood.seed_fit import best_fit
from spiral.inference.problem import Progress
from spiral.types.invalid import ROBUST, bridged, cubic_residual
from spiral.types.record import Array, Record

_OUT = 8.0  # robust deviations from which a reading is doubted
_ALONE = 0.75  # share of a miss that a reading is off its neighbours; half after a step
_BESIDE = 3  # samples on each side that miss less
_AFTER = 8  # samples over which a force that acted shows in the motion
_RARE = 0.01  # share of other stretches that miss as much
_MOST = 0.01  # share of a channel's readings above which they are how it reads
_OURS = 0.5  # share of the doubted ones that are the machine's, from which they all are
_ROUNDS = 2  # of looking for outliers beside those that are left out already

Masks = dict[str, Array]


def fit_without_outliers(
    assembly: Assembly, state: FitState, progress: Progress
) -> tuple[Assembly, LikelihoodFit]:
    """The most likely fit, and the study without readings that only their sensor's fault explains.

    ``state`` is where fits start.
    """
    fit = best_fit(assembly, state, progress)
    for _ in range(_ROUNDS):
        if not fit.estimate.finite:
            break
        noise, problem = fit.estimate.noise, assembly.problem
        ours = _find_outliers(assembly, fit.state, noise)
        count = len(problem.test)
        others = _of_any_record(fit.state, count)
        theirs = _find_outliers(_with_only(assembly, problem.test), others, noise) if count else []
        if not any((*ours, *theirs)):
            break
        assembly = _left_out(assembly, ours, theirs)
        if any(ours):
            progress("fitting without readings that stand out")
            fit = best_fit(assembly, state, progress)
    return assembly, fit


def _find_outliers(assembly: Assembly, state: FitState, noise: NoiseModel) -> list[Masks]:
    """The outliers of each record of a study, by channel, (samples,) True there."""
    channels = assembly.study.compiled.traced.channels
    tasks = prepare_filter_tasks(assembly, state)
    seen = predict_cases([(tasks, noise)])[0]
    doubted = [
        _doubted_readings(part, task.series.y, channels)
        for part, (task, _) in zip(seen, tasks, strict=True)
    ]
    if not any(doubted):
        return doubted
    apart = _left_out(assembly, doubted, [{} for _ in assembly.problem.test])
    unseen = predict_cases([(prepare_filter_tasks(apart, state), noise)])[0]
    return [_faults(part, masks) for part, masks in zip(unseen, doubted, strict=True)]


def _doubted_readings(part: Prediction, readings: Array, channels: Sequence[str]) -> Masks:
    """Readings (samples, channels) that are far off what precedes and what is beside them."""
    doubted: Masks = {}
    if not part.whole:
        return doubted
    for j, channel in enumerate(channels):
        size, known = np.abs(part.whitened[:, j]), part.spreads[:, j] > 0
        if not known.any():
            continue
        usual = ROBUST * float(np.median(size[known]))
        around = np.lib.stride_tricks.sliding_window_view(np.pad(size, _BESIDE), 2 * _BESIDE + 1)
        apart = np.abs(cubic_residual(bridged(readings[:, j], ~known)))
        mask = (size > _OUT * usual) & (size >= around.max(axis=1))
        mask &= apart > _ALONE * np.abs(part.misses[:, j])
        mask &= np.convolve(~known, np.ones(2 * _BESIDE + 1), "same") < 1  # no neighbours there
        if 0 < mask.sum() <= _MOST * known.sum():
            doubted[channel] = mask
    return doubted


def _left_out(assembly: Assembly, masks: Sequence[Masks], tested: Sequence[Masks]) -> Assembly:
    """The study without these readings of its records and of its test records."""
    problem = assembly.problem
    records, test = (
        tuple(r.without_readings(m) for r, m in zip(some, marks, strict=True))
        for some, marks in ((problem.records, masks), (problem.test, tested))
    )
    other = with_records(assembly, records, assembly.study.series[0].substeps)
    return replace(other, problem=replace(problem, records=records, test=test))


def _with_only(assembly: Assembly, records: tuple[Record, ...]) -> Assembly:
    """The study of these records in place of its own."""
    problem = replace(assembly.problem, records=records, test=())
    other = with_records(assembly, records, assembly.study.series[0].substeps)
    return replace(other, problem=problem, excerpt=None)


def _of_any_record(state: FitState, count: int) -> FitState:
    """A state for so many other records of the machine, of which no start is known."""
    return replace(state, values=np.repeat(state.values[:1], count, axis=0), starts=None,
                   spreads=None)  # fmt: skip


def _faults(unseen: Prediction, masks: Masks) -> Masks:
    """Those of a record's doubted readings that its motion does not answer, run without them."""
    if not unseen.whole:
        return {}
    after = _mean_square_after(unseen.whitened)
    doubted = np.logical_or.reduce(list(masks.values())) if masks else np.zeros(len(after), bool)
    usual = after[~doubted & np.isfinite(after)]
    limit = float(np.quantile(usual, 1 - _RARE)) if len(usual) else np.inf
    faults = {channel: mask & ~(after > limit) for channel, mask in masks.items()}
    return {k: own for k, own in faults.items() if own.sum() > (1 - _OURS) * masks[k].sum()}


def _mean_square_after(whitened: Array) -> Array:
    """(samples,) mean square of all whitened misses of the samples that follow; nan at the end."""
    each = np.mean(whitened**2, axis=1)
    sums = np.concatenate([[0.0], np.cumsum(each)])
    after = np.full(len(each), np.nan)
    count = len(each) - _AFTER
    if count > 0:
        after[:count] = (sums[_AFTER + 1 :] - sums[1 : count + 1])[:count] / _AFTER
    return after
