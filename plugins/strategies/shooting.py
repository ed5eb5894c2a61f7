"""Evidence from trajectories on windows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spiral.inference.strategies.base import (
    AddedEffects,
    RefittedModel,
    StartedStudy,
    Step,
    Strategy,
)
from spiral.inference.strategy_options import ShootingOptions

if TYPE_CHECKING:
    from spiral.inference.evidence.assembly import Assembly
    from spiral.inference.evidence.fit_state import FitState
    from spiral.inference.problem import Problem, Progress
    from spiral.inference.suggest import Proposal
    from spiral.types.effect import Effect
    from spiral.types.run import Comparison, Diagnosis, Suggestion


class Shooting(ShootingOptions, Strategy):
    """Trajectories on windows with free starts, judged on windows that did not select.

    F = ((RSS_0 - RSS_1) / q) / s^2 of each candidate on half of the blocks, and a robust Wald
    statistic; its refit must lower the error on the other half (docs/method.md).
    """

    curves = True
    by_hand = True
    by_name = True

    def begin(self, problem: Problem, progress: Progress) -> StartedStudy:
        """The seed fitted on growing windows of the half that judges."""
        from spiral.inference.strategies.shooting.propose import begin

        return begin(problem, progress)

    def propose(
        self,
        assembly: Assembly,
        fit_state: FitState,
        comparison: Comparison,
        number: int,
        progress: Progress,
    ) -> Step[Proposal]:
        """The candidate that one half of the blocks selects and the other half confirms."""
        from spiral.inference.strategies.shooting.propose import propose_candidate

        return propose_candidate(self, assembly, fit_state, comparison, number, progress)

    def settle(self, assembly: Assembly, step: Step[Proposal], progress: Progress) -> RefittedModel:
        """Refitted on the half that did not select; effects made superfluous are dropped."""
        from spiral.inference.strategies.shooting.propose import settle

        return settle(assembly, step, progress)

    def ranked(self, step: Step[Proposal]) -> tuple[Suggestion, ...]:
        """All candidates by their evidence on the same windows."""
        from spiral.inference.strategies.shooting.propose import ranked_suggestions

        return ranked_suggestions(step)

    def choose(
        self, assembly: Assembly, fit_state: FitState, step: Step[Proposal], label: str
    ) -> Step[Proposal]:
        """Another candidate at the windows on which all were scored; no gate is asked."""
        from spiral.inference.strategies.shooting.propose import choose

        return choose(assembly, fit_state, step, label)

    def compare(self, problem: Problem, progress: Progress) -> Comparison:
        """The model fitted to all samples on growing windows."""
        from spiral.inference.compare import compare_on_windows

        return compare_on_windows(problem, progress)

    def add(
        self, problem: Problem, effects: tuple[Effect, ...], progress: Progress
    ) -> AddedEffects:
        """Before and after, each fitted to all samples."""
        from spiral.inference.strategies.shooting.propose import fit_before_and_after

        return fit_before_and_after(problem, effects, progress)

    def diagnose(self, problem: Problem, progress: Progress) -> Diagnosis:
        """Of the model fitted to all samples; the best suggestions are tried on the test record."""
        from spiral.inference.diagnose import diagnose_on_windows

        return diagnose_on_windows(self, problem, progress)
