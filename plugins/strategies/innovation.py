"""Evidence from the innovations of a filter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spiral_plugins.gates.innovation import Innovation as MostLikely
from spiral_plugins.gates.joint import ValidationRollback

from spiral.engine.gate import Gate
from spiral.inference.strategies.base import RefittedModel, StartedStudy, Step, Strategy
from spiral.inference.strategy_options import InnovationOptions

if TYPE_CHECKING:
    from spiral.inference.evidence.assembly import Assembly
    from spiral.inference.evidence.fit_state import FitState
    from spiral.inference.problem import Problem, Progress
    from spiral.inference.strategies.innovation import Admission
    from spiral.types.run import Comparison


class Innovation(InnovationOptions, Strategy):
    """The innovations of a filter on the full system, its process noise tuned.

    e = S^(-1/2) (y - h(x)): candidates are scored by e and its slopes, then by the likelihood of a
    refit. For effects on states that no sensor sees, and where process noise is real
    (docs/method.md).
    """

    by_name = True
    # Its gates have levels of their own, and the filter tracks the phase itself.
    ignores = ("level", "alias_level", "phase_knot", "learned")

    gate: tuple[Gate, ...] = (MostLikely(), ValidationRollback())

    def begin(self, problem: Problem, progress: Progress) -> StartedStudy:
        """The seed at its most likely values and process noise."""
        from spiral.inference.strategies.innovation import begin

        return begin(problem, progress)

    def propose(
        self,
        assembly: Assembly,
        fit_state: FitState,
        comparison: Comparison,
        number: int,
        progress: Progress,
    ) -> Step[Admission]:
        """The candidates scored by the innovations; those that the gates let through."""
        from spiral.inference.strategies.innovation import propose

        return propose(self, assembly, fit_state, comparison, progress)

    def settle(
        self, assembly: Assembly, step: Step[Admission], progress: Progress
    ) -> RefittedModel:
        """Most likely values and process noise with what was admitted."""
        from spiral.inference.strategies.innovation import settle

        return settle(assembly, step, progress)

    def admit(
        self, assembly: Assembly, fit_state: FitState, label: str, progress: Progress
    ) -> RefittedModel:
        """Most likely values and process noise with an effect that the user names."""
        from spiral.inference.strategies.innovation import admit

        return admit(assembly, fit_state, label, progress)
