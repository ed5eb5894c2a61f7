"""Candidates of a round raced and tested in one study: of the whole records, or of an excerpt."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.statistics import round_level
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.enlarge import study_with
from spiral.inference.evidence.fit_state import FitState, Masks, half_masks
from spiral.inference.evidence.scoring import Ranking
from spiral.inference.likelihood.alternative_fits import (
    rivals_beside_less_noise,
    rivals_from_given_values,
)
from spiral.inference.likelihood.candidates import Race, Rival, start_race
from spiral.inference.likelihood.excerpts import excerpt_study, whole_state, whole_study
from spiral.inference.likelihood.fitting import (
    WARM,
    WORTH,
    LikelihoodFit,
    fit_by_likelihood,
    is_random_force_small,
    is_white,
)
from spiral.inference.likelihood.interpolation import likelier_interpolation_fit
from spiral.inference.likelihood.scores import rank_candidates
from spiral.inference.likelihood.suggestions import sort_by_net, suggestions
from spiral.inference.likelihood.tolerances import refitted_tolerances
from spiral.inference.nearness import (
    is_near_noise,
    leaves_less_than_noise,
    may_noise_stand_in,
)
from spiral.inference.problem import Progress, ScoreMessage, Settings
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.accepted import (
    NOTHING_TRIED,
    AcceptedCandidate,
    Objection,
    RaceOutcome,
)
from spiral.inference.strategies.likelihood.admission import benefit_objection, first_to_pass
from spiral.inference.strategies.likelihood.changes import PromisingChanges
from spiral.inference.strategies.likelihood.explaining import (
    first_to_explain_all,
    stands_in_for_all,
)
from spiral.inference.strategies.likelihood.free_running import first_to_take_free_run
from spiral.inference.strategies.likelihood.look_alikes import prefer_special_case
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.effect import is_plain_change
from spiral.types.run import Comparison

_SHOWN = 0.5  # of a candidate's score for each reading, from which an excerpt shows it
_FAR = 1.5  # times the best candidate's gain, from which a change is asked before all others


@dataclass(frozen=True)
class ScoredRound:
    """Candidates of one round: all with their scores, and those that were refitted.

    ``refitted`` is the model with what is admitted, compared, if anything is.
    """

    ranking: Ranking
    rivals: tuple[Rival, ...]
    refitted: RefittedModel | None = None


@dataclass(frozen=True)
class RoundInput:
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

    def helps(self, freely: bool = False) -> Objection:
        """The objection to what is of no use; ``freely`` as in ``refuse_unhelpful``."""
        return benefit_objection(self.options, self.comparison, self.bare.problem.settings, freely)


@dataclass(frozen=True)
class TestedCandidates:
    """Candidates raced and tested in one study, that of ``assembly``, in which ``state`` is.

    ``other`` is the state with another interpolation of inputs that is likelier than them all.
    """

    assembly: Assembly
    state: FitState
    base: LikelihoodFit
    masks: tuple[Masks, Masks]
    changes: PromisingChanges
    scored: ScoredRound
    outcome: RaceOutcome = NOTHING_TRIED
    passed: tuple[AcceptedCandidate, ...] = ()
    other: FitState | None = None


def race_and_test_beyond(
    asked: RoundInput, assembly: Assembly, state: FitState, part: TestedCandidates
) -> TestedCandidates | None:
    """Race and test on the whole records what an excerpt of them may not have shown.

    These are candidates whose score on the whole is that of a change of every reading by
    ``settings.smallest`` of its noise: one that acts all along with less is too small to count, and
    would have been as much on the excerpt. One that the excerpt showed as plainly, for each of its
    readings, was refused there. What the whole records have refused is not asked again. Where all
    misses are white and a free run errs by no more than noise, none is there: so much of the
    innovations would have a colour.
    """
    masks, settings = half_masks(assembly), assembly.problem.settings
    changes = PromisingChanges(assembly, masks[0])
    whole = replace(part, assembly=assembly, state=state, masks=masks, changes=changes)
    white = asked.comparison.whiteness_p >= settings.whiteness_level
    if white and _leaves_nothing(asked.comparison, settings):
        return replace(whole, base=_fit_on_blocks(assembly, state, masks[0]))
    scored = _score_candidates(assembly, state, masks[0])
    if scored is None:
        return None
    base, ranked = scored
    shown = _gains_per_reading(part.assembly, part.masks[0], part.scored.ranking)
    gains = _gains_per_reading(assembly, masks[0], ranked)
    promising = [
        r for r in ranked.ranked
        if (gain := gains[x := r.variant.original.label]) >= settings.smallest**2
        and shown.get(x, 0.0) < _SHOWN * gain
    ]  # fmt: skip
    if not promising:
        return replace(whole, base=base)
    race = start_race(assembly, base, promising, masks[0], asked.progress, asked.options.rivals)
    outcome = first_to_pass(
        asked.options, assembly, base, race, masks[1], asked.level(), asked.helps(),
        asked.progress, before=part.outcome.refused_on_whole(),
    )  # fmt: skip
    passed = outcome.admitted
    if len(passed) == 1:
        passed = (prefer_special_case(asked.options, passed[0], asked.progress),)
    tried = ScoredRound(ranked, race.tried)
    return TestedCandidates(assembly, state, base, masks, changes, tried, outcome, passed)


def _gains_per_reading(assembly: Assembly, masks: Masks, ranking: Ranking) -> dict[str, float]:
    """What each candidate's score promises for every reading that selects, in log-likelihood."""
    readings = sum(
        (s.samples if m is None else int(m.sum())) * s.y.shape[1]
        for s, m in zip(assembly.study.series, masks, strict=True)
    )
    return {r.variant.original.label: r.score.gain / readings for r in ranking.ranked}


