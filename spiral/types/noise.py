"""Kinds of random forces and sensor noise (``spiral.engine.likelihood.noise``)."""

from __future__ import annotations

from typing import Literal

import numpy as np

Array = np.ndarray

NOISE_LAGS = 13
"""Autocovariances that bear on ``estimate_noise``: up to its highest order, 12."""
_MEDIAN = 0.45494  # of the square of a normal variable

Kind = Literal["white", "coloured", "band", "vibration", "drift", "force", "gust", "swell"]

COLOURED: tuple[Kind, ...] = ("coloured", "band", "vibration")
"""Kinds of stationary sensor noise that are not white."""

STATIONARY: tuple[Kind, ...] = ("white", *COLOURED)
"""Noise that a sensor has all the time."""

FORCES: tuple[Kind, ...] = ("force", "gust", "swell")
"""Kinds of random forces: white, correlated over a time, around a frequency."""

FILTERED: tuple[Kind, ...] = ("band", "swell")
"""Kinds behind a filter whose order is told by the likelihood, too."""

CORRELATED: tuple[Kind, ...] = ("gust", "swell")
"""Random forces that are not white."""


def estimate_noise(values: Array, robust: bool = False) -> float:
    """Noise from high-order differences: sigma^2 = mean (d^k y)^2 / C(2k, k), smallest over k.

    A k-th difference removes a polynomial of degree k - 1 and leaves white noise with the variance
    C(2k, k) sigma^2. Orders 2 to 12 are tried; a smooth signal only ever adds. Where it has kinks,
    as under an input that jumps, the median of the squares in place of their mean is ``robust``.
    """
    from scipy.special import comb

    best = np.inf
    difference = np.diff(np.asarray(values, dtype=float))
    for order in range(2, 13):
        difference = np.diff(difference)
        square = np.median(difference**2) / _MEDIAN if robust else np.mean(difference**2)
        best = min(best, float(square / comb(2 * order, order)))
    return float(np.sqrt(best))


def expected_noise_estimate(autocovariance: Array) -> float:
    """What ``estimate_noise`` tells of stationary noise beside a smooth signal.

    Of noise r_m = cov(e_t, e_t+m) (``NOISE_LAGS`` of them) the k-th difference has the variance
    C(2k, k) r_0 + 2 sum_m (-1)^m C(2k, k + m) r_m; of coloured noise little is left.
    """
    from scipy.special import comb

    orders, lags = range(2, NOISE_LAGS), np.arange(1, NOISE_LAGS)
    signs = 2.0 * (-1.0) ** lags * autocovariance[lags]
    told = (
        autocovariance[0] + np.sum(signs * comb(2 * k, k + lags)) / comb(2 * k, k) for k in orders
    )
    return float(np.sqrt(max(min(told), 0.0)))
