"""The interface of a strategy: how it begins a study, proposes effects, and refits the model.

The loop (``spiral.inference.discover``) is the same for all strategies and calls only this
interface. The work of the shipped strategies is done by the modules of this folder; their classes
are plugins (``plugins/strategies``), which import little so that every command can list them.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from spiral.types.plugin import Plugin

if TYPE_CHECKING:
    from spiral.inference.evidence.assembly import Assembly
    from spiral.inference.evidence.fit_state import FitState
    from spiral.inference.problem import Problem, Progress
    from spiral.types.effect import Effect
    from spiral.types.model import Model
    from spiral.types.run import Comparison, Diagnosis, StopReason, Suggestion

Result = TypeVar("Result", covariant=True)
"""What a strategy hands from its proposal to its refit, of a type of its own."""


@dataclass(frozen=True)
class StartedStudy:
    """A study ready for its first round: compiled, its seed fitted and compared.

    ``groups`` are effects of the seed that the record cannot tell apart. Where that is ``refused``
    the loop ends there, where it is ``doubtful`` (of a fit that explains too little to say) only if
    no candidate passes; else ``details["tied"]`` says which parameters keep given or fitted values.
    """

    assembly: Assembly
    fit_state: FitState
    comparison: Comparison
    details: Mapping[str, Any] = field(default_factory=dict)
    refused: bool = False
    doubtful: bool = False
    groups: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Step(Generic[Result]):
    """The outcome of ranking in one round: suggestions, and the effects to admit, if any.

    ``admitted`` are labels of effects, none where the loop ends here, for the reason ``stopped``.
    ``second_order`` and ``meaning`` describe what is admitted; ``details`` log how it came about;
    ``result`` is what the strategy needs to settle, absent where there is nothing to settle.
    ``again`` is the model as it is, where the strategy came to fit that otherwise before it ranked
    candidates.
    """

    suggestions: tuple[Suggestion, ...]
    rejected: Mapping[str, str]
    admitted: tuple[str, ...] = ()
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    second_order: bool = False
    meaning: str = ""
    stopped: StopReason = "no_candidate"
    details: Mapping[str, Any] = field(default_factory=dict)
    result: Result | None = None
    again: RefittedModel | None = None

    def required_result(self) -> Result:
        """``result``, which ``settle`` needs; an error for a step that has none."""
        assert self.result is not None
        return self.result


@dataclass(frozen=True)
class RefittedModel:
    """The model after an admission, refitted and compared; ``retired`` effects were dropped.

    ``log_likelihood`` is that of the refit, where the strategy has one and it is finite.
    """

    fit_state: FitState
    comparison: Comparison
    retired: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    log_likelihood: float = -math.inf


@dataclass(frozen=True)
class RemainingLookAlikes:
    """Effects that even the final model cannot distinguish from an admitted one, by its label.

    ``step`` puts a likelier one in an effect's place, where there is one.
    """

    aliases: Mapping[str, tuple[str, ...]]
    step: Step[Any] | None = None


@dataclass(frozen=True)
class AddedEffects:
    """A model before and after effects added by hand, and the seconds that the first fit took."""

    before: Comparison
    after: Comparison
    seconds: float


class Strategy(Plugin):
    """A method to find missing effects: what counts as evidence, and how models are fitted.

    Its fields are the configuration's ``strategy.FIELD``. A field ``gate`` (a tuple of gates),
    ``derivative``, ``learner`` or ``library`` takes what the option of that name chooses; an option
    that the strategy of a study has no field for is refused.

    ``everywhere`` : candidates are asked for at every place where they fit, not at the system's
    first port alone. ``curves`` : learned curves are tried where no candidate explains what is
    left. ``by_hand`` : a person may admit any candidate in place of the one proposed, as the page
    does; such a strategy has ``choose``. ``by_name`` : a person may add an effect that no step
    proposed (``spiral add``); such a strategy has ``admit``, or ``add``. ``ignores`` : settings of
    all studies that this kind of evidence never looks at; given with it they are refused.
    """

    kind: ClassVar[str] = "strategy"
    everywhere: ClassVar[bool] = False
    curves: ClassVar[bool] = False
    by_hand: ClassVar[bool] = False
    by_name: ClassVar[bool] = False
    ignores: ClassVar[tuple[str, ...]] = ()

    # --- what every strategy has ---

    @abstractmethod
    def begin(self, problem: Problem, progress: Progress) -> StartedStudy:
        """Compile the study, fit and compare its seed."""

    @abstractmethod
    def propose(
        self,
        assembly: Assembly,
        fit_state: FitState,
        comparison: Comparison,
        number: int,
        progress: Progress,
    ) -> Step[Any]:
        """What round ``number`` (from 1) admits, or why it admits nothing."""

    @abstractmethod
    def settle(self, assembly: Assembly, step: Step[Any], progress: Progress) -> RefittedModel:
        """The model with the effects that a step admits, refitted and compared.

        ``strategy=likelihood`` has refitted already in ``propose`` and hands that result over.
        """

    # --- what it may have ---

    def candidates(self, model: Model, named: tuple[str, ...] | None) -> tuple[Effect, ...] | None:
        """Candidates of the strategy's own making (of its library), ``named`` among them only.

        ``None`` : those that fit the system, as the question names them.
        """
        return None

    def ranked(self, step: Step[Any]) -> tuple[Suggestion, ...]:
        """All that a step scored, by its evidence; a step's suggestions may be only the best."""
        return step.suggestions

    def choose(
        self, assembly: Assembly, fit_state: FitState, step: Step[Any], label: str
    ) -> Step[Any]:
        """The step with another candidate in place of its own; asked where ``by_hand`` is set."""
        raise NotImplementedError

    def admit(
        self, assembly: Assembly, fit_state: FitState, label: str, progress: Progress
    ) -> RefittedModel:
        """The model with another candidate, refitted and compared; asked where ``by_name`` is."""
        raise NotImplementedError

    def ask_again(
        self, assembly: Assembly, fit_state: FitState, comparison: Comparison,
        aliases: Mapping[str, tuple[str, ...]], promising: Mapping[str, tuple[Suggestion, ...]],
        progress: Progress,
    ) -> RemainingLookAlikes:  # fmt: skip
        """Which look-alikes the final model can still not distinguish from its effects.

        ``aliases`` by admitted effect as they were when it was admitted, ``promising`` itself and
        what else was worth its penalty then, the best first.
        """
        return RemainingLookAlikes(aliases)

    def compare(self, problem: Problem, progress: Progress) -> Comparison:
        """The model as it is, fitted and compared: that of the beginning, without candidates."""
        return self.begin(replace(problem, candidates=()), progress).comparison

    def add(
        self, problem: Problem, effects: tuple[Effect, ...], progress: Progress
    ) -> AddedEffects | None:
        """Effects added by hand, all in one fit; ``None``: one after the other by ``admit``."""
        return None

    def diagnose(self, problem: Problem, progress: Progress) -> Diagnosis | None:
        """A diagnosis of the strategy's own making; ``None``: that of its first round."""
        return None
