"""Process noise by maximum likelihood of the innovations.

    log L = -1/2 sum_k (log det S_k + v_k^T S_k^-1 v_k + channels log 2 pi)

is what the filter returns anyway. Levels of the groups of states (``spiral.engine.filter.noise``)
are found on a logarithmic scale: first one for all on a coarse grid, then each, by Nelder and Mead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from spiral.types.record import Array

LOWEST, HIGHEST = 1e-5, 10.0
_GRID = (1e-4, 1e-2, 1e-1, 1.0)
_EVALUATIONS = 20
_ENOUGH = 0.5  # log-likelihood that is not worth another step
_RUNAWAY = 1e6  # log-likelihood that a sample not reached costs

Likelihood = Callable[[Mapping[str, float]], tuple[float, int]]


def most_likely_levels(
    groups: tuple[str, ...],
    samples: int,
    likelihood: Likelihood,
    near: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """The level of each group with the highest likelihood.

    Parameters
    ----------
    likelihood : levels -> (log-likelihood, samples done before the filter ran away).
    near : levels to start from; left out, the best of a coarse grid with all levels equal.
    """
    from scipy.optimize import minimize

    def cost(logs: Array) -> float:
        clipped = np.clip(logs, np.log10(LOWEST), np.log10(HIGHEST))
        outside = float(np.sum(np.abs(logs - clipped)))
        levels = dict(zip(groups, 10.0**clipped, strict=True))
        result, done = likelihood(levels)
        result = result if np.isfinite(result) else -_RUNAWAY
        return -result + _RUNAWAY * (samples - done) + outside

    if near is None:
        common = [cost(np.full(len(groups), np.log10(level))) for level in _GRID]
        begin = np.full(len(groups), np.log10(_GRID[int(np.argmin(common))]))
    else:
        begin = np.log10([max(near[g], LOWEST) for g in groups])
    simplex = np.vstack([begin, *(begin + 0.4 * row for row in np.eye(len(groups)))])
    result = minimize(
        cost, begin, method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": _EVALUATIONS, "xatol": 0.03,
                 "fatol": _ENOUGH},
    )  # fmt: skip
    best = np.clip(result.x, np.log10(LOWEST), np.log10(HIGHEST))
    return {g: float(v) for g, v in zip(groups, 10.0**best, strict=True)}
