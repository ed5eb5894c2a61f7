"""Slopes of predictions by amplitudes that are zero, propagated along a filtered record."""

from __future__ import annotations

import numba as nb
import numpy as np
from numba import types

from spiral.physics.compile import VALUE_FUNCTION

_F1, _F2, _F3 = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
_FAST = {"contract", "reassoc"}
_TILE = 16  # samples whose columns are put side by side at a time


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _fill_tile(pushes, readings, first, b, h):
    """The columns of some samples next to one another: b (tile + 1, n, width), h (tile, m, width).

    Samples that are not there are zero.
    """
    count = pushes.shape[1]
    for a in range(pushes.shape[0]):
        for k in range(b.shape[0]):
            for i in range(b.shape[1]):
                b[k, i, a] = pushes[a, first + k, i] if first + k < count else 0.0
        for k in range(h.shape[0]):
            for j in range(h.shape[1]):
                h[k, j, a] = readings[a, first + k, j] if first + k < count else 0.0


@nb.njit(
    types.void(_F3, _F3, _F3, _F3, _F3, _F2, types.float64, _F3),
    cache=True, nogil=True, error_model="numpy", fastmath=_FAST,
)  # fmt: skip
def propagate_signatures(transitions, gains, rows, pushes, readings, s, half, slopes):
    """Slopes of predictions by amplitudes that are zero, along a filtered stretch.

        d = c S + H,   S <- S - K d,   S <- F S + dt/2 (F_x B_k + B_{k+1})

    Parameters
    ----------
    transitions, gains, rows : F, K and c as ``predict_record`` left them, of this stretch.
    pushes : (width, samples or one more, n) slopes B of the rates, that after the last sample zero
        where it is not there; readings : (width, samples or one more, channels) H.
    s : (N, width) before the stretch, and after it on return. half : dt / 2.
    slopes : (samples, channels, width) out: d.
    """
    samples, m, width = slopes.shape
    size, n = s.shape[0], pushes.shape[2]
    out = np.zeros((size, width))
    push, told = np.zeros((_TILE + 1, n, width)), np.zeros((_TILE, m, width))
    for k in range(samples):
        if k % _TILE == 0:
            _fill_tile(pushes, readings, k, push, told)
        at = k % _TILE
        for j in range(m):
            d = slopes[k, j]
            for a in range(width):
                d[a] = told[at, j, a]
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
                s[i, a] += half * push[at, i, a]
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
                s[i, a] += half * push[at + 1, i, a]


@nb.njit(
    types.void(VALUE_FUNCTION, VALUE_FUNCTION, _F2, _F2, _F2, _F1, _F2, _F2),
    cache=True, nogil=True, error_model="numpy",
)  # fmt: skip
def evaluate_along(rate, output, states, inputs, given, values, rates, readings):
    """Rates (samples, n) and readings (samples, channels) of a model along its states, out.

    ``inputs`` act on the rates, ``given`` are those of the readings.
    """
    for k in range(states.shape[0]):
        rate(states[k], inputs[k], values, rates[k])
        output(states[k], given[k], values, readings[k])
