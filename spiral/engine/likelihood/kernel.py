"""The extended Kalman filter with noise states and the slopes of its predictions, in one loop.

The state is (x, theta, z): the model's states, tracked parameters, and states of the noise,

    x' = f(x, u, theta) + G z,    z_{k+1} = Phi z_k + w_k,    y = h(x, u, theta) + H z + v,

z held within a sample. A force that acts at random with a correlation time, coloured measurement
noise and a sensor's drift are all states z with matrices of their own.

Channels of a sample are taken in one after the other (their noise v is independent), which needs
no matrix to be factorised and lets any of them be missing:

    s = c P c^T + r,  K = P c^T / s,  x <- x + K e,  P <- (I - K c) P (I - K c)^T + K r K^T.

The slopes S = d(x, theta, z)/dp of the mean follow with the gains held: d = c S + h_p is the slope
of a prediction, S <- S - K d.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.kernel import EXACT, hold, propagate, reset, sound, step_with_slopes
from spiral.physics.compile import MODEL_FUNCTION, VALUE_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]
_FAST = {"contract", "reassoc"}


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def take_in(x, p, c, r, miss, gain, pc):
    """One scalar measurement with row c and variance r; the spread s, x, P and gain in place."""
    size = x.shape[0]
    s = r
    for i in range(size):
        value = 0.0
        for a in range(size):
            value += p[i, a] * c[a]
        pc[i] = value
        s += c[i] * value
    for i in range(size):
        gain[i] = pc[i] / s
        x[i] += gain[i] * miss
    for i in range(size):  # T = (I - K c) P
        for a in range(size):
            p[i, a] -= gain[i] * pc[a]
    for i in range(size):  # T c^T - K r
        value = -gain[i] * r
        for a in range(size):
            value += p[i, a] * c[a]
        pc[i] = value
    for i in range(size):
        for a in range(size):
            p[i, a] -= pc[i] * gain[a]
    for i in range(size):
        for a in range(i):
            mean = 0.5 * (p[i, a] + p[a, i])
            p[i, a] = mean
            p[a, i] = mean
    return s


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _slope(c, hp, both, tracked, s, gain, d):
    """d = c S + h_p, and S <- S - K d."""
    size, width = s.shape
    for j in range(width):
        d[j] = hp[both[tracked + j]]
    for i in range(size):
        if c[i] != 0.0:
            for j in range(width):
                d[j] += c[i] * s[i, j]
    for i in range(size):
        for j in range(width):
            s[i, j] -= gain[i] * d[j]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _push(x, driven, first, half):
    """x <- x + G z dt / 2."""
    for i in range(driven.shape[0]):
        for j in range(driven.shape[1]):
            x[i] += half * driven[i, j] * x[first + j]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _forget(x, phi, first, later):
    """z <- Phi z."""
    k = phi.shape[0]
    for i in range(k):
        later[i] = 0.0
        for j in range(k):
            later[i] += phi[i, j] * x[first + j]
    for i in range(k):
        x[first + i] = later[i]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _transition(f, x, phi, driven, tracked, half, scratch, whole):
    """The (N, N) transition of (x, theta, z) from the slopes (n, n + theta + q) of the flow.

    Beside it z <- Phi z.
    """
    n, k = f.shape[0], phi.shape[0]
    first = n + tracked
    whole[:] = 0.0
    for i in range(n):
        for a in range(first):
            whole[i, a] = f[i, a]
        for j in range(k):
            value = driven[i, j]
            for a in range(n):
                value += f[i, a] * driven[a, j]
            whole[i, first + j] = half * value
    for i in range(tracked):
        whole[n + i, n + i] = 1.0
    for i in range(k):
        for j in range(k):
            whole[first + i, first + j] = phi[i, j]
    _forget(x, phi, first, scratch)


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _carry(whole, f, tracked, s, out):
    """S <- F S + F_p."""
    size, width = s.shape
    n = f.shape[0]
    for i in range(size):
        for j in range(width):
            out[i, j] = f[i, n + tracked + j] if i < n else 0.0
        for a in range(size):
            value = whole[i, a]
            if value != 0.0:
                for j in range(width):
                    out[i, j] += value * s[a, j]
    s[:] = out


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _rows(cx, cv, both, tracked, seen, x, y, h, c, misses):
    """Rows c of all channels by (x, theta, z), and y less what the mean predicts."""
    m, n = cx.shape
    first = n + tracked
    for j in range(m):
        misses[j] = y[j] - h[j]
        for i in range(n):
            c[j, i] = cx[j, i]
        for i in range(tracked):
            c[j, n + i] = cv[j, both[i]]
        for i in range(seen.shape[1]):
            c[j, first + i] = seen[j, i]
            misses[j] -= seen[j, i] * x[first + i]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _measured(
    x, p, c, cv, both, tracked, r, s, scratch, misses, spreads, slopes, k, gains
):  # fmt: skip
    """All channels of a sample taken in one by one; False where a variance is not positive.

    What the mean has moved since the first channel is taken from the misses of those after it.
    """
    size, width = s.shape
    gain, pc, before = scratch[1], scratch[2], scratch[3]
    before[:] = x
    for j in range(c.shape[0]):
        if np.isnan(misses[j]):
            spreads[j] = 0.0
            misses[j] = 0.0
            slopes[j] = 0.0
            continue
        for i in range(size):
            misses[j] -= c[j, i] * (x[i] - before[i])
        spreads[j] = take_in(x, p, c[j], r[j], misses[j], gain, pc)
        if not spreads[j] > 0.0:
            return False
        if gains.shape[0] > 0:
            gains[k, j] = gain
        if width:
            _slope(c[j], cv[j], both, tracked, s, gain, slopes[j])
    return True


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _keep(k, c, x, rows, means):
    """Rows and mean of a sample, where they are asked for."""
    if rows.shape[0] > 0:
        rows[k] = c
    if means.shape[0] > 0:
        means[k] = x


@nb.njit(
    types.int64(
        MODEL_FUNCTION, MODEL_FUNCTION, _F1, _F2, _F1, _I1, types.int64, _F2, _F2, types.int64,
        types.float64, _F2, _F1, _F2, _F2, _F2, _F2, _F2, _F2, _F3, _F2, _F3, _F3, _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def predict_record(
    rate, output, x, p, values, both, tracked, inputs, stages, substeps, dt, y, r, q, phi, seen,
    driven,
    misses, spreads, slopes, means, transitions, gains, rows,
):  # fmt: skip
    """One-step predictions of a record.

    Parameters
    ----------
    rate, output : model functions with Jacobians.
    x : (N,) mean of (states, tracked parameters, noise states) before the first sample; p : (N, N)
        its covariance; both are overwritten. values : (parameters,).
    both : indices of the ``tracked`` parameters, then of those differentiated (width).
    inputs : on the half-step grid; stages : of every Runge-Kutta step (``Series.stages``);
    substeps : steps per sample; dt : s.
    y : (samples, channels), NaN where missing; r : (channels,) variance of the white noise.
    q : (N, N) covariance that a sample adds; phi (k, k), seen (channels, k), driven (n, k) : Phi,
        H and G of the noise states.
    misses, spreads : (samples, channels) out: e and s; s is 0 where a channel is missing.
    slopes : (samples, channels, width) out: d. means : (samples, N) out, or no rows.
    transitions, gains, rows : (samples, N, N) F, (samples, channels, N) K and c out, for
        ``carry_signatures``, or no rows.

    Returns
    -------
    Samples done before a number became infinite.
    """
    samples, m = y.shape
    size, width = x.shape[0], slopes.shape[2]
    n = size - tracked - phi.shape[0]
    first, half, followed = n + tracked, 0.5 * dt, both[:tracked]
    f, work = np.zeros((n, n + tracked + width)), np.zeros((3, n, n + tracked + width))
    vectors, a, b = np.zeros((3, n)), np.zeros((n, n)), np.zeros((n, values.shape[0]))
    h, cx, cv = np.zeros(m), np.zeros((m, n)), np.zeros((m, values.shape[0]))
    c, scratch = np.zeros((m, size)), np.zeros((4, size))
    whole, big = np.zeros((size, size)), np.zeros((size, size))
    s, out, k = np.zeros((size, width)), np.zeros((size, width)), 0
    for k in range(samples):
        hold(values, followed, x[:first])
        output(x[:n], inputs[k * 2 * substeps], values, h, cx, cv)
        _rows(cx, cv, both, tracked, seen, x, y[k], h, c, misses[k])
        if not _measured(x, p, c, cv, both, tracked, r, s, scratch, misses[k], spreads[k],
                         slopes[k], k, gains):  # fmt: skip
            return k
        _keep(k, c, x, rows, means)
        if k == samples - 1 or not sound(x, p):
            break
        reset(f)
        hold(values, followed, x[:first])
        _push(x, driven, first, half)
        for sub in range(substeps):
            step_with_slopes(rate, x, values, both, stages, (k * substeps + sub) * 3,
                             dt / substeps, EXACT, f, vectors, a, b, work)  # fmt: skip
        _push(x, driven, first, half)
        _transition(f, x, phi, driven, tracked, half, scratch[0], whole)
        if transitions.shape[0] > 0:
            transitions[k] = whole
        if width:
            _carry(whole, f, tracked, s, out)
        propagate(p, whole, q, big)
    return k + 1 if sound(x, p) else k


@nb.njit(
    types.void(_F3, _F3, _F3, _F3, _F3, _F2, types.float64, _F3),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def carry_signatures(transitions, gains, rows, pushes, readings, s, half, slopes):
    """Slopes of predictions by amplitudes that are zero, along a filtered stretch.

        d = c S + H,   S <- S - K d,   S <- F S + dt/2 (F_x B_k + B_{k+1})

    Parameters
    ----------
    transitions, gains, rows : F, K and c as ``predict_record`` left them, of this stretch.
    pushes : (samples + 1, n, width) slopes B of the rates; readings : (samples, channels, width) H.
    s : (N, width) before the stretch, and after it on return. half : dt / 2.
    slopes : (samples, channels, width) out: d.
    """
    samples, m, width = slopes.shape
    size, n = s.shape[0], pushes.shape[1]
    out = np.zeros((size, width))
    for k in range(samples):
        for j in range(m):
            d = slopes[k, j]
            for a in range(width):
                d[a] = readings[k, j, a]
            for i in range(size):
                value = rows[k, j, i]
                if value != 0.0:
                    for a in range(width):
                        d[a] += value * s[i, a]
            for i in range(size):
                value = gains[k, j, i]
                for a in range(width):
                    s[i, a] -= value * d[a]
        for i in range(n):
            for a in range(width):
                s[i, a] += half * pushes[k, i, a]
        for i in range(size):
            for a in range(width):
                out[i, a] = 0.0
            for b in range(size):
                value = transitions[k, i, b]
                if value != 0.0:
                    for a in range(width):
                        out[i, a] += value * s[b, a]
        s[:] = out
        for i in range(n):
            for a in range(width):
                s[i, a] += half * pushes[k + 1, i, a]


@nb.njit(
    types.void(VALUE_FUNCTION, _F2, _F2, _F2, _F2, types.float64, _F3),
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def drive_own(rate, motion, between, inputs, values, dt, states):
    """States z of an effect alone, driven by a motion, by classical Runge-Kutta from rest.

    Parameters
    ----------
    rate : function of (z, motion), u, p. motion, between : (samples, m) at the samples, and half a
        step later. inputs : (samples, k). values : (copies, parameters).
    states : (copies, samples, n) out.
    """
    copies, samples, n = states.shape
    m = motion.shape[1]
    x, f, total, u = np.zeros(n + m), np.zeros(n + m), np.zeros(n), inputs[0].copy()
    for copy in range(copies):
        p = values[copy]
        for k in range(samples - 1):
            total[:] = 0.0
            for stage in range(4):
                point = dt * (0.0 if stage == 0 else (1.0 if stage == 3 else 0.5))
                for i in range(n):
                    x[i] = states[copy, k, i] + point * f[i]
                here = motion[k] if stage == 0 else (motion[k + 1] if stage == 3 else between[k])
                for i in range(m):
                    x[n + i] = here[i]
                for i in range(u.shape[0]):
                    late = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                    u[i] = (1.0 - late) * inputs[k, i] + late * inputs[k + 1, i]
                rate(x, u, p, f)
                for i in range(n):
                    total[i] += (2.0 if stage == 1 or stage == 2 else 1.0) * f[i]
            for i in range(n):
                states[copy, k + 1, i] = states[copy, k, i] + dt / 6.0 * total[i]


@nb.njit(
    types.void(VALUE_FUNCTION, VALUE_FUNCTION, _F2, _F2, _F1, _F2, _F2),
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def evaluate_along(rate, output, states, inputs, values, rates, readings):
    """Rates (samples, n) and readings (samples, channels) of a model along its states, out."""
    for k in range(states.shape[0]):
        rate(states[k], inputs[k], values, rates[k])
        output(states[k], inputs[k], values, readings[k])
