"""Filter step from one sample to the next: the transition of (x, theta, z), P and S.

    F = [ A | 0 I 0 | 0 0 Phi ]    (rows of x, of theta, of z)

    [P | S] <- [F P F^T + Q | F S + F_p]

Only A is a full matrix, so F M is made row by row of what is not zero; the product with F^T, which
makes P, is a full one. P and S stand side by side in one matrix M = [P | S].
"""

from __future__ import annotations

import numba as nb
import numpy as np

from spiral.physics.lanes import INNER

_FAST = {"contract", "reassoc"}
NOTHING = 1e-280
"""A variance, in any unit, below which it is taken for zero."""


@nb.njit(cache=True, nogil=True)
def entries_of(matrix):
    """Rows and columns of the entries of a matrix (G, Phi) that are not zero."""
    entries = np.zeros((matrix.size, 2), dtype=np.int64)
    count = 0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            if matrix[i, j] != 0.0:
                entries[count, 0], entries[count, 1] = i, j
                count += 1
    return entries[:count].copy()


@nb.njit(cache=True, nogil=True)
def compressed_rows(matrix):
    """Columns of the entries that are not zero, row by row, and where each row ends (from 0)."""
    columns, ends = np.zeros(matrix.size, dtype=np.int64), np.zeros(len(matrix) + 1, dtype=np.int64)
    for i in range(matrix.shape[0]):
        ends[i + 1] = ends[i]
        for j in range(matrix.shape[1]):
            if matrix[i, j] != 0.0:
                columns[ends[i + 1]] = j
                ends[i + 1] += 1
    return columns[: ends[-1]].copy(), ends


@nb.njit(cache=True, nogil=True)
def entries_in(matrix, columns, ends):
    """The entries of a matrix at places of ``compressed_rows``."""
    values = np.zeros(len(columns))
    for i in range(matrix.shape[0]):
        for e in range(ends[i], ends[i + 1]):
            values[e] = matrix[i, columns[e]]
    return values


@nb.njit(**INNER, fastmath=_FAST)
def add_forces(x, driven, entries, first, half):
    """x <- x + G z dt / 2."""
    for e in range(entries.shape[0]):
        i, j = entries[e, 0], entries[e, 1]
        x[i] += half * driven[i, j] * x[first + j]


@nb.njit(**INNER, fastmath=_FAST)
def advance_noise_states(x, phi, first, later):
    """z <- Phi z."""
    k = phi.shape[0]
    for i in range(k):
        later[i] = 0.0
        for j in range(k):
            later[i] += phi[i, j] * x[first + j]
    for i in range(k):
        x[first + i] = later[i]


@nb.njit(**INNER, fastmath=_FAST)
def transition_rows(f, driven, entries, first, half, a, turned):
    """A (n, N), and A^T, from the slopes (n, n + theta + q) of the flow."""
    n = f.shape[0]
    for i in range(n):
        for j in range(first):
            a[i, j] = f[i, j]
    for e in range(entries.shape[0]):
        for i in range(n):
            a[i, first + entries[e, 1]] = 0.0
    for e in range(entries.shape[0]):
        at, j = entries[e, 0], entries[e, 1]
        weight = half * driven[at, j]
        a[at, first + j] += weight
        for i in range(n):
            a[i, first + j] += weight * f[i, at]
    for i in range(n):
        for j in range(turned.shape[0]):
            turned[j, i] = a[i, j]


@nb.njit(**INNER, fastmath=_FAST)
def store_transition(k, a, phi, n, transitions):
    """Store F of a sample, where transitions are kept."""
    if transitions.shape[0] == 0:
        return
    size = transitions.shape[1]
    first = size - phi.shape[0]
    for i in range(size):
        for j in range(size):
            transitions[k, i, j] = a[i, j] if i < n else (1.0 if i == j and i < first else 0.0)
    for i in range(phi.shape[0]):
        for j in range(phi.shape[0]):
            transitions[k, first + i, first + j] = phi[i, j]


@nb.njit(**INNER, fastmath=_FAST)
def apply_transition(product, sparse, a, links, m, w, n, first):
    """W = F M; ``links`` of Phi: its ``entries_in``, and their ``compressed_rows``."""
    values, columns, ends = links
    product(a, m, w, n, first + len(ends) - 1)
    for i in range(n, first):
        for j in range(m.shape[1]):
            w[i, j] = m[i, j]
    sparse(values, columns, ends, m, w, first)


@nb.njit(cache=True, nogil=True)
def turn_noise_rows(phi, n, turned):
    """The columns of F^T that belong to theta and z; ``transition_rows`` makes those of x."""
    first = turned.shape[0] - phi.shape[0]
    for i in range(n, first):
        turned[i, i] = 1.0
    for i in range(phi.shape[0]):
        for j in range(phi.shape[0]):
            turned[first + j, first + i] = phi[i, j]


@nb.njit(**INNER)
def store_flow(k, f, flows):
    """Slopes of a sample's flow by the states and tracked parameters, where they are kept."""
    if flows.shape[0] > 0:
        for i in range(flows.shape[1]):
            for j in range(flows.shape[2]):
                flows[k, i, j] = f[i, j]


@nb.njit(**INNER)
def load_flow(k, flows, f):
    """What ``store_flow`` kept."""
    for i in range(flows.shape[1]):
        for j in range(flows.shape[2]):
            f[i, j] = flows[k, i, j]


@nb.njit(**INNER, fastmath=_FAST)
def transition_covariance(lower, w, turned, q, m, size):
    """P <- W F^T + Q with W = F P and ``turned`` F^T; P stays exactly symmetric.

    A state without process noise is known ever better; its variance is set to zero before it is too
    small to be a number of full precision, or negative by rounding.
    """
    lower(w, turned, m, size, size)
    for i in range(size):
        for j in range(i + 1):
            m[i, j] += q[i, j]
            m[j, i] = m[i, j]
    for i in range(size):
        if m[i, i] != 0.0 and abs(m[i, i]) < NOTHING:
            for j in range(size):
                m[i, j] = m[j, i] = 0.0


@nb.njit(**INNER, fastmath=_FAST)
def transition_slopes(w, f, m, n, first, size, width, at):
    """S <- F S + F_p, from W; S begins at column ``at``."""
    for i in range(n):
        for j in range(width):
            m[i, at + j] = w[i, at + j] + f[i, first + j]
    for i in range(n, size):
        for j in range(width):
            m[i, at + j] = w[i, at + j]
