"""Diagnose: compare, say where the model fails, and rank what is missing; changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.threads import one_blas_thread
from spiral.inference.advice import advice_for
from spiral.inference.evidence.admission import admit
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import judged, last_stage, prepared, test_run
from spiral.inference.evidence.fit_state import FitState, all_samples, half_masks
from spiral.inference.evidence.judge import whole
from spiral.inference.identifiability.parameters import entangled
from spiral.inference.likelihood.fitting import integrated
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.rounds import strategy_for
from spiral.inference.strategies.base import Strategy
from spiral.inference.strategies.resolved import remembered
from spiral.inference.strategies.shooting import curve_of
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose
from spiral.inference.unknown.holding import carried
from spiral.inference.verdict import seed_said, seed_verdict, verdict_sentence
from spiral.inference.where.regions import where
from spiral.types.run import Comparison, Diagnosis, Round, Stopped, Suggestion


@one_blas_thread
def diagnose(problem: Problem, progress: Progress = silent) -> Diagnosis:
    """The verdict on the model as it is, with ranked suggestions, by the problem's strategy."""
    strategy = strategy_for(problem)
    own = strategy.diagnose(problem, progress)
    return _by_a_round(strategy, problem, progress) if own is None else own


def on_windows(options: ShootingOptions, problem: Problem, progress: Progress) -> Diagnosis:
    """The diagnosis from trajectories on windows.

    The candidates are scored on one half of the blocks and judged on the other, as in a round of
    ``discover``; the comparison is of the model fitted to all samples.
    """
    progress("compiling the model and all candidates")
    assembly, standing = prepared(problem)
    tangle = entangled(assembly, standing)
    progress("fitting the model as it is")
    stage = last_stage(assembly, standing, all_samples(assembly))
    standing = replace(standing, values=stage.fitted.point.values)
    comparison = judged(assembly, standing, stage, progress)
    first = Round(0, (), {}, {}, (), comparison, 0.0)
    if tangle is not None:
        return _tangled(assembly, comparison, tangle.groups, stage)
    masks = half_masks(assembly)
    proposal = propose(options, assembly, standing, masks, 1, progress)
    white = comparison.whiteness_p >= problem.settings.whiteness_level
    proposal = remembered(options, assembly, standing, proposal, white, masks, 1, progress)
    if proposal.wide is not None:
        standing, assembly = carried(standing, assembly, proposal.wide), proposal.wide
    return _diagnosis(options, assembly, standing, comparison, proposal, first, progress)


def _by_a_round(strategy: Strategy, problem: Problem, progress: Progress) -> Diagnosis:
    """The verdict of a first round of a strategy; what it would admit is tried out."""
    begun = strategy.begin(problem, progress)
    comparison, standing, settings = begun.comparison, begun.standing, problem.settings
    first = Round(0, (), {}, {}, (), comparison, 0.0)
    step = None
    if not begun.refused:
        step = strategy.propose(begun.assembly, standing, comparison, 1, progress)
    if step is None or (begun.doubtful and not step.admitted):
        stage = whole(begun.assembly, standing.labels, standing.values)
        return _tangled(begun.assembly, comparison, begun.groups, stage)
    if step.again is not None:
        standing, comparison = step.again.standing, step.again.comparison
        first = replace(first, comparison=comparison)
    shape, memory = step.details.get("unknown"), step.details.get("memory")
    told = {"unknown": shape, "memory": memory, "tied": begun.details.get("tied")}
    first = replace(first, details={k: v for k, v in told.items() if v is not None})
    verdict = seed_verdict(first, step.stopped, settings, bool(step.admitted))
    suggestions = () if verdict == "nothing_missing" else step.suggestions
    advice = advice_for(verdict, step.stopped, [first], (), settings)
    if step.admitted and shape is None:
        after = strategy.settle(begun.assembly, step, progress).comparison.test_error
        best, *others = step.suggestions
        best = replace(best, test_error_before=comparison.test_error, test_error_after=after)
        suggestions, advice = (best, *others), _advice(best)
    assembly = integrated(begun.assembly, standing)
    stage = whole(assembly, standing.labels, standing.values)
    return Diagnosis(
        verdict, comparison, suggestions, where(assembly, stage), advice, stage.length,
        step.stopped == "diverged", unknown=shape, left_out=begun.assembly.left_out,
        summary=seed_said(verdict, [first], settings), memory=memory,
    )  # fmt: skip


