"""The loop: guard, evidence, gates, roll-back, refit, round by round (the paper's Algorithm 1)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from spiral.assembly import Assembly, to_model
from spiral.compare import judged, last_stage, prepared
from spiral.effect import Effect
from spiral.evidence import Masks, Standing, all_samples, half_masks
from spiral.identifiability import Entanglement, entangled
from spiral.problem import Problem, Progress, silent
from spiral.retire import let_go, superfluous
from spiral.run import Comparison, Round, Run, Stopped, Verdict
from spiral.suggest import Proposal, propose
from spiral.threads import one_blas_thread
from spiral.verdict import advice_for, seed_verdict

OnRound = Callable[[Round], None]

SECOND_ORDER = ("cross_damping", "speed_stiffness")
"""Effects that a hidden tilt leaves beyond leading order (design, fact 3)."""


@one_blas_thread
def discover(problem: Problem, progress: Progress = silent, on_round: OnRound | None = None) -> Run:
    """Find what the model is missing.

    Every round fits on one half of the blocks, scores all candidates, passes them through the
    gates on the other half, and reports estimates refitted on that other half.
    """
    tell = on_round or (lambda _: None)
    progress("compiling the model and all candidates")
    clock = time.perf_counter()
    assembly, standing = prepared(problem)
    masks = half_masks(assembly)
    tangle = entangled(assembly, standing)
    comparison = _judge(assembly, standing, masks[1], progress)
    rounds = [Round(0, (), {}, {}, (), comparison, time.perf_counter() - clock)]
    if tangle is not None:
        tell(rounds[0])
        return _refusal(assembly, standing, rounds[0], tangle)
    return _loop(assembly, standing, rounds, masks, progress, tell)


def _loop(
    assembly: Assembly,
    standing: Standing,
    rounds: list[Round],
    masks: tuple[Masks, Masks],
    progress: Progress,
    tell: OnRound,
) -> Run:
    settings = assembly.problem.settings
    stopped: Stopped = "max_rounds"
    while True:
        number = len(rounds)
        clock = time.perf_counter()
        if number > settings.max_rounds:
            tell(rounds[-1])
            break
        proposal = propose(assembly, standing, masks, number, progress)
        rounds[-1] = replace(
            rounds[-1], suggestions=proposal.suggestions, rejected=dict(proposal.rejected)
        )
        tell(rounds[-1])
        if proposal.admitted is None:
            stopped = _why_stopped(proposal, rounds[-1].comparison, settings.whiteness_level)
            break
        standing, comparison, gone = _settled(assembly, proposal, masks[1], progress)
        taken = time.perf_counter() - clock
        rounds.append(replace(_round(number, proposal, comparison, rounds, taken), retired=gone))
    verdict = seed_verdict(rounds, stopped, settings.whiteness_level)
    return Run(
        verdict, stopped, tuple(rounds), rounds[-1].comparison.model,
        advice_for(verdict, stopped, rounds, ()),
    )  # fmt: skip


def _settled(
    assembly: Assembly, proposal: Proposal, mask: Masks, progress: Progress
) -> tuple[Standing, Comparison, tuple[str, ...]]:
    """Refit and compare after an admission, letting go of effects it has made superfluous."""
    latest = proposal.admitted
    assert latest is not None
    assert proposal.evidence is not None
    comparison = _judge(assembly, latest.standing, mask, progress)
    gone = superfluous(assembly, latest, comparison.model, mask, proposal.evidence.block)
    if not gone:
        return latest.standing, comparison, ()
    standing = let_go(latest.standing, gone)
    comparison = _judge(assembly, standing, mask, progress)
    return standing, comparison, tuple(assembly.variant(x).original.label for x in gone)


def _judge(
    assembly: Assembly,
    standing: Standing,
    mask: Masks,
    progress: Progress,
) -> Comparison:
    """Refit on the half that did not select, and compare."""
    progress("refitting on the half that did not select")
    stage = last_stage(assembly, standing, mask)
    refitted = replace(standing, values=stage.fitted.point.values)
    return judged(assembly, refitted, stage, progress)


def _why_stopped(proposal: Proposal, comparison: Comparison, level: float) -> Stopped:
    if proposal.diverged:
        return "diverged"
    return "whiteness" if comparison.whiteness_p >= level else "no_candidate"


def _round(
    number: int, proposal: Proposal, comparison: Comparison, rounds: list[Round], seconds: float
) -> Round:
    assert proposal.admitted is not None
    effect = proposal.admitted.variant.original
    mediated = any("gyroscopic" in r.admitted for r in rounds)
    return Round(
        number=number,
        admitted=(effect.label,),
        aliases={effect.label: proposal.aliases},
        rejected={},
        suggestions=(),
        comparison=comparison,
        seconds=seconds,
        second_order=mediated and effect.plugin_name() in SECOND_ORDER,
        meaning=effect.meaning(),
    )


def _refusal(assembly: Assembly, standing: Standing, first: Round, tangle: Entanglement) -> Run:
    model = to_model(assembly, standing.labels, standing.values, {})
    verdict: Verdict = "not_identifiable"
    return Run(
        verdict, "not_identifiable", (first,), model,
        advice_for(verdict, "not_identifiable", [first], tangle.groups), tangle.groups,
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
