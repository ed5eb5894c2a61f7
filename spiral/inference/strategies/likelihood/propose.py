"""A round of ``strategy=likelihood``: candidates scored, raced, refitted and tested.

several starts -> most likely values and noise -> score, race and judge the candidates ->
admission, where no horizon on unseen data grows worse -> refit, noise and effects that are
no longer wanted let go.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.statistics import round_level
from spiral.inference.evidence.admission import is_second_order_remainder, untestable_effect_error
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.enlarge import enlarge
from spiral.inference.evidence.fit_state import FitState, Masks, half_masks
from spiral.inference.evidence.scoring import RankedCandidate, Ranking
from spiral.inference.likelihood.alternative_fits import (
    rivals_beside_less_noise,
    rivals_from_given_values,
)
from spiral.inference.likelihood.candidates import (
    Race,
    Rival,
    refit_candidate,
    start_race,
)
from spiral.inference.likelihood.excerpts import excerpt_study, whole_state
from spiral.inference.likelihood.fitting import (
    LITTLE,
    WARM,
    LikelihoodFit,
    fit_by_likelihood,
)
from spiral.inference.likelihood.interpolation import (
    likelier_interpolation_fit,
)
from spiral.inference.likelihood.needless_noise import drop_needless_noise
from spiral.inference.likelihood.scores import rank_candidates
from spiral.inference.likelihood.suggestions import suggestions
from spiral.inference.nearness import is_near_noise, may_noise_stand_in
from spiral.inference.problem import Progress, ScoreMessage, Settings, silent
from spiral.inference.strategies.base import RefittedModel, RemainingLookAlikes, Step
from spiral.inference.strategies.likelihood.admission import (
    NOTHING_TRIED,
    AcceptedCandidate,
    Objection,
    RaceOutcome,
    benefit_objection,
    compare_likelihood_fit,
    finish_fit,
    first_to_pass,
    fit_with_effect,
)
from spiral.inference.strategies.likelihood.curves import (
    MissingCurve,
    find_equal_curve,
    find_missing_curve,
)
from spiral.inference.strategies.likelihood.laws import find_named_law
from spiral.inference.strategies.likelihood.look_alikes import prefer_special_case, recheck_admitted
from spiral.inference.strategies.likelihood.memory_rounds import find_missing_memory
from spiral.inference.strategies.likelihood.other_noise import (
    refit_with_noise_growth,
    refit_with_resonant_force,
    refit_with_smaller_forces,
)
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.errors import ConfigError
from spiral.types.run import Comparison, StopReason, Suggestion


@dataclass(frozen=True)
class ScoredRound:
    """Candidates of one round: all with their scores, and those that were refitted.

    ``refitted`` is the model with what is admitted, compared, if anything is.
    """

    ranking: Ranking
    rivals: tuple[Rival, ...]
    refitted: RefittedModel | None = None


def propose(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, comparison: Comparison,
    number: int, progress: Progress,
) -> Step[ScoredRound]:  # fmt: skip
    """The candidate that makes the record most likely, if it passes on other blocks.

    Or two at once, where none is of use alone.
    """
    bare, assembly = assembly, enlarge(assembly, state.labels)
    asked = _Question(options, bare, comparison, number, progress)
    made = excerpt_study(assembly, state)
    before = NOTHING_TRIED
    if made is not None:
        contest = _contest(asked, *made, before)
        if contest is not None and (step := _decided_step(asked, assembly, state, contest)):
            return step
        before = NOTHING_TRIED if contest is None else contest.outcome.refused_on_whole()
    contest = _contest(asked, assembly, state, before)
    if contest is None:
        return Step((), {}, stopped="diverged")
    if (step := _decided_step(asked, assembly, state, contest)) is not None:
        return step
    scored = contest.scored
    listed = suggestions(scored.rivals, scored.ranking, "", ())
    ending = _ending(comparison, assembly)
    step = Step(listed[: options.listed], contest.outcome.rejected, stopped=ending, result=scored)
    return _step_without_candidate(
        options, assembly, state, contest.base, step, comparison, contest.masks,
        asked.level(), number, progress,
    )  # fmt: skip


@dataclass(frozen=True)
class _Question:
    """What a round asks of any study of its records: of a part of them, or of all."""

    options: LikelihoodOptions
    bare: Assembly
    comparison: Comparison
    number: int
    progress: Progress

    def level(self) -> float:
        """The level of one test of this round."""
        settings = self.bare.problem.settings
        return round_level(settings.level, self.number) / self.options.judged

    def helps(self) -> Objection:
        """The objection to what is of no use."""
        return benefit_objection(self.options, self.comparison, self.bare.problem.settings)


@dataclass(frozen=True)
class _Contest:
    """Candidates raced and tested in one study.

    ``other`` is the state with another interpolation of inputs that is likelier than them all.
    """

    base: LikelihoodFit
    masks: tuple[Masks, Masks]
    scored: ScoredRound
    outcome: RaceOutcome = NOTHING_TRIED
    passed: tuple[AcceptedCandidate, ...] = ()
    other: FitState | None = None


def _contest(
    asked: _Question, assembly: Assembly, state: FitState, before: RaceOutcome
) -> _Contest | None:
    """Race and test the candidates in a study; nothing where its filter diverges."""
    options, progress = asked.options, asked.progress
    masks = half_masks(assembly)
    begun = _race_candidates(options, assembly, state, masks[0], progress, _score_message)
    if begun is None:
        return None
    base, ranked, race = begun
    least = race.best - np.log(options.odds)  # what is not told apart is no effect
    if (other := likelier_interpolation_fit(assembly, base, masks[0], least, progress)) is not None:
        there = whole_state(assembly, other.state)
        return _Contest(base, masks, ScoredRound(ranked, ()), other=there)
    level, helps = asked.level(), asked.helps()
    race = race.with_more_rivals(rivals_from_given_values(assembly, base, masks[0], progress))
    quiet = functools.cache(lambda: rivals_beside_less_noise(assembly, base, masks[0], progress))
    if may_noise_stand_in(asked.comparison, assembly.problem.settings):
        race = race.with_more_rivals(quiet())
    outcome = first_to_pass(
        options, assembly, base, race, masks[1], level, helps, progress, before=before
    )
    passed, tried = outcome.admitted, race.tried
    if not passed and outcome.likely is not None:
        passed = _find_second_effect(asked, outcome.likely, assembly.excerpt is not None)
    if not passed:
        race = race.with_only_rivals(quiet())
        outcome = first_to_pass(
            options, assembly, base, race, masks[1], level, helps, progress, before=outcome
        )
        passed, tried = outcome.admitted, (*tried, *race.tried)
    if len(passed) == 1:
        passed = (prefer_special_case(options, passed[0], progress),)
    return _Contest(base, masks, ScoredRound(ranked, tried), outcome, passed)


def _decided_step(
    asked: _Question, assembly: Assembly, state: FitState, contest: _Contest
) -> Step[ScoredRound] | None:
    """The step of a contest that has decided something; nothing where no candidate passed."""
    if contest.other is not None:
        return _propose_with_other_interpolation(
            asked.options, assembly, contest.other, asked.number, asked.progress
        )
    if not contest.passed:
        return None
    return _admitting_step(
        asked.options, assembly, state, contest.passed, contest.scored, contest.outcome
    )


def _step_without_candidate(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, base: LikelihoodFit,
    step: Step[ScoredRound], comparison: Comparison, masks: tuple[Masks, Masks], level: float,
    number: int, progress: Progress,
) -> Step[ScoredRound]:  # fmt: skip
    """The step where no candidate passes: other noise, then what no candidate is, then waves."""
    other = refit_with_smaller_forces(assembly, state, progress)
    if other is None:
        if (grown := refit_with_noise_growth(assembly, state, base, progress)) is not None:
            return replace(step, stopped=_ending(grown.comparison, assembly), again=grown)
        left = _step_for_unexplained(
            options, assembly, state, base, step, comparison, masks, level, progress
        )
        other = refit_with_resonant_force(assembly, state, progress) if left is step else None
        if other is None:
            return left
    return _propose_after_refit(options, assembly, other, number, progress)


def _race_candidates(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, select: Masks,
    progress: Progress, scored: Callable[[Ranking], str] | None = None,
) -> tuple[LikelihoodFit, Ranking, Race] | None:  # fmt: skip
    """The model as it is on the blocks that select, candidates by their score, and their race.

    ``scored`` : the message about the scores, where they are of interest by themselves.
    """
    progress("scoring candidates by one-step predictions")
    base = fit_by_likelihood(assembly, state, masks=select, steps=WARM, rough=True)
    ranked = rank_candidates(assembly, base, base.estimate.noise, select)
    if ranked is None:
        return None
    if scored is not None:
        progress(scored(ranked))
    return (
        base,
        ranked,
        start_race(assembly, base, list(ranked.ranked), select, progress, options.rivals),
    )


def _score_message(ranking: Ranking) -> ScoreMessage:
    listed = _sort_by_net(suggestions((), ranking, "", ()))
    return ScoreMessage(f"refitting the best of {len(listed)} candidates", listed)


def _find_second_effect(
    asked: _Question, first: AcceptedCandidate, on_excerpt: bool
) -> tuple[AcceptedCandidate, ...]:
    """A second candidate that passes together with a likely one that is of no use alone.

    A softening spring whose sensor is off by a constant is wrong without either. Together they must
    do to what is predicted what one alone has to. Nothing where none passes. The study begins with
    no more than its seed: ``first`` may have let go what was admitted before. ``on_excerpt`` : it
    is looked for on an excerpt, as the first was.
    """
    options, progress = asked.options, asked.progress
    progress(f"trying a second effect beside {first.rival.label}")
    state = first.whole.refitted.fit_state
    assembly = enlarge(asked.bare, state.labels)
    if on_excerpt:
        assembly, state = excerpt_study(assembly, state) or (assembly, state)
    masks = half_masks(assembly)
    contest = _race_candidates(options, assembly, state, masks[0], progress)
    if contest is None:
        return ()
    base, _, race = contest
    race = race.with_more_rivals(rivals_from_given_values(assembly, base, masks[0], progress))
    race = race.with_more_rivals(rivals_beside_less_noise(assembly, base, masks[0], progress))
    second = first_to_pass(
        options, assembly, base, race, masks[1], asked.level(), asked.helps(), progress
    ).passed
    if second is None:
        return ()
    refitted = second.whole.refitted
    if first.rival.label in refitted.retired:
        gone = tuple(x for x in refitted.retired if x != first.rival.label)
        whole = replace(second.whole, refitted=replace(refitted, retired=gone))
        return (replace(second, whole=whole),)
    return first, second


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
    options: LikelihoodOptions, assembly: Assembly, state: FitState, base: LikelihoodFit,
    step: Step[ScoredRound], comparison: Comparison, masks: tuple[Masks, Masks], level: float,
    progress: Progress,
) -> Step[ScoredRound]:  # fmt: skip
    """The step where no candidate passes: a force with memory, a law or a curve is tried."""
    memory = find_missing_memory(assembly, base, comparison, masks, progress)
    if memory is not None:  # a curve over the present state would only stand in for it
        return replace(step, stopped="no_candidate", details={"memory": memory.as_dict()})
    white = step.stopped == "whiteness"
    law = find_named_law(options, assembly, state, base, white, comparison, masks, level, progress)
    if law is not None:
        label, aliases = law.effect.label, law.aliases
        return replace(
            step, suggestions=suggestions(law.tried, law.ranking, label, aliases)[: options.listed],
            admitted=(label,), aliases={label: aliases}, meaning=law.effect.meaning(),
            stopped="no_candidate", result=ScoredRound(law.ranking, law.tried, law.refitted),
        )  # fmt: skip
    if not assembly.problem.dictionary:
        return step
    much = max((comparison.random or {}).values(), default=0.0) > LITTLE
    if white and not much:
        curve = find_equal_curve(options, assembly, state, base, comparison, masks, level, progress)
    else:
        curve = find_missing_curve(options, assembly, base, comparison, masks, level, progress)
    return step if curve is None else _with_missing_curve(step, curve, assembly.problem.settings)


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
) -> Step[ScoredRound]:
    """Propose once more, from a model that was refitted in another way."""
    step = propose(options, assembly, again.fit_state, again.comparison, number, progress)
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
    told = {"test_error": with_it.test_error, "noise_floor": with_it.noise_floor}
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
    return _sort_by_net(listed)


def _sort_by_net(listed: Sequence[Suggestion]) -> tuple[Suggestion, ...]:
    return tuple(sorted(listed, key=lambda s: -(s.net or 0.0)))


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
    aliases: Mapping[str, tuple[str, ...]], promising: Mapping[str, tuple[str, ...]],
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
