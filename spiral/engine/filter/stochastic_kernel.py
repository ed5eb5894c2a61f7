"""The compiled loop of ``spiral.engine.filter.stochastic``."""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.kernel import runge_kutta
from spiral.physics.compile import VALUE_FUNCTION

_F1, _F2 = types.float64[::1], types.float64[:, ::1]


@nb.njit(
    types.boolean(
        VALUE_FUNCTION, VALUE_FUNCTION, _F1, _F1, _F2, types.int64, types.float64, _F2, _F2, _F2
    ),
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def disturbed_trajectory(rate, output, x, values, inputs, substeps, dt, kicks, states, readings):
    """States and readings of one disturbed trajectory; False where it becomes infinite.

    ``kicks`` ((samples - 1) * substeps, n) are added after every Runge-Kutta step.
    """
    samples, n = states.shape
    step = dt / substeps
    work, h = np.zeros((3, n)), np.zeros(readings.shape[1])
    for k in range(samples):
        output(x, inputs[k * 3 * substeps], values, h)
        states[k] = x
        readings[k] = h
        if k == samples - 1:
            break
        for sub in range(substeps):
            at = k * substeps + sub
            runge_kutta(rate, x, values, inputs, 3 * at, step, work)
            for i in range(n):
                x[i] += kicks[at, i]
                if not np.isfinite(x[i]):
                    return False
    return True
