"""The discovery loop: fit, rank candidates, test the best, admit it, refit; round by round."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.rounds import (
    Checkpoint,
    admit_step,
    conclude_study,
    rank_last_round,
    refuse_study,
    start_study,
    strategy_for,
)
from spiral.inference.strategies.base import AddedEffects, RefittedModel, Strategy
from spiral.inference.verdict import (
    interrupted_summary,
    missing_effects,
    seed_verdict,
    study_summary,
)
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError
from spiral.types.horizon import changes
from spiral.types.run import Comparison, Round, Run, StopReason, Verdict

OnRound = Callable[[Round], None]


Keep = Callable[[Checkpoint], None]


@one_blas_thread
def discover(
    problem: Problem,
    progress: Progress = silent,
    on_round: OnRound | None = None,
    keep: Keep | None = None,
    resume: Checkpoint | None = None,
) -> Run:
    """Find what the model is missing.

    The problem's strategy supplies the evidence; rounds, verdict and history are the same for all.

    Parameters
    ----------
    problem : the question.
    progress : told in words what is being done, and after every round what is known by then
        ("so far: ...").
    on_round : told of every round once its candidates are ranked.
    keep : given a checkpoint before every search; ``resume`` with it goes on from there, to the
        same result.
    """
    tell, keep = on_round or (lambda _: None), keep or (lambda _: None)
    strategy = strategy_for(problem)
    clock = time.perf_counter()
    begun = strategy.begin(problem, progress)
    at = resume or start_study(begun, time.perf_counter() - clock)
    if begun.refused:
        tell(at.rounds[0])
        return refuse_study(begun, at.rounds[0])
    for earlier in at.rounds[:-1]:
        tell(earlier)
    run = _run_rounds(strategy, begun.assembly, at, progress, tell, keep)
    if begun.doubtful and not any(r.admitted for r in run.rounds):
        return refuse_study(begun, run.rounds[-1])
    return run


def _run_rounds(
    strategy: Strategy,
    assembly: Assembly,
    at: Checkpoint,
    progress: Progress,
    tell: OnRound,
    keep: Keep,
) -> Run:
    settings = assembly.problem.settings
    stopped: StopReason = "max_rounds"
    if settings.seconds > 0:
        progress = _progress_until(time.perf_counter() + settings.seconds, progress)
    while True:
        keep(at)
        clock = time.perf_counter()
        if len(at.rounds) > settings.max_rounds:
            tell(at.rounds[-1])
            break
        try:
            at, step = rank_last_round(strategy, assembly, at, progress)
            tell(at.rounds[-1])
            if not step.admitted:
                stopped = step.stopped
                break
            at = admit_step(strategy, assembly, at, step, progress, time.perf_counter() - clock)
            progress(f"so far: {interrupted_summary(at.rounds, settings)}")
        except _TimeOverError:
            stopped = "max_seconds"
            tell(at.rounds[-1])
            break
    return conclude_study(at, stopped, settings)


class _TimeOverError(Exception):
    """``settings.seconds`` are over."""


def _progress_until(end: float, progress: Progress) -> Progress:
    """A progress function that ends the search once a moment has passed (``time.perf_counter``)."""

    def tell_in_time(message: str) -> None:
        if time.perf_counter() > end:
            raise _TimeOverError
        progress(message)

    return tell_in_time


@one_blas_thread
def add(
    problem: Problem, effects: tuple[Effect, ...], progress: Progress = silent
) -> tuple[Comparison, Comparison, Run]:
    """Fit the model, then the model plus the effects, on all samples; before and after."""
    clock = time.perf_counter()
    strategy = strategy_for(problem)
    added = strategy.add(problem, effects, progress) or _add_by_name(
        strategy, problem, effects, progress
    )
    before, after, spent = added.before, added.after, added.seconds
    rounds = [Round(0, (), {}, {}, (), before, spent)]
    labels = tuple(e.label for e in effects)
    meaning = "; ".join(e.meaning() for e in effects)
    rounds.append(Round(1, labels, {}, {}, (), after, time.perf_counter() - clock - spent,
                        meaning=meaning,
                        changes=changes(before.unseen, after.unseen)))  # fmt: skip
    missing = missing_effects(rounds, problem.settings)
    verdict: Verdict = (
        "effect_missing" if missing else seed_verdict(rounds[0], "no_candidate", problem.settings)
    )
    run = Run(
        verdict, "max_rounds", tuple(rounds), after.model, "The effects were added by hand.",
        missing=missing, summary=study_summary(rounds, verdict, "max_rounds", problem.settings),
    )  # fmt: skip
    return before, after, run


def _add_by_name(
    strategy: Strategy, problem: Problem, effects: tuple[Effect, ...], progress: Progress
) -> AddedEffects:
    _check_can_add(strategy, problem, [e.label for e in effects])
    clock = time.perf_counter()
    begun = strategy.begin(replace(problem, candidates=effects), progress)
    settled, spent = RefittedModel(begun.fit_state, begun.comparison), time.perf_counter() - clock
    for effect in effects:
        settled = strategy.admit(begun.assembly, settled.fit_state, effect.label, progress)
    return AddedEffects(begun.comparison, settled.comparison, spent)


def _check_can_add(strategy: Strategy, problem: Problem, labels: list[str]) -> None:
    """Refuse, before anything is fitted, what a strategy cannot add."""
    given = f"add {' '.join(labels)} with strategy={strategy.plugin_name()}"
    if not strategy.by_name:
        raise ConfigError(
            given, "a strategy that can add what a person names",
            "strategy=likelihood, or spiral compare effect=[...]",
        )  # fmt: skip
    known = strategy.candidates(problem.model, None)
    if known is not None and not {e.label for e in known} >= set(labels):
        names = ", ".join(e.label for e in known)
        advice = "another library=, or strategy=likelihood"
        raise ConfigError(given, f"its own candidates: {names}", advice)
