"""Process noise: white noise of rates, as shares of the settled deviations of states and rates.

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

from spiral.engine.filter.task import FilterInput
from spiral.engine.resting import state_jacobian
from spiral.types.label import parameter_of
from spiral.types.record import Array

OBSERVED, HIDDEN = "observed", "hidden"


def noise_groups(task: FilterInput) -> dict[str, tuple[int, ...]]:
    """States driven by noise, by group: those beside a measured channel, and all others.

    An effect's own states get none. Its law says how they follow the machine, and what acts at
    random acts on the machine: a force on a state of a late sensor, an actuator or a hysteresis
    would make the law explain whatever it is given.
    """
    names, traced = task.states, task.compiled.traced
    members: dict[str, list[int]] = {OBSERVED: [], HIDDEN: []}
    for i, name in enumerate(names):
        if traced.rate_name(name) in names or parameter_of(name):
            continue
        base = traced.base_name(name)
        members[HIDDEN if traced.measured_or_read.isdisjoint((base, name)) else OBSERVED].append(i)
    return {k: tuple(v) for k, v in members.items() if v}


def driven_states(task: FilterInput, where: str) -> tuple[int, ...]:
    """Indices of the states that a force drives: a group's, or the one of this name; else none."""
    known = noise_groups(task)
    if where in known:
        return known[where]
    return (task.states.index(where),) if where in task.states else ()


def noise_intensity(task: FilterInput, levels: Mapping[str, float]) -> Array:
    """(n,) white-noise intensity of every state, state^2 / s; levels by group or by state."""
    density = np.zeros(len(task.states))
    for where, level in levels.items():
        at = list(driven_states(task, where))
        density[at] += level**2 * task.scales[at] * task.rates[at]
    return density


def sampled_covariance(task: FilterInput, continuous: Array) -> Array:
    """(n, n) covariance that white noise of this intensity (n,) adds over one sample."""
    known, key = task.disturbed, continuous.tobytes()
    if key not in known:
        known[key] = _integrate_noise(task, continuous)
    return known[key]


def _integrate_noise(task: FilterInput, continuous: Array) -> Array:
    size = task.scales
    a = (
        state_jacobian(task.compiled, task.values, task.mean_inputs, task.centre)
        * size
        / size[:, None]
    )
    covariance = added_covariance(a, np.diag(continuous / size**2), task.series.dt)
    return covariance * np.outer(size, size)


def added_covariance(a: Array, intensity: Array, time: float) -> Array:
    """integral of e^{A s} Q e^{A^T s} over 0 <= s <= t, A (n, n), Q (n, n) symmetric.

    By Van Loan's block exponential (IEEE Trans. Autom. Control 23, 1978) over a part h of the time
    with |A| h <= 1, beyond which a fast decay (dry friction near rest) would cost it all digits,
    and then by doubling: with F = e^{A h}, Q(2 h) = Q(h) + F Q(h) F^T and F(2 h) = F F.
    """
    from scipy.linalg import expm

    n = len(a)
    doublings = int(np.ceil(np.log2(max(np.linalg.norm(a, 1) * time, 1.0))))
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[n:, n:], block[:n, n:] = -a, a.T, intensity
    whole = expm(block * (time / 2**doublings))
    flow = whole[n:, n:].T
    covariance = flow @ whole[:n, n:]
    with np.errstate(all="ignore"):  # a trial step of a fit may make a machine that runs away
        for _ in range(doublings):
            covariance, flow = covariance + flow @ covariance @ flow.T, flow @ flow
    return 0.5 * (covariance + covariance.T)
