"""Linear least squares y = X b + e by QR of unit-scaled columns, and its diagnostics.

Columns of one regression may differ by 14 orders of magnitude (a cubic of micrometres beside a
constant), so every column is divided by its norm before anything is factorised. A column whose
part outside the columns before it is below ``RANK`` of its norm carries nothing of its own: it is
*dropped*, its coefficient 0 and its standard error infinite, and it is named as such.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray

RANK = 1e-9
_PIECE, _TALL = 512, 8  # rows factorised at a time, and at least so many for each column


@dataclass(frozen=True)
class Fit:
    """A solved regression with n rows and k columns.

    ``b`` (k,) coefficients; ``inverse`` (k, k) rows of R^-1 in the columns' own scale, so that the
    OLS covariance is s^2 ``inverse inverse^T``; ``kept`` (k,) False for dropped columns; ``rss``
    the residual sum of squares; ``rows`` n.
    """

    b: Array
    inverse: Array
    kept: Array
    rss: float
    rows: int

    @property
    def parameters(self) -> int:
        """Columns that carry something of their own."""
        return int(self.kept.sum())

    @property
    def dof(self) -> int:
        """Rows less parameters, at least 1."""
        return max(self.rows - self.parameters, 1)

    @property
    def se(self) -> Array:
        """OLS standard errors s sqrt((X^T X)^-1_jj); infinite for dropped columns."""
        return self.spread(np.sqrt(self.rss / self.dof))

    def spread(self, sigma: float) -> Array:
        """Standard errors where the noise is white with this standard deviation."""
        size = sigma * np.linalg.norm(self.inverse, axis=1)
        return np.where(self.kept, size, np.inf)

    @property
    def t(self) -> Array:
        """b / se; 0 for dropped columns."""
        return t_values(self.b, self.se)


def t_values(b: Array, se: Array) -> Array:
    """b / se, with 0 where nothing was estimated and infinity where there is no error at all."""
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(np.isinf(se), 0.0, b / se)
    return np.where(np.isnan(values), 0.0, values)


def triangle(rows: Iterable[Array]) -> tuple[Array, int]:
    """R (k, k) of the QR of stacked blocks (n_i, k), one block in memory at a time; and n."""
    upper: Any = None
    count = 0
    for block in rows:
        count += len(block)
        block = _compress_rows(block)
        stacked = block if upper is None else np.concatenate([upper, block])
        upper = np.linalg.qr(stacked, mode="r")
    short = upper.shape[1] - upper.shape[0]
    return (np.pad(upper, ((0, short), (0, 0))) if short > 0 else upper), count


def _compress_rows(block: Array) -> Array:
    """Fewer rows with the same R: pieces that a processor's cache holds, each by its own R."""
    size = max(_PIECE, _TALL * block.shape[1])
    whole = len(block) // size * size
    if whole < 2 * size:
        return block
    pieces: Any = np.linalg.qr(block[:whole].reshape(-1, size, block.shape[1]), mode="r")
    return np.concatenate([pieces.reshape(-1, block.shape[1]), block[whole:]])


def solve_triangle(upper: Array, rows: int, columns: tuple[int, ...] | None = None) -> Fit:
    """Regress the last column of [X y] on others, from its R; ``columns`` of X, or all."""
    from scipy import linalg

    chosen = list(range(upper.shape[1] - 1)) if columns is None else list(columns)
    inner: Any = np.linalg.qr(upper[:, [*chosen, upper.shape[1] - 1]], mode="r")
    k = len(chosen)
    r, target = inner[:, :k], inner[:, k]
    norms = np.linalg.norm(r, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    own = np.abs(np.diag(r)[:k]) if k else np.zeros(0)
    kept = np.zeros(k, dtype=bool)
    kept[: len(own)] = own > RANK * norms[: len(own)]
    if not kept.all():  # factorise again without the dropped ones
        left = np.flatnonzero(kept)
        smaller = solve_triangle(upper, rows, tuple(chosen[i] for i in left))
        return _restore_dropped_columns(smaller, left, kept)
    b = linalg.solve_triangular(r[:k] / scale, target[:k]) / scale if k else np.zeros(0)
    inverse = (
        linalg.solve_triangular(r[:k] / scale, np.eye(k)) / scale[:, None]
        if k
        else np.zeros((0, 0))
    )
    rest = target[k:]
    return Fit(b, inverse, kept, float(rest @ rest), rows)


def _restore_dropped_columns(smaller: Fit, left: Array, kept: Array) -> Fit:
    b = np.zeros(len(kept))
    b[left] = smaller.b
    inverse = np.zeros((len(kept), smaller.inverse.shape[1]))
    inverse[left] = smaller.inverse
    again = kept.copy()
    again[left] = smaller.kept
    return Fit(b, inverse, again, smaller.rss, smaller.rows)


def least_squares(x: Array, y: Array) -> Fit:
    """Regress y (n,) on X (n, k); the residual sum of squares is that of y - X b itself."""
    upper, rows = triangle([np.column_stack([x, y])])
    fit = solve_triangle(upper, rows)
    rest = y - x @ fit.b
    return Fit(fit.b, fit.inverse, fit.kept, float(rest @ rest), rows)


def leverages(x: Array, fit: Fit) -> Array:
    """h_ii = |Q(i, :)|^2 (paper, eq. press), Q = X R^-1."""
    return np.sum((x @ fit.inverse) ** 2, axis=1)


def press(x: Array, y: Array, fit: Fit) -> float:
    """Sum of (e_i / (1 - h_ii))^2: leave-one-out prediction error (paper, eq. press)."""
    residual = y - x @ fit.b
    return float(np.sum((residual / np.maximum(1.0 - leverages(x, fit), 1e-12)) ** 2))


def variance_inflation(x: Array) -> Array:
    """VIF_j = 1 / (1 - R_j^2), R_j^2 of column j on the others and a constant (paper, eq. vif).

    |R^-1_j|^2 (N - 1) of the paper gives this only for centred columns of unit variance, so the
    columns are centred and scaled first. Infinite for a column that others make up exactly.
    """
    centred = x - x.mean(axis=0)
    norms = np.linalg.norm(centred, axis=0)
    scaled = centred / np.where(norms > 0, norms, 1.0)
    upper, rows = triangle([np.column_stack([scaled, np.zeros(len(x))])])
    factors = np.empty(x.shape[1])
    for j in range(x.shape[1]):
        others = tuple(i for i in range(x.shape[1]) if i != j)
        part = solve_triangle(np.column_stack([upper[:, :-1], upper[:, j]]), rows, others)
        factors[j] = 1.0 / part.rss if norms[j] > 0 and part.rss > 1e-15 else np.inf
    return factors


def adjusted_r2(y: Array, fit: Fit) -> float:
    """1 - (N - 1)/(N - p) RSS/SS_T, SS_T about the mean (paper, eq. radj)."""
    total = float(np.sum((y - y.mean()) ** 2))
    return 1.0 - (fit.rows - 1) / fit.dof * fit.rss / total


def partial_f(before: Fit, after: Fit) -> tuple[float, float]:
    """F = [(RSS_0 - RSS_1)/q] / [RSS_1/(N - p)] and its p-value (paper, eq. Ftest)."""
    from scipy import special

    q = after.parameters - before.parameters
    if q <= 0:
        return 0.0, 1.0
    gain = max(before.rss - after.rss, 0.0)
    if after.rss <= 0:
        return (np.inf, 0.0) if gain > 0 else (0.0, 1.0)
    value = (gain / q) / (after.rss / after.dof)
    return float(value), float(special.fdtrc(q, after.dof, value))
