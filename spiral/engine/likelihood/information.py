"""The scoring regression's rows, and standard errors that do not rest on the model of the noise.

With e the whitened misses, X their slopes by parameters, and for a size of the noise w and l as in
``fit``, the rows are [X, -w | e] and [0, l / 2^(1/2) | (e^2 - 1) / 2^(1/2)]. With g_b the sum of
a block's rows times their last column, and V the inverse of the information I = sum_b I_b,

    var_j = sum_b (V g_b)_j^2 / (1 - w_b / V_jj),    w_b = (V I_b V)_jj

(White 1980; Liang and Zeger 1986, blocks as clusters; MacKinnon and White 1985 for the leverage
w_b / V_jj) is V_jj where the noise is what it is said to be, and var_j / V_jj then about chi2 / nu
with nu = (sum_b w_b)^2 / sum_b w_b^2 (Satterthwaite).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from spiral.engine.leastsquares import Fit
from spiral.engine.likelihood.predict import Prediction
from spiral.types.record import Array

_DOUBTED = 0.05  # level at which the noise is not what it is said to be

Beside = Sequence[tuple[Array, Array]]
"""By size of the noise: slopes of e and of log s by its logarithm, (samples, channels) each."""


def regression_rows(
    part: Prediction, columns: Array, beside: Beside, mask: Array | slice = slice(None)
) -> list[Array]:
    """Rows [X, -w | e] and [0, l / 2^(1/2) | (e^2 - 1) / 2^(1/2)] of one record, in a mask."""
    seen = part.spreads[mask] > 0
    e, columns = part.whitened[mask][seen], columns[mask][seen]
    width = columns.shape[1]
    first = np.zeros((len(e), width + len(beside) + 1))
    second = np.zeros_like(first)
    first[:, :width], first[:, -1] = columns, e
    for j, (miss, grown) in enumerate(beside):
        first[:, width + j] = -miss[mask][seen]
        second[:, width + j] = grown[mask][seen] / np.sqrt(2.0)
    second[:, -1] = (e**2 - 1.0) / np.sqrt(2.0)
    return [first, second] if beside else [first]


def widening_factors(
    parts: Sequence[Prediction], rows: Sequence[Sequence[Array]], solved: Fit, block: int
) -> Array:
    """(columns of the regression,) factors from I's standard errors to those of blocks.

    ``rows`` are those of every record. 1 where the blocks do not contradict the model of the noise,
    or say less.
    """
    scores, shares = [], []
    for part, own in zip(parts, rows, strict=True):
        edges = np.flatnonzero(np.diff(np.nonzero(part.spreads > 0)[0] // block, prepend=-1))
        moved = [r[:, :-1] @ solved.inverse for r in own]
        each = sum((m * r[:, -1:] for m, r in zip(moved, own, strict=True)), np.zeros(1))
        scores.append(np.add.reduceat(each, edges) @ solved.inverse.T)
        spread = sum(((m @ solved.inverse.T) ** 2 for m in moved), np.zeros(1))
        shares.append(np.add.reduceat(spread, edges))
    g, w = np.concatenate(scores), np.concatenate(shares)
    with np.errstate(divide="ignore", invalid="ignore"):
        whole = np.sum(solved.inverse**2, axis=1)
        held = np.maximum(1 - w / whole, 1 / len(w))
        size = np.sum((g - g.mean(axis=0)) ** 2 / held, axis=0) / whole
        nu = np.sum(w, axis=0) ** 2 / np.sum(w**2, axis=0)
        doubted = special.chdtrc(nu, nu * size) < _DOUBTED
    return np.where(doubted & (size > 1), np.sqrt(size), 1.0)
