"""Likelihood of predictions whose misses follow their own past.

Where no noise model of the filter leaves white innovations, those of one model and of another are
still to be compared. With e the whitened innovations of all channels (m of them),

    e_k = sum_{i=1..p} A_i e_{k-i} + r_k,   r ~ N(0, S),
    log L = -1/2 sum_kj log 2 pi s_kj - N/2 (log |S| + m),

N the samples, A_i and S by least squares (a vector autoregression; Luetkepohl, New Introduction to
Multiple Time Series Analysis, 2005, ch. 3). Any stationary colour is described so if p is large
enough; a gain in this likelihood is one beyond what the record's own past tells. Parameters are
carried on by Gauss-Newton steps on r, whose slopes are those of e filtered alike, while that makes
the record likelier: values that were fitted as if e were white are not the likeliest ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spiral.engine.likelihood.fit import MaximumLikelihood, innovation_slopes
from spiral.engine.likelihood.predict import Masks, Prediction
from spiral.types.record import Array

_ORDERS = (1, 2, 4, 8, 16, 32)
_EACH = 20  # samples for each coefficient of a row, at least
_STEPS = 4  # Gauss-Newton steps, at most
_ENOUGH = 0.1  # log-likelihood that is not worth another


@dataclass(frozen=True)
class Autoregression:
    """A_1 to A_p, transposed and one below another (p m, m), of the channels ``read``; S^(-1/2)."""

    weights: Array
    root: Array
    read: Array

    def whiten(self, rows: Array) -> Array:
        """(samples, m, columns) of (samples, channels, columns) less what their past tells."""
        rows = rows[:, self.read]
        channels = rows.shape[1]
        left = rows.copy()
        for i in range(len(self.weights) // channels):
            weights = self.weights[i * channels : (i + 1) * channels].T
            left[i + 1 :] -= weights @ rows[: len(rows) - i - 1]
        return self.root @ left


def fit_autoregression(
    predictions: Sequence[Prediction], masks: Masks = None
) -> Autoregression | None:
    """The autoregression of the innovations; nothing where they follow no past."""
    order = autoregressive_order(predictions, masks)
    if order == 0:
        return None
    read = _read_channels(predictions, masks)
    weights, left = _regression([p.whitened[:, read] for p in predictions], masks, order)
    return Autoregression(weights, _inverse_root(left), read)


def autoregressive_order(predictions: Sequence[Prediction], masks: Masks = None) -> int:
    """The order p by Schwarz's criterion, 0 where the misses do not follow their past."""
    read = _read_channels(predictions, masks)
    parts = [p.whitened[:, read] for p in predictions]
    samples, channels = _chosen(parts, masks).shape
    best, order = _height(parts, masks, 0), 0
    for p in _ORDERS:
        if p * channels * _EACH > samples:
            break
        price = 0.5 * p * channels**2 * float(np.log(samples * channels))
        if (height := _height(parts, masks, p) - price) > best:
            best, order = height, p
    return order


def coloured_log_likelihood(at: MaximumLikelihood, order: int, masks: Masks = None) -> float:
    """Log-likelihood with innovations that follow their past, on the samples of the masks."""
    read = _read_channels(at.predictions, masks)
    parts = [p.whitened[:, read] for p in at.predictions]
    constant = 0.0
    for r, part in enumerate(at.predictions):
        mask = slice(None) if masks is None or masks[r] is None else masks[r]
        spreads = part.spreads[mask]
        constant -= 0.5 * float(np.sum(np.log(2 * np.pi * spreads[spreads > 0])))
    height = _height(parts, masks, order)
    slopes = [x[:, read] for x in innovation_slopes(at)] if at.keys else []
    for _ in range(_STEPS if slopes else 0):
        step = _gauss_newton_step(parts, slopes, masks, order)
        moved = [e - x @ step for e, x in zip(parts, slopes, strict=True)]
        better = _height(moved, masks, order)
        if not better > height + _ENOUGH:
            break
        parts, height = moved, better
    return constant + height


def _read_channels(predictions: Sequence[Prediction], masks: Masks) -> Array:
    """(channels,) whether a channel is read in any sample that counts."""
    return np.any(_chosen([p.spreads for p in predictions], masks) > 0, axis=0)


def _chosen(parts: Sequence[Array], masks: Masks) -> Array:
    """(samples, ..) the rows of all records that count."""
    if masks is None:
        return np.concatenate(list(parts))
    kept = (p if m is None else p[m] for p, m in zip(parts, masks, strict=True))
    return np.concatenate(list(kept))


def _with_past(part: Array, order: int) -> Array:
    """(samples, order m) the rows before each row, nearest first; zeros before the record."""
    samples, channels = part.shape
    out = np.zeros((samples, order * channels))
    for i in range(1, order + 1):
        out[i:, (i - 1) * channels : i * channels] = part[:-i]
    return out


def _regression(parts: Sequence[Array], masks: Masks, order: int) -> tuple[Array, Array]:
    """A (order m, m) and r (samples, m) on the rows that count."""
    now = _chosen(parts, masks)
    if order == 0:
        return np.zeros((0, now.shape[1])), now
    past = _chosen([_with_past(p, order) for p in parts], masks)
    weights = np.linalg.lstsq(past, now, rcond=None)[0]
    return weights, now - past @ weights


def _height(parts: Sequence[Array], masks: Masks, order: int) -> float:
    """-N/2 (log |S| + m); -inf where S is singular."""
    left = _regression(parts, masks, order)[1]
    samples, channels = left.shape
    sign, size = np.linalg.slogdet(left.T @ left / samples)
    return -0.5 * samples * (float(size) + channels) if sign > 0 else -np.inf


def _gauss_newton_step(
    parts: Sequence[Array], slopes: Sequence[Array], masks: Masks, order: int
) -> Array:
    """The step of the parameters that takes most off r^T S^-1 r, with A and S held."""
    weights, left = _regression(parts, masks, order)
    past = Autoregression(weights, _inverse_root(left), np.ones(left.shape[1], dtype=bool))
    whole = [
        past.whiten(np.concatenate([e[..., None], x], axis=2))
        for e, x in zip(parts, slopes, strict=True)
    ]
    rows = _chosen(whole, masks)
    rows = rows.reshape(-1, rows.shape[2])
    return np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0]


def _inverse_root(left: Array) -> Array:
    """(m, m) R with R^T R = S^-1, of what is left."""
    return np.linalg.cholesky(np.linalg.inv(left.T @ left / len(left))).T
