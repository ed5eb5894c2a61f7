"""Kinds of random forces and sensor noise (``spiral.engine.likelihood.noise``)."""

from __future__ import annotations

from typing import Literal

import numpy as np

Array = np.ndarray

Kind = Literal["white", "coloured", "band", "vibration", "drift", "force", "gust"]

COLOURED: tuple[Kind, ...] = ("coloured", "band", "vibration")
"""Kinds of stationary sensor noise that are not white."""


def estimate_noise(values: Array) -> float:
    """Noise from high-order differences: sigma^2 = mean (d^k y)^2 / C(2k, k), smallest over k.

    A k-th difference removes a polynomial of degree k - 1 and leaves white noise with the variance
    C(2k, k) sigma^2. Orders 2 to 12 are tried; a smooth signal only ever adds.
    """
    from scipy.special import comb

    best = np.inf
    difference = np.diff(np.asarray(values, dtype=float))
    for order in range(2, 13):
        difference = np.diff(difference)
        best = min(best, float(np.mean(difference**2) / comb(2 * order, order)))
    return float(np.sqrt(best))
