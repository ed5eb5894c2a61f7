"""Readings that stand out from their neighbours, and of which the signal does not tell why.

A reading of a force or an acceleration may jump, and so may any near a jump of an input: there a
spike in the signal (``types.invalid``) is the sensor's or the machine's. The filter tells. It runs
without these readings, and one of them is the machine's where

- the model predicts it: the whitened miss |e_k| / s_k^(1/2) is below ``_PREDICTED``, or
- the machine has moved otherwise since: over the next ``_AFTER`` samples the mean square of the
  whitened misses of all sensors is above all but ``_RARE`` of those after other readings.

The others are the sensor's, and are left out.
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
from spiral.types.record import Array, Record

_PREDICTED = 6.0  # standard deviations within which a reading is as the model predicts it
_AFTER = 8  # samples over which a force that acted shows in the motion
_RARE = 0.01  # share of other stretches that miss as much
_MOST = 0.5  # share of them that are the machine's, from which they all are

Masks = dict[str, Array]


def fit_without_outliers(
    assembly: Assembly, state: FitState, progress: Progress
) -> tuple[Assembly, LikelihoodFit]:
    """The most likely fit, and the study without readings that only their sensor's fault explains.

    ``state`` is where fits start.
    """
    problem = assembly.problem
    doubtful = [r.doubtful() for r in problem.records]
    tested = [r.doubtful() for r in problem.test]
    if not any((*doubtful, *tested)):
        return assembly, best_fit(assembly, state, progress)
    progress("fitting without readings that stand out")
    apart = _left_out(assembly, doubtful, tested)
    fit = best_fit(apart, state, progress)
    if not fit.estimate.finite:
        return assembly, best_fit(assembly, state, progress)
    ours = _outliers(assembly, apart, fit.state, fit.estimate.noise, doubtful)
    theirs = _outliers(
        _with_only(assembly, problem.test), _with_only(apart, apart.problem.test),
        _of_any_record(fit.state, len(problem.test)), fit.estimate.noise, tested,
    )  # fmt: skip
    if not any((*ours, *theirs)):
        return assembly, best_fit(assembly, state, progress)
    final = _left_out(assembly, ours, theirs)
    if all(set(a) == set(b) and all((a[k] == b[k]).all() for k in a)
           for a, b in zip(ours, doubtful, strict=True)):  # fmt: skip
        return final, fit
    return final, best_fit(final, state, progress)


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


def _outliers(
    assembly: Assembly, apart: Assembly, state: FitState, noise: NoiseModel, masks: Sequence[Masks]
) -> list[Masks]:
    """Those of the doubtful readings, by record and channel, that are no more than a sensor's."""
    if not any(masks):
        return [{} for _ in masks]
    seen, unseen = (
        predict_cases([(prepare_filter_tasks(one, state), noise)])[0] for one in (assembly, apart)
    )
    channels = assembly.study.compiled.traced.channels
    return [
        _faults(here, there, {channels.index(k): v for k, v in some.items()}, channels)
        for here, there, some in zip(seen, unseen, masks, strict=True)
    ]


def _faults(
    seen: Prediction, unseen: Prediction, masks: dict[int, Array], channels: Sequence[str]
) -> Masks:
    """The readings of one record that neither the model predicts nor the motion answers."""
    if not (seen.whole and unseen.whole):
        return {}
    after = _mean_square_after(unseen.whitened)
    doubtful = np.logical_or.reduce(list(masks.values())) if masks else np.zeros(len(after), bool)
    usual = after[~doubtful & np.isfinite(after)]
    limit = float(np.quantile(usual, 1 - _RARE)) if len(usual) else np.inf
    faults = {}
    for j, mask in masks.items():
        own = mask & (np.abs(seen.whitened[:, j]) > _PREDICTED) & ~(after > limit)
        if own.any() and own.sum() > (1 - _MOST) * mask.sum():
            faults[channels[j]] = own
    return faults


def _mean_square_after(whitened: Array) -> Array:
    """(samples,) mean square of all whitened misses of the samples that follow; nan at the end."""
    each = np.mean(whitened**2, axis=1)
    sums = np.concatenate([[0.0], np.cumsum(each)])
    after = np.full(len(each), np.nan)
    count = len(each) - _AFTER
    if count > 0:
        after[:count] = (sums[_AFTER + 1 :] - sums[1 : count + 1])[:count] / _AFTER
    return after
