"""Posterior of uncertain parameters given a record, with the process noise tuned beside them.

1. the most probable values, log L(innovations) + log p(theta) (``engine.filter.innovation_fit``),
   with the process noise lowered as they are found, to zero where that is as likely;
2. the innovations to second order around them (``spiral.engine.filter.curved_posterior``);
3. steps of one standard deviation along each axis where the posterior is a Gaussian, else draws
   from the second order, weighed with the likelihood of the run itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.curved_posterior import Expansion, build_expansion, draw_samples
from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.innovation_fit import TunedTasks, climb_likelihood
from spiral.engine.filter.prior import Prior, covariance_root
from spiral.engine.filter.setup import choose_levels, with_level, zero_unneeded_levels
from spiral.engine.filter.task import FilterInput
from spiral.engine.filter.tuning import LOWEST
from spiral.engine.filter.whitened import whiten_innovations
from spiral.types.record import Array

_DRAWS = 32
_SEED = 14  # of the draws: the same record gives the same bands
_TOLD = (1e-3, 4e-3)  # shares of the prior deviation below which a direction is determined


@dataclass(frozen=True)
class Posterior:
    """The distribution of uncertain parameters after a record.

    ``task`` has the most probable values, ``levels`` are of the process noise, ``covariance`` is
    (q, q). ``draws`` (count, q) with ``heights`` (count,), the log density that they were drawn
    from over that of the most probable values; both are empty where the posterior is a Gaussian.
    """

    task: FilterInput
    levels: Mapping[str, float]
    covariance: Array
    draws: Array
    heights: Array

    @property
    def root(self) -> Array:
        """(q, r) steps of one standard deviation."""
        return covariance_root(self.covariance)


def posterior(
    task: FilterInput, settings: FilterSettings, given: Mapping[str, float] | float | None
) -> Posterior:
    """The posterior of a task's uncertain parameters; process noise ``given`` or tuned.

    What a fit knows (``Prior.settled``) is the posterior already.
    """
    prior = task.prior
    assert prior is not None
    none = np.zeros((0, len(prior.keys)))
    if prior.settled:
        levels = choose_levels(task, settings, given)
        return Posterior(task, levels, prior.covariance, none, np.zeros(0))
    task = replace(task, moved=prior.keys)
    known = None if given is None else choose_levels(task, settings, given)
    best = _climb_posterior(task, settings, prior, known)
    if not best.finite or max(best.levels.values()) > LOWEST:  # another valley, or model error
        starts = _mirror_starts(best, prior) if len(best.covariance) else []
        others = [_climb_posterior(start, settings, prior, known) for start in starts]
        best = max([best, *others], key=lambda c: c.log_likelihood)
    task, levels = best.prepared[0][0], dict(best.levels)
    covariance = best.covariance
    if not best.finite or not len(covariance):
        return Posterior(task, levels, prior.covariance, none, np.zeros(0))
    bend = _expand_innovations(task, with_level(task, settings, levels), prior, covariance)
    if bend is None or bend.straight:
        return Posterior(task, levels, covariance, none, np.zeros(0))
    w = draw_samples(bend, _DRAWS, np.random.default_rng(_SEED))
    draws = task.parameter_values(prior.keys) + w @ covariance_root(covariance).T
    return Posterior(task, levels, covariance, draws, bend.log_density(w))


def _mirror_starts(estimate: TunedTasks, prior: Prior) -> list[FilterInput]:
    """Other starts: the estimate, mirrored in the directions that the record determines least.

    Where two parameters can share what the record tells in two ways, such as the stiffness of two
    bearings, the ways lie on both sides of what was expected. In z, along axes of its covariance,
    those known better than a share of the prior's deviation stay, all others change their sign.
    """
    task = estimate.prepared[0][0]
    inverse = np.linalg.pinv(prior.root)
    left, axes = np.linalg.eigh(inverse @ estimate.covariance @ inverse.T)
    z = axes.T @ prior.coordinates(task.parameter_values(prior.keys))
    told = [np.sqrt(np.maximum(left, 0.0)) < share for share in _TOLD]
    turned = [prior.mean + prior.root @ axes @ np.where(stay, z, -z) for stay in told]
    return [task.with_parameters(prior.keys, values) for values in turned]


def _climb_posterior(
    task: FilterInput, settings: FilterSettings, prior: Prior, known: Mapping[str, float] | None
) -> TunedTasks:
    """The most probable values, then once more with the process noise that is needed there."""
    bounds = {
        k: (-np.inf if p.lower is None else p.lower, np.inf if p.upper is None else p.upper)
        for k, p in task.model.pairs
        if k in prior.keys
    }
    estimate = climb_likelihood(((task, settings),), prior.keys, known, bounds, prior=prior)
    if known is not None or not estimate.finite:
        return estimate
    levels = zero_unneeded_levels(estimate.prepared[0][0], settings, estimate.levels)
    return climb_likelihood(estimate.prepared, prior.keys, levels, bounds, prior=prior)


def _expand_innovations(
    task: FilterInput, settings: FilterSettings, prior: Prior, covariance: Array
) -> Expansion | None:
    """Innovations and prior to second order in steps of one standard deviation."""
    root, here = covariance_root(covariance), task.parameter_values(prior.keys)

    def whitened_rows(values: Array) -> tuple[Array, Array] | None:
        part = whiten_innovations(task.with_parameters(prior.keys, values), settings, prior.keys)
        if part is None:
            return None
        return part.innovations.reshape(-1), -part.columns.reshape(-1, len(here)) @ root

    base = whitened_rows(here)
    if base is None:
        return None
    second = np.zeros((root.shape[1], root.shape[1], len(base[0])))
    for axis, step in enumerate(root.T):
        ahead, behind = whitened_rows(here + step), whitened_rows(here - step)
        if ahead is None or behind is None:
            return None
        second[axis] = 0.5 * (ahead[1] - behind[1]).T
    second = 0.5 * (second + second.transpose(1, 0, 2))
    slopes = np.linalg.lstsq(prior.root, root, rcond=None)[0]
    return build_expansion(*base, second, prior.coordinates(here), slopes)
