"""Process noise: white accelerations as shares of what the states do anyway.

A state whose rate the model does not know exactly is driven by white noise of intensity

    Q_ii = level^2 s_i a_i        (state^2 / s)

s_i and a_i the settled standard deviations of the state and of its rate: an error of the share
``level`` of the rate that lasts the state's own time s_i / a_i. Rates that hold by definition
(q' = v) get none. Over one sample the covariance is the exact integral (Van Loan 1978) of the
linearisation at the mean of the settled states: a tank is linear nowhere near its empty state.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spiral.engine.filter.task import Task, linearised
from spiral.types.record import Array

OBSERVED, HIDDEN = "observed", "hidden"


def groups(task: Task) -> dict[str, tuple[int, ...]]:
    """States driven by noise, by group: those beside a measured channel, and all others."""
    names, traced = task.states, task.compiled.traced
    found: dict[str, list[int]] = {OBSERVED: [], HIDDEN: []}
    for i, name in enumerate(names):
        if traced.rate_name(name) in names:
            continue
        base = traced.base_name(name)
        found[OBSERVED if base in traced.channels else HIDDEN].append(i)
    return {k: tuple(v) for k, v in found.items() if v}


def intensity(task: Task, levels: Mapping[str, float]) -> Array:
    """(n,) white-noise intensity of every state, state^2 / s."""
    found = np.zeros(len(task.states))
    for group, members in groups(task).items():
        at = list(members)
        found[at] = levels.get(group, 0.0) ** 2 * task.scales[at] * task.rates[at]
    return found


def sampled(task: Task, continuous: Array) -> Array:
    """(n, n) covariance that white noise of this intensity (n,) adds over one sample."""
    from scipy.linalg import expm

    n, size = len(continuous), task.scales
    a = linearised(task.compiled, task.values, task.mean_inputs, task.centre) * size / size[:, None]
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[n:, n:] = -a, a.T
    block[:n, n:] = np.diag(continuous / size**2)
    whole = expm(block * task.series.dt)
    covariance = whole[n:, n:].T @ whole[:n, n:]
    return 0.5 * (covariance + covariance.T) * np.outer(size, size)
