"""Tests on residuals: whiteness, paired errors, and the spending of a study's error rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from spiral.types.record import Array


@dataclass(frozen=True)
class Whiteness:
    """Ljung-Box over channels: smallest p-value (Bonferroni), and (Q - m) / N as effect size."""

    p: float
    effect: float


def whiteness(residuals: tuple[Array, ...], lags: int) -> Whiteness:
    """Ljung-Box Q = N (N + 2) sum_k rho_k^2 / (N - k) of every channel (paper, eq. ljungbox).

    (Q - m) / N is about the summed squared autocorrelation over m lags: the size of what is left,
    whatever N, less what white noise shows by chance. Of a short record at most a fifth as many
    lags are taken as it has samples.
    """
    lags = min([lags, *(max(2, len(values) // 5) for values in residuals)])
    p_values, effects = [], []
    for values in residuals:
        for channel in values.T:
            kept = channel[channel != 0.0]
            if len(kept) <= lags + 1 or not np.all(np.isfinite(kept)):
                return Whiteness(0.0, np.inf)
            statistic = ljung_box(kept, lags)
            p_values.append(float(special.chdtrc(lags, statistic)))
            effects.append(max(statistic - lags, 0.0) / len(kept))
    smallest = min(p_values) if p_values else 1.0
    return Whiteness(min(1.0, smallest * len(p_values)), max(effects, default=0.0))


def autocorrelation(values: Array, lags: int) -> Array:
    """(lags + 1,) rho_k about zero, not about the mean, of values that are not all zero."""
    size = 2 ** int(np.ceil(np.log2(2 * len(values))))
    spectrum = np.abs(np.fft.rfft(values, size)) ** 2
    return np.fft.irfft(spectrum)[: lags + 1] / float(values @ values)


def ljung_box(values: Array, lags: int) -> float:
    """Q = N (N + 2) sum_k rho_k^2 / (N - k) for lags 1 to ``lags``, in time N lags.

    The same number as statsmodels' ``acorr_ljungbox``, which computes all N autocorrelations.
    """
    centred = values - values.mean()
    count, energy = len(centred), float(centred @ centred)
    rho = np.array([centred[k:] @ centred[:-k] for k in range(1, lags + 1)]) / energy
    return float(count * (count + 2) * np.sum(rho**2 / (count - np.arange(1, lags + 1))))


@dataclass(frozen=True)
class PairedDifference:
    """Paired difference of two models' squared errors on held-out samples.

    ``fall`` = sum (a^2 - b^2), above zero where b predicts better; ``share`` the weight g of b in
    the best combination of both, so that fall > 0 exactly where g > 1/2; ``t`` = (g - 1/2) / se(g);
    ``p_fall`` one-sided (b better), ``p_differ`` two-sided; ``energy`` sum d^2: if either model is
    the truth, t has the mean sqrt(energy) / 2.
    """

    fall: float
    share: float
    t: float
    p_fall: float
    p_differ: float
    energy: float = np.inf


def paired_errors(
    first: tuple[Array, ...], second: tuple[Array, ...], block: int
) -> PairedDifference:
    """Compare weighted residuals a and b of two models on the same held-out samples.

    With d = a - b the paired difference is sum (a^2 - b^2) = 2 sum a d - sum d^2 = 2 sum d^2
    (g - 1/2), g = sum a d / sum d^2. Its standard error comes from sums over blocks of the
    residual of the best combination, e = a - g d: se(g) = sqrt(sum_b (sum e d)^2) / sum d^2. A
    plain t on the blocks' differences would be capped where few blocks hold most of the energy,
    as at a resonance. (Encompassing test: Harvey, Leybourne and Newbold 1998.)
    """
    if not all(np.isfinite(b).all() for b in second):
        return PairedDifference(-np.inf, 0.0, -np.inf, 1.0, 0.0)
    if not all(np.isfinite(a).all() for a in first):
        return PairedDifference(np.inf, 1.0, np.inf, 0.0, 0.0)
    counted = [np.any((a != 0) | (b != 0), axis=1) for a, b in zip(first, second, strict=True)]
    a, b = ([r[c] for r, c in zip(side, counted, strict=True)] for side in (first, second))
    d = [x - y for x, y in zip(a, b, strict=True)]
    energy = sum(float(np.sum(x * x)) for x in d)
    if energy < 1e-12:
        return PairedDifference(0.0, 0.5, 0.0, 1.0, 1.0, energy)
    share = sum(float(np.sum(x * y)) for x, y in zip(a, d, strict=True)) / energy
    sums = np.concatenate(
        [_block_sums(np.sum((x - share * y) * y, axis=1), block) for x, y in zip(a, d, strict=True)]
    )
    spread = float(np.sqrt(np.sum(sums**2) * len(sums) / max(len(sums) - 1, 1))) / energy
    t = (share - 0.5) / max(spread, 1e-300)
    degrees = max(len(sums) - 1, 1)
    fall = 2.0 * energy * (share - 0.5)
    p_fall, p_differ = float(special.stdtr(degrees, -t)), float(2 * special.stdtr(degrees, -abs(t)))
    return PairedDifference(fall, share, t, p_fall, p_differ, energy)


def _block_sums(values: Array, block: int) -> Array:
    edges = np.arange(0, max(len(values) - block // 2, 1), block)
    return np.add.reduceat(values, edges)


def round_level(level: float, round_number: int) -> float:
    """Significance level of round r (from 1): level * 6 / (pi r)^2, all rounds sum to ``level``."""
    return level * 6.0 / (np.pi * round_number) ** 2
