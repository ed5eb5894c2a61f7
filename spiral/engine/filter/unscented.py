"""The unscented Kalman filter in one compiled loop: no Jacobian, 2 N + 1 points instead.

With P = L L^T, points x, x +- sqrt(N + lambda) L_i and weights w_0 = lambda / (N + lambda),
w_i = 1 / (2 (N + lambda)), means and covariances of the propagated points replace the linearised
ones. Points are drawn anew before every update, so that the process noise is in them: on a linear
model this is the Kalman filter. (Julier and Uhlmann 1997; van der Merwe 2004.)
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.kernel import (
    _FAST,
    factor_in_place,
    is_sound,
    solve_in_place,
    write_tracked,
)
from spiral.engine.kernel import runge_kutta
from spiral.physics.compile import VALUE_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _draw_sigma_points(x, p, spread, points, root):
    """Sigma points (2 N + 1, N); a covariance without full rank has points that coincide."""
    n = x.shape[0]
    for i in range(n):
        for j in range(i + 1):
            value = p[i, j]
            for k in range(j):
                value -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = np.sqrt(value) if value > 0.0 else 0.0
            else:
                root[i, j] = value / root[j, j] if root[j, j] > 0.0 else 0.0
    for i in range(n):
        points[0, i] = x[i]
    for k in range(n):
        for i in range(n):
            offset = spread * root[i, k] if i >= k else 0.0
            points[1 + k, i] = x[i] + offset
            points[1 + n + k, i] = x[i] - offset


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _sigma_moments(points, weights, mean, covariance):
    """Weighted mean and covariance of points; ``weights`` (2, points): of mean, of covariance."""
    count, n = points.shape
    for i in range(n):
        mean[i] = 0.0
        for k in range(count):
            mean[i] += weights[0, k] * points[k, i]
    for i in range(n):
        for j in range(i + 1):
            value = 0.0
            for k in range(count):
                value += weights[1, k] * (points[k, i] - mean[i]) * (points[k, j] - mean[j])
            covariance[i, j] = value
            covariance[j, i] = value


@nb.njit(
    types.void(VALUE_FUNCTION, _F1, _F1, _I1, _F2, types.int64, types.int64, types.float64, _F2),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def _advance_point(rate, x, values, tracked, inputs, at, substeps, step, work):
    """One sample of x' = f by RK4 for one point, in place; its tracked entries stay."""
    write_tracked(values, tracked, x)
    for sub in range(substeps):
        runge_kutta(rate, x, values, inputs, at + 3 * sub, step, work)


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _unscented_update(x, p, points, readings, weights, r, y, v, s, expected, cross, w):
    """Mean and covariance after a measurement, in place; its log-likelihood."""
    n, m, count = x.shape[0], y.shape[0], points.shape[0]
    _sigma_moments(readings, weights, expected, s)
    for j in range(m):
        s[j, j] += r[j]
        v[j] = y[j] - expected[j]
    for i in range(n):
        for j in range(m):
            value = 0.0
            for k in range(count):
                value += weights[1, k] * (points[k, i] - x[i]) * (readings[k, j] - expected[j])
            cross[i, j] = value
    w[:] = s
    log_det = factor_in_place(w)
    if not np.isfinite(log_det):
        return np.nan
    here = v.copy()
    squared = solve_in_place(w, here)
    for i in range(n):
        gain = cross[i].copy()
        solve_in_place(w, gain)
        for j in range(m):
            x[i] += cross[i, j] * here[j]
        for a in range(i + 1):
            for j in range(m):
                p[i, a] -= gain[j] * cross[a, j]
            p[a, i] = p[i, a]
    return -0.5 * (log_det + squared + m * np.log(2.0 * np.pi))


@nb.njit(
    types.Tuple((types.float64, types.int64))(
        VALUE_FUNCTION, VALUE_FUNCTION, _F1, _F2, _F1, _I1, _F2, types.int64, types.float64,
        types.float64, _F2, _F2, _F1, _F2, _F2, _F2, _F2, _F3, _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def unscented_filter(
    rate, output, x, p, values, tracked, inputs, substeps, dt, spread, weights, y, r, q,
    means, variances, innovations, spreads, covariances,
):  # fmt: skip
    """Filter one record; parameters as ``kernel.extended_filter``, with value functions.

    ``spread`` is sqrt(N + lambda); ``weights`` (2, 2 N + 1) of mean and covariance.
    """
    samples, m = y.shape
    size, n = x.shape[0], x.shape[0] - tracked.shape[0]
    count = 2 * size + 1
    points, readings = np.zeros((count, size)), np.zeros((count, m))
    root, work, w = np.zeros((size, size)), np.zeros((3, n)), np.zeros((m, m))
    expected, cross = np.zeros(m), np.zeros((size, m))
    likelihood = 0.0
    for k in range(samples):
        _draw_sigma_points(x, p, spread, points, root)
        for i in range(count):
            write_tracked(values, tracked, points[i])
            output(points[i, :n], inputs[k * 3 * substeps], values, readings[i])
        term = _unscented_update(x, p, points, readings, weights, r, y[k], innovations[k],
                                  spreads[k], expected, cross, w)  # fmt: skip
        if not np.isfinite(term):
            return likelihood, k
        likelihood += term
        for i in range(size):
            means[k, i] = x[i]
            variances[k, i] = p[i, i]
        if covariances.shape[0] > 0:
            covariances[k] = p
        if k == samples - 1:
            break
        _draw_sigma_points(x, p, spread, points, root)
        for i in range(count):
            _advance_point(rate, points[i], values, tracked, inputs, k * substeps * 3, substeps,
                         dt / substeps, work)  # fmt: skip
        _sigma_moments(points, weights, x, p)
        for i in range(size):
            for a in range(size):
                p[i, a] += q[i, a]
        if not is_sound(x, p):
            return likelihood, k + 1
    return likelihood, samples
