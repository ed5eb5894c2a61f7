"""The evidence as published, from differentiated data."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spiral_plugins.derivatives.total_variation import TotalVariation
from spiral_plugins.gates.joint import KfoldMajority, PartialF, ValidationRollback
from spiral_plugins.gates.screening import BonferroniT, Contribution, CorrelationCluster
from spiral_plugins.gates.whiteness import LjungBox
from spiral_plugins.learners.tanh_network import TanhNetwork
from spiral_plugins.libraries.paper import Paper as PaperTable

from spiral.engine.gate import Gate
from spiral.inference.strategies.base import RefittedModel, StartedStudy, Step, Strategy
from spiral.inference.strategy_options import PaperOptions
from spiral.types.derivative import Derivative
from spiral.types.errors import ConfigError
from spiral.types.learner import Learner
from spiral.types.library import Library, terms_of

if TYPE_CHECKING:
    from spiral.inference.evidence.assembly import Assembly
    from spiral.inference.evidence.fit_state import FitState
    from spiral.inference.problem import Problem, Progress
    from spiral.types.effect import Effect
    from spiral.types.model import Model
    from spiral.types.run import Comparison


class Paper(PaperOptions, Strategy):
    """The evidence as published: differentiated data, a learned residual, a library, two gates.

    y'' - f(y, y', u) = Phi theta with terms Phi of a library: the residual is learned and projected
    onto them; Gate 1 (t) and Gate 2 (partial F with roll-back) admit (the paper's Algorithm 1).
    """

    by_name = True
    ignores = ("level", "alias_level", "learned")  # its gates have levels of their own

    gate: tuple[Gate, ...] = (
        LjungBox(), BonferroniT(), CorrelationCluster(), Contribution(), KfoldMajority(),
        PartialF(), ValidationRollback(),
    )  # fmt: skip
    derivative: Derivative = TotalVariation()
    learner: Learner = TanhNetwork()
    library: Library = PaperTable()

    def candidates(self, model: Model, named: tuple[str, ...] | None) -> tuple[Effect, ...]:
        """The effects of the library that the model has not.

        Raises
        ------
        ConfigError : none of those named is in the library.
        """
        effects = {t.effect.label: t.effect for t in terms_of(self.library, model.system)}
        offered = tuple(
            e
            for label, e in effects.items()
            if label not in model.labels and (named is None or label in named)
        )
        if named is not None and not offered:
            raise ConfigError(
                f"candidates=[{', '.join(named)}] with library={self.library.plugin_name()}",
                f"effects of that library: {', '.join(effects)}",
                "another library, or candidates left out",
            )
        return offered

    def begin(self, problem: Problem, progress: Progress) -> StartedStudy:
        """Derivatives, equations and columns of the study; the seed by joint least squares."""
        from spiral.inference.strategies.paper import begin

        return begin(self, problem, progress)

    def propose(
        self,
        assembly: Assembly,
        fit_state: FitState,
        comparison: Comparison,
        number: int,
        progress: Progress,
    ) -> Step[FitState]:
        """Algorithm 1 up to the annotation: what passes all gates."""
        from spiral.inference.strategies.paper import propose

        return propose(self, assembly, fit_state, progress)

    def settle(self, assembly: Assembly, step: Step[FitState], progress: Progress) -> RefittedModel:
        """Joint least squares with the admitted terms."""
        from spiral.inference.strategies.paper import settle

        return settle(self, assembly, step, progress)

    def admit(
        self, assembly: Assembly, fit_state: FitState, label: str, progress: Progress
    ) -> RefittedModel:
        """Joint least squares with the terms of an effect that the user names."""
        from spiral.inference.strategies.paper import admit

        return admit(self, assembly, fit_state, label, progress)
