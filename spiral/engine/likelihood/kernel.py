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

from spiral.engine.filter.algebra import ABSORB, PRODUCT
from spiral.engine.filter.kernel import hold, reset, room, sound
from spiral.physics.compile import MODEL_FUNCTION
from spiral.physics.flow import FLOW_FUNCTION
from spiral.physics.lanes import padded

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]
_FAST = {"contract", "reassoc"}


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _slope(c, hp, both, tracked, s, gain, d):
    """d = c S + h_p, and S <- S - K d."""
    size, width = s.shape[0], d.shape[0]
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
def _carry(product, whole, f, first, width, s, out):
    """S <- F S + F_p."""
    product(whole, s, out)
    for i in range(f.shape[0]):
        for j in range(width):
            out[i, j] += f[i, first + j]
    s[:] = out


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _propagate(product, p, whole, q, work):
    """P <- F P F^T + Q in place; P stays exactly symmetric."""
    product(whole, p, work[0])
    for i in range(whole.shape[0]):
        for a in range(whole.shape[0]):
            work[1, a, i] = whole[i, a]
    product(work[0], work[1], p)
    for i in range(q.shape[0]):
        for a in range(i + 1):
            p[i, a] += q[i, a]
            p[a, i] = p[i, a]


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
    absorb, x, p, c, cv, both, tracked, r, s, scratch, work, misses, spreads, slopes, k, gains
):  # fmt: skip
    """All channels of a sample taken in one by one; False where a variance is not positive.

    What the mean has moved since the first channel is taken from the misses of those after it.
    """
    size, width = gains.shape[2], slopes.shape[1]
    before, gain = scratch[0], scratch[1]
    before[:] = x
    for j in range(c.shape[0]):
        if np.isnan(misses[j]):
            spreads[j] = 0.0
            misses[j] = 0.0
            slopes[j] = 0.0
            continue
        for i in range(x.shape[0]):
            misses[j] -= c[j, i] * (x[i] - before[i])
        spreads[j] = absorb(x, p, c[j], r[j], misses[j], gain, work)
        if not spreads[j] > 0.0:
            return False
        if gains.shape[0] > 0:
            gains[k, j] = gain[:size]
        if width:
            _slope(c[j], cv[j], both, tracked, s, gain, slopes[j])
    return True


@nb.njit(cache=True, nogil=True)
def _square(matrix):
    """A square matrix with zeros around it, in room for lanes."""
    wide = padded(len(matrix))
    out = np.zeros((wide, wide))
    out[: len(matrix), : len(matrix)] = matrix
    return out


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _keep(k, c, x, rows, means):
    """Rows and mean of a sample, where they are asked for."""
    if rows.shape[0] > 0:
        rows[k] = c[:, : rows.shape[2]]
    if means.shape[0] > 0:
        means[k] = x[: means.shape[1]]


