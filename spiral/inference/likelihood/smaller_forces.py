"""Replaces a large white force on hidden states by a smaller correlated one on one state.

A white force on a state that no sensor sees reaches the readings through the machine, and is
coloured there. A force with a correlation time on a state that is measured looks the same: misses
are white with either. The first may have to be as large as the machine's own forces where the
second is small; so where a fit ends with a force that is no explanation, the second is tried.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spiral.engine.filter.noise import noise_groups
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    continue_fit,
    is_white,
    largest_force,
    schwarz_penalty,
)
from spiral.inference.likelihood.noise_selection import (
    initial_gust_sizes,
    shared_groups,
    tune_noise,
)
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.types.noise import CORRELATED

_FITTED = 2  # models of the noise that are fitted together with the parameters


def replace_large_forces(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit | None:
    """The fit with one correlated force in place of those above ``settings.random_limit``.

    Of the groups of states, and of single states, the likeliest. It is taken where it is below that
    limit, leaves white misses, and the odds against it are less than 100 to one once all numbers
    are paid for. Nothing where no force is as large, or none is taken.
    """
    limit, at = assembly.problem.settings.random_limit, fit.estimate
    if not at.finite or not largest_force(at.noise) > limit:
        return None
    progress("trying a smaller, correlated random force")
    noises = list(_small_force_models(at.prepared[0][0], at.noise, limit))
    looks = sorted((tune_noise(at.prepared, n) for n in noises), key=lambda m: -m.log_likelihood)
    best: LikelihoodFit | None = None
    for look in looks[:_FITTED]:
        trial = continue_fit(assembly, fit, look.noise, rough=True) if look.finite else fit
        more = schwarz_penalty(len(trial.estimate.noise.names) - len(at.noise.names), at.prepared)
        likely = trial.log_likelihood - more > fit.log_likelihood - np.log(DECISIVE_ODDS)
        small = largest_force(trial.estimate.noise) <= limit
        if not (likely and small and is_white(assembly, trial)):
            continue
        if best is None or trial.log_likelihood > best.log_likelihood:
            best = trial
    return best


def _small_force_models(task: FilterInput, noise: NoiseModel, limit: float) -> Iterator[NoiseModel]:
    """Noise models with one correlated force in place of large white and all correlated ones."""
    kept = noise.select_terms(
        t for t in noise.terms
        if t.kind not in CORRELATED and not (t.kind == "force" and noise.values[t.size] > limit)
    )  # fmt: skip
    states = (task.states[i] for s in shared_groups(task).values() for i in s)
    for where in (*noise_groups(task), *states):
        one = NoiseTerm("gust", where)
        for values in initial_gust_sizes(task, (one,)):
            yield kept.with_terms((one,), values)
