"""How far random forces carry a free run, which no reading corrects, from the motion without them.

About the machine's mean motion, with A its slope there and the noise states z of ``noise``,

    P_{k+1} = F P_k F^T + Q,    F = exp(A dt) with what z pushes,    P_0 = 0 but for z,

so that reading j is off by sqrt(mean_k (c_j P_k c_j^T)). Of a machine whose slope changes much
along its motion this is the order of magnitude.
"""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.task import Task, linearised
from spiral.engine.likelihood.noise import NoiseModel, matrices
from spiral.types.record import Array

_MOST = 20_000  # samples after which it does not grow any more


def free_spread(task: Task, settings: FilterSettings, noise: NoiseModel, samples: int) -> Array:
    """(channels,) rms over so many samples; infinite where the machine is not stable."""
    from scipy.linalg import expm

    forces = noise.without("coloured", "band", "drift")
    parts = matrices(task, settings, forces)
    n, k, dt = len(task.states), len(parts.phi), task.series.dt
    kept = np.r_[:n, len(parts.q) - k : len(parts.q)]  # without tracked parameters
    flow = expm(linearised(task.compiled, task.values, task.mean_inputs, task.centre) * dt)
    f = np.zeros((n + k, n + k))
    f[:n, :n], f[n:, n:] = flow, parts.phi
    f[:n, n:] = 0.5 * dt * (flow @ parts.driven + parts.driven)
    q, p = parts.q[np.ix_(kept, kept)], np.zeros((n + k, n + k))
    p[n:, n:] = parts.p[-k:, -k:] if k else 0.0
    seen = [task.states.index(c) for c in task.compiled.traced.channels]
    count, total = min(samples, _MOST), np.zeros(len(seen))
    with np.errstate(all="ignore"):
        for _ in range(count):
            p = f @ p @ f.T + q
            total += np.diag(p)[seen]
    found = np.sqrt(total / count)
    return np.where(np.isfinite(found), found, np.inf)
