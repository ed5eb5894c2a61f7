"""Bands that hold what nobody said of the inputs: how they run between their samples.

Each way that may be (a spline, a band-limited signal, straight lines, held) gives states x_i with
the likelihood L_i of the record's innovations. With w_i = L_i / sum L_j, the states of the
way that is taken, x_0, keep their place, and

    P <- P_0 + sum_i w_i (x_i - x_0) (x_i - x_0)'

is their covariance about it (Hoeting et al., Bayesian Model Averaging, Statistical Science 1999).
A rate that no sensor sees follows the force between two samples; its readings hardly tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from spiral.engine.filter.observer import Observer, Reconstruction
from spiral.engine.filter.task import FilterInput, with_record
from spiral.types.parameter import Interpolation, Ways
from spiral.types.record import Record

_WAYS: tuple[Interpolation, ...] = ("smooth", "band_limited", "linear", "zero_order")
_TOLD = 0.01  # share of the likelihood from which a way is said to be possible
_ALIKE = 1e-6  # of an input's deviation, by which two ways do not differ


@dataclass(frozen=True)
class UndecidedInputs:
    """A reconstruction whose covariance holds other interpolations, and the inputs they are of."""

    reconstruction: Reconstruction
    names: tuple[str, ...] = ()


def widen_by_undecided_inputs(
    task: FilterInput, observer: Observer, own: Reconstruction, record: Record, between: Ways
) -> UndecidedInputs:
    """The reconstruction with the doubt of inputs that the record does not declare (its ``hold``).

    ``between`` : how a study found them to run, as they do in the task.
    """
    if own.levels and any(f.name == "process_noise" for f in fields(observer)):
        observer = replace(observer, process_noise=dict(own.levels))  # not tuned for each way
    others, likely, apart = [], [own.log_likelihood], []
    for names, other in _other_ways(task, record, between):
        again = observer.reconstruct(other)
        alike = again.done == own.done and again.means.shape == own.means.shape
        if alike and np.isfinite(again.log_likelihood):
            others.append(names)
            likely.append(again.log_likelihood)
            apart.append(np.nan_to_num(again.means - own.means))
    if not others or not np.isfinite(own.log_likelihood):
        return UndecidedInputs(own)
    weights = np.exp(np.array(likely) - max(likely))
    weights = weights[1:] / weights.sum()
    variance = sum(w * d**2 for w, d in zip(weights, apart, strict=True))
    wider = replace(own, deviations=np.sqrt(own.deviations**2 + variance))
    if len(own.covariances):
        outer = (w * d[:, :, None] * d[:, None, :] for w, d in zip(weights, apart, strict=True))
        wider = replace(wider, covariances=own.covariances + sum(outer))
    told = [n for names, w in zip(others, weights, strict=True) if w >= _TOLD for n in names]
    return UndecidedInputs(wider, tuple(dict.fromkeys(told)))


def _other_ways(
    task: FilterInput, record: Record, between: Ways
) -> Iterator[tuple[tuple[str, ...], FilterInput]]:
    """The task with each other interpolation of each open input, and of all of them together."""
    inputs = task.model.system.inputs
    usual = [i for i in inputs if not (i.derivative or i.derived_from)]
    free = [i for i in usual if i.name not in record.hold]
    groups = [(i,) for i in free] + ([tuple(free)] if len(free) > 1 else [])
    scale = np.maximum(np.std(task.inputs, axis=0), np.finfo(float).tiny)
    seen = [task.inputs]
    for some in groups:
        for way in _WAYS:
            ways: dict[str, Interpolation] = {
                **between,
                **dict.fromkeys([i.name for i in some], way),
            }
            other = with_record(task, record.running(ways))
            alike = (
                i.shape == other.inputs.shape
                and float(np.max(np.abs(i - other.inputs) / scale, initial=0.0)) < _ALIKE
                for i in seen
            )
            if other.series.substeps == task.series.substeps and not any(alike):
                seen.append(other.inputs)
                yield tuple(i.name for i in some), replace(other, prior=task.prior)
