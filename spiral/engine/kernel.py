"""The generic integrator: states and sensitivities by classical Runge-Kutta, compiled once.

    x' = f(x, u, p)         S' = f_x S + [0 | f_p]         S = d x / d(x0, p)

One compiled function serves every model: the model's own functions are passed as first-class
functions. It advances a batch of windows, so that long windows can be taken in pieces.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.physics.compile import MODEL_FUNCTION, VALUE_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_I1 = types.int64[::1]


@nb.njit(
    types.void(_F2, _F2, _I1, _F2, _F2),
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract", "reassoc"},
)
def sensitivity_rates(
    a: np.ndarray, b: np.ndarray, columns: np.ndarray, s: np.ndarray, out: np.ndarray
) -> None:
    """out = A S + [0 | B[:, columns]]; structural zeros of A are skipped."""
    n, width = s.shape
    for i in range(n):
        for c in range(n):
            out[i, c] = 0.0
        for c in range(n, width):
            out[i, c] = b[i, columns[c - n]]
        for k in range(n):
            value = a[i, k]
            if value != 0.0:
                for c in range(width):
                    out[i, c] += value * s[k, c]


@nb.njit(types.void(_F2, _I1, _I1, _F2, types.int64), cache=True, nogil=True)
def _add_correction_columns(
    b: np.ndarray, phase: np.ndarray, first: np.ndarray, basis: np.ndarray, at: int
) -> None:
    """Columns of the phase correction: that of the phase origin times each spline."""
    if basis.shape[1] == 0:
        return
    origin, plain = phase[0], phase[1]
    for i in range(b.shape[0]):
        for k in range(plain, b.shape[1]):
            b[i, k] = 0.0
        for j in range(basis.shape[1]):
            b[i, plain + first[at] + j] = b[i, origin] * basis[at, j]


@nb.njit(
    types.boolean(
        MODEL_FUNCTION,
        MODEL_FUNCTION,
        _F2,
        _F3,
        _I1,
        types.int64,
        _F1,
        _I1,
        _I1,
        _I1,
        _F2,
        _F2,
        types.int64,
        types.float64,
        _F2,
        _F2,
        _F3,
    ),
    cache=True,
    nogil=True,
    error_model="numpy",
    fastmath={"contract"},
)
def advance_windows(
    rate, output, x, s, starts, length, p, columns, phase, first, basis, inputs, substeps, dt, y,
    weight, rows,
):  # fmt: skip
    """Advance a batch of windows by ``length`` samples and write their weighted rows.

    Parameters
    ----------
    rate, output : model functions (see ``spiral.physics.compile``).
    x : (windows, n) states at the windows' starts; on return at start + length.
    s : (windows, n, n + columns) sensitivities, carried like ``x``.
    starts : (windows,) first sample of each.
    length : samples to write.
    p : (parameters,) values; columns : indices of those differentiated.
    phase : (2,) position of the phase origin, and number of parameters of the model; what follows
        them in ``p`` are coefficients of a phase correction, whose derivative is that of the origin
        times a spline. first, basis : its splines on the half-step grid, first one and weights.
    inputs : ((samples - 1) * 3 * substeps + 1, inputs) at the stages (``series.stage_inputs``).
    substeps : Runge-Kutta steps per sample; dt : sample interval in s.
    y : (samples, channels) measurements; weight : (samples, channels), 1/sigma or 0.
    rows : (windows, length * channels, width + 1) out: weight * [d y / d(x0, p) | y - h].

    Returns
    -------
    False where a state became infinite or not a number.
    """
    windows, n = x.shape
    width = s.shape[2]
    channels = y.shape[1]
    count = columns.shape[0]
    last = (inputs.shape[0] - 1) // (3 * substeps)
    step = dt / substeps
    f = np.empty(n)
    a = np.zeros((n, n))
    b = np.zeros((n, p.shape[0]))
    h = np.empty(channels)
    cx = np.zeros((channels, n))
    cp = np.zeros((channels, p.shape[0]))
    xs = np.empty(n)
    total = np.empty(n)
    ss = np.empty((n, width))
    slope = np.empty((n, width))
    stotal = np.empty((n, width))
    for w in range(windows):
        xw = x[w]
        sw = s[w]
        for k in range(length):
            sample = starts[w] + k
            output(xw, inputs[sample * 3 * substeps], p, h, cx, cp)
            _add_correction_columns(cp, phase, first, basis, sample * 2 * substeps)
            for j in range(channels):
                scale = weight[sample, j]
                row = rows[w, k * channels + j]
                if scale == 0.0:
                    for c in range(width + 1):
                        row[c] = 0.0
                    continue
                row[width] = scale * (y[sample, j] - h[j])
                for c in range(n):
                    row[c] = 0.0
                for c in range(count):
                    row[n + c] = scale * cp[j, columns[c]]
                for i in range(n):
                    value = scale * cx[j, i]
                    if value != 0.0:
                        for c in range(width):
                            row[c] += value * sw[i, c]
            if sample == last:
                continue
            for sub in range(substeps):
                at = sample * substeps + sub
                total[:] = 0.0
                stotal[:] = 0.0
                f[:] = 0.0
                slope[:] = 0.0
                for stage in range(4):
                    point = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                    gain = 2.0 if stage == 1 or stage == 2 else 1.0
                    for i in range(n):
                        xs[i] = xw[i] + point * step * f[i]
                        for c in range(width):
                            ss[i, c] = sw[i, c] + point * step * slope[i, c]
                    place = (stage + 1) // 2
                    rate(xs, inputs[3 * at + place], p, f, a, b)
                    _add_correction_columns(b, phase, first, basis, 2 * at + place)
                    sensitivity_rates(a, b, columns, ss, slope)
                    for i in range(n):
                        total[i] += gain * f[i]
                        for c in range(width):
                            stotal[i, c] += gain * slope[i, c]
                for i in range(n):
                    xw[i] += step / 6.0 * total[i]
                    for c in range(width):
                        sw[i, c] += step / 6.0 * stotal[i, c]
            for i in range(n):
                if not np.isfinite(xw[i]) or abs(xw[i]) > 1e12:
                    return False
    return True


@nb.njit(
    types.void(VALUE_FUNCTION, _F1, _F1, _F2, types.int64, types.float64, _F2),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def runge_kutta(rate, x, p, inputs, at, step, work):
    """One step of x' = f for the first n entries of x, in place; ``work`` (3, n) is scratch."""
    n = work.shape[1]
    slope, total, here = work[0], work[1], work[2]
    total[:] = 0.0
    slope[:] = 0.0
    for stage in range(4):
        point = step * (0.0 if stage == 0 else (1.0 if stage == 3 else 0.5))
        gain = 2.0 if stage == 1 or stage == 2 else 1.0
        for i in range(n):
            here[i] = x[i] + point * slope[i]
        rate(here, inputs[at + (stage + 1) // 2], p, slope)
        for i in range(n):
            total[i] += gain * slope[i]
    for i in range(n):
        x[i] += step / 6.0 * total[i]


@nb.njit(
    types.boolean(
        VALUE_FUNCTION,
        VALUE_FUNCTION,
        _F2,
        _I1,
        _I1,
        _F2,
        _F2,
        types.int64,
        types.float64,
        _F2,
        _F2,
    ),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def trajectories(rate, output, x, starts, lengths, p, inputs, substeps, dt, states, readings):
    """States (samples, n) and readings (samples, channels) of windows; False on divergence.

    ``x`` (windows, n) states at ``starts``; ``p`` (1, parameters); only the samples inside the
    windows are written.
    """
    windows, n = x.shape
    samples, channels = readings.shape
    step = dt / substeps
    h = np.empty(channels)
    xw = np.empty(n)
    work = np.empty((3, n))
    for w in range(windows):
        for i in range(n):
            xw[i] = x[w, i]
        for k in range(lengths[w]):
            sample = starts[w] + k
            output(xw, inputs[sample * 3 * substeps], p[0], h)
            for i in range(n):
                states[sample, i] = xw[i]
            for j in range(channels):
                readings[sample, j] = h[j]
            if k == lengths[w] - 1 or sample == samples - 1:
                break
            for sub in range(substeps):
                runge_kutta(rate, xw, p[0], inputs, (sample * substeps + sub) * 3, step, work)
            for i in range(n):
                if not np.isfinite(xw[i]) or abs(xw[i]) > 1e12:
                    return False
    return True


@nb.njit(
    types.boolean(VALUE_FUNCTION, _F2, _I1, _F2, _F2, types.int64, types.float64),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def drive_states(rate, states, own, p, inputs, substeps, dt):
    """Fill the columns ``own`` of states (samples, n), integrated along the other columns.

    What drives them is taken as linear between samples; the first sample holds their start.
    ``p`` (1, parameters). Returns False where one of them is no number or runs away.
    """
    samples, n = states.shape
    x, f = np.empty(n), np.empty(n)
    count = own.shape[0]
    now, slope, total = np.empty(count), np.empty(count), np.empty(count)
    step = dt / substeps
    for i in range(count):
        now[i] = states[0, own[i]]
    for k in range(samples - 1):
        for sub in range(substeps):
            at = (k * substeps + sub) * 3
            total[:] = 0.0
            slope[:] = 0.0
            for stage in range(4):
                point = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                share = (sub + point) / substeps
                for i in range(n):
                    x[i] = (1.0 - share) * states[k, i] + share * states[k + 1, i]
                for i in range(count):
                    x[own[i]] = now[i] + point * step * slope[i]
                rate(x, inputs[at + (stage + 1) // 2], p[0], f)
                gain = 2.0 if stage == 1 or stage == 2 else 1.0
                for i in range(count):
                    slope[i] = f[own[i]]
                    total[i] += gain * slope[i]
            for i in range(count):
                now[i] += step / 6.0 * total[i]
                if not np.isfinite(now[i]) or abs(now[i]) > 1e12:
                    return False
        for i in range(count):
            states[k + 1, own[i]] = now[i]
    return True
