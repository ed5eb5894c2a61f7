"""States of an effect alone, driven by a motion, in steps that are short enough for them.

A slider that yields over a length L forgets at the rate |v| / L, in a few samples or in a part of
one, and jumps where the motion turns. With the slopes k1 to k4 of a classical Runge-Kutta step

    e = h / 6 |k1 - k2 - k3 + k4|

is of the third order in h and large where h is too long; a step in which it is more than a share of
the largest state so far is taken again in parts.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.physics.compile import VALUE_FUNCTION

_F2, _F3 = types.float64[:, ::1], types.float64[:, :, ::1]
_SHARE = 0.1  # of the largest state, up to which a step is short enough
_FINER, _MOST = 4, 64  # times as many parts, and at most


@nb.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _runge_kutta_step(
    rate, motion, between, inputs, k, first, share, dt, p, z, largest, x, u, f, slopes
):
    """z one step on, from ``first`` of the way between two samples over a ``share`` of it.

    Returns the largest e, as a share of the largest state.
    """
    n, worst = z.shape[0], 0.0
    for stage in range(4):
        late = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        for i in range(n):
            x[i] = z[i] if stage == 0 else z[i] + share * dt * late * slopes[stage - 1, i]
        s = first + late * share
        before, after = (1.0 - s) * (1.0 - 2.0 * s), s * (2.0 * s - 1.0)  # a parabola's weights
        middle = 1.0 - before - after
        for i in range(motion.shape[1]):
            x[n + i] = before * motion[k, i] + middle * between[k, i] + after * motion[k + 1, i]
        for i in range(u.shape[0]):
            u[i] = (1.0 - s) * inputs[k, i] + s * inputs[k + 1, i]
        rate(x, u, p, f)
        for i in range(n):
            slopes[stage, i] = f[i]
    for i in range(n):
        ends, inner = slopes[0, i] + slopes[3, i], slopes[1, i] + slopes[2, i]
        moved = share * dt / 6.0 * (ends + 2.0 * inner)
        size = max(largest[i], abs(z[i]), abs(moved))
        z[i] += moved
        if not np.isfinite(z[i]):
            return np.inf
        if size > 0.0:
            worst = max(worst, share * dt / 6.0 * abs(ends - inner) / size)
    return worst


@nb.njit(
    types.void(VALUE_FUNCTION, _F2, _F2, _F2, _F2, types.float64, _F3),
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def drive_own_states(rate, motion, between, inputs, values, dt, states):
    """States z of an effect alone, driven by a motion, by classical Runge-Kutta from rest.

    Parameters
    ----------
    rate : function of (z, motion), u, p. motion, between : (samples, m) at the samples, and half a
        step later. inputs : (samples, k). values : (copies, parameters).
    states : (copies, samples, n) out; not a number from where they run away.
    """
    copies, samples, n = states.shape
    x, u = np.zeros(n + motion.shape[1]), inputs[0].copy()
    f, slopes, largest = np.zeros(n + motion.shape[1]), np.zeros((4, n)), np.zeros(n)
    for copy in range(copies):
        largest[:] = 0.0
        for k in range(samples - 1):
            after = states[copy, k + 1]
            parts = 1
            while True:
                after[:] = states[copy, k]
                worst = 0.0
                for part in range(parts):
                    error = _runge_kutta_step(
                        rate, motion, between, inputs, k, part / parts, 1.0 / parts, dt,
                        values[copy], after, largest, x, u, f, slopes,
                    )  # fmt: skip
                    worst = max(worst, error)
                if worst <= _SHARE or parts >= _MOST:
                    break
                parts *= _FINER
            if worst == np.inf:  # it runs away however short the steps are
                states[copy, k + 1 :] = np.nan
                break
            for i in range(n):
                largest[i] = max(largest[i], abs(after[i]))