def race_and_test(
    asked: RoundInput, assembly: Assembly, state: FitState
) -> TestedCandidates | None:
    """Race and test the candidates in a study; nothing where its filter diverges."""
    options, progress = asked.options, asked.progress
    masks = half_masks(assembly)
    begun = _race_candidates(options, assembly, state, masks[0], progress, _score_message)
    if begun is None:
        return None
    base, ranked, race = begun
    changes = PromisingChanges(assembly, masks[0], race.tolerances)
    contest = TestedCandidates(assembly, state, base, masks, changes, ScoredRound(ranked, ()))
    least = race.best - np.log(options.odds)  # what is not told apart is no effect
    if (other := likelier_interpolation_fit(assembly, base, masks[0], least, progress)) is not None:
        return replace(contest, other=whole_state(assembly, other.state))
    level, helps = asked.level(), asked.helps()
    raced = _race_changes_first(asked, assembly, contest, race.first)
    if raced and is_near_noise(_last_comparison(asked, raced[0]), assembly.problem.settings):
        return raced[0]
    race = race.with_more_rivals(rivals_from_given_values(assembly, base, masks[0], progress))
    quiet = functools.cache(lambda: rivals_beside_less_noise(assembly, base, masks[0], progress))
    if may_noise_stand_in(asked.comparison, assembly.problem.settings):
        race = race.with_more_rivals(quiet())
    outcome = first_to_pass(options, assembly, base, race, masks[1], level, helps, progress)
    passed, tried = outcome.admitted, race.tried
    if not passed and (there := _likelier_instead(assembly, state, outcome)) is not None:
        return replace(contest, scored=ScoredRound(ranked, tried), outcome=outcome, other=there)
    if not passed and outcome.likely is not None:
        passed = _find_second_effect(asked, outcome.likely, assembly.excerpt is not None)
    if not passed:
        contest = replace(contest, scored=ScoredRound(ranked, tried), outcome=outcome)
        outcome, tried = _ask_further(asked, assembly, state, contest, race, quiet())
        passed = outcome.admitted
    if len(passed) == 1:
        passed = (prefer_special_case(options, passed[0], progress),)
    scored = ScoredRound(ranked, tried)
    contest = replace(contest, scored=scored, outcome=outcome, passed=passed)
    return _with_leading_change(asked, assembly, contest, raced)


