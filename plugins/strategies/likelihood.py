"""Options of ``strategy=likelihood``, the default: the likelihood of one-step predictions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spiral.inference.strategies.base import (
    RefittedModel,
    RemainingLookAlikes,
    StartedStudy,
    Step,
    Strategy,
)
from spiral.inference.strategy_options import LikelihoodOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from spiral.inference.evidence.assembly import Assembly
    from spiral.inference.evidence.fit_state import FitState
    from spiral.inference.problem import Problem, Progress
    from spiral.inference.strategies.likelihood.race_round import ScoredRound
    from spiral.types.run import Comparison, Suggestion


class Likelihood(LikelihoodOptions, Strategy):
    """The likelihood of the whole record, with a model of what is random: the usual strategy.

    G = 2 (log L_1 - log L_0) of a candidate refitted on half of the blocks must hold on the other
    half, and no error on unseen data may grow, at any horizon (docs/method.md).
    """

    everywhere = True
    curves = True
    by_hand = True
    by_name = True
    ignores = ("phase_knot",)  # the filter tracks the phase itself

    def begin(self, problem: Problem, progress: Progress) -> StartedStudy:
        """The model as it is, most likely with the noise that its record wants."""
        from spiral.inference.strategies.likelihood.begin_study import begin_study

        return begin_study(problem, progress)

    def propose(
        self,
        assembly: Assembly,
        fit_state: FitState,
        comparison: Comparison,
        number: int,
        progress: Progress,
    ) -> Step[ScoredRound]:
        """The candidate that makes the record most likely, if it passes on other blocks."""
        from spiral.inference.strategies.likelihood.propose import propose

        return propose(self, assembly, fit_state, comparison, number, progress)

    def settle(
        self, assembly: Assembly, step: Step[ScoredRound], progress: Progress
    ) -> RefittedModel:
        """The refit and comparison that were made when the effect was proposed."""
        from spiral.inference.strategies.likelihood.propose import settle

        return settle(step)

    def ranked(self, step: Step[ScoredRound]) -> tuple[Suggestion, ...]:
        """All candidates by what they are worth."""
        from spiral.inference.strategies.likelihood.propose import suggestions_by_worth

        return suggestions_by_worth(step)

    def choose(
        self, assembly: Assembly, fit_state: FitState, step: Step[ScoredRound], label: str
    ) -> Step[ScoredRound]:
        """Another candidate in place of the proposal; no gate is asked."""
        from spiral.inference.strategies.likelihood.propose import choose

        return choose(self, assembly, fit_state, step, label)

    def ask_again(
        self, assembly: Assembly, fit_state: FitState, comparison: Comparison,
        aliases: Mapping[str, tuple[str, ...]], promising: Mapping[str, tuple[Suggestion, ...]],
        progress: Progress,
    ) -> RemainingLookAlikes:  # fmt: skip
        """Earlier look-alikes beside the final model's values and noise."""
        from spiral.inference.strategies.likelihood.propose import ask_again

        return ask_again(self, assembly, fit_state, comparison, aliases, promising, progress)

    def admit(
        self, assembly: Assembly, fit_state: FitState, label: str, progress: Progress
    ) -> RefittedModel:
        """An effect by its name, with the shapes that the record prefers."""
        from spiral.inference.strategies.likelihood.propose import admit

        return admit(assembly, fit_state, label, progress)
