"""A round of ``strategy=likelihood``: candidates scored, raced, refitted and tested.

several starts -> most likely values and noise -> score, race and judge the candidates ->
admission, where no horizon on unseen data grows worse -> refit, noise and effects that are
no longer wanted let go.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from spiral.inference.evidence.admission import is_second_order_remainder, untestable_effect_error
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.enlarge import enlarge
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import RankedCandidate, Ranking
from spiral.inference.likelihood.candidates import (
    refit_candidate,
)
from spiral.inference.likelihood.excerpts import excerpt_study
from spiral.inference.likelihood.fitting import (
    WARM,
    fit_by_likelihood,
    prepare_filter_tasks,
)
from spiral.inference.likelihood.needless_noise import drop_needless_noise
from spiral.inference.likelihood.scores import rank_candidates
from spiral.inference.likelihood.suggestions import sort_by_net, suggestions
from spiral.inference.likelihood.timescales import time_scale_sentences
from spiral.inference.nearness import is_near_noise
from spiral.inference.problem import Progress, Settings, silent
from spiral.inference.strategies.base import RefittedModel, RemainingLookAlikes, Step
from spiral.inference.strategies.likelihood.accepted import (
    AcceptedCandidate,
    RaceOutcome,
)
from spiral.inference.strategies.likelihood.curves import (
    MissingCurve,
    find_equal_curve,
    find_missing_curve,
)
from spiral.inference.strategies.likelihood.laws import (
    NamedLaw,
    find_named_law,
    is_much_random,
)
from spiral.inference.strategies.likelihood.look_alikes import recheck_admitted
from spiral.inference.strategies.likelihood.memory_rounds import find_missing_memory
from spiral.inference.strategies.likelihood.other_noise import (
    refit_in_place_of,
    refit_with_noise_growth,
    refit_with_resonant_force,
    refit_with_smaller_forces,
    refit_with_smooth_force,
)
from spiral.inference.strategies.likelihood.race_round import (
    RoundInput,
    ScoredRound,
    TestedCandidates,
    race_and_test,
    race_and_test_beyond,
)
from spiral.inference.strategies.likelihood.whole_fit import (
    compare_likelihood_fit,
    finish_fit,
    fit_with_effect,
)
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.errors import ConfigError
from spiral.types.run import Comparison, StopReason, Suggestion


def propose(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, comparison: Comparison,
    number: int, progress: Progress, beyond: bool = True,
) -> Step[ScoredRound]:  # fmt: skip
    """The candidate that makes the record most likely, if it passes on other blocks.

    Or two at once, where none is of use alone. None is tried on a record whose time is not the
    model's: of such motion each would be fitted for long and told of nothing. ``beyond`` : where
    none passes, what no candidate is (memory, laws, curves) is looked for.
    """
    bare, assembly = assembly, enlarge(assembly, state.labels)
    if comparison.contradictions and _is_of_another_time(assembly, state):
        return Step((), {}, stopped="no_candidate")
    asked = RoundInput(options, bare, comparison, number, progress)
    made = excerpt_study(assembly, state)
    part = None if made is None else race_and_test(asked, *made)
    if part is not None and (step := _decided_step(asked, assembly, state, part)) is not None:
        return step
    contest = (
        race_and_test(asked, assembly, state)
        if part is None
        else race_and_test_beyond(asked, assembly, state, part)
    )
    if contest is None:
        return Step((), {}, stopped="diverged")
    if (step := _decided_step(asked, assembly, state, contest)) is not None:
        return step
    scored = contest.scored
    listed = suggestions(scored.rivals, scored.ranking, "", ())
    ending = _ending(comparison, assembly)
    step = Step(listed[: options.listed], contest.outcome.rejected, stopped=ending, result=scored)
    return _step_without_candidate(asked, contest, part or contest, step, beyond)


def _is_of_another_time(assembly: Assembly, state: FitState) -> bool:
    """Whether the model's motion is over within a sample of the record, or hardly begins in it."""
    task = prepare_filter_tasks(assembly, state)[0][0]
    return bool(time_scale_sentences(task, assembly.problem.model.given_values))


def _decided_step(
    asked: RoundInput, assembly: Assembly, state: FitState, contest: TestedCandidates
) -> Step[ScoredRound] | None:
    """The step of a contest that has decided something; nothing where no candidate passed.

    Beside an effect that leaves much to chance, the model without it may be as likely with other
    forces: candidates are asked once more beside those.
    """
    if contest.other is not None:
        return _propose_with_other_interpolation(
            asked.options, assembly, contest.other, asked.number, asked.progress
        )
    if not contest.passed:
        return None
    other = refit_in_place_of(contest.passed[-1].whole, assembly, state, asked.progress)
    if other is not None:
        return _propose_after_refit(asked.options, assembly, other, asked.number, asked.progress)
    return _admitting_step(
        asked.options, assembly, state, contest.passed, contest.scored, contest.outcome
    )