def _ask_further(
    asked: RoundInput, assembly: Assembly, state: FitState, contest: TestedCandidates, race: Race,
    quiet: list[Rival],
) -> tuple[RaceOutcome, tuple[Rival, ...]]:  # fmt: skip
    """What comes of the ``quiet`` rivals, then of any that explain all; and all that were tried.

    ``contest`` : the candidates of ``race``, of which none passed.
    """
    base, level, judge = contest.base, asked.level(), contest.masks[1]
    race = race.with_only_rivals(quiet)
    outcome = first_to_pass(
        asked.options, assembly, base, race, judge, level, asked.helps(), asked.progress,
        before=contest.outcome,
    )  # fmt: skip
    tried = (*contest.scored.rivals, *race.tried)
    if outcome.passed or not stands_in_for_all(asked.comparison, assembly.problem.settings):
        return outcome, tried
    outcome, freely = first_to_take_free_run(
        asked.options, assembly, base, outcome, level, asked.helps(freely=True), asked.progress
    )
    if outcome.passed:
        return outcome, (*tried, *freely)
    return first_to_explain_all(
        asked.options, assembly, state, base, contest.scored.ranking, race.with_only_rivals(tried),
        outcome, asked.comparison, level, asked.progress,
    )  # fmt: skip


Raced = tuple[TestedCandidates, ...] | None
"""Changes that were raced: nothing where none leads, empty where none passes, else the contest."""


def _race_changes_first(
    asked: RoundInput, assembly: Assembly, contest: TestedCandidates, first: Rival | None
) -> Raced:
    """A race of changes that lead all candidates by far, before these are raced to their end.

    ``first`` is the best candidate so far: where it leaves white misses and no force at random, no
    change is asked. Where the change leaves no more than noise and what acts at random, no
    candidate is asked further.
    """
    if not asked.options.laws or _leaves_nothing(asked.comparison, assembly.problem.settings):
        return None
    if first and is_white(first.assembly, first.fit) and is_random_force_small(first.fit):
        return None
    best = 0.0 if first is None else first.worth
    return _race_changes(asked, assembly, contest, _least_worth(asked.options, best), _FAR)


def _race_changes(
    asked: RoundInput, assembly: Assembly, contest: TestedCandidates, least: float, lead: float
) -> Raced:
    """A race of the changes that lead all candidates; one passes that is worth more than ``least``.

    ``lead`` : times the best candidate's gain that theirs has to be.
    """
    options = asked.options
    led = contest.changes.race_leading(
        contest.base, contest.scored.ranking, asked.progress, options.rivals, lead
    )
    if led is None:
        return None
    outcome = first_to_pass(
        options, assembly, contest.base, led[0], contest.masks[1], asked.level(), asked.helps(),
        asked.progress, least,
    )  # fmt: skip
    if outcome.passed is None:
        return ()
    passed = outcome.passed
    if not is_plain_change(passed.rival.ranked.variant.original):
        passed = prefer_special_case(options, passed, asked.progress)
    scored = ScoredRound(led[1], led[0].tried)
    return (replace(contest, scored=scored, outcome=outcome, passed=(passed,)),)


def _with_leading_change(
    asked: RoundInput, assembly: Assembly, contest: TestedCandidates, raced: Raced
) -> TestedCandidates:
    """The contest with a parameter's change in place of what passed, where that is far likelier.

    None is asked where the model, with what passed, leaves nothing. ``raced`` : changes that were
    raced before.
    """
    passed = contest.passed
    if not asked.options.laws or len(passed) > 1:
        return contest
    if _leaves_nothing(_last_comparison(asked, contest), assembly.problem.settings):
        return contest
    least = _least_worth(asked.options, passed[0].rival.worth if passed else 0.0)
    if raced is None:
        raced = _race_changes(asked, assembly, contest, least, 1.0)
    return raced[0] if raced and raced[0].passed[0].rival.worth > least else contest