def _tangled(
    assembly: Assembly, comparison: Comparison, groups: tuple[tuple[str, ...], ...], stage: Stage
) -> Diagnosis:
    """The refusal of a record that cannot tell the model's own effects apart."""
    settings = assembly.problem.settings
    first = Round(0, (), {}, {}, (), comparison, 0.0)
    advice = advice_for("not_identifiable", "not_identifiable", [first], groups, settings)
    alike = tuple(Suggestion(g[0], "", g[1:], 1.0, 0.0, 1.0, 0.0) for g in groups)
    return Diagnosis(
        "not_identifiable", comparison, alike, where(assembly, stage), advice, stage.length,
        left_out=assembly.left_out,
        summary=verdict_sentence("not_identifiable", comparison, settings),
    )  # fmt: skip


def _advice(best: Suggestion) -> str:
    alike = f" (or {', '.join(best.aliases)}: this record cannot tell)" if best.aliases else ""
    return f"Add {best.effect}{alike}: {best.meaning}"


def _diagnosis(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    comparison: Comparison,
    proposal: Proposal,
    first: Round,
    progress: Progress,
) -> Diagnosis:
    settings = assembly.problem.settings
    stopped: Stopped = "diverged" if proposal.diverged else "no_candidate"
    shape = None
    if proposal.admitted is None and comparison.whiteness_p < settings.whiteness_level:
        found = curve_of(options, assembly, standing, proposal, comparison, 1, progress)
        shape = None if found is None else found.shape.as_dict()
        first = replace(first, details={} if shape is None else {"unknown": shape})
    verdict = seed_verdict(first, stopped, settings, proposal.admitted is not None)
    evidence = proposal.evidence
    before = comparison.test_error
    suggestions = _with_test_errors(options, assembly, standing, before, proposal, progress)
    if verdict == "nothing_missing":
        suggestions = ()
    shown = evidence.stage if evidence is not None else proposal.stages[-1]
    advice = advice_for(verdict, stopped, [first], (), settings)
    if verdict == "effect_missing":
        advice = _advice(next(iter(suggestions)))
    return Diagnosis(
        verdict,
        comparison,
        suggestions,
        where(assembly, shown),
        advice,
        shown.length,
        proposal.diverged,
        proposal.not_separable,
        shape,
        assembly.left_out,
        verdict_sentence(verdict, comparison, settings),
    )


def _with_test_errors(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    before: float,
    proposal: Proposal,
    progress: Progress,
) -> tuple[Suggestion, ...]:
    """Work out the test error of the best suggestions, each admitted alone."""
    if proposal.evidence is None:
        return proposal.suggestions
    found = []
    level = assembly.problem.settings.level
    by_label = {r.variant.original.label: r for r in proposal.evidence.ranked}
    for number, suggestion in enumerate(proposal.suggestions):
        if number >= options.tried or suggestion.wald_p_value > level:
            found.append(suggestion)
            continue
        progress(f"trying {suggestion.effect} on the test record")
        if number == 0 and proposal.admitted is not None:
            wider = proposal.admitted.standing
        else:
            chosen = by_label[suggestion.effect]
            wider = admit(assembly, standing, proposal.evidence.stage, chosen).standing
        stage = last_stage(assembly, wider, all_samples(assembly))
        run = test_run(assembly, wider.labels, stage.fitted.point.values)
        after = None
        if run is not None:
            names = assembly.problem.model.system.observed
            after = float(np.mean([e.relative for e in run.errors(names).values()]))
        found.append(replace(suggestion, test_error_before=before, test_error_after=after))
    return tuple(found)
