"""The model with a candidate, fitted to all samples, beside the noise that these prefer.

Of long records the values are looked for on an excerpt, from which all samples go on.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np

from spiral.engine.likelihood.fit import add_standard_errors
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import FilterInputs
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.enlarge import study_with, transfer_fit_state
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.likelihood.comparison import compare_by_likelihood
from spiral.inference.likelihood.excerpts import search_on_excerpt, whole_state, whole_study
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    continue_fit,
    fit_by_likelihood,
    innovation_whiteness,
    is_start_settled,
    largest_force,
    restart_vanished_noise,
)
from spiral.inference.likelihood.initial_states import refit_initial_states
from spiral.inference.likelihood.interpolation import restore_declared_interpolation
from spiral.inference.likelihood.needless_noise import drop_needless_forces, drop_needless_noise
from spiral.inference.likelihood.noise_selection import (
    reselect_noise_model,
    select_noise_model,
    select_sensor_drift,
)
from spiral.inference.likelihood.seed_fit import (
    best_fit,
    fit_whole_from_excerpt,
    is_noise_settled,
    refine_integration_steps,
    refit_on_wanted_steps,
    restart_from_given_values,
    restart_from_sensor_noise,
    restart_without_forces,
    without_noise_of_steps,
)
from spiral.inference.likelihood.shapes import held_shapes, refit_effect_shapes
from spiral.inference.likelihood.tied_parameters import find_parameter_ties
from spiral.inference.nearness import is_free_run_carried_away, unexplained_error_growth
from spiral.inference.problem import Progress
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.accepted import (
    Objection,
    WholeRecordFit,
)
from spiral.inference.strategies.likelihood.superfluous import (
    admitted_variants,
    drop_superfluous_effects,
    likelihood_ratio_t,
    replace_by_interpolation,
)
from spiral.inference.verdict import LIKELIHOOD_RATIO_T
from spiral.types.label import owner_of, without_variant

_LAST = 1e-6  # whiteness from which a model may be the last


def fit_with_rival(
    rival: Rival, progress: Progress, objection: Objection | None = None
) -> WholeRecordFit:
    """The model with a candidate that was raced, fitted to all samples; as ``fit_with_effect``."""
    own, state = _drop_unused_variants(rival.assembly, rival.fit.state)
    label, like = rival.ranked.variant.label, rival.fit.estimate.prepared
    if own.excerpt is None:
        return fit_with_effect(own, state, label, progress, like, objection)
    fit = _fit_values_on_whole(own, state, label, progress, like)
    return _with_noise_model(whole_study(own), fit, label, progress, objection)


def fit_with_effect(
    own: Assembly, state: FitState, label: str, progress: Progress,
    like: FilterInputs | None = None, objection: Objection | None = None,
) -> WholeRecordFit:  # fmt: skip
    """The model with a candidate, fitted to all samples; superfluous noise terms and effects go.

    Parameters
    ----------
    own : the study with the candidate. state : in its terms. label : the candidate's, compiled.
    like : the records with the scales that its noise was fitted on. objection : the fit ends
        before its noise model is looked for where errors on unseen data grow by it.
    """
    fit = _fit_values(own, state, label, progress, like)
    return _with_noise_model(own, fit, label, progress, objection)


def _fit_values(
    own: Assembly, state: FitState, label: str, progress: Progress, like: FilterInputs | None
) -> LikelihoodFit:
    """The most likely values with a candidate, beside the noise of the model as it was.

    Parameters as in ``fit_with_effect``; ``own`` may be an excerpt.
    """
    fit = fit_by_likelihood(own, state, rough=True)
    if not fit.estimate.finite:  # sizes of its noise may mean something else: on the same scales
        fit = fit_by_likelihood(own, state, rough=True, like=like)
    fit = refit_initial_states(own, refit_on_wanted_steps(own, fit))
    fit, state = _release_told_values(own, fit, state)
    if not is_start_settled(own, fit):  # it may have stayed with the noise of the model as it was
        fit = max(fit, best_fit(own, state, progress), key=lambda f: f.log_likelihood)
    return _fit_shapes(own, drop_needless_noise(own, fit, progress), label)


def _fit_values_on_whole(
    part: Assembly, state: FitState, label: str, progress: Progress, like: FilterInputs
) -> LikelihoodFit:
    """The most likely values for the whole records, from those that an excerpt of them prefers.

    Parameters as in ``fit_with_effect``, of the excerpt ``part``.
    """
    whole = whole_study(part)
    first = _fit_values(part, state, label, progress, like)
    if first.estimate.finite:
        fit = fit_whole_from_excerpt(whole, part, first, progress)
        if fit.estimate.finite:
            return _release_told_values(whole, fit, whole_state(part, first.state))[0]
    return _fit_values(whole, whole_state(part, state), label, progress, None)


def _held_of_seed(assembly: Assembly, state: FitState) -> tuple[str, ...]:
    """Parameters of system and seed that a fit holds, since the record did not tell them apart."""
    seed = {"system", *assembly.problem.model.labels}
    return tuple(k for k in state.held if owner_of(k) in seed)


def _release_told_values(
    own: Assembly, fit: LikelihoodFit, state: FitState
) -> tuple[LikelihoodFit, FitState]:
    """The fit without holds that are no longer needed, and the state it began with without them.

    What a model that lacks something does not tell apart (a time constant and a gain, beside a
    force as large as its own) the record may tell once that is there. Held at a value that is off,
    it would be made up for by effects that are not there.
    """
    held = _held_of_seed(own, fit.state) if fit.estimate.finite else ()
    while held:
        free = replace(fit.state, held=tuple(k for k in fit.state.held if k not in held))
        loose = fit_by_likelihood(
            own, free, fit.estimate.noise, rough=True, like=fit.estimate.prepared
        )
        tied = {*find_parameter_ties(loose).parts} if loose.estimate.finite else {*held}
        if not tied & {*held}:
            kept = tuple(k for k in state.held if k not in held)
            return loose, replace(state, held=kept)
        held = tuple(k for k in held if k not in tied)
    return fit, state


def _fit_shapes(own: Assembly, fit: LikelihoodFit, label: str) -> LikelihoodFit:
    """The fit with the latest effect's shapes at their likeliest, and those of others before it.

    A width that was of no use while another friction was missing may be all that is still wrong;
    held, it would be made up for by whatever scales the motion.
    """
    for effect in (
        *(v.effect for v in admitted_variants(own, fit, label)),
        own.variant(label).effect,
    ):
        keys = held_shapes(own, fit, effect)
        fit = refit_effect_shapes(own, fit, effect, keys, chosen=True)
    return fit


def _with_noise_model(
    own: Assembly, fit: LikelihoodFit, label: str, progress: Progress, objection: Objection | None
) -> WholeRecordFit:
    """The model with a candidate and the noise that its records prefer, compared with them.

    Parameters as in ``fit_with_effect``.
    """
    early = None
    if objection is not None and fit.estimate.finite:
        early = compare_whole_record_fit(own, fit, (), progress)
        refusal = objection(early)
        if refusal is not None and refusal.grows:
            return replace(early, complete=False)
    fit = finish_fit(own, restore_declared_interpolation(own, fit, progress), progress, anew=True)
    whole = _without_needless_effects(own, fit, label, progress, early)
    if early is None or not _is_led_astray(early, whole):
        return whole
    progress("going on with the noise model as it was, with which unseen data are predicted")
    return _without_needless_effects(own, early.fit, label, progress, early)


def finish_fit(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress, anew: bool = False
) -> LikelihoodFit:
    """The fit with the noise model that its records prefer; ``anew`` : terms it has may go.

    Where its misses are white it is taken to its very maximum, since the model may be the last, and
    its integration steps are refined, but where a force above ``settings.random_limit`` acts.
    """
    fit = without_noise_of_steps(assembly, fit, progress)
    search = functools.partial(_search_noise, progress, anew)
    fit = search_on_excerpt(assembly, fit, search, select_sensor_drift)
    if not fit.estimate.finite or innovation_whiteness(assembly, fit).p < _LAST:
        return fit
    progress("polishing the fit")
    fit = drop_needless_forces(assembly, fit)
    fit = continue_fit(assembly, restart_without_forces(assembly, fit, progress))
    limit = assembly.problem.settings.random_limit
    lacks = bool(assembly.problem.candidates) and largest_force(fit.estimate.noise) > limit
    return fit if lacks else refine_integration_steps(assembly, fit)  # it is no answer


def _search_noise(
    progress: Progress, anew: bool, assembly: Assembly, fit: LikelihoodFit
) -> LikelihoodFit:
    """The fit with the noise model that its records prefer, restarted where that may lead on."""
    begun = fit
    fit = select_noise_model(assembly, fit, progress)
    fit = restart_from_given_values(assembly, fit, progress)
    if anew and is_noise_settled(assembly, fit):  # else it is selected anew from sensor noise alone
        fit = reselect_noise_model(assembly, fit, progress)
    else:
        fit = restart_from_sensor_noise(assembly, fit, progress, begun)
    return restart_vanished_noise(assembly, fit)


def _without_needless_effects(
    own: Assembly, fit: LikelihoodFit, label: str, progress: Progress, early: WholeRecordFit | None
) -> WholeRecordFit:
    """A fit without effects that its latest makes needless, compared with its records.

    ``early`` : a comparison that holds where nothing has changed since.
    """
    fit, gone = drop_superfluous_effects(own, fit, label)
    fit, needless = replace_by_interpolation(own, fit, progress)
    if early is not None and fit is early.fit:
        return early
    return compare_whole_record_fit(own, fit, (*gone, *needless), progress)


def _is_led_astray(early: WholeRecordFit, whole: WholeRecordFit) -> bool:
    """Whether errors on unseen data grew while the noise model was looked for, more than by chance.

    Beside other noise, values that the record hardly tells may go where a free run leaves all
    bounds.
    """
    before, after = early.refitted.comparison, whole.refitted.comparison
    return unexplained_error_growth(before, after, whole.assembly.problem.settings) is not None


def fit_beside_noise(rival: Rival, noise: NoiseModel, progress: Progress) -> WholeRecordFit:
    """The model with a candidate, fitted to all samples beside noise whose terms are known."""
    own, state = _study_of_rival(rival)
    fit = fit_by_likelihood(own, state, noise, rough=True)
    fit = _fit_shapes(own, fit, rival.ranked.variant.label)
    return compare_whole_record_fit(own, continue_fit(own, fit), (), progress)


def _study_of_rival(rival: Rival) -> tuple[Assembly, FitState]:
    """The study of the whole records with what a rival has, and its state there."""
    own, state = _drop_unused_variants(rival.assembly, rival.fit.state)
    return whole_study(own), whole_state(own, state)


def _drop_unused_variants(own: Assembly, state: FitState) -> tuple[Assembly, FitState]:
    """The study compiled with the effects of a fit state alone, and the state in its order."""
    if all(v.label in state.labels for v in own.variants):
        return own, state
    final = study_with(own, state.labels)
    return final, transfer_fit_state(state, own, final)


def compare_whole_record_fit(
    own: Assembly, fit: LikelihoodFit, gone: tuple[str, ...], progress: Progress,
    halves_agree: bool = True,
) -> WholeRecordFit:  # fmt: skip
    """A fit to all samples and its comparison, in a study compiled with its own effects alone."""
    refitted = compare_likelihood_fit(own, fit, progress, gone, halves_agree)
    _, fit_state = _drop_unused_variants(own, refitted.fit_state)
    return WholeRecordFit(own, fit, replace(refitted, fit_state=fit_state))


def compare_likelihood_fit(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress, retired: tuple[str, ...] = (),
    halves_agree: bool = True,
) -> RefittedModel:  # fmt: skip
    """The model of a fit to all samples, compared with the test records."""
    fit = replace(fit, estimate=add_standard_errors(fit.estimate))
    state, comparison = compare_by_likelihood(assembly, fit, progress, halves_agree)
    details: dict[str, Any] = {"noise": dict(fit.estimate.noise.values)}
    if told := likelihood_ratio_t(assembly, fit, comparison.model):
        details[LIKELIHOOD_RATIO_T] = told
    if is_free_run_carried_away(comparison):
        details["carried_away"] = True
    likelihood = -np.inf
    if fit.estimate.finite:
        details["log_likelihood"] = likelihood = fit.log_likelihood
    if held := _held_of_seed(assembly, fit.state):
        details["held"] = list(held)
    if ties := find_parameter_ties(fit):
        details["untold"] = {
            "groups": [tuple(map(without_variant, group)) for group in ties.groups],
            "parameters": list(map(without_variant, ties.parts)),
        }
    return RefittedModel(state, comparison, retired, details, likelihood)
