"""Standard errors of a regression whose residual is coloured: Newey-West, and a block bootstrap.

V = (X'X)^-1 M (X'X)^-1 with M from the scores u_t = sum_c x_tc e_tc, summed over the equations of
one instant.
"""

from __future__ import annotations

import numpy as np

from spiral.engine.gate import Trial
from spiral.engine.leastsquares import Fit
from spiral.types.record import Array


def automatic_lags(trial: Trial) -> int:
    """Correlation time of the training residual in samples, at least 4 (N/100)^(2/9)."""
    from spiral.engine.score import correlation_samples

    left = trial.residual[trial.train]
    usual = int(np.ceil(4 * (len(left) / 100) ** (2 / 9)))
    return int(np.clip(correlation_samples((left,)), usual, max(len(left) // 20, usual)))


def sample_scores(trial: Trial, kept: tuple[int, ...], fit: Fit) -> Array:
    """u_t = sum_c x_tc e_tc in coordinates where X'X is the identity; (training samples, k)."""
    x, y = trial.rows(kept, trial.train)
    q = x @ fit.inverse
    e = y - x @ fit.b
    return (q * e[:, None]).reshape(-1, trial.target.shape[1], q.shape[1]).sum(axis=1)


def hac_errors(trial: Trial, kept: tuple[int, ...], fit: Fit, lags: int) -> Array:
    """Newey-West standard errors of the joint fit; infinite for dropped columns."""
    from statsmodels.stats.sandwich_covariance import S_hac_simple

    meat = S_hac_simple(sample_scores(trial, kept, fit), nlags=lags)
    return _sandwich_errors(fit, meat * fit.rows / fit.dof)


def bootstrap_errors(
    trial: Trial, kept: tuple[int, ...], fit: Fit, block: int, draws: int
) -> Array:
    """Standard errors from resampled blocks of scores; infinite for dropped columns."""
    u = sample_scores(trial, kept, fit)
    count = max(len(u) // block, 2)
    sums = np.stack([part.sum(axis=0) for part in np.array_split(u, count)])
    rng = np.random.default_rng(trial.seed)
    drawn = sums[rng.integers(count, size=(draws, count))].sum(axis=1)
    return _sandwich_errors(fit, np.atleast_2d(np.cov(drawn.T)))


def _sandwich_errors(fit: Fit, meat: Array) -> Array:
    covariance = fit.inverse @ meat @ fit.inverse.T
    return np.where(fit.kept, np.sqrt(np.maximum(np.diag(covariance), 0.0)), np.inf)
