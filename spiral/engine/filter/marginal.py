"""Bands with the parameters' uncertainty: variance = mean of variances + variance of means.

Of a Gaussian posterior it is P + S C S^T, with S the slope of the states by the parameters, from
differences of two runs along each axis of C. Of a bent one it is that of runs at its draws, weighed
by p(run) / p(drawn from), no weight over sqrt(draws) times that of the most probable values
(truncated importance sampling, Ionides 2008).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.extended import FilterPass
from spiral.engine.filter.posterior import Posterior
from spiral.types.record import Array

_SHARES = (1.0, 0.1, 0.01)

Runs = Callable[[Array], FilterPass]
"""The observer's run at values (q,) of the uncertain parameters."""


@dataclass(frozen=True)
class MarginalPass:
    """A run whose bands hold the parameters' doubt; their ``mean`` (q,) and ``covariance`` (q, q).

    ``effective`` is the number of draws that the weights amount to; none for a Gaussian.
    """

    filter_pass: FilterPass
    mean: Array
    covariance: Array
    effective: float | None = None

    def values(self, keys: tuple[str, ...]) -> dict[str, tuple[float, float]]:
        """Mean and standard deviation of every parameter."""
        spread = np.sqrt(np.diag(self.covariance))
        rows = zip(self.mean, spread, strict=True)
        return {k: (float(m), float(s)) for k, (m, s) in zip(keys, rows, strict=True)}


def add_parameter_doubt(runs: Runs, known: Posterior, at_top: FilterPass) -> MarginalPass:
    """The run at the most probable values, its variances widened by the parameters' covariance.

    Parameters
    ----------
    at_top : that run.
    """
    prior = known.task.prior
    assert prior is not None
    here = known.task.parameter_values(prior.keys)
    if not len(known.draws):
        spread = _linear_spread(runs, here, known.root, at_top)
        return MarginalPass(_add_spread(at_top, at_top.means, spread), here, known.covariance)
    top = at_top.log_likelihood + prior.log_density(here)
    sums = _Sums(at_top)
    kept, weights = [], []
    for values, height in zip(known.draws, known.heights, strict=True):
        run = runs(values)
        if run.done < at_top.done or not np.isfinite(run.log_likelihood):
            continue
        over = run.log_likelihood + prior.log_density(values) - top - height
        weight = float(np.exp(min(over, 0.5 * np.log(len(known.draws)))))
        sums.add(run, weight)
        kept.append(values)
        weights.append(weight)
    if sum(w > 0 for w in weights) < 2:
        spread = _linear_spread(runs, here, known.root, at_top)
        return MarginalPass(_add_spread(at_top, at_top.means, spread), here, known.covariance)
    mean, covariance, effective = _weighted_moments(np.array(kept), np.array(weights))
    return MarginalPass(sums.pooled_run(effective), mean, covariance, effective)


def _linear_spread(runs: Runs, here: Array, root: Array, top: FilterPass) -> Array:
    """S C S^T: (samples, N, N), or its diagonal (samples, N) where no covariances were kept."""
    total = np.zeros_like(top.covariances if len(top.covariances) else top.variances)
    for step in root.T:
        for share in _SHARES:  # of a deviation with which the filter stays with the record
            ahead, behind = runs(here + share * step), runs(here - share * step)
            if min(ahead.done, behind.done) == top.done:
                total += _square_rows(0.5 / share * (ahead.means - behind.means), total.ndim)
                break
    return total


def _square_rows(rows: Array, dimensions: int) -> Array:
    return rows[:, :, None] * rows[:, None, :] if dimensions == 3 else rows**2


def _add_spread(top: FilterPass, means: Array, spread: Array) -> FilterPass:
    if spread.ndim == 3:
        covariances = top.covariances + spread
        variances = np.diagonal(covariances, axis1=1, axis2=2).copy()
        return replace(top, means=means, covariances=covariances, variances=variances)
    return replace(top, means=means, variances=top.variances + spread)


def _weighted_moments(values: Array, weights: Array) -> tuple[Array, Array, float]:
    """Weighted mean, covariance, and the number of draws that the weights amount to."""
    share = weights / weights.sum()
    effective = float(1.0 / np.sum(share**2))
    mean = share @ values
    left = values - mean
    return mean, _bias_correction(effective) * (left.T * share) @ left, effective


def _bias_correction(effective: float) -> float:
    """(n + 1) / (n - 1): the bias of a variance of n draws, and the error of their mean."""
    return (effective + 1.0) / max(effective - 1.0, 1.0)


class _Sums:
    """Weighted sums over runs, of means as differences from one of them."""

    def __init__(self, top: FilterPass) -> None:
        self.top, self.weight = top, 0.0
        self.full = bool(len(top.covariances))
        own = top.covariances if self.full else top.variances
        self.shift, self.squares, self.own = (
            np.zeros_like(top.means), np.zeros_like(own), np.zeros_like(own),
        )  # fmt: skip

    def add(self, run: FilterPass, weight: float) -> None:
        """One run with its weight."""
        shift = run.means - self.top.means
        self.weight += weight
        self.shift += weight * shift
        self.squares += weight * _square_rows(shift, self.squares.ndim)
        self.own += weight * (run.covariances if self.full else run.variances)

    def pooled_run(self, effective: float) -> FilterPass:
        """The mean of means; the mean of variances and the variance of means."""
        shift, over = self.shift / self.weight, self.squares / self.weight
        spread = _bias_correction(effective) * (over - _square_rows(shift, over.ndim))
        base = replace(self.top, variances=self.own / self.weight)
        if self.full:
            base = replace(self.top, covariances=self.own / self.weight)
        return _add_spread(base, self.top.means + shift, spread)
