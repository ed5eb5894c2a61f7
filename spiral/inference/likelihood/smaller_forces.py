"""Replaces a large random force by a smaller correlated one on one state, or by a smooth one.

A white force on a state that no sensor sees reaches the readings through the machine, and is
coloured there. A force with a correlation time on a state that is measured looks the same: misses
are white with either. The first may have to be as large as the machine's own forces where the
second is small; so where a fit ends with a force that is no explanation, the second is tried.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.noise import SMOOTHEST, NoiseModel, NoiseTerm
from spiral.engine.likelihood.predict import FilterInputs
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import (
    LITTLE,
    LikelihoodFit,
    continue_fit,
    innovation_whiteness,
    largest_force,
)
from spiral.inference.likelihood.noise_selection import (
    force_places,
    tune_next_order,
    tune_noise,
    worth_beside,
)
from spiral.inference.likelihood.noise_terms import initial_gust_sizes
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.types.noise import CORRELATED

_FITTED = 2  # models of the noise that are fitted together with the parameters


def replace_large_forces(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit | None:
    """The fit with one correlated force in place of those above ``settings.random_limit``.

    Of the groups of states, and of single states, the likeliest. It is taken where it is below that
    limit, leaves misses that are white, or no less so than before, and the odds against it are less
    than 100 to one once all numbers are paid for; one above the limit where it is smaller than the
    largest before, and likelier by these odds. Nothing where no force is as large, or none is
    taken.
    """
    limit, at = assembly.problem.settings.random_limit, fit.estimate
    if not at.finite or not (before := largest_force(at.noise)) > limit:
        return None
    progress("trying a smaller, correlated random force")
    noises = list(_small_force_models(at.prepared[0][0], at.noise, limit))
    looks = likeliest_noises(at.prepared, noises)
    odds = float(np.log(DECISIVE_ODDS))
    fits = [
        f for f in fit_beside_small_forces(assembly, fit, looks, -odds, before)
        if largest_force(f.estimate.noise) <= limit or worth_beside(f.estimate, at) > odds
    ]  # fmt: skip
    least = min(innovation_whiteness(assembly, fit).p, assembly.problem.settings.whiteness_level)
    white = [f for f in fits if innovation_whiteness(assembly, f).p >= least]
    return max(white, key=lambda f: f.log_likelihood, default=None)


def smooth_large_forces(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit | None:
    """The fit with correlated forces that are smooth (gusts of order 2 to 4); nothing if none is.

    Each order has to be likelier by the odds of any other noise: heat through doors, a load that a
    spring passes on. Beside a force that jumps from sample to sample in its place misses are
    coloured, and effects are found that make up for it. What a model lacks is smooth, too, and such
    a force would explain it, so that it is not tried before effects are. How smooth a small force
    is matters to nothing.
    """
    smooth = None
    while (next_one := _smooth_once(assembly, smooth or fit)) is not None:
        smooth = next_one
    return smooth


def _smooth_once(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit | None:
    """The fit with correlated forces of the next order, if these are large and it is likelier."""
    at = fit.estimate
    if largest_force(at.noise) <= LITTLE:
        return None
    smoother = tune_next_order(at, "gust", 1, SMOOTHEST)
    if smoother is None:
        return None
    least = fit.log_likelihood + float(np.log(DECISIVE_ODDS))
    fit = continue_fit(assembly, fit, smoother.noise, rough=True)
    return fit if fit.log_likelihood > least else None


def likeliest_noises(
    prepared: FilterInputs, noises: Iterable[NoiseModel]
) -> list[MaximumLikelihood]:
    """The ``_FITTED`` likeliest of several noise models, each tuned alone."""
    looks = sorted((tune_noise(prepared, n) for n in noises), key=lambda m: -m.log_likelihood)
    return looks[:_FITTED]


def fit_beside_small_forces(
    assembly: Assembly, fit: LikelihoodFit, looks: Iterable[MaximumLikelihood], least: float,
    limit: float,
) -> list[LikelihoodFit]:  # fmt: skip
    """The fit continued with each of several noise models, where these have small forces.

    No force may end above ``limit``. ``least`` : log-likelihood that a fit has to gain over the one
    given, all numbers paid for.
    """
    at = fit.estimate
    fits = (continue_fit(assembly, fit, k.noise, rough=True) for k in looks if k.finite)
    return [
        f for f in fits
        if worth_beside(f.estimate, at) > least and largest_force(f.estimate.noise) <= limit
    ]  # fmt: skip


def _small_force_models(task: FilterInput, noise: NoiseModel, limit: float) -> Iterator[NoiseModel]:
    """Noise models with one correlated force in place of large white and all correlated ones.

    From a few small sizes, and from that of the largest force in whose place it is.
    """
    kept = noise.select_terms(
        t for t in noise.terms
        if t.kind not in CORRELATED and not (t.kind == "force" and noise.values[t.size] > limit)
    )  # fmt: skip
    for where in force_places(task):
        one = NoiseTerm("gust", where)
        small = list(initial_gust_sizes(task, (one,)))
        for values in (*small, {**small[0], one.size: largest_force(noise)}):
            yield kept.with_terms((one,), values)
