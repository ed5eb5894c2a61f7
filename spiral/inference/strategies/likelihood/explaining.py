"""A candidate that explains all that is left, asked where no half of the records confirms one.

Beside a large random force scores tell little, and on half of the blocks such a force may do all
that a candidate would. So every candidate whose score is worth its numbers is refitted, and one
passes without a confirmation on blocks if with it

- noise explains all that is left, on records of the fit and of the test, which it does not without;
- no random force above ``settings.random_limit`` acts any more;
- all records are likelier by the odds of any other choice, times the candidates that were asked,
  once its numbers are paid for.

What explains a test record that no fit has seen down to its noise, where the model as it is errs by
more, is confirmed by that record.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.inference.disturbances import random_forces
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import Ranking
from spiral.inference.likelihood.candidates import Race, Rival
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    fit_by_likelihood,
    largest_force,
    schwarz_penalty,
)
from spiral.inference.likelihood.noise_selection import worth_beside
from spiral.inference.nearness import is_moved_unseen, is_near_noise
from spiral.inference.problem import Progress, Settings
from spiral.inference.strategies.likelihood.accepted import Objection, RaceOutcome, WholeRecordFit
from spiral.inference.strategies.likelihood.admission import benefit_objection, first_to_pass
from spiral.inference.strategies.likelihood.benefit import Refusal
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.run import Comparison


def stands_in_for_all(comparison: Comparison, settings: Settings) -> bool:
    """Whether a random force too large to be an explanation acts beside a model with a test."""
    largest = max(random_forces(comparison).values(), default=0.0)
    large = largest > settings.random_limit and not is_moved_unseen(comparison)
    return large and bool(comparison.unseen) and not is_near_noise(comparison, settings)


def first_to_explain_all(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, base: LikelihoodFit,
    ranked: Ranking, race: Race, before: RaceOutcome, comparison: Comparison, level: float,
    progress: Progress,
) -> tuple[RaceOutcome, tuple[Rival, ...]]:  # fmt: skip
    """The first candidate that explains all that is left, and all candidates that were refitted.

    Parameters
    ----------
    state : the model as it is; base : its fit to the blocks that select. ranked : all candidates'
        scores beside it. race : of those that were tried, ``before`` what came of it.
    """
    known = {r.label for r in race.tried}
    promising = [r for r in ranked.ranked if r.rank < 0 and not r.whole]
    rest = [r for r in promising if r.variant.original.label not in known]
    wider = race.with_candidates(rest)
    now = fit_by_likelihood(assembly, state, steps=0)
    asked = len({r.label for r in wider.tried})
    objection = _explains_less(options, now, comparison, assembly.problem.settings, asked)
    outcome = first_to_pass(
        options, assembly, base, wider, None, level, objection, progress,
        before=before.refused_on_whole(), confirmed=False,
    )  # fmt: skip
    told = replace(outcome, rejected={**before.rejected, **outcome.rejected})
    return told, wider.tried


def _explains_less(
    options: LikelihoodOptions, now: LikelihoodFit, before: Comparison, settings: Settings,
    asked: int,
) -> Objection:  # fmt: skip
    """The objection to a candidate beside which more than noise is left."""
    helps = benefit_objection(options, before, settings)
    least = float(np.log(options.odds * max(asked, 1)))

    def object_to(whole: WholeRecordFit) -> Refusal | None:
        if refusal := helps(whole):
            return refusal
        numbers = len(whole.fit.estimate.keys) - len(now.estimate.keys)
        worth = worth_beside(whole.fit.estimate, now.estimate)
        worth -= schwarz_penalty(max(numbers, 0), now.estimate.prepared)
        calm = largest_force(whole.fit.estimate.noise) <= settings.random_limit
        if worth > least and calm and is_near_noise(whole.refitted.comparison, settings):
            return None
        return Refusal(
            "no half of the records confirms it, and it does not explain all that is left"
        )

    return object_to
