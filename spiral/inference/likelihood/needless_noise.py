"""Noise terms that are no longer worth their penalty go: whole kinds, single terms, white forces.

The penalty is Schwarz's, as where they came (``noise_selection``).
"""

from __future__ import annotations

import numpy as np

from spiral.engine.likelihood.noise import EXTRA, NoiseModel, size_limits
from spiral.engine.likelihood.predict import (
    FilterInputs,
    log_likelihood,
    predict_cases,
    total_log_likelihood,
)
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    continue_fit,
    is_acting,
    schwarz_penalty,
)
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.types.noise import COLOURED, CORRELATED


def noise_penalty(noise: NoiseModel, before: NoiseModel, prepared: FilterInputs) -> float:
    """Penalty of the sizes and times that a noise model has more than the one before."""
    return schwarz_penalty(len(noise.names) - len(before.names), prepared)


def drop_needless_forces(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with forces reduced to their lower limits, where they are not worth their penalty.

    Of a machine that nothing disturbs half the records would have some by chance, and standard
    errors that are too large with it.
    """
    noise, task = fit.estimate.noise, fit.estimate.prepared[0][0]
    least = {
        t.size: size_limits(task, t.size)[0]
        for t in noise.terms
        if t.kind == "force" and is_acting(task, noise, t)
    }
    if not fit.estimate.finite or not least:
        return fit
    enough = fit.log_likelihood - schwarz_penalty(len(least), fit.estimate.prepared)
    trial = continue_fit(assembly, fit, noise.with_values(least), rough=True, least=enough)
    return trial if trial.log_likelihood > enough else fit


def drop_needless_noise(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit without the terms beyond white noise that are no longer worth their penalty."""
    noise = fit.estimate.noise
    if not fit.estimate.finite:
        return fit
    for kind in (*COLOURED, *CORRELATED, "drift"):
        if not noise.has_kind(kind):
            continue
        progress("trying a simpler noise model")
        less = noise.replace_with_white(kind)
        worth = noise_penalty(noise, less, fit.estimate.prepared)
        enough = fit.log_likelihood - worth - float(np.log(DECISIVE_ODDS))
        trial = continue_fit(assembly, fit, less, rough=True, least=enough)
        if trial.log_likelihood > enough:
            fit, noise = trial, less
    return drop_idle_terms(assembly, fit)


def drop_idle_terms(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit without single terms beyond white noise that do less than their penalty.

    A kind comes for all sensors or forces at once, and for most of them it may do next to nothing.
    Here nothing else is refitted to make up for a term, so that it takes one pass to tell. They go
    one by one, the least first, while together they are not worth what they cost.
    """
    at = fit.estimate
    terms = [t for t in at.noise.terms if t.kind in EXTRA]
    if not at.finite or len(terms) < 2:
        return fit
    trials = [at.noise.select_terms(x for x in at.noise.terms if x is not t) for t in terms]
    heights = [log_likelihood(p) for p in predict_cases([(at.prepared, n) for n in trials])]
    kept = at.noise
    for place in np.argsort(heights)[::-1]:
        less = kept.select_terms(t for t in kept.terms if t is not terms[place])
        height = heights[place] if kept is at.noise else total_log_likelihood(at.prepared, less)
        if not height > at.log_likelihood - noise_penalty(at.noise, less, at.prepared):
            break
        kept = less
    return fit if kept is at.noise else continue_fit(assembly, fit, kept, rough=True)