def _least_worth(options: LikelihoodOptions, best: float) -> float:
    """The worth that takes the place of the best one, likelier by the odds; zero where none is."""
    return best + float(np.log(options.odds)) if best > 0 else 0.0


def _last_comparison(asked: RoundInput, contest: TestedCandidates) -> Comparison:
    """The comparison of the model with what passed, or of the one that the round began with."""
    return contest.passed[-1].whole.refitted.comparison if contest.passed else asked.comparison


def _leaves_nothing(last: Comparison, settings: Settings) -> bool:
    """Whether noise explains all that a model leaves, and its free run errs by no more than that.

    A free run that random forces or uncertain values excuse may still hide what is missing, and so
    may noise of a sensor that is mostly coloured.
    """
    if may_noise_stand_in(last, settings):
        return False
    return is_near_noise(last, settings) and leaves_less_than_noise(last.test_error, last, settings)


def _likelier_instead(assembly: Assembly, state: FitState, outcome: RaceOutcome) -> FitState | None:
    """The state with another interpolation in place of what a race refused for it, if likelier.

    The step over an input's samples and a lag of it look alike to a few steps of a race: that it is
    the step shows when the refused candidate is fitted to all samples. ``state`` has neither.
    """
    instead = outcome.instead
    if instead is None or instead.fit_state.between == state.between:
        return None
    now = fit_by_likelihood(whole_study(assembly), whole_state(assembly, state), steps=0)
    return instead.fit_state if instead.log_likelihood > now.log_likelihood + WORTH else None


def _fit_on_blocks(assembly: Assembly, state: FitState, select: Masks) -> LikelihoodFit:
    """The model as it is on the blocks that select."""
    return fit_by_likelihood(assembly, state, masks=select, steps=WARM, rough=True)


def _score_candidates(
    assembly: Assembly, state: FitState, select: Masks
) -> tuple[LikelihoodFit, Ranking] | None:
    """The model as it is on the blocks that select, and candidates by their score beside it."""
    base = _fit_on_blocks(assembly, state, select)
    ranked = rank_candidates(assembly, base, base.estimate.noise, select)
    return None if ranked is None else (base, ranked)


def _race_candidates(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, select: Masks,
    progress: Progress, scored: Callable[[Ranking], str] | None = None,
) -> tuple[LikelihoodFit, Ranking, Race] | None:  # fmt: skip
    """The model as it is on the blocks that select, candidates by their score, and their race.

    ``scored`` : the message about the scores, where they are of interest by themselves.
    """
    progress("scoring candidates by one-step predictions")
    begun = _score_candidates(assembly, state, select)
    if begun is None:
        return None
    base, ranked = begun
    if scored is not None:
        progress(scored(ranked))
    race = start_race(assembly, base, list(ranked.ranked), select, progress, options.rivals)
    return (
        base,
        ranked,
        replace(race, tolerances=refitted_tolerances(assembly, base, ranked, select)),
    )


def _score_message(ranking: Ranking) -> ScoreMessage:
    listed = sort_by_net(suggestions((), ranking, "", ()))
    return ScoreMessage(f"refitting the best of {len(listed)} candidates", listed)


def _find_second_effect(
    asked: RoundInput, first: AcceptedCandidate, on_excerpt: bool
) -> tuple[AcceptedCandidate, ...]:
    """A second candidate that passes together with a likely one that is of no use alone.

    A softening spring whose sensor is off by a constant is wrong without either. Together they must
    do to what is predicted what one alone has to. Nothing where none passes. ``on_excerpt`` : it is
    looked for on an excerpt, as the first was.
    """
    options, progress = asked.options, asked.progress
    progress(f"trying a second effect beside {first.rival.label}")
    state = first.whole.refitted.fit_state
    assembly = study_with(asked.bare, state.labels)
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
