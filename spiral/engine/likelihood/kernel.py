"""The extended Kalman filter with noise states and the slopes of its predictions, in one loop.

The state is (x, theta, z): the model's states, tracked parameters, and states of the noise,

    x' = f(x, u, theta) + G z,    z_{k+1} = Phi z_k + w_k,    y = h(x, u, theta) + H z + v,

z held within a sample. A force that acts at random with a correlation time, coloured measurement
noise and a sensor's drift are all states z with matrices of their own.

Channels of a sample are taken in one after the other (their noise v is independent), which needs
no matrix to be factorised and lets any of them be missing:

    s = c P c^T + r,  K = P c^T / s,  x <- x + K e,  P <- (I - K c) P (I - K c)^T + K r K^T.

The slopes S = d(x, theta, z)/dp of the mean follow with the gains held: d = c S + h_p is the slope
of a prediction, S <- S - K d. They stand beside P in one matrix M = [P | S] (``transition``).

Where F, c, r and Q are the same at every sample, P becomes stationary: from then on s and K are
those of the sample before, and only x and S go on (``steady``).
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.algebra import ABSORB, PRODUCT, SPARSE
from spiral.engine.filter.kernel import is_sound, reset_to_identity, slope_workspace, write_tracked
from spiral.engine.filter.long_steps import LONG_STEPS
from spiral.engine.filter.long_steps_kernel import ADVANCE_LONG, long_step_room
from spiral.engine.likelihood.alike import (
    find_alike,
    is_worth_asking,
    keep_transition,
    memory_of_transitions,
)
from spiral.engine.likelihood.steady import (
    CALM,
    absorb_steadily,
    count_calm,
    is_same_reading,
    store_slopes,
)
from spiral.engine.likelihood.transition import (
    add_forces,
    advance_noise_states,
    apply_transition,
    compressed_rows,
    entries_in,
    entries_of,
    store_flow,
    store_transition,
    transition_covariance,
    transition_rows,
    transition_slopes,
    turn_noise_rows,
)
from spiral.physics.compile import MODEL_FUNCTION
from spiral.physics.flow import FLOW_FUNCTION
from spiral.physics.lanes import INNER, LOOP, padded_width
from spiral.physics.slope_bounds import BOUNDS_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]
_FAST = {"contract", "reassoc"}


@nb.njit(**INNER, fastmath=_FAST)
def _reading_rows(cx, cv, both, tracked, seen, x, y, h, k, c, misses):
    """Rows c of all channels by (x, theta, z), and y less what the mean predicts."""
    m, n = cx.shape
    first = n + tracked
    for j in range(m):
        misses[k, j] = y[k, j] - h[j]
        for i in range(n):
            c[j, i] = cx[j, i]
        for i in range(tracked):
            c[j, n + i] = cv[j, both[i]]
        for i in range(seen.shape[1]):
            c[j, first + i] = seen[j, i]
            misses[k, j] -= seen[j, i] * x[first + i]


@nb.njit(**INNER, fastmath=_FAST)
def _absorb_sample(
    absorb, x, p, c, cv, both, tracked, r, scratch, work, k, d, misses, spreads, slopes, kept
):  # fmt: skip
    """All channels of a sample taken in one by one; False where a variance is not positive.

    What the mean has moved since the first channel is taken from the misses of those after it.
    ``kept`` (channels, N + 1) out: K and s.
    """
    size, width = len(x), slopes.shape[2]
    before, gain = scratch[0], scratch[1]
    for i in range(size):
        before[i] = x[i]
    for j in range(c.shape[0]):
        if np.isnan(misses[k, j]):
            spreads[k, j] = misses[k, j] = 0.0
            for i in range(width):
                slopes[k, j, i] = 0.0
            continue
        for i in range(size):
            misses[k, j] -= c[j, i] * (x[i] - before[i])
        for i in range(width):
            d[j, i] = cv[j, both[tracked + i]]
        spreads[k, j] = absorb(x, p, c, d, j, r[min(k, len(r) - 1), j], misses[k, j], gain, work)
        if not spreads[k, j] > 0.0:
            return False
        for i in range(width):
            slopes[k, j, i] = d[j, i]
        for i in range(size):
            kept[j, i] = gain[i]
        kept[j, size] = spreads[k, j]
    return True


@nb.njit(cache=True, nogil=True)
def _pad_covariance(matrix, width):
    """[P | S] with S = 0 of so many columns, in room for lanes."""
    wide = padded_width(len(matrix))
    out = np.zeros((wide, wide + padded_width(width)))
    out[: len(matrix), : len(matrix)] = matrix
    return out


@nb.njit(**INNER)
def _store_sample(k, c, x, kept, spreads, rows, means, gains):
    """Rows, mean and gains of a sample, where they are asked for."""
    if rows.shape[0] > 0:
        for j in range(rows.shape[1]):
            for i in range(rows.shape[2]):
                rows[k, j, i] = c[j, i]
    if means.shape[0] > 0:
        for i in range(means.shape[1]):
            means[k, i] = x[i]
    if gains.shape[0] > 0:
        for j in range(gains.shape[1]):
            for i in range(gains.shape[2]):
                gains[k, j, i] = kept[j, i] if spreads[k, j] > 0.0 else 0.0


@nb.njit(**INNER, fastmath=_FAST)
def advance_sample(
    flow, watch, x, inputs, k, substeps, dt, values, same, f, work, own, own_work, ways,
    stepper, rest, sources,
):  # fmt: skip
    """x a sample on, and its slopes f by states and parameters.

    By long steps where there are any (``long_steps_kernel``). Else, where those by the states are
    the ``same`` as at the sample before, or those of one that was kept (``likelihood.alike``), the
    others (``own``) alone. ``ways`` : the memory of kept ones; ``LongSteps``, the parameters that
    slopes are by, of which none is tracked then, and its room.
    """
    n, at, step = f.shape[0], k * substeps * 3, dt / substeps
    alike, long, moved, room = ways
    if long[4] > 0 and stepper(rest, sources, long, x, inputs, k, substeps, values, moved, f,
                                    room):  # fmt: skip
        return
    kept, kept_slopes, bounds, counts, before = alike
    place = -2
    if not same and is_worth_asking(bounds.shape[1], counts):
        for i in range(n):
            before[i] = x[i]
        for v in range(bounds.shape[1]):
            bounds[0, v], bounds[1, v] = np.inf, -np.inf
        watch(before, inputs, at, 3, substeps, step, values, bounds)
        place = find_alike(bounds, kept_slopes, counts)
    if not same and place < 0:
        reset_to_identity(f)
        flow(x, inputs, at, 3, substeps, step, values, f, work, 0)
        if place == -1:
            keep_transition(f, kept, bounds, kept_slopes, counts)
        return
    if not same:
        for i in range(n):
            for j in range(n):
                f[i, j] = kept[place, i, j]
    own[:] = 0.0
    flow(x, inputs, at, 3, substeps, step, values, own, own_work, n)
    for i in range(n):
        for j in range(min(own.shape[1], f.shape[1] - n)):
            f[i, n + j] = own[i, j]


@nb.njit(**INNER, fastmath=_FAST)
def _take_reading(
    k, calm, unchanging, output, absorb, x, p, c, cx, cv, both, tracked, seen, y, r, h, kept,
    kept_rows, s, scratch, space, d, misses, spreads, slopes, states, reading, values,
):  # fmt: skip
    """A sample's reading taken in, by the gains of the one before where P is stationary.

    ``calm`` counts samples in which no variance changed; so many there are still, or -1 where a
    variance is not positive.
    """
    output(states, reading, values, h, cx, cv)
    _reading_rows(cx, cv, both, tracked, seen, x, y, h, k, c, misses)
    usual = unchanging and is_same_reading(k, c, kept_rows, misses)
    if calm >= CALM and not usual:
        store_slopes(s, p, len(p))
    if usual and calm >= CALM:
        absorb_steadily(k, x, s, c, cv, both, kept, scratch[0], d, misses, spreads, slopes)
    elif not _absorb_sample(absorb, x, p, c, cv, both, tracked, r, scratch, space, k, d, misses,
                            spreads, slopes, kept):  # fmt: skip
        return -1
    return calm if usual else 0


@nb.njit(**INNER, fastmath=_FAST)
def _advance_steadily(
    k, product, sparse, a, phi, links, s, s_later, f, first, size, width, transitions
):  # fmt: skip
    """Slopes a sample on, by the transition of the sample before."""
    n = f.shape[0]
    store_transition(k, a, phi, n, transitions)
    apply_transition(product, sparse, a, links, s, s_later, n, first)
    transition_slopes(s_later, f, s, n, first, size, width, 0)


@nb.njit(**LOOP, fastmath=_FAST)
def _predict_along(
    values, flow, output, product, lower, sparse, absorb, both, tracked, inputs, substeps, dt,
    y, r, q, phi, seen, driven, constant, misses, spreads, slopes, means, transitions, gains, rows,
    flows, states, followed_states, followed, entries, links, f, work, p, later, a, turned, x, c, d,
    scratch, space, h, cx, cv, own, own_work, kept, kept_rows, variances, s, s_later, watch, ways,
    stepper, rest, sources,
):  # fmt: skip
    """The loop of ``predict_record``, in arrays made before."""
    n, first, size, width, half = len(states), len(followed_states), len(q), slopes.shape[2], dt / 2
    k, calm, unchanging = 0, 0, constant and tracked == 0 and len(r) == 1
    for k in range(y.shape[0]):
        write_tracked(values, followed, followed_states)
        calm = _take_reading(
            k, calm, unchanging, output, absorb, x, p, c, cx, cv, both, tracked, seen, y, r, h,
            kept, kept_rows, s, scratch, space, d, misses, spreads, slopes, states,
            inputs[k * 3 * substeps], values,
        )  # fmt: skip
        if calm < 0:
            return k
        _store_sample(k, c, x, kept, spreads, rows, means, gains)
        if k == y.shape[0] - 1 or not is_sound(x, p):
            break
        write_tracked(values, followed, followed_states)
        add_forces(x, driven, entries, first, half)
        advance_sample(flow, watch, x, inputs, k, substeps, dt, values, constant and k > 0, f,
                        work, own, own_work, ways, stepper, rest, sources)  # fmt: skip
        store_flow(k, f, flows)
        add_forces(x, driven, entries, first, half)
        advance_noise_states(x, phi, first, scratch[0])
        if calm >= CALM:
            _advance_steadily(k, product, sparse, a, phi, links, s, s_later, f, first, size, width,
                              transitions)  # fmt: skip
            continue
        transition_rows(f, driven, entries, first, half, a, turned)
        store_transition(k, a, phi, n, transitions)
        apply_transition(product, sparse, a, links, p, later, n, first)
        transition_slopes(later, f, p, n, first, size, width, len(p))
        transition_covariance(lower, later, turned, q, p, size)
        calm = count_calm(calm, unchanging, p, variances, s, size)
    return k + 1 if is_sound(x, p) else k


@nb.njit(
    types.int64(
        FLOW_FUNCTION, BOUNDS_FUNCTION, types.int64, MODEL_FUNCTION, PRODUCT, PRODUCT, SPARSE,
        ABSORB, _F1, _F2, _F1, _I1, types.int64, _F2, types.int64, types.float64, _F2, _F2, _F2,
        _F2, _F2, _F2, types.boolean, ADVANCE_LONG, *LONG_STEPS, _F2, _F2, _F3, _F2, _F3, _F3, _F3,
        _F3,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def predict_record(
    flow, watch, varying, output, product, lower, sparse, absorb, mean, covariance, values, both,
    tracked, inputs, substeps, dt, y, r, q, phi, seen, driven, constant, stepper, rest,
    sources, long, misses, spreads, slopes, means, transitions, gains, rows, flows,
):  # fmt: skip
    """One-step predictions of a record.

    Parameters
    ----------
    flow, output : the model's flow and output with slopes by the parameters ``both``.
    watch : the bounds of its slopes by states (``physics.slope_bounds``), of which so many are
        ``varying``; 0 where transitions of samples alike are not looked for.
    product, lower, sparse, absorb : as in ``filter.algebra``.
    mean : (N,) of (states, tracked parameters, noise states) before the first sample; covariance :
        (N, N) of it. values : (parameters,), overwritten where tracked.
    both : indices of the ``tracked`` parameters, then of those differentiated (width).
    inputs : at the stages of every Runge-Kutta step (``series.stage_inputs``); substeps : steps per
        sample; dt : s.
    y : (samples, channels), NaN where missing; r : (samples or 1, channels) variance of the white
        noise.
    q : (N, N) covariance that a sample adds; phi (k, k), seen (channels, k), driven (n, k) : Phi,
        H and G of the noise states.
    constant : whether the slopes of the flow by the states are the same at every sample.
    stepper, rest, sources, long : ``long_steps_kernel.advance_long``, ``LongSteps.fields``.
    misses, spreads : (samples, channels) out: e and s; s is 0 where a channel is missing.
    slopes : (samples, channels, width) out: d. means : (samples, N) out, or no rows.
    transitions, gains, rows : (samples, N, N) F, (samples, channels, N) K and c out, for
        ``propagate_signatures``, or no rows. flows : (samples, n, n + tracked) out: A by states and
        tracked parameters without forces, for ``variation_kernel.vary_record``, or no rows.

    Returns
    -------
    Samples done before a number became infinite.
    """
    m, size, width = y.shape[1], mean.shape[0], slopes.shape[2]
    n = size - tracked - phi.shape[0]
    first = n + tracked
    f, work = slope_workspace(n, first + width)
    own, own_work = slope_workspace(n, tracked + width)
    p = _pad_covariance(covariance, width)
    wide, later = len(p), np.zeros_like(p)
    a, turned = np.zeros((padded_width(n), size)), np.zeros((size, padded_width(size)))
    x, c, d = np.zeros(wide), np.zeros((m, wide)), np.zeros((m, padded_width(width)))
    scratch, space = np.zeros((2, wide)), np.zeros(2 * p.shape[1])
    kept, kept_rows = np.zeros((m, wide + 1)), np.zeros((m, wide))
    s, s_later = np.zeros((wide, padded_width(width))), np.zeros((wide, padded_width(width)))
    h, cx, cv = np.zeros(m), np.zeros((m, n)), np.zeros((m, values.shape[0]))
    x[:size] = mean
    columns, ends = compressed_rows(phi)
    turn_noise_rows(phi, n, turned)
    return _predict_along(
        values, flow, output, product, lower, sparse, absorb, both, tracked, inputs, substeps, dt,
        y, r, q, phi, seen, driven, constant, misses, spreads, slopes, means, transitions, gains,
        rows, flows, x[:n], x[:first], both[:tracked], entries_of(driven),
        (entries_in(phi, columns, ends), columns, ends), f, work, p, later, a, turned, x, c, d,
        scratch, space, h, cx, cv, own, own_work, kept, kept_rows, np.zeros(size), s, s_later,
        watch, (memory_of_transitions(n, varying), long, both[tracked:],
                long_step_room(long, n, f.shape[1], inputs.shape[1], len(values), width)),
        stepper, rest, sources,
    )  # fmt: skip
