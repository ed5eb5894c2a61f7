"""The extended Kalman filter in one compiled loop, for any model (see ``spiral.physics.compile``).

    update    v = y - h(x),  S = C P C^T + R,  K = P C^T S^-1,  x <- x + K v,
              P <- (I - K C) P (I - K C)^T + K R K^T                       (Joseph form)
    predict   x <- RK4 of x' = f(x, u, p),  P <- F P F^T + Q

Parameters may be *tracked*: they are appended to the state, x = (states, tracked), with rate zero.
States keep their own units: every step is covariant under a change of them.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.long_steps import LONG_STEPS
from spiral.engine.filter.long_steps_kernel import ADVANCE_LONG, long_step_room
from spiral.engine.kernel import sensitivity_rates
from spiral.physics.compile import MODEL_FUNCTION
from spiral.physics.flow import FLOW_FUNCTION
from spiral.physics.lanes import INNER, padded_width

EXACT, SECOND_ORDER = 0, 1

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]
_FAST = {"contract", "reassoc"}
_LARGEST = 1e12


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def factor_in_place(s):
    """Lower Cholesky factor of S written into its lower triangle; log det S, NaN where not > 0."""
    total = 0.0
    for i in range(s.shape[0]):
        for j in range(i + 1):
            value = s[i, j]
            for k in range(j):
                value -= s[i, k] * s[j, k]
            if i == j:
                if not value > 0.0:
                    return np.nan
                s[i, i] = np.sqrt(value)
                total += 2.0 * np.log(s[i, i])
            else:
                s[i, j] = value / s[j, j]
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def solve_in_place(s, v):
    """S^-1 v with S as left by ``factor_in_place``; the squared length of L^-1 v is returned."""
    m = s.shape[0]
    squared = 0.0
    for i in range(m):
        for k in range(i):
            v[i] -= s[i, k] * v[k]
        v[i] /= s[i, i]
        squared += v[i] * v[i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            v[i] -= s[k, i] * v[k]
        v[i] /= s[i, i]
    return squared


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def update_measurement(x, p, c, v, r, gain, s, cp, w):
    """One measurement update of x and P in place; ``gain`` and ``s`` (S) are left for the caller.

    Returns (log det S, v^T S^-1 v); NaN where S is not positive.
    """
    n, m = x.shape[0], v.shape[0]
    for j in range(m):
        for a in range(n):
            cp[j, a] = 0.0
        for i in range(n):
            if c[j, i] != 0.0:
                for a in range(n):
                    cp[j, a] += c[j, i] * p[i, a]
    for j in range(m):
        for k in range(m):
            value = r[j] if j == k else 0.0
            for i in range(n):
                value += cp[j, i] * c[k, i]
            s[j, k] = value
            w[j, k] = value
    log_det = factor_in_place(w)
    if not np.isfinite(log_det):
        return np.nan, np.nan
    for i in range(n):
        for j in range(m):
            gain[i, j] = cp[j, i]
        solve_in_place(w, gain[i])
    for i in range(n):
        for j in range(m):
            x[i] += gain[i, j] * v[j]
    squared = solve_in_place(w, v)
    _joseph_update(p, c, r, gain, cp)
    return log_det, squared


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _joseph_update(p, c, r, gain, cp):
    """P <- (I - K C) P (I - K C)^T + K R K^T; ``cp`` holds C P and is overwritten by C T."""
    n, m = gain.shape
    for i in range(n):
        for j in range(m):
            for a in range(n):
                p[i, a] -= gain[i, j] * cp[j, a]
    for j in range(m):  # now T = (I - K C) P; row j of (T C^T)^T
        for i in range(n):
            value = 0.0
            for a in range(n):
                value += p[i, a] * c[j, a]
            cp[j, i] = value - gain[i, j] * r[j]
    for i in range(n):
        for j in range(m):
            for a in range(n):
                p[i, a] -= cp[j, i] * gain[a, j]
    for i in range(n):
        for a in range(i):
            mean = 0.5 * (p[i, a] + p[a, i])
            p[i, a] = mean
            p[a, i] = mean


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def propagate_covariance(p, f, q, work):
    """P <- F P F^T + Q in place; P stays exactly symmetric."""
    n = p.shape[0]
    for i in range(n):
        for a in range(n):
            work[i, a] = 0.0
        for k in range(n):
            if f[i, k] != 0.0:
                for a in range(n):
                    work[i, a] += f[i, k] * p[k, a]
    for i in range(n):
        for a in range(i + 1):
            value = q[i, a]
            for k in range(n):
                value += work[i, k] * f[a, k]
            p[i, a] = value
            p[a, i] = value


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _add_second_order(a, step, first, s):
    """S <- S + h S' + h^2 A S' / 2 with S' = A S + [0 | B] given (paper, eq. ekf_Phi)."""
    n, width = s.shape
    for i in range(n):
        for c in range(width):
            value = 0.0
            for k in range(n):
                value += a[i, k] * first[k, c]
            s[i, c] += step * first[i, c] + 0.5 * step * step * value


