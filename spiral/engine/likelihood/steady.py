"""A filter whose covariance has become stationary: gains that are those of the sample before.

Where F, c, r and Q are the same at every sample, P follows a Riccati recursion of its own, which
the readings do not enter, to its fixed point. A sample then costs N^2 in place of N^3.
"""

from __future__ import annotations

import numba as nb

from spiral.physics.lanes import INNER

_FAST = {"contract", "reassoc"}
SETTLED = 1e-12
"""Of itself, by which a variance that is stationary changes from sample to sample."""
CALM = 4
"""Samples in a row after which variances that hardly change are taken to be stationary."""


@nb.njit(**INNER)
def is_stationary(p, variances, size):
    """Whether no variance differs from that of the sample before; ``variances`` are kept."""
    same = True
    for i in range(size):
        same = same and abs(p[i, i] - variances[i]) <= SETTLED * p[i, i]
        variances[i] = p[i, i]
    return same


@nb.njit(**INNER)
def is_same_reading(k, c, kept, misses):
    """Whether all channels are read, by the rows of the sample before; these are ``kept``."""
    same = True
    for j in range(c.shape[0]):
        same = same and misses[k, j] == misses[k, j]
        for i in range(c.shape[1]):
            same = same and c[j, i] == kept[j, i]
            kept[j, i] = c[j, i]
    return same


@nb.njit(**INNER)
def is_read_alike(k, rows, seen):
    """Whether all channels of a sample were read, by the rows of the sample before."""
    for j in range(rows.shape[1]):
        if not (seen[k, j] > 0.0 and seen[k - 1, j] > 0.0):
            return False
        for i in range(rows.shape[2]):
            if rows[k, j, i] != rows[k - 1, j, i]:
                return False
    return True


@nb.njit(**INNER)
def load_slopes(p, s, size):
    """S from M = [P | S]."""
    wide = p.shape[0]
    for i in range(size):
        for j in range(s.shape[1]):
            s[i, j] = p[i, wide + j]


@nb.njit(**INNER)
def store_slopes(s, p, size):
    """S back into M = [P | S]."""
    wide = p.shape[0]
    for i in range(size):
        for j in range(s.shape[1]):
            p[i, wide + j] = s[i, j]


@nb.njit(**INNER)
def count_calm(calm, unchanging, p, variances, s, size):
    """Samples in a row in which no variance changed; S leaves M where P becomes stationary."""
    if not unchanging:
        return 0
    calm = calm + 1 if is_stationary(p, variances, size) else 0
    if calm == CALM:
        load_slopes(p, s, size)
    return calm


@nb.njit(**INNER, fastmath=_FAST)
def absorb_steadily(k, x, s, c, cv, both, kept, before, d, misses, spreads, slopes):
    """All channels of a sample taken in with the gains and variances ``kept`` (K, then s)."""
    size, width = kept.shape[1] - 1, slopes.shape[2]
    for i in range(size):
        before[i] = x[i]
    for j in range(c.shape[0]):
        for i in range(size):
            misses[k, j] -= c[j, i] * (x[i] - before[i])
        spreads[k, j] = kept[j, size]
        for i in range(size):
            x[i] += kept[j, i] * misses[k, j]
        for w in range(width):
            d[j, w] = cv[j, both[w]]
        for i in range(size):
            weight = c[j, i]
            if weight != 0.0:
                for w in range(width):
                    d[j, w] += weight * s[i, w]
        for i in range(size):
            gain = kept[j, i]
            for w in range(width):
                s[i, w] -= gain * d[j, w]
        for w in range(width):
            slopes[k, j, w] = d[j, w]
