"""Other noise models, tried where no missing effect explains the residual.

Noise may grow with its reading; a random force that is no explanation may be one with a memory,
smaller and on one state alone; it may be smooth, or act around a frequency.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from spiral.inference.evidence.assembly import Assembly, with_records
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.departures import noise_growth_by_channel
from spiral.inference.likelihood.fitting import (
    WARM,
    WORTH,
    LikelihoodFit,
    fit_by_likelihood,
    is_white,
    largest_force,
    schwarz_penalty,
)
from spiral.inference.likelihood.noise_selection import worth_beside
from spiral.inference.likelihood.resonant_forces import add_resonant_force
from spiral.inference.likelihood.seed_fit import best_fit
from spiral.inference.likelihood.smaller_forces import replace_large_forces, smooth_large_forces
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.accepted import WholeRecordFit
from spiral.inference.strategies.likelihood.superfluous import drop_superfluous_effects
from spiral.inference.strategies.likelihood.whole_fit import compare_likelihood_fit, finish_fit


def fit_with_noise_growth(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> tuple[Assembly, LikelihoodFit] | None:
    """The study and its fit with noise that grows with its reading; nothing if not likelier.

    What a model lacks makes misses grow with the motion too, but leaves them coloured: they must be
    white with such noise, and no random force be wanted that is too large to explain anything. It
    must be likelier beside the noise that the fit has, too, before all starts are tried with it.
    """
    growth = noise_growth_by_channel(fit.estimate)
    if not growth or any(r.growth for r in assembly.problem.records):
        return None
    progress("fitting with noise that grows with its reading")
    problem = assembly.problem.with_growth(growth)
    other = with_records(assembly, problem.records, assembly.study.series[0].substeps)
    other = replace(other, problem=problem)
    beside = fit_by_likelihood(other, fit.state, fit.estimate.noise, steps=WARM, rough=True)
    if not beside.log_likelihood > fit.log_likelihood + WORTH:
        return None
    begun = replace(fit.state, noise=None, starts=None, spreads=None)
    grown = finish_fit(other, best_fit(other, begun, progress), progress)
    better = grown.log_likelihood > fit.log_likelihood + WORTH
    calm = largest_force(grown.estimate.noise) <= problem.settings.random_limit
    return (other, grown) if better and calm and is_white(other, grown) else None


def refit_with_noise_growth(
    assembly: Assembly, state: FitState, base: LikelihoodFit, progress: Progress
) -> RefittedModel | None:
    """The model as it is with noise that grows with its reading, fitted to all samples.

    ``base`` is its fit to a part of them; nothing where such noise is not likelier.
    """
    if not noise_growth_by_channel(base.estimate):
        return None
    likelier = fit_with_noise_growth(
        assembly, fit_by_likelihood(assembly, state, rough=True), progress
    )
    if likelier is None:
        return None
    return _compare_without_needless(*likelier, progress)


def refit_with_smaller_forces(
    assembly: Assembly, state: FitState, progress: Progress
) -> RefittedModel | None:
    """The model as it is, beside forces with a memory where those it has are too large to explain.

    Nothing where they are not, or where the record does not have it so.
    """
    fit = _fit_with_smaller_forces(
        assembly, state, lambda: fit_by_likelihood(assembly, state, rough=True), progress
    )
    return None if fit is None else _compare_without_needless(assembly, fit, progress)


def refit_in_place_of(
    passed: WholeRecordFit, assembly: Assembly, state: FitState, progress: Progress
) -> RefittedModel | None:
    """The model beside other forces, where these do what an effect that ``passed`` does.

    Beside an effect that leaves a random force too large to explain anything, that force may be
    what is wrong. Nothing where the model with the effect is likelier by the odds of any other
    choice: it is right in any case. ``assembly``, ``state`` : the model without it.
    """
    with_it = passed.fit.estimate
    if largest_force(with_it.noise) <= assembly.problem.settings.random_limit:
        return None
    now = functools.cache(lambda: fit_by_likelihood(assembly, state, rough=True))
    fit = _fit_with_smaller_forces(assembly, state, now, progress)
    fit = fit or smooth_large_forces(assembly, now())
    if fit is None:
        return None
    fewer = len(with_it.keys) - len(fit.estimate.keys)
    gain = worth_beside(with_it, fit.estimate) - schwarz_penalty(max(fewer, 0), with_it.prepared)
    if gain > np.log(DECISIVE_ODDS):
        return None
    return _compare_without_needless(assembly, fit, progress)


def _fit_with_smaller_forces(
    assembly: Assembly, state: FitState, now: Callable[[], LikelihoodFit], progress: Progress
) -> LikelihoodFit | None:
    """The fit beside smaller forces than the state's, if any is too large to explain anything.

    ``now`` : the state's own fit, made where it is needed.
    """
    limit = assembly.problem.settings.random_limit
    if state.noise is None or not (before := largest_force(state.noise)) > limit:
        return None
    fit = replace_large_forces(assembly, now(), progress)
    if fit is None:
        return None
    fit = finish_fit(assembly, fit, progress)
    return fit if largest_force(fit.estimate.noise) < before else None


def refit_with_smooth_force(
    assembly: Assembly, state: FitState, progress: Progress
) -> RefittedModel | None:
    """The model as it is, with large forces that are smooth; nothing where misses are white."""
    fit = fit_by_likelihood(assembly, state, rough=True)
    if is_white(assembly, fit):
        return None
    progress("trying a random force that is smooth")
    smooth = smooth_large_forces(assembly, fit)
    if smooth is None:
        return None
    return _compare_without_needless(assembly, finish_fit(assembly, smooth, progress), progress)


def refit_with_resonant_force(
    assembly: Assembly, state: FitState, progress: Progress
) -> RefittedModel | None:
    """The model as it is, beside a random force around a frequency; nothing if not likelier."""
    fit = fit_by_likelihood(assembly, state, rough=True)
    fit = add_resonant_force(assembly, fit, progress)
    if fit is None:
        return None
    return _compare_without_needless(assembly, finish_fit(assembly, fit, progress), progress)


def _compare_without_needless(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> RefittedModel:
    """A fit beside other noise, compared, without effects that this noise makes needless.

    An offset may have been there for what is noise that grows with its reading.
    """
    fit, gone = drop_superfluous_effects(assembly, fit)
    return compare_likelihood_fit(assembly, fit, progress, gone)