@nb.njit(cache=True, nogil=True)
def slope_workspace(n, width):
    """Slopes of n states, and the scratch of a flow with them (``spiral.physics.flow``)."""
    columns = padded_width(width)
    return np.zeros((n, columns)), np.zeros((3, n, columns))


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _second_order_step(rate, x, p, tracked, inputs, at, substeps, step, s, a, b):
    """Runge-Kutta steps of x; slopes of each by h A + h^2 A^2 / 2 from its start."""
    n, vectors, rates = s.shape[0], np.zeros((2, s.shape[0])), np.zeros_like(s)
    here, slope = vectors[0], vectors[1]
    for sub in range(substeps):
        rate(x[:n], inputs[at + 3 * sub], p, slope, a, b)
        sensitivity_rates(a, b, tracked, s, rates)
        _add_second_order(a, step, rates, s)
        total = slope.copy()
        for stage in range(1, 4):
            point = step * (1.0 if stage == 3 else 0.5)
            for i in range(n):
                here[i] = x[i] + point * slope[i]
            rate(here, inputs[at + 3 * sub + (stage + 1) // 2], p, slope, a, b)
            for i in range(n):
                total[i] += (1.0 if stage == 3 else 2.0) * slope[i]
        for i in range(n):
            x[i] += step / 6.0 * total[i]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _update_sample(x, p, y, r, h, cx, cv, tracked, c, v, s, gain, cp, w):
    """The update at one sample; its log-likelihood. A missing value changes nothing."""
    m, n = cx.shape
    seen = True
    for j in range(m):
        for i in range(n):
            c[j, i] = cx[j, i]
        for i in range(tracked.shape[0]):
            c[j, n + i] = cv[j, tracked[i]]
        seen = seen and not np.isnan(y[j])
        v[j] = y[j] - h[j]
    if not seen:
        gain[:] = 0.0
        c[:] = 0.0
        s[:] = 0.0
        return 0.0
    here = v.copy()
    log_det, squared = update_measurement(x, p, c, here, r, gain, s, cp, w)
    return -0.5 * (log_det + squared + m * np.log(2.0 * np.pi))


@nb.njit(**INNER)
def is_sound(x, p):
    """Whether mean and covariance are finite numbers of a sane size."""
    for i in range(x.shape[0]):
        if not (np.isfinite(x[i]) and abs(x[i]) < _LARGEST and np.isfinite(p[i, i])):
            return False
        if p[i, i] < 0.0:
            return False
    return True


@nb.njit(**INNER)
def write_tracked(values, tracked, x):
    """Write the tracked entries at the end of x into the values of parameters."""
    first = x.shape[0] - tracked.shape[0]
    for j in range(tracked.shape[0]):
        values[tracked[j]] = x[first + j]


@nb.njit(**INNER)
def reset_to_identity(f):
    """F = I, or [I | 0] where it is wider."""
    f[:] = 0.0
    for i in range(f.shape[0]):
        f[i, i] = 1.0


@nb.njit(**INNER, fastmath=_FAST)
def _exact_step(
    flow, stepper, rest, sources, long, x, inputs, k, substeps, dt, values, tracked, wide,
    work, room, f,
):  # fmt: skip
    """x a sample on and its slopes f; by long steps, if there are any, no parameter is tracked."""
    stepped = long[4] > 0 and stepper(rest, sources, long, x, inputs, k, substeps, values,
                                           tracked, wide, room)  # fmt: skip
    if not stepped:
        reset_to_identity(wide)
        flow(x, inputs, k * substeps * 3, 3, substeps, dt / substeps, values, wide, work, 0)
    f[: wide.shape[0]] = wide[:, : f.shape[1]]


@nb.njit(
    types.Tuple((types.float64, types.int64))(
        FLOW_FUNCTION, MODEL_FUNCTION, MODEL_FUNCTION, ADVANCE_LONG, *LONG_STEPS, _F1, _F2, _F1,
        _I1, _F2, types.int64, types.float64, types.int64, _F2, _F1, _F2, _F2, _F2, _F2, _F3, _F3,
        _F3, _F3, _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def extended_filter(
    flow, rate, output, stepper, rest, sources, long, x, p, values, tracked, inputs, substeps, dt,
    mode, y, r, q, means, variances, innovations, spreads, covariances, transitions, gains, slopes,
):  # fmt: skip
    """Filter one record.

    Parameters
    ----------
    flow, rate, output : model functions with slopes by the ``tracked`` parameters; ``rate`` where
        ``mode`` is SECOND_ORDER.
    stepper, rest, sources, long : ``long_steps_kernel.advance_long``, ``LongSteps.fields``.
    x : (N,) mean before the first sample, tracked parameters last; p : (N, N) its covariance;
        both are overwritten. values : (parameters,); tracked : indices of those appended to x.
    inputs : at the stages (``series.stage_inputs``); substeps : steps per sample; dt : s.
    mode : EXACT or SECOND_ORDER. y : (samples, channels), NaN where a sample is missing.
    r : (channels,) variance of the noise; q : (N, N) covariance of the process noise per sample.
    means, variances : (samples, N) out, after each update. innovations, spreads : (samples,
        channels) and (samples, channels, channels) out: v and S before each update.
    covariances, transitions, gains, slopes : (samples, N, N), (samples, N, N), (samples, N,
        channels), (samples, channels, N) out, for a smoother; left alone where they have no rows.

    Returns
    -------
    The log-likelihood of the innovations, and the samples done before a number became infinite.
    """
    samples, m = y.shape
    size, n = x.shape[0], x.shape[0] - tracked.shape[0]
    a, b, big = np.zeros((n, n)), np.zeros((n, values.shape[0])), np.zeros((size, size))
    (wide, work), f = slope_workspace(n, size), np.eye(size)
    room = long_step_room(long, n, wide.shape[1], inputs.shape[1], len(values), 0)
    h, c, cp = np.zeros(m), np.zeros((m, size)), np.zeros((m, size))
    cx, cv = np.zeros((m, n)), np.zeros((m, values.shape[0]))
    gain, w, likelihood = np.zeros((size, m)), np.zeros((m, m)), 0.0
    for k in range(samples):
        write_tracked(values, tracked, x)
        output(x[:n], inputs[k * 3 * substeps], values, h, cx, cv)
        term = _update_sample(x, p, y[k], r, h, cx, cv, tracked, c, innovations[k], spreads[k],
                         gain, cp, w)  # fmt: skip
        if not np.isfinite(term):
            return likelihood, k
        likelihood += term
        means[k], variances[k] = x, np.diag(p)
        if covariances.shape[0] > 0:
            covariances[k], gains[k], slopes[k] = p, gain, c
        if k == samples - 1:
            break
        write_tracked(values, tracked, x)
        if mode == EXACT:
            _exact_step(flow, stepper, rest, sources, long, x, inputs, k, substeps, dt, values,
                        tracked, wide, work, room, f)  # fmt: skip
        else:
            reset_to_identity(f)
            _second_order_step(rate, x, values, tracked, inputs, k * substeps * 3, substeps,
                          dt / substeps, f[:n], a, b)  # fmt: skip
        if covariances.shape[0] > 0:
            transitions[k] = f
        propagate_covariance(p, f, q, big)
        if not is_sound(x, p):
            return likelihood, k + 1
    return likelihood, samples