@nb.njit(
    types.int64(
        FLOW_FUNCTION, MODEL_FUNCTION, PRODUCT, ABSORB, _F1, _F2, _F1, _I1, types.int64, _F2, _F2,
        types.int64, types.float64, _F2, _F1, _F2, _F2, _F2, _F2, _F2, _F2, _F3, _F2, _F3, _F3, _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def predict_record(
    flow, output, product, absorb, mean, covariance, values, both, tracked, inputs, stages,
    substeps, dt, y, r, q, phi, seen, driven,
    misses, spreads, slopes, means, transitions, gains, rows,
):  # fmt: skip
    """One-step predictions of a record.

    Parameters
    ----------
    flow, output : the model's flow and output with slopes by the parameters ``both``.
    product, absorb : as in ``filter.algebra``.
    mean : (N,) of (states, tracked parameters, noise states) before the first sample; covariance :
        (N, N) of it. values : (parameters,), overwritten where tracked.
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
    size, width = mean.shape[0], slopes.shape[2]
    n = size - tracked - phi.shape[0]
    first, half, followed, step = n + tracked, 0.5 * dt, both[:tracked], dt / substeps
    f, work = room(n, first + width)
    h, cx, cv = np.zeros(m), np.zeros((m, n)), np.zeros((m, values.shape[0]))
    p = _square(covariance)
    wide, (s, _) = len(p), room(len(p), width)
    matrices, out, k = np.zeros((3, wide, wide)), np.zeros_like(s), 0
    x, c, scratch, whole = np.zeros(wide), np.zeros((m, wide)), np.zeros((2, wide)), matrices[2]
    space = np.zeros(2 * wide)
    x[:size] = mean
    for k in range(samples):
        hold(values, followed, x[:first])
        output(x[:n], inputs[k * 2 * substeps], values, h, cx, cv)
        _rows(cx, cv, both, tracked, seen, x, y[k], h, c, misses[k])
        if not _measured(absorb, x, p, c, cv, both, tracked, r, s, scratch, space, misses[k],
                         spreads[k], slopes[k], k, gains):  # fmt: skip
            return k
        _keep(k, c, x, rows, means)
        if k == samples - 1 or not sound(x, p):
            break
        reset(f)
        hold(values, followed, x[:first])
        _push(x, driven, first, half)
        flow(x, stages, k * substeps * 3, 3, substeps, step, values, f, work)
        _push(x, driven, first, half)
        _transition(f, x, phi, driven, tracked, half, scratch[0], whole)
        if transitions.shape[0] > 0:
            transitions[k] = whole[:size, :size]
        if width:
            _carry(product, whole, f, first, width, s, out)
        _propagate(product, p, whole, q, matrices)
    return k + 1 if sound(x, p) else k


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _follow(absorb, x, p, rows, gains, before, seen, r, scratch, work, misses, spreads):
    """A sample taken in with other noise: x is how far its mean is from that of the first run."""
    size, c, gain = rows.shape[1], scratch[0], scratch[1]
    for j in range(len(misses)):
        misses[j] = spreads[j] = 0.0
        if not seen[j] > 0.0:
            continue
        c[:size] = rows[j]
        misses[j] = before[j]
        for i in range(size):
            misses[j] -= rows[j, i] * x[i]
        spreads[j] = absorb(x, p, c, r[j], misses[j], gain, work)
        for i in range(size):
            x[i] -= gains[j, i] * before[j]


@nb.njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _departed(x, whole, z, phi, before, first, later):
    """x <- F x + (Phi - Phi_0) z with F = ``whole``, which is given this Phi."""
    k = phi.shape[0]
    for i in range(k):
        later[first + i] = 0.0
        for j in range(k):
            later[first + i] += (phi[i, j] - before[i, j]) * z[first + j]
            whole[first + i, first + j] = phi[i, j]
    later[:first] = 0.0
    for i in range(first + k):
        for a in range(first + k):
            later[i] += whole[i, a] * x[a]
    x[: first + k] = later[: first + k]


@nb.njit(
    types.void(
        FLOW_FUNCTION, PRODUCT, ABSORB, _F1, _I1, _F2, types.int64, types.float64, _F2, _F2,
        _F2, _F3, _F3, _F2, _F2, _F3, _F2, _F3, _F3, _F3, _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def vary_record(
    flow, product, absorb, values, followed, stages, substeps, dt, phi, driven,
    means, gains, rows, before, seen, starts, r, q, phis, misses, spreads,
):  # fmt: skip
    """One-step predictions of a record under other models of its noise, along one filtered motion.

    The filter is linear about the means of a run before: with F and c of that run, P follows from
    the other noise, and with it how far a mean departs, d <- d + K e - K_0 e_0, e = e_0 - c d,
    d <- F d. What is left out is that F would be made at another mean.

    Parameters
    ----------
    flow : with slopes by the parameters ``followed``; others as in ``predict_record``. phi : Phi of
        the run before.
    means, gains, rows, before, seen : what that run left: means, K, c, e and s.
    starts, r, q, phis : (noises, ..) covariance before the first sample, r, Q and Phi of each.
    misses, spreads : (noises, samples, channels) out: e and s.
    """
    samples, size = means.shape
    first, n = size - phi.shape[0], size - phi.shape[0] - len(followed)
    f, work = room(n, first)
    blank = _square(starts[0])
    wide, p = len(blank), np.zeros((len(starts), *blank.shape))
    x, here, later = np.zeros((len(starts), wide)), np.zeros(size), np.zeros(size)
    scratch, space, matrices = np.zeros((2, wide)), np.zeros(2 * wide), np.zeros((3, *blank.shape))
    whole = matrices[2]
    p[:, :size, :size] = starts
    for k in range(samples):
        for v in range(len(starts)):
            _follow(absorb, x[v], p[v], rows[k], gains[k], before[k], seen[k], r[v], scratch,
                    space, misses[v, k], spreads[v, k])  # fmt: skip
        if k == samples - 1:
            break
        here[:] = means[k]
        reset(f)
        hold(values, followed, here[:first])
        _push(here, driven, first, 0.5 * dt)
        flow(here, stages, k * substeps * 3, 3, substeps, dt / substeps, values, f, work)
        _transition(f, here, phi, driven, len(followed), 0.5 * dt, later, whole)
        for v in range(len(starts)):
            _departed(x[v], whole, means[k], phis[v], phi, first, later)
            _propagate(product, p[v], whole, q[v], matrices)
