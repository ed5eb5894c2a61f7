"""How many independent values what a free run misses consists of, and what a gain in them is worth.

What a free run misses lasts: a thousand readings tell as much of it as

    nu = N / (1 + 2 sum_k rho_k^2)

independent ones, rho_k its autocorrelation at lag k up to a quarter of a record (Bartlett 1935:
estimated mean squares vary as those of so many values). A model that errs by E_1 in place of E_0 is
then likelier by nu / 2 log(E_0^2 / E_1^2), whatever made it miss.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from spiral.engine.statistics import autocorrelation
from spiral.types.record import Array

_LONGEST = 4  # records that hold the longest lag


def independent_misses(misses: Sequence[Array]) -> Array:
    """(channels,) nu of what free runs miss of each channel: ``misses`` (samples, channels) each.

    Samples without a reading are zero in all channels that they lack.
    """
    return np.sum([[_independent_values(x) for x in miss.T] for miss in misses], axis=0)


def _independent_values(miss: Array) -> float:
    """nu of one channel of one record."""
    if not miss.any():
        return 0.0
    rho = autocorrelation(miss, max(len(miss) // _LONGEST, 1))[1:]
    return np.count_nonzero(miss) / (1 + 2 * float(rho @ rho))


def free_run_gain(before: Sequence[Array], after: Sequence[Array], nu: Array) -> float:
    """How much likelier the misses ``after`` are than those ``before``: mean over channels.

    What a machine lacks shows in all its channels, which are no witnesses of one another. ``nu`` :
    ``independent_misses`` of those before.
    """
    squares = [np.sum([np.sum(m**2, axis=0) for m in misses], axis=0) for misses in (before, after)]
    with np.errstate(divide="ignore", invalid="ignore"):
        gains = np.where(nu > 0, 0.5 * nu * np.log(squares[0] / squares[1]), 0.0)
    return float(np.mean(gains))


def free_run_level(gain: float, nu: float, known: int, added: int) -> float:
    """The probability of a gain as large as this by chance alone (Fisher's F).

    nu : independent values, mean over channels. known : numbers fitted before, added : since.
    """
    left = nu - known - added
    if not left > 0:
        return 1.0
    ratio = np.expm1(2 * max(gain, 0.0) / nu)  # (E_0^2 - E_1^2) / E_1^2
    return float(special.fdtrc(added, left, ratio * left / added))
