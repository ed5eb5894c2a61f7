"""The fixed-interval smoother: every sample estimated from the whole record.

The Rauch-Tung-Striebel estimate in the form of Bryson and Frazier, which inverts only the
innovations' covariance S, so that a process noise of zero is no trouble:

    at a sample      L~ = C^T S^-1 C + (I - K C)^T L (I - K C)
                     l~ = -C^T S^-1 v + (I - K C)^T l
    between samples  L = F^T L~ F,    l = F^T l~
    smoothed         x_s = x - P l,   P_s = P - P L P

with x, P the filtered mean and covariance and L, l from the samples after. L is positive
semidefinite, so P_s never exceeds P. (Bierman 1977, Factorization Methods, chapter X.)
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.kernel import _FAST, factor_in_place, solve_in_place

_F2, _F3 = types.float64[:, ::1], types.float64[:, :, ::1]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _smooth_sample(x, p, adjoint, weight, work):
    """x <- x - P l and P <- P - P L P, in place."""
    n = x.shape[0]
    for i in range(n):
        for a in range(n):
            value = 0.0
            for k in range(n):
                value += p[i, k] * weight[k, a]
            work[i, a] = value
        for a in range(n):
            x[i] -= p[i, a] * adjoint[a]
    for i in range(n):
        for a in range(n):
            value = 0.0
            for k in range(n):
                value += work[i, k] * p[k, a]
            work[n + i, a] = value
    for i in range(n):
        for a in range(n):
            p[i, a] -= 0.5 * (work[n + i, a] + work[n + a, i])


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _reverse_update(adjoint, weight, c, gain, s, v, work):
    """l and L from after a sample's update to before it."""
    n, m = gain.shape
    if s[0, 0] == 0.0:  # nothing was measured
        return
    for i in range(n):
        for a in range(n):
            value = 1.0 if i == a else 0.0
            for j in range(m):
                value -= gain[i, j] * c[j, a]
            work[i, a] = value
    _congruence(adjoint, weight, work[:n], work[n:])
    w = s.copy()
    factor_in_place(w)
    here = v.copy()
    solve_in_place(w, here)
    for a in range(n):
        column = c[:, a].copy()
        solve_in_place(w, column)
        for j in range(m):
            adjoint[a] -= c[j, a] * here[j]
            for i in range(n):
                weight[i, a] += c[j, i] * column[j]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _congruence(adjoint, weight, f, work):
    """l <- F^T l and L <- F^T L F, in place; L stays exactly symmetric."""
    n = adjoint.shape[0]
    for i in range(n):
        for a in range(n):
            value = 0.0
            for k in range(n):
                value += weight[i, k] * f[k, a]
            work[i, a] = value
    fresh = np.zeros(n)
    for i in range(n):
        for k in range(n):
            fresh[i] += f[k, i] * adjoint[k]
        for a in range(i + 1):
            value = 0.0
            for k in range(n):
                value += f[k, i] * work[k, a]
            weight[i, a] = value
    for i in range(n):
        adjoint[i] = fresh[i]
        for a in range(i):
            weight[a, i] = weight[i, a]


@nb.njit(
    types.void(_F2, _F3, _F2, _F3, _F3, _F3, _F3),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def smooth_record(means, covariances, innovations, spreads, transitions, gains, slopes):
    """Turn filtered ``means`` (samples, N) and ``covariances`` into smoothed ones, in place.

    The other arrays are those ``kernel.extended_filter`` leaves behind.
    """
    samples, n = means.shape
    adjoint, weight, work = np.zeros(n), np.zeros((n, n)), np.zeros((2 * n, n))
    for k in range(samples - 1, -1, -1):
        if k < samples - 1:
            _congruence(adjoint, weight, transitions[k], work[:n])
        _smooth_sample(means[k], covariances[k], adjoint, weight, work)
        _reverse_update(adjoint, weight, slopes[k], gains[k], spreads[k], innovations[k], work)