def _step_without_candidate(
    asked: RoundInput, contest: TestedCandidates, searched: TestedCandidates,
    step: Step[ScoredRound], beyond: bool,
) -> Step[ScoredRound]:  # fmt: skip
    """The step where no candidate passes: other noise, what no candidate is, smooth forces, waves.

    Beside these candidates are asked once more. What no candidate is was not found where more was
    left to explain, and is not looked for again. Beside a model that is near its noise they would
    explain colour of which next to nothing follows the motion: no effect that counts is behind it.

    ``contest`` : of all samples. ``searched`` : of those on which what no candidate is is looked
    for; all samples judge what is found.
    """
    assembly, state, progress = contest.assembly, contest.state, asked.progress
    other = refit_with_smaller_forces(assembly, state, progress)
    if other is None:
        if (grown := refit_with_noise_growth(assembly, state, contest.base, progress)) is not None:
            return replace(step, stopped=_ending(grown.comparison, assembly), again=grown)
        left = _step_for_unexplained(asked, searched, step) if beyond else step
        if left is not step or step.stopped == "whiteness":
            return left
        other = refit_with_smooth_force(assembly, state, progress)
        other = other or refit_with_resonant_force(assembly, state, progress)
        if other is None:
            return left
        beyond = False
    return _propose_after_refit(asked.options, assembly, other, asked.number, progress, beyond)


def _admitting_step(
    options: LikelihoodOptions, assembly: Assembly, state: FitState,
    passed: tuple[AcceptedCandidate, ...], scored: ScoredRound, outcome: RaceOutcome,
) -> Step[ScoredRound]:  # fmt: skip
    """The step that admits the accepted candidates."""
    labels = tuple(p.rival.label for p in passed)
    effects = [p.rival.ranked.variant.original for p in passed]
    of_second_order = (is_second_order_remainder(e, assembly, state) for e in effects)
    shown = suggestions(scored.rivals, scored.ranking, labels[0], passed[0].aliases)
    rejected = {k: v for k, v in outcome.rejected.items() if k not in labels}
    return Step(
        shown[: options.listed], rejected, labels,
        {p.rival.label: p.aliases for p in passed}, any(of_second_order),
        "; ".join(e.meaning() for e in effects),
        result=replace(scored, refitted=passed[-1].whole.refitted),
    )  # fmt: skip


def _step_for_unexplained(
    asked: RoundInput, searched: TestedCandidates, step: Step[ScoredRound]
) -> Step[ScoredRound]:
    """The step where no candidate passes: a force with memory, a law or a curve is tried."""
    options, comparison, progress = asked.options, asked.comparison, asked.progress
    assembly, base, masks = searched.assembly, searched.base, searched.masks
    memory = find_missing_memory(assembly, base, comparison, masks, progress)
    if memory is not None:  # a curve over the present state would only stand in for it
        return replace(step, stopped="no_candidate", details={"memory": memory.as_dict()})
    white, level, changes = step.stopped == "whiteness", asked.level(), searched.changes
    law = find_named_law(
        options, assembly, searched.state, base, white, comparison, masks, level, changes, progress
    )
    if law is not None:
        return _law_step(options, step, law)
    if not assembly.problem.dictionary:
        return step
    if white and not is_much_random(comparison):
        curve = find_equal_curve(
            options, assembly, searched.state, base, comparison, masks, level, progress
        )
    else:
        curve = find_missing_curve(
            options, assembly, base, comparison, masks, level, changes, progress
        )
    if curve is not None and curve.law is not None:
        return _law_step(options, step, curve.law)
    return step if curve is None else _with_missing_curve(step, curve, assembly.problem.settings)


def _law_step(
    options: LikelihoodOptions, step: Step[ScoredRound], law: NamedLaw
) -> Step[ScoredRound]:
    """The step that admits a law."""
    label, aliases = law.effect.label, law.aliases
    return replace(
        step, suggestions=suggestions(law.tried, law.ranking, label, aliases)[: options.listed],
        admitted=(label,), aliases={label: aliases}, meaning=law.effect.meaning(),
        stopped="no_candidate", result=ScoredRound(law.ranking, law.tried, law.refitted),
    )  # fmt: skip


def _ending(comparison: Comparison, assembly: Assembly) -> StopReason:
    """Why the loop ends at a model beside which no candidate passes."""
    near = is_near_noise(comparison, assembly.problem.settings)
    return "whiteness" if near else "no_candidate"


def _propose_with_other_interpolation(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, number: int,
    progress: Progress,
) -> Step[ScoredRound]:  # fmt: skip
    """Propose once more, with another interpolation of the inputs between their samples."""
    fit = drop_needless_noise(assembly, fit_by_likelihood(assembly, state, rough=True), progress)
    fit = finish_fit(assembly, fit, progress)
    return _propose_after_refit(
        options, assembly, compare_likelihood_fit(assembly, fit, progress), number, progress
    )


