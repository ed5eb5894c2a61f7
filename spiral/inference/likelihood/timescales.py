"""Whether a record's time fits the time constants of a model: a sentence where neither meets.

    1 / |lambda|,    lambda the eigenvalues of f_x at rest, at the values given

A record in milliseconds taken for seconds has all of a model's motion between two samples, or none
of it in its whole length.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.resting import resting_jacobian
from spiral.types.formatting import number

_GONE = 6.0  # time constants within one sample after which nothing of a motion is left
_BEGUN = 0.05  # share of the fastest time constant that a record lasts, under which nothing happens


def time_scale_sentences(task: FilterInput, given: Mapping[str, float]) -> tuple[str, ...]:
    """A sentence where all of the model's motion is faster than a sample, or slower than a record.

    ``given`` : values of parameters by name, in place of the task's.
    """
    values = np.array([given.get(k, v) for k, v in zip(task.keys, task.values, strict=True)])
    matrix = resting_jacobian(task.compiled, values, task.series, task.mean_inputs)
    rates = np.abs(np.linalg.eigvals(matrix))
    rates = rates[rates > 1e-9 * rates.max(initial=0.0)]
    if not len(rates) or not np.all(np.isfinite(rates)):
        return ()
    dt, whole = task.series.dt, task.series.dt * task.series.samples
    slow, fast = 1 / rates.min(), 1 / rates.max()
    if dt > _GONE * slow:
        return (
            f"even the slowest motion of the model as given (time constant {number(slow)} s) is "
            f"over within one sample ({number(dt)} s): is the record's time in s?",
        )
    if whole < _BEGUN * fast:
        return (
            f"even the fastest motion of the model as given (time constant {number(fast)} s) "
            f"hardly begins in this record ({number(whole)} s): is its time in s?",
        )
    return ()
