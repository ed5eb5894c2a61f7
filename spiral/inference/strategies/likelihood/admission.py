"""Three tests that a candidate must pass before it is admitted to the model.

1. *Confirmed.* It must predict the blocks that did not select it (``judging``).
2. *Fitted.* The model takes its likeliest values and noise; effects made superfluous go.
3. *Of use.* No error on unseen data may grow, at any horizon, and one must fall by a size that
   counts.
"""

from __future__ import annotations

import functools
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly, build_variants
from spiral.inference.evidence.scoring import (
    Parts,
    RankedCandidate,
    Ranking,
    active_labels,
)
from spiral.inference.likelihood.alias_groups import (
    indistinguishable_rivals,
    simplest_rival,
    twin_rivals,
)
from spiral.inference.likelihood.candidates import Race, Rival, start_race
from spiral.inference.likelihood.fitting import (
    WORTH,
    LikelihoodFit,
    largest_force,
)
from spiral.inference.likelihood.judging import JudgingFits, fit_on_judging_blocks, judge_winner
from spiral.inference.likelihood.scores import rank_variants
from spiral.inference.likelihood.tolerances import Tolerances
from spiral.inference.problem import Progress, Settings
from spiral.inference.strategies.likelihood.accepted import (
    NOTHING_TRIED,
    AcceptedCandidate,
    Objection,
    RaceOutcome,
)
from spiral.inference.strategies.likelihood.benefit import Refusal, refuse_unhelpful
from spiral.inference.strategies.likelihood.meaning import STILL_STATE, refuse_senseless
from spiral.inference.strategies.likelihood.twins import untold_twin
from spiral.inference.strategies.likelihood.whole_fit import (
    compare_whole_record_fit,
    fit_with_rival,
)
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.effect import Effect, ParameterEffect, is_other_value
from spiral.types.run import Comparison


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
    runners = _by_turns_of_places(ranked.ranked)
    return start_race(assembly, base, runners, select, progress, most), ranked


def _by_turns_of_places(ranked: Sequence[RankedCandidate]) -> list[RankedCandidate]:
    """Candidates by their score, changes of parameters by turns: the best of each place first.

    To first order all forms of a change are one, and those of the best place would take the room
    of all others. Of the one that leads at the end every form is raced (``with_every_form``).
    """
    places = defaultdict[str, Iterator[int]](itertools.count)
    effects = (r.variant.original for r in ranked)
    turns = [next(places[e.port]) if isinstance(e, ParameterEffect) else 0 for e in effects]
    return [r for _, r in sorted(zip(turns, ranked, strict=True), key=lambda pair: pair[0])]


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
    fitted: dict[str, float] = {}  # what those were worth that were fitted and refused
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
        chosen, near = _simplest_that_counts(options, race, rival, rivals)
        if chosen is not rival and chosen.worth <= fitted.get(chosen.label, -np.inf) + WORTH:
            rejected[rival.label] = rejected[chosen.label]  # it is not told apart from that one
            continue
        aliases = tuple(dict.fromkeys((*near, *twin_rivals(chosen, rivals))))
        progress(f"most likely values with {chosen.label}")
        passed, refusal = fit_and_ask(chosen, aliases, objection, progress)
        if refusal is None:
            return RaceOutcome(passed, rejected, likely, worths, tuple(refused), instead)
        if instead is None and chosen.label in passed.whole.refitted.retired:
            instead = passed.whole.refitted
        rejected[chosen.label], worths[chosen.label] = refusal.reason, chosen.worth
        fitted[chosen.label] = chosen.worth
        refused.append(chosen.label)
        likely = likely or (passed if refusal.alone else None)
    return RaceOutcome(None, rejected, likely, worths, tuple(refused), instead)


def _simplest_that_counts(
    options: LikelihoodOptions, race: Race, rival: Rival, rivals: list[Rival]
) -> tuple[Rival, tuple[str, ...]]:
    """The simplest rival that is not told apart from a winner, and the labels of the others.

    The winner itself, where that one is no more than known values that are a little off.
    """
    chosen, near = simplest_rival(rival, indistinguishable_rivals(rivals, options.odds), rivals)
    if not _within_tolerances(chosen, race.tolerances):
        return chosen, near
    return rival, tuple(x for x in near if x != rival.label)


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


def fit_and_ask(
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
    return fit_and_ask(chosen, aliases, objection, progress, early=False)


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
    options: LikelihoodOptions, before: Comparison, settings: Settings, freely: bool = False
) -> Objection:
    """An objection to candidates that do not improve predictions of unseen data.

    ``freely`` : as in ``refuse_unhelpful``.
    """
    return lambda whole: refuse_unhelpful(
        options, before, whole.refitted.comparison, settings, freely
    )