def _propose_after_refit(
    options: LikelihoodOptions,
    assembly: Assembly,
    again: RefittedModel,
    number: int,
    progress: Progress,
    beyond: bool = True,
) -> Step[ScoredRound]:
    """Propose once more, from a model that was refitted in another way."""
    step = propose(options, assembly, again.fit_state, again.comparison, number, progress, beyond)
    return replace(step, again=step.again or again)


def _with_missing_curve(
    step: Step[ScoredRound], curve: MissingCurve, settings: Settings
) -> Step[ScoredRound]:
    """The step with a learned curve for a force that no candidate explains.

    It is looked for where the model is not near its noise, where much would have to act at
    random for that, or where what was admitted is not determined. It is admitted where the settings
    say so.
    """
    with_it = curve.refitted.comparison
    told = {"test_error": with_it.test_error, "noise_floor": with_it.floor}
    told |= {"replaces": curve.replaces, "undetermined": curve.undetermined}
    shape = {**curve.shape.as_dict(), **told}
    details = {**step.details, "unknown": shape}
    if not settings.learned:
        return replace(step, details=details)
    gone = (*curve.refitted.retired, *curve.replaces)
    refitted = replace(curve.refitted, retired=tuple(dict.fromkeys(gone)))
    return replace(
        step, admitted=(curve.shape.effect,), meaning=curve.shape.meaning, details=details,
        result=replace(step.required_result(), refitted=refitted),
    )  # fmt: skip


def settle(step: Step[ScoredRound]) -> RefittedModel:
    """The refit and comparison, which were made when the effect was proposed."""
    refitted = step.required_result().refitted
    assert refitted is not None
    return refitted


def suggestions_by_worth(step: Step[ScoredRound]) -> tuple[Suggestion, ...]:
    """All candidates by their worth, whatever is proposed; none where the fit has diverged."""
    if step.result is None:
        return ()
    scored = step.result
    label = next(iter(step.admitted), "")
    listed = suggestions(scored.rivals, scored.ranking, label, step.aliases.get(label, ()))
    return sort_by_net(listed)


def choose(
    options: LikelihoodOptions,
    assembly: Assembly,
    state: FitState,
    step: Step[ScoredRound],
    label: str,
) -> Step[ScoredRound]:
    """The step with a candidate that the user chose in place of the proposed one, untested."""
    scored = step.required_result()
    assembly = enlarge(assembly, state.labels)
    rival = next((r for r in scored.rivals if r.label == label), None)
    if rival is None:
        base = fit_by_likelihood(assembly, state, steps=WARM, rough=True)
        rival = refit_candidate(assembly, base, _best_ranked(assembly, scored.ranking, label))
    whole = fit_with_effect(rival.assembly, rival.fit.state, rival.ranked.variant.label, silent)
    effect = rival.ranked.variant.original
    groups = ({k, *v} for k, v in step.aliases.items())
    aliases = tuple(sorted(next((g - {label} for g in groups if label in g), set())))
    return replace(
        step, suggestions=suggestions_by_worth(step)[: options.listed], admitted=(label,),
        aliases={label: aliases},
        second_order=is_second_order_remainder(effect, assembly, state), meaning=effect.meaning(),
        result=replace(scored, refitted=whole.refitted),
    )  # fmt: skip


def ask_again(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, comparison: Comparison,
    aliases: Mapping[str, tuple[str, ...]], promising: Mapping[str, tuple[Suggestion, ...]],
    progress: Progress,
) -> RemainingLookAlikes:  # fmt: skip
    """Look-alikes that remain, and the step that replaces an effect by a likelier look-alike."""
    assembly = enlarge(assembly, state.labels)
    left, likelier = recheck_admitted(
        options, assembly, state, comparison, aliases, promising, progress
    )
    if likelier is None:
        return RemainingLookAlikes(left)
    scored = ScoredRound(likelier.ranking, likelier.tried)
    step = _admitting_step(
        options, assembly, state, (likelier.passed,), scored, RaceOutcome(None, {})
    )
    return RemainingLookAlikes(left, step)


def admit(assembly: Assembly, state: FitState, label: str, progress: Progress) -> RefittedModel:
    """An effect admitted by its name, with the shapes that the record prefers."""
    assembly = enlarge(assembly, state.labels)
    base = fit_by_likelihood(assembly, state, steps=WARM, rough=True)
    progress(f"refitting with {label}")
    scores = rank_candidates(assembly, base, base.estimate.noise, None)
    if scores is None:
        raise ConfigError(f"add {label}", "a model whose fit does not diverge",
                          "check units and signs of the channels")  # fmt: skip
    rival = refit_candidate(assembly, base, _best_ranked(assembly, scores, label))
    label = rival.ranked.variant.label
    return fit_with_effect(rival.assembly, rival.fit.state, label, progress).refitted


def _best_ranked(assembly: Assembly, scores: Ranking, label: str) -> RankedCandidate:
    """The best variant of an effect among those ranked."""
    for ranked in scores.ranked:
        if ranked.variant.original.label == label:
            return ranked
    raise untestable_effect_error(assembly, label)
