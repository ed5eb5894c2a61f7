"""Three tests that a candidate must pass before it is admitted to the model.

1. *Confirmed.* It must predict the blocks that did not select it (``judging``).
2. *Fitted.* The model takes its likeliest values and noise; effects made superfluous go.
3. *Of use.* No error on unseen data may grow, at any horizon, and one must fall by a size that
   counts.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from spiral.engine.likelihood.fit import add_standard_errors
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import FilterInputs, Masks
from spiral.inference.evidence.assembly import Assembly, build_variants
from spiral.inference.evidence.enlarge import study_with, transfer_fit_state
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import Parts, Ranking, active_labels
from spiral.inference.likelihood.alias_groups import (
    indistinguishable_rivals,
    simplest_rival,
    twin_rivals,
)
from spiral.inference.likelihood.candidates import Race, Rival, start_race
from spiral.inference.likelihood.comparison import compare_by_likelihood
from spiral.inference.likelihood.excerpts import search_on_excerpt, whole_state, whole_study
from spiral.inference.likelihood.fitting import (
    WORTH,
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
from spiral.inference.likelihood.judging import JudgingFits, fit_on_judging_blocks, judge_winner
from spiral.inference.likelihood.needless_noise import drop_needless_forces, drop_needless_noise
from spiral.inference.likelihood.noise_selection import (
    reselect_noise_model,
    select_noise_model,
    select_sensor_drift,
)
from spiral.inference.likelihood.scores import rank_variants
from spiral.inference.likelihood.seed_fit import (
    best_fit,
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
from spiral.inference.likelihood.tolerances import Tolerances
from spiral.inference.nearness import is_free_run_carried_away, unexplained_error_growth
from spiral.inference.problem import Progress, Settings
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.accepted import (
    NOTHING_TRIED,
    AcceptedCandidate,
    Objection,
    RaceOutcome,
    WholeRecordFit,
)
from spiral.inference.strategies.likelihood.benefit import Refusal, refuse_unhelpful
from spiral.inference.strategies.likelihood.meaning import STILL_STATE, refuse_senseless
from spiral.inference.strategies.likelihood.superfluous import (
    admitted_variants,
    drop_superfluous_effects,
    likelihood_ratio_t,
    replace_by_interpolation,
)
from spiral.inference.strategies.likelihood.twins import untold_twin
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.inference.verdict import LIKELIHOOD_RATIO_T
from spiral.types.effect import Effect, is_other_value
from spiral.types.label import owner_of, without_variant
from spiral.types.run import Comparison

_LAST = 1e-6  # whiteness from which a model may be the last


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


def offer_effects(assembly: Assembly, effects: tuple[Effect, ...]) -> Assembly:
    """The study with these effects offered in place of its candidates."""
    asked = replace(assembly.problem, candidates=effects)
    return replace(assembly, offered=tuple(build_variants(asked, (), assembly.expected)[0]))


def race_offered(
    assembly: Assembly, base: LikelihoodFit, select: Masks, progress: Progress, most: int,
    parts: Parts | None = None,
) -> tuple[Race, Ranking] | None:  # fmt: skip
    """The race of the offered candidates with the best scores, and all scores.

    Nothing where they cannot be scored; ``parts`` as in ``rank_groups``.
    """
    present = active_labels(assembly, base.state)
    new = [v for v in assembly.offered if v.original.label not in present]
    ranked = rank_variants(assembly, base, base.estimate.noise, select, lambda _: new, parts)
    if ranked is None:
        return None
    return start_race(assembly, base, list(ranked.ranked), select, progress, most), ranked


def first_to_pass(
    options: LikelihoodOptions, assembly: Assembly, base: LikelihoodFit, race: Race, judge: Masks,
    level: float, objection: Objection, progress: Progress, least: float = 0.0,
    before: RaceOutcome = NOTHING_TRIED, confirmed: bool = True,
) -> RaceOutcome:  # fmt: skip
    """The first winner worth more than ``least`` that the judging blocks confirm, unopposed.

    ``confirmed`` : whether these blocks are asked, where the objection alone is not enough.
    ``before`` : another race of the same candidates; what was rejected there at the same maximum is
        not asked again, and is told as well.
    """
    rejected = dict(before.rejected)
    worths: dict[str, float] = {}
    likely: AcceptedCandidate | None = None
    refused, instead = list(before.refused), before.instead
    ours = functools.cache(lambda: fit_on_judging_blocks(base, assembly, judge))
    unasked = _unasked(_meaningful(race, rejected), before, rejected, worths)
    for rival, rivals in itertools.islice(unasked, options.judged):
        reason = _unlikely_reason(rival, race.tolerances, least)
        if confirmed:
            reason = reason or _unconfirmed_reason(base, ours, rival, judge, level)
        if reason:
            rejected[rival.label] = reason
            continue
        if twin := untold_twin(base, rival, race.masks):
            rejected[rival.label] = f"in place of {twin} it explains as much: one of the two acts"
            continue
        chosen, near = simplest_rival(rival, indistinguishable_rivals(rivals, options.odds), rivals)
        if _within_tolerances(chosen, race.tolerances):
            chosen, near = rival, tuple(x for x in near if x != rival.label)
        aliases = tuple(dict.fromkeys((*near, *twin_rivals(chosen, rivals))))
        progress(f"most likely values with {chosen.label}")
        passed, refusal = _fit_and_ask(chosen, aliases, objection, progress)
        if refusal is None:
            return RaceOutcome(passed, rejected, likely, worths, tuple(refused), instead)
        if instead is None and chosen.label in passed.whole.refitted.retired:
            instead = passed.whole.refitted
        rejected[chosen.label], worths[chosen.label] = refusal.reason, chosen.worth
        refused.append(chosen.label)
        likely = likely or (passed if refusal.alone else None)
    return RaceOutcome(None, rejected, likely, worths, tuple(refused), instead)


def _unasked(
    winners: Iterator[tuple[Rival, list[Rival]]], before: RaceOutcome, rejected: dict[str, str],
    worths: dict[str, float],
) -> Iterator[tuple[Rival, list[Rival]]]:  # fmt: skip
    """Winners without those that came to a maximum that was rejected, in ``before`` or since.

    Their reasons go to ``rejected``, what each is worth to ``worths``.
    """
    for rival, rivals in winners:
        label, worth = rival.label, worths.get(rival.label, -np.inf)
        worths[label] = max(rival.worth, worth)
        if reason := before.reason_for(rival):
            rejected[label] = reason
        elif rival.worth > worth + WORTH:
            yield rival, rivals


def _fit_and_ask(
    chosen: Rival, aliases: tuple[str, ...], objection: Objection, progress: Progress,
    early: bool = True,
) -> tuple[AcceptedCandidate, Refusal | None]:  # fmt: skip
    """A candidate fitted to all samples, and why it is refused, if it is.

    ``early`` : its noise model is not looked for where it is refused without.
    """
    whole = fit_with_rival(chosen, progress, objection if early else None)
    passed = AcceptedCandidate(chosen, aliases, whole)
    refusal = refuse_senseless(whole, chosen) or objection(whole)
    if refusal is None or not refusal.alone:
        return passed, refusal
    freely = _with_free_run_values(passed, progress)
    if freely is None or objection(freely.whole) is not None:
        return passed, refusal
    if whole.complete:
        return freely, None
    return _fit_and_ask(chosen, aliases, objection, progress, early=False)


def _meaningful(race: Race, rejected: dict[str, str]) -> Iterator[tuple[Rival, list[Rival]]]:
    """Winners of a race with the rivals behind them, without those whose own states stand still.

    These are ``rejected``: a lag of years adds a constant, which another effect may be.
    """
    for rival, rivals in race.winners():
        if rival.stands_still:
            rejected[rival.label] = STILL_STATE
        else:
            yield rival, [one for one in rivals if not one.stands_still]


def _with_free_run_values(
    passed: AcceptedCandidate, progress: Progress
) -> AcceptedCandidate | None:
    """The same candidate with values that minimise the error of free runs, or nothing.

    Only beside a random force above ``settings.random_limit``: then one-step predictions are
    corrected for what is missing, and unseen data decide which values are better.
    """
    whole = passed.whole
    if largest_force(whole.fit.estimate.noise) <= whole.assembly.problem.settings.random_limit:
        return None
    gone = whole.refitted.retired
    freely = compare_whole_record_fit(whole.assembly, whole.fit, gone, progress, halves_agree=False)
    return replace(passed, whole=freely)


def _drop_unused_variants(own: Assembly, state: FitState) -> tuple[Assembly, FitState]:
    """The study compiled with the effects of a fit state alone, and the state in its order."""
    if all(v.label in state.labels for v in own.variants):
        return own, state
    final = study_with(own, state.labels)
    return final, transfer_fit_state(state, own, final)


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
    fit = select_noise_model(assembly, fit, progress)
    fit = restart_from_given_values(assembly, fit, progress)
    if anew and is_noise_settled(assembly, fit):  # else it is selected anew from sensor noise alone
        fit = reselect_noise_model(assembly, fit, progress)
    else:
        fit = restart_from_sensor_noise(assembly, fit, progress)
    return restart_vanished_noise(assembly, fit)


def _unlikely_reason(rival: Rival, known: Tolerances, least: float) -> str:
    """Why a candidate is not likely enough on the blocks that select; empty where it is."""
    if not rival.worth > 0:
        return "refitted, its gain in likelihood does not pay for its additional parameters"
    if not rival.worth > least:
        return "refitted, it is not likelier than what it would replace"
    return _within_tolerances(rival, known)


def _unconfirmed_reason(
    base: LikelihoodFit, ours: Callable[[], JudgingFits], rival: Rival, judge: Masks, level: float
) -> str:
    """Why a candidate is not confirmed on the judging blocks; empty where it is."""
    judgement = judge_winner(base, ours(), rival, judge)
    if not judgement.passes(level):
        return (
            f"not confirmed on the blocks that did not select (p = {judgement.p_value:.2g}, "
            f"log-likelihood {judgement.predicted:+.3g} as it was fitted)"
        )
    return ""


def _within_tolerances(rival: Rival, known: Tolerances) -> str:
    """Why a candidate is no more than known values that are a little off; empty where it is more.

    Also where it is such a value itself: it is told with what it is.
    """
    itself = is_other_value(rival.ranked.variant.original)
    return "" if itself else known.refuses(rival.worth)


def benefit_objection(
    options: LikelihoodOptions, before: Comparison, settings: Settings
) -> Objection:
    """An objection to candidates that do not improve predictions of unseen data."""
    return lambda whole: refuse_unhelpful(options, before, whole.refitted.comparison, settings)


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
    fit = fit_by_likelihood(own, state, rough=True)
    if not fit.estimate.finite:  # sizes of its noise may mean something else: on the same scales
        fit = fit_by_likelihood(own, state, rough=True, like=like)
    fit = refit_initial_states(own, refit_on_wanted_steps(own, fit))
    fit, state = _release_told_values(own, fit, state)
    if not is_start_settled(own, fit):  # it may have stayed with the noise of the model as it was
        fit = max(fit, best_fit(own, state, progress), key=lambda f: f.log_likelihood)
    fit = _fit_shapes(own, drop_needless_noise(own, fit, progress), label)
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


def fit_with_rival(
    rival: Rival, progress: Progress, objection: Objection | None = None
) -> WholeRecordFit:
    """The model with a candidate that was raced, fitted to all samples; as ``fit_with_effect``."""
    own, state, like = _study_of_rival(rival)
    return fit_with_effect(own, state, rival.ranked.variant.label, progress, like, objection)


def _study_of_rival(rival: Rival) -> tuple[Assembly, FitState, FilterInputs | None]:
    """The study of the whole records with what a rival has, its state there, and its scales."""
    own, state = _drop_unused_variants(rival.assembly, rival.fit.state)
    if own.excerpt is None:
        return own, state, rival.fit.estimate.prepared
    return whole_study(own), whole_state(own, state), None


def fit_beside_noise(rival: Rival, noise: NoiseModel, progress: Progress) -> WholeRecordFit:
    """The model with a candidate, fitted to all samples beside noise whose terms are known."""
    own, state, _ = _study_of_rival(rival)
    fit = fit_by_likelihood(own, state, noise, rough=True)
    fit = _fit_shapes(own, fit, rival.ranked.variant.label)
    return compare_whole_record_fit(own, continue_fit(own, fit), (), progress)


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


def compare_whole_record_fit(
    own: Assembly, fit: LikelihoodFit, gone: tuple[str, ...], progress: Progress,
    halves_agree: bool = True,
) -> WholeRecordFit:  # fmt: skip
    """A fit to all samples and its comparison, in a study compiled with its own effects alone."""
    refitted = compare_likelihood_fit(own, fit, progress, gone, halves_agree)
    _, fit_state = _drop_unused_variants(own, refitted.fit_state)
    return WholeRecordFit(own, fit, replace(refitted, fit_state=fit_state))
