"""The loop: guard, evidence, gates, roll-back, refit, round by round (the paper's Algorithm 1)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from spiral.engine.growth import Stage
from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.admission import with_effects
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import judged, last_stage, prepared
from spiral.inference.evidence.fit_state import FitState, all_samples
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.rounds import (
    Checkpoint,
    concluded,
    looked,
    refused,
    started,
    strategy_for,
    turned,
)
from spiral.inference.strategies.base import Settled, Strategy
from spiral.inference.strategies.resolved import widened
from spiral.inference.unknown.holding import carried, having, holding
from spiral.types.effect import Effect
from spiral.types.horizon import changes
from spiral.types.run import Comparison, Round, Run, Stopped

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
    progress : told in words what is being done.
    on_round : told of every round once its candidates are ranked.
    keep : given a checkpoint before every search; ``resume`` with it goes on from there, to the
        same result.
    """
    tell, keep = on_round or (lambda _: None), keep or (lambda _: None)
    strategy = strategy_for(problem)
    clock = time.perf_counter()
    begun = strategy.begin(problem, progress)
    if resume is not None:
        for found in resume.rounds[:-1]:
            tell(found)
        return _loop(strategy, begun.assembly, resume, progress, tell, keep)
    at = started(begun, time.perf_counter() - clock)
    if begun.refused:
        tell(at.rounds[0])
        return refused(begun, at.rounds[0])
    return _loop(strategy, begun.assembly, at, progress, tell, keep)


def _loop(
    strategy: Strategy,
    assembly: Assembly,
    at: Checkpoint,
    progress: Progress,
    tell: OnRound,
    keep: Keep,
) -> Run:
    settings = assembly.problem.settings
    stopped: Stopped = "max_rounds"
    while True:
        keep(at)
        clock = time.perf_counter()
        if len(at.rounds) > settings.max_rounds:
            tell(at.rounds[-1])
            break
        at, step = looked(strategy, assembly, at, progress)
        tell(at.rounds[-1])
        if not step.admitted:
            stopped = step.stopped
            break
        at = turned(strategy, assembly, at, step, progress, time.perf_counter() - clock)
    return concluded(at, stopped, settings)


@one_blas_thread
def add(
    problem: Problem, effects: tuple[Effect, ...], progress: Progress = silent
) -> tuple[Comparison, Comparison, Run]:
    """Fit the model, then the model plus the effects, on all samples; before and after."""
    clock = time.perf_counter()
    if strategy_for(problem).admit is None:
        before, after, spent = _added_on_windows(problem, effects, progress)
    else:
        before, after, spent = _added(strategy_for(problem), problem, effects, progress)
    rounds = [Round(0, (), {}, {}, (), before, spent)]
    labels = tuple(e.label for e in effects)
    meaning = "; ".join(e.meaning() for e in effects)
    rounds.append(Round(1, labels, {}, {}, (), after, time.perf_counter() - clock - spent,
                        meaning=meaning,
                        changes=changes(before.unseen, after.unseen)))  # fmt: skip
    run = Run(
        "effect_missing",
        "max_rounds",
        tuple(rounds),
        after.model,
        "The effects were added by hand.",
    )
    return before, after, run


Added = tuple[Comparison, Comparison, float]
"""The comparisons before and after, and the seconds that the first took."""


def _added(
    strategy: Strategy, problem: Problem, effects: tuple[Effect, ...], progress: Progress
) -> Added:
    assert strategy.admit is not None
    clock = time.perf_counter()
    begun = strategy.begin(replace(problem, candidates=effects), progress)
    settled, spent = Settled(begun.standing, begun.comparison), time.perf_counter() - clock
    for effect in effects:
        settled = strategy.admit(begun.assembly, settled.standing, effect.label, progress)
    return begun.comparison, settled.comparison, spent


def _added_on_windows(problem: Problem, effects: tuple[Effect, ...], progress: Progress) -> Added:
    clock = time.perf_counter()
    assembly, before_standing = prepared(problem, effects)
    masks = all_samples(assembly)
    progress("fitting before")
    stage = last_stage(assembly, before_standing, masks)
    before_standing = replace(before_standing, values=stage.fitted.point.values)
    before = judged(assembly, before_standing, stage, progress)
    spent = time.perf_counter() - clock
    assembly, standing = _with_all(assembly, before_standing, stage, effects, progress)
    progress("fitting after")
    stage = last_stage(assembly, standing, masks)
    standing = replace(standing, values=stage.fitted.point.values)
    return before, judged(assembly, standing, stage, progress), spent


def _with_all(
    assembly: Assembly,
    standing: FitState,
    stage: Stage,
    effects: tuple[Effect, ...],
    progress: Progress,
) -> tuple[Assembly, FitState]:
    """Admit effects without gates; those with states of their own bring a study that holds them.

    Their frequencies are free from then on: beside an amplitude the long windows tell them well.
    """
    late = tuple(e for e in effects if e.states)
    if not late:
        return assembly, with_effects(assembly, standing, effects, progress)
    progress("resolving what is left into resonances and lags")
    wide, _ = widened(assembly, standing, stage, late)
    found = with_effects(wide, carried(standing, assembly, wide), effects, progress)
    final = having(assembly, found.labels)
    chosen = (v for v in final.variants if v.label in found.labels and v.original in late)
    tuned = tuple(k for v in chosen for k in v.tuned if k not in found.freed)
    found = replace(carried(found, wide, final), freed=(*found.freed, *tuned))
    return holding(final, found), found
