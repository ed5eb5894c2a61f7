"""The loop: guard, evidence, gates, roll-back, refit, round by round (the paper's Algorithm 1)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from spiral.assembly import Assembly, to_model
from spiral.compare import judged, last_stage, prepared
from spiral.effect import Effect
from spiral.evidence import Standing, all_samples
from spiral.problem import Problem, Progress, silent
from spiral.published import PAPER
from spiral.run import Comparison, Round, Run, Stopped, Verdict
from spiral.strategy import Begun, Settled, Step, Strategy
from spiral.threads import one_blas_thread
from spiral.trajectories import SHOOTING
from spiral.verdict import advice_for, seed_verdict

OnRound = Callable[[Round], None]


@dataclass(frozen=True)
class Checkpoint:
    """All that the loop needs to go on: the rounds so far and where the study stands."""

    rounds: tuple[Round, ...]
    standing: Standing


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
    strategy = SHOOTING if problem.published is None else PAPER
    clock = time.perf_counter()
    begun = strategy.begin(problem, progress)
    if resume is not None:
        for found in resume.rounds[:-1]:
            tell(found)
        rounds = list(resume.rounds)
        return _loop(strategy, begun.assembly, resume.standing, rounds, progress, tell, keep)
    seconds = time.perf_counter() - clock
    rounds = [Round(0, (), {}, {}, (), begun.comparison, seconds, details=begun.details)]
    if begun.refused:
        tell(rounds[0])
        return _refusal(begun, rounds[0])
    return _loop(strategy, begun.assembly, begun.standing, rounds, progress, tell, keep)


def _loop(
    strategy: Strategy,
    assembly: Assembly,
    standing: Standing,
    rounds: list[Round],
    progress: Progress,
    tell: OnRound,
    keep: Keep,
) -> Run:
    settings = assembly.problem.settings
    stopped: Stopped = "max_rounds"
    while True:
        keep(Checkpoint(tuple(rounds), standing))
        number = len(rounds)
        clock = time.perf_counter()
        if number > settings.max_rounds:
            tell(rounds[-1])
            break
        step = strategy.propose(assembly, standing, rounds[-1].comparison, number, progress)
        rounds[-1] = replace(
            rounds[-1],
            suggestions=step.suggestions,
            rejected=dict(step.rejected),
            details={**rounds[-1].details, **step.details},
        )
        tell(rounds[-1])
        if not step.admitted:
            stopped = step.stopped
            break
        settled = strategy.settle(assembly, step, progress)
        standing = settled.standing
        rounds.append(_round(number, step, settled, time.perf_counter() - clock))
    verdict = seed_verdict(rounds, stopped, settings.whiteness_level)
    return Run(
        verdict, stopped, tuple(rounds), rounds[-1].comparison.model,
        advice_for(verdict, stopped, rounds, ()),
    )  # fmt: skip


def _round(number: int, step: Step, settled: Settled, seconds: float) -> Round:
    return Round(
        number=number,
        admitted=step.admitted,
        aliases=dict(step.aliases),
        rejected={},
        suggestions=(),
        comparison=settled.comparison,
        seconds=seconds,
        second_order=step.second_order,
        meaning=step.meaning,
        retired=settled.retired,
        details=settled.details,
    )


def _refusal(begun: Begun, first: Round) -> Run:
    standing = begun.standing
    model = to_model(begun.assembly, standing.labels, standing.values, {})
    verdict: Verdict = "not_identifiable"
    return Run(
        verdict, "not_identifiable", (first,), model,
        advice_for(verdict, "not_identifiable", [first], begun.groups), begun.groups,
    )  # fmt: skip


@one_blas_thread
def add(
    problem: Problem, effects: tuple[Effect, ...], progress: Progress = silent
) -> tuple[Comparison, Comparison, Run]:
    """Fit the model, then the model plus the effects, on all samples; before and after."""
    clock = time.perf_counter()
    assembly, before_standing = prepared(problem, effects)
    masks = all_samples(assembly)
    progress("fitting before")
    stage = last_stage(assembly, before_standing, masks)
    before_standing = replace(before_standing, values=stage.fitted.point.values)
    before = judged(assembly, before_standing, stage, progress)
    rounds = [Round(0, (), {}, {}, (), before, time.perf_counter() - clock)]
    clock = time.perf_counter()
    standing = _with_effects(assembly, before_standing, effects, progress)
    progress("fitting after")
    stage = last_stage(assembly, standing, masks)
    standing = replace(standing, values=stage.fitted.point.values)
    after = judged(assembly, standing, stage, progress)
    labels = tuple(e.label for e in effects)
    meaning = "; ".join(e.meaning() for e in effects)
    rounds.append(Round(1, labels, {}, {}, (), after, time.perf_counter() - clock, meaning=meaning))
    run = Run("effect_missing", "max_rounds", tuple(rounds), after.model, "added by hand")
    return before, after, run


def _with_effects(
    assembly: Assembly, standing: Standing, effects: tuple[Effect, ...], progress: Progress
) -> Standing:
    """Admit the effects one by one at the shortest windows, without gates, for a good start."""
    from spiral.evidence import admit, grown, score_stage, stage_lengths

    for effect in effects:
        progress(f"adding {effect.label}")
        length = stage_lengths(assembly)[:1]
        stage = next(iter(grown(assembly, standing, all_samples(assembly), length)))
        evidence = score_stage(assembly, standing, stage)
        chosen = next(r for r in evidence.ranked if r.variant.original.label == effect.label)
        standing = admit(assembly, standing, stage, chosen).standing
    return standing
