"""Slopes of the extended filter's predictions by parameters, in one compiled loop.

The filter's gain K is held, so that with S_k = dx_k/dp just before sample k

    d_k = C S_k + h_p,    S_k <- S_k - K d_k,    S_{k+1} = F S_k + F_p,

d_k is the slope of the prediction of y_k, and -d_k that of the innovation. The gain's own slope
multiplies past innovations only: left out, d_k still depends on nothing but the past, and a test
that the innovations do not follow it keeps its level.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.kernel import _FAST, reset_to_identity, slope_workspace, write_tracked
from spiral.physics.compile import MODEL_FUNCTION
from spiral.physics.flow import FLOW_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _measurement_slopes(cx, cv, both, tracked, s, gain, d):
    """d = C S + h_p, and S <- S - K d."""
    m, n = cx.shape
    size, width = s.shape
    for j in range(m):
        for c in range(width):
            value = cv[j, both[tracked + c]]
            for i in range(n):
                value += cx[j, i] * s[i, c]
            for i in range(tracked):
                value += cv[j, both[i]] * s[n + i, c]
            d[j, c] = value
    for i in range(size):
        for j in range(m):
            for c in range(width):
                s[i, c] -= gain[i, j] * d[j, c]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _propagate_slopes(f, s, out):
    """S <- F S + F_p for the states; tracked rows stay."""
    n = f.shape[0]
    size, width = s.shape
    for i in range(n):
        for c in range(width):
            out[i, c] = f[i, size + c]
        for k in range(size):
            value = f[i, k]
            for c in range(width):
                out[i, c] += value * s[k, c]
    s[:n] = out


@nb.njit(
    types.void(
        FLOW_FUNCTION, MODEL_FUNCTION, _F1, _F1, _I1, types.int64, _F2, types.int64,
        types.float64, _F2, _F3, _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def prediction_slopes(
    flow, output, x, values, both, tracked, inputs, substeps, dt, means, gains, slopes,
):  # fmt: skip
    """Slopes d_k along a filtered record.

    Parameters
    ----------
    flow, output : model functions with slopes by the parameters ``both``.
    x : (N,) mean before the first sample, tracked parameters last. values : (parameters,).
    both : indices of the ``tracked`` parameters at the end of x, then of those differentiated (q).
    inputs : at the stages (``series.stage_inputs``); substeps : steps per sample; dt : s.
    means, gains : (samples, N) and (samples, N, channels) that the filter left.
    slopes : (samples, channels, q) out.
    """
    samples, m, width = slopes.shape
    size, n = x.shape[0], x.shape[0] - tracked
    s, out = np.zeros((size, width)), np.zeros((n, width))
    (f, work), step = slope_workspace(n, size + width), dt / substeps
    h, cx, cv = np.zeros(m), np.zeros((m, n)), np.zeros((m, values.shape[0]))
    followed = both[:tracked]
    for k in range(samples):
        write_tracked(values, followed, x)
        output(x[:n], inputs[k * 3 * substeps], values, h, cx, cv)
        _measurement_slopes(cx, cv, both, tracked, s, gains[k], slopes[k])
        if k == samples - 1:
            break
        x[:] = means[k]
        write_tracked(values, followed, x)
        reset_to_identity(f)
        flow(x, inputs, k * substeps * 3, 3, substeps, step, values, f, work, 0)
        _propagate_slopes(f, s, out)
