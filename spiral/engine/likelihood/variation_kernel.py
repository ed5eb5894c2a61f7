"""The filter of ``likelihood.kernel`` under several models of the noise at once, without slopes.

Along one filtered motion F and c are the same for every model of the noise; P, K and how far the
mean departs are not. Four models stand side by side as lanes (``filter.lane_algebra``).
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.engine.filter.kernel import slope_workspace, write_tracked
from spiral.engine.filter.lane_algebra import ABSORB, ADVANCE, SPARE
from spiral.engine.filter.long_steps import LONG_STEPS
from spiral.engine.filter.long_steps_kernel import ADVANCE_LONG, long_step_room
from spiral.engine.likelihood.alike import memory_of_transitions
from spiral.engine.likelihood.kernel import advance_sample
from spiral.engine.likelihood.steady import CALM, SETTLED, is_read_alike
from spiral.engine.likelihood.transition import (
    NOTHING,
    add_forces,
    compressed_rows,
    entries_of,
    load_flow,
    transition_rows,
)
from spiral.physics.flow import FLOW_FUNCTION
from spiral.physics.lanes import INNER, LANES, LOOP, padded_width
from spiral.physics.slope_bounds import BOUNDS_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_F4 = types.float64[:, :, :, ::1]
_I1 = types.int64[::1]
_FAST = {"contract", "reassoc"}


@nb.njit(**INNER, fastmath=_FAST)
def _absorb_lanes(absorb, k, rows, gains, before, seen, steady, x, p, r, work, kept, e, out):
    """Update at one sample; x is the mean less that of the first run.

    ``kept`` (channels, N + 1, lanes): K and s, out, or in where they are ``steady``.
    """
    size = rows.shape[2]
    for j in range(rows.shape[1]):
        for v in range(LANES):
            e[j, v] = out[j, v] = 0.0
        if not seen[k, j] > 0.0:
            continue
        if not steady:
            absorb(x, p, rows[k, j], gains[k, j], before[k, j], r[j], kept[j], work, e[j])
        else:
            for v in range(LANES):
                e[j, v] = before[k, j]
                for i in range(size):
                    e[j, v] -= rows[k, j, i] * x[i, v]
            for i in range(size):
                held = gains[k, j, i] * before[k, j]
                for v in range(LANES):
                    x[i, v] += kept[j, i, v] * e[j, v] - held
        for v in range(LANES):
            out[j, v] = kept[j, size, v]


@nb.njit(**INNER, fastmath=_FAST)
def _propagate_departure(x, a, z, phi, links, columns, ends, n, first, later):
    """x <- F x + (Phi - Phi_0) z, F with the Phi of each lane; ``phi`` is Phi_0."""
    size = x.shape[0]
    for i in range(n):
        for v in range(LANES):
            later[i, v] = 0.0
        for j in range(size):
            for v in range(LANES):
                later[i, v] += a[i, j] * x[j, v]
    for i in range(len(ends) - 1):
        for v in range(LANES):
            later[first + i, v] = 0.0
        for at in range(ends[i], ends[i + 1]):
            j = columns[at]
            for v in range(LANES):
                later[first + i, v] += (links[at, v] - phi[i, j]) * z[first + j]
                later[first + i, v] += links[at, v] * x[first + j, v]
    for i in range(n):
        for v in range(LANES):
            x[i, v] = later[i, v]
    for i in range(first, size):
        for v in range(LANES):
            x[i, v] = later[i, v]


@nb.njit(**INNER)
def _are_stationary(p, variances):
    """Whether no variance differs from that of the sample before; ``variances`` are kept.

    A state without process noise is known ever better; its variance is set to zero before it is too
    small to be a number of full precision, or negative by rounding.
    """
    size, same = variances.shape[0], True
    for i in range(size):
        for v in range(LANES):
            now = p[i, LANES * i + v]
            if now != 0.0 and abs(now) < NOTHING:
                for j in range(size):
                    p[i, LANES * j + v] = p[j, LANES * i + v] = 0.0
                now = 0.0
            same = same and abs(now - variances[i, v]) <= SETTLED * now
            variances[i, v] = now
    return same


@nb.njit(**LOOP, fastmath=_FAST)
def _vary_along(
    values, flow, advance, absorb, followed, inputs, substeps, dt, phi, driven, constant, means,
    gains, rows, flows, before, seen, r, q, misses, spreads, n, first, followed_states, entries,
    columns, ends, links, f, work, p, w, x, here, scratch, a, turned, own, own_work, kept,
    variances, calm, watch, ways, stepper, rest, sources,
):  # fmt: skip
    """The loop of ``vary_record``, in arrays made before."""
    samples, size = means.shape
    unchanging = constant and first == n and r.shape[1] == 1
    for k in range(samples):
        usual = unchanging and k > 0 and is_read_alike(k, rows, seen)
        for b in range(len(x)):
            calm[b] = calm[b] if usual else 0
            _absorb_lanes(absorb, k, rows, gains, before, seen, calm[b] >= CALM, x[b], p[b],
                          r[b, min(k, r.shape[1] - 1)], scratch, kept[b], misses[b, k],
                          spreads[b, k])  # fmt: skip
        if k == samples - 1:
            break
        same = constant and k > 0
        if not same or first > n:  # else all of F is that of the sample before
            if flows.shape[0] > 0:
                load_flow(k, flows, f)
            else:
                for i in range(size):
                    here[i] = means[k, i]
                write_tracked(values, followed, followed_states)
                add_forces(here, driven, entries, first, 0.5 * dt)
                advance_sample(
                    flow, watch, here, inputs, k, substeps, dt, values, same, f, work, own,
                    own_work, ways, stepper, rest, sources,
                )  # fmt: skip
            transition_rows(f, driven, entries, first, 0.5 * dt, a, turned)
        for b in range(len(x)):
            _propagate_departure(x[b], a, means[k], phi, links[b], columns, ends, n, first, scratch)
            if calm[b] < CALM:
                advance(a, links[b], columns, ends, q[b], p[b], w, n, first)
                still = _are_stationary(p[b], variances[b])
                calm[b] = calm[b] + 1 if still and unchanging else 0


@nb.njit(
    types.void(
        FLOW_FUNCTION, BOUNDS_FUNCTION, types.int64, ADVANCE, ABSORB, _F1, _I1, _F2, types.int64,
        types.float64, _F2, _F2, types.boolean, ADVANCE_LONG, *LONG_STEPS, _F2, _F3, _F3, _F3, _F2,
        _F2, _F4, _F4, _F4, _F4, _F4, _F4,
    ),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def vary_record(
    flow, watch, varying, advance, absorb, values, followed, inputs, substeps, dt, phi, driven,
    constant, stepper, rest, sources, long, means, gains, rows, flows, before, seen, starts,
    r, q, phis, misses, spreads,
):  # fmt: skip
    """One-step predictions of a record under other models of its noise, along one filtered motion.

    The filter is linear about the means of a run before: with F and c of that run, P follows from
    the other noise, and with it how far a mean departs, d <- d + K e - K_0 e_0, e = e_0 - c d,
    d <- F d. What is left out is that F would be made at another mean.

    Parameters
    ----------
    flow : with slopes by the parameters ``followed``; others as in ``predict_record``. advance,
        absorb : as in ``filter.lane_algebra``. phi : Phi of the run before.
    means, gains, rows, flows, before, seen : what that run left: means, K, c, A, e and s; A is
        made anew where it has no rows.
    starts, q, phis : (blocks, .., .., lanes) covariance before the first sample, Q and Phi of each
        model, four to a block. r : (blocks, samples or 1, channels, lanes).
    misses, spreads : (blocks, samples, channels, lanes) out: e and s.
    """
    size, channels, blocks = means.shape[1], misses.shape[2], len(starts)
    first, n = size - phi.shape[0], size - phi.shape[0] - len(followed)
    f, work = slope_workspace(n, first)
    own, own_work = slope_workspace(n, len(followed))
    x, here, scratch = np.zeros((blocks, size, LANES)), np.zeros(size), np.zeros((2 * size, LANES))
    a, turned = np.zeros((padded_width(n), size)), np.zeros((size, padded_width(size)))
    p, w = np.zeros((blocks, size + SPARE, size * LANES)), np.zeros((size + SPARE, size * LANES))
    added, magnitudes = np.zeros((blocks, size, size * LANES)), np.abs(phi)
    for b in range(blocks):
        p[b, :size] = starts[b].reshape(size, size * LANES)
        added[b] = q[b].reshape(size, size * LANES)
        for v in range(LANES):
            magnitudes += np.abs(phis[b, :, :, v])
    columns, ends = compressed_rows(magnitudes)
    links = np.zeros((blocks, len(columns), LANES))
    for i in range(phi.shape[0]):
        for at in range(ends[i], ends[i + 1]):
            links[:, at] = phis[:, i, columns[at]]
    _vary_along(
        values, flow, advance, absorb, followed, inputs, substeps, dt, phi, driven, constant, means,
        gains, rows, flows, before, seen, r, added, misses, spreads, n, first, here[:first],
        entries_of(driven), columns, ends, links, f, work, p, w, x, here, scratch, a, turned, own,
        own_work, np.zeros((blocks, channels, size + 1, LANES)), np.zeros((blocks, size, LANES)),
        np.zeros(blocks, dtype=np.int64), watch,
        (memory_of_transitions(n, varying), long, followed,
         long_step_room(long, n, f.shape[1], inputs.shape[1], len(values), len(followed))),
        stepper, rest, sources,
    )  # fmt: skip
