"""What a kind of evidence supplies to the loop: a beginning, proposals, and refits.

The loop (``spiral.inference.discover``) is the same for all; strategies differ only in these three
steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from spiral.inference.evidence.assembly import Assembly, effects_of
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.problem import Problem, Progress
from spiral.types.effect import Effect
from spiral.types.run import Comparison, Stopped, Suggestion


@dataclass(frozen=True)
class Begun:
    """A study ready for its first round: compiled, its seed fitted and compared.

    ``groups`` are effects of the seed that the record cannot tell apart; the loop then refuses.
    """

    assembly: Assembly
    standing: FitState
    comparison: Comparison
    details: Mapping[str, Any] = field(default_factory=dict)
    refused: bool = False
    groups: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Step:
    """What a strategy found in one round.

    ``admitted`` are labels of effects, none where the loop ends here, for the reason ``stopped``.
    ``second_order`` and ``meaning`` describe what is admitted; ``details`` log how it came about;
    ``found`` is what the strategy itself needs to settle.
    """

    suggestions: tuple[Suggestion, ...]
    rejected: Mapping[str, str]
    admitted: tuple[str, ...] = ()
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    second_order: bool = False
    meaning: str = ""
    stopped: Stopped = "no_candidate"
    details: Mapping[str, Any] = field(default_factory=dict)
    found: Any = None


@dataclass(frozen=True)
class Settled:
    """The model after an admission, refitted and compared; effects let go again."""

    standing: FitState
    comparison: Comparison
    retired: tuple[str, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Strategy:
    """One kind of evidence.

    ``begin(problem, progress)`` fits the seed; ``propose(assembly, standing, comparison, number,
    progress)`` finds what round ``number`` (from 1) admits; ``settle(assembly, step, progress)``
    refits with it.

    Where any candidate may be admitted by hand, ``ranked(step)`` lists all that a step scored, and
    ``choose(assembly, standing, step, label)`` puts one in place of its own proposal;
    ``admit(assembly, standing, label, progress)`` refits with one that nothing was asked about.
    """

    name: str
    begin: Callable[[Problem, Progress], Begun]
    propose: Callable[[Assembly, FitState, Comparison, int, Progress], Step]
    settle: Callable[[Assembly, Step, Progress], Settled]
    ranked: Callable[[Step], tuple[Suggestion, ...]] | None = None
    choose: Callable[[Assembly, FitState, Step, str], Step] | None = None
    admit: Callable[[Assembly, FitState, str, Progress], Settled] | None = None


def second_order(effect: Effect, assembly: Assembly, state: FitState) -> bool:
    """Whether an effect is what one that the state holds leaves beyond leading order."""
    held = effects_of(assembly, state.labels)
    return any(effect.plugin_name() in e.leaves for e in held)
