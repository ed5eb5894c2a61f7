"""How far random forces carry a free run, which no reading corrects, from the motion without them.

About the machine's mean motion, with A its slope there and the noise states z of ``noise``,

    P_{k+1} = F P_k F^T + Q,    F = exp(A dt) with what z pushes,    P_0 = 0 but for z,

so that reading j is off by sqrt(mean_k (c_j P_k c_j^T)). Of a machine whose slope changes much
along its motion this is the order of magnitude. The sum is taken by doubling: over m samples

    P_m = A P_0 A^T + W,    sum_k c_j P_k c_j^T = <G_j, P_0> + u_j,    A = F^m

and two such stretches, one after the other, make a third.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.task import Task, linearised, reading_rows
from spiral.engine.likelihood.noise import NoiseModel, matrices
from spiral.types.noise import COLOURED
from spiral.types.record import Array

_MOST = 20_000  # samples after which it does not grow any more


def free_spread(task: Task, settings: FilterSettings, noise: NoiseModel, samples: int) -> Array:
    """(channels,) rms over so many samples; infinite where the machine is not stable."""
    from scipy.linalg import expm

    forces = noise.without(*COLOURED, "drift")
    parts = matrices(task, settings, forces)
    n, k, dt = len(task.states), len(parts.phi), task.series.dt
    kept = np.r_[:n, len(parts.q) - k : len(parts.q)]  # without tracked parameters
    flow = expm(linearised(task.compiled, task.values, task.mean_inputs, task.centre) * dt)
    f = np.zeros((n + k, n + k))
    f[:n, :n], f[n:, n:] = flow, parts.phi
    f[:n, n:] = 0.5 * dt * (flow @ parts.driven + parts.driven)
    q, p = parts.q[np.ix_(kept, kept)], np.zeros((n + k, n + k))
    p[n:, n:] = parts.p[-k:, -k:] if k else 0.0
    seen = np.hstack([reading_rows(task), parts.seen])
    count = min(samples, _MOST)
    with np.errstate(all="ignore"):
        run = _stretch(f, q, seen, count)
        found = np.sqrt((np.einsum("jab,ab->j", run.slopes, p) + run.sums) / count)
    return np.where(np.isfinite(found), found, np.inf)


@dataclass(frozen=True)
class _Stretch:
    """m samples: ``flow`` A, ``added`` W, ``slopes`` G (channels, n, n) and ``sums`` u."""

    flow: Array
    added: Array
    slopes: Array
    sums: Array

    def then(self, other: _Stretch) -> _Stretch:
        """One stretch and another after it."""
        return _Stretch(
            other.flow @ self.flow,
            other.flow @ self.added @ other.flow.T + other.added,
            self.slopes + self.flow.T @ other.slopes @ self.flow,
            self.sums + other.sums + np.einsum("jab,ab->j", other.slopes, self.added),
        )


def _stretch(f: Array, q: Array, seen: Array, samples: int) -> _Stretch:
    """So many samples of P <- F P F^T + Q, at least one, by doubling.

    ``seen`` (channels, n) are the rows c_j of the readings.
    """
    rows, added = seen @ f, np.einsum("ja,ab,jb->j", seen, q, seen)
    double = _Stretch(f, q, np.einsum("ja,jb->jab", rows, rows), added)
    whole = double if samples % 2 else None
    while samples := samples // 2:
        double = double.then(double)
        if samples % 2:
            whole = double if whole is None else whole.then(double)
    return double if whole is None else whole
