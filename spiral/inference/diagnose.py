"""Diagnose: compare, say where the model fails, and rank what is missing; changes nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.threads import one_blas_thread
from spiral.inference.advice import advice_for
from spiral.inference.evidence.admission import admit_candidate
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import (
    compare_fit,
    free_run_on_test,
    last_stage,
    prepare_study,
)
from spiral.inference.evidence.enlarge import transfer_fit_state
from spiral.inference.evidence.fit_state import FitState, all_samples, half_masks
from spiral.inference.evidence.free_run import fit_whole_records
from spiral.inference.identifiability.parameters import find_entanglement
from spiral.inference.likelihood.fitting import apply_integration_settings
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.rounds import strategy_for
from spiral.inference.strategies.base import Strategy
from spiral.inference.strategies.shooting.propose import find_unknown_curve
from spiral.inference.strategies.shooting.resonances import propose_with_own_states
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose_on_windows
from spiral.inference.verdict import seed_sentence, seed_verdict, verdict_sentence
from spiral.inference.where.regions import locate_failure
from spiral.types.run import Comparison, Diagnosis, Round, StopReason, Suggestion


@one_blas_thread
def diagnose(problem: Problem, progress: Progress = silent) -> Diagnosis:
    """The verdict on the model as it is, with ranked suggestions, by the problem's strategy."""
    strategy = strategy_for(problem)
    own = strategy.diagnose(problem, progress)
    return _diagnose_by_round(strategy, problem, progress) if own is None else own


def diagnose_on_windows(
    options: ShootingOptions, problem: Problem, progress: Progress
) -> Diagnosis:
    """The diagnosis from trajectories on windows.

    The candidates are scored on one half of the blocks and judged on the other, as in a round of
    ``discover``; the comparison is of the model fitted to all samples.
    """
    progress("compiling the model and all candidates")
    assembly, fit_state = prepare_study(problem)
    tangle = find_entanglement(assembly, fit_state)
    progress("fitting the model as it is")
    stage = last_stage(assembly, fit_state, all_samples(assembly))
    fit_state = replace(fit_state, values=stage.fitted.point.values)
    comparison = compare_fit(assembly, fit_state, stage, progress)
    first = Round(0, (), {}, {}, (), comparison, 0.0)
    if tangle is not None:
        return _tangled_diagnosis(assembly, comparison, tangle.groups, stage)
    masks = half_masks(assembly)
    proposal = propose_on_windows(options, assembly, fit_state, masks, 1, progress)
    white = comparison.whiteness_p >= problem.settings.whiteness_level
    proposal = propose_with_own_states(
        options, assembly, fit_state, proposal, white, masks, 1, progress
    )
    if proposal.wide is not None:
        fit_state, assembly = transfer_fit_state(fit_state, assembly, proposal.wide), proposal.wide
    return _windows_diagnosis(options, assembly, fit_state, comparison, proposal, first, progress)


def _diagnose_by_round(strategy: Strategy, problem: Problem, progress: Progress) -> Diagnosis:
    """The verdict after a strategy's first round; the test error with what it would admit."""
    begun = strategy.begin(problem, progress)
    comparison, fit_state, settings = begun.comparison, begun.fit_state, problem.settings
    first = Round(0, (), {}, {}, (), comparison, 0.0)
    step = None
    if not begun.refused:
        step = strategy.propose(begun.assembly, fit_state, comparison, 1, progress)
    if step is None or (begun.doubtful and not step.admitted):
        stage = fit_whole_records(begun.assembly, fit_state.labels, fit_state.values)
        return _tangled_diagnosis(begun.assembly, comparison, begun.groups, stage)
    if step.again is not None:
        fit_state, comparison = step.again.fit_state, step.again.comparison
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
        suggestions, advice = (best, *others), _add_advice(best)
    assembly = apply_integration_settings(begun.assembly, fit_state)
    stage = fit_whole_records(assembly, fit_state.labels, fit_state.values)
    return Diagnosis(
        verdict, comparison, suggestions, locate_failure(assembly, stage), advice, stage.length,
        step.stopped == "diverged", unknown=shape, left_out=begun.assembly.left_out,
        summary=seed_sentence(verdict, [first], settings), memory=memory,
    )  # fmt: skip


def _tangled_diagnosis(
    assembly: Assembly, comparison: Comparison, groups: tuple[tuple[str, ...], ...], stage: Stage
) -> Diagnosis:
    """The refusal of a record that cannot tell the model's own effects apart."""
    settings = assembly.problem.settings
    first = Round(0, (), {}, {}, (), comparison, 0.0)
    advice = advice_for("not_identifiable", "not_identifiable", [first], groups, settings)
    alike = tuple(Suggestion(g[0], "", g[1:], 1.0, 0.0, 1.0, 0.0) for g in groups)
    return Diagnosis(
        "not_identifiable",
        comparison,
        alike,
        locate_failure(assembly, stage),
        advice,
        stage.length,
        left_out=assembly.left_out,
        summary=verdict_sentence("not_identifiable", comparison, settings),
    )


def _add_advice(best: Suggestion) -> str:
    alike = f" (or {', '.join(best.aliases)}: this record cannot tell)" if best.aliases else ""
    return f"Add {best.effect}{alike}: {best.meaning}"


def _windows_diagnosis(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    comparison: Comparison,
    proposal: Proposal,
    first: Round,
    progress: Progress,
) -> Diagnosis:
    settings = assembly.problem.settings
    stopped: StopReason = "diverged" if proposal.diverged else "no_candidate"
    shape = None
    if proposal.admitted is None and comparison.whiteness_p < settings.whiteness_level:
        curve = find_unknown_curve(options, assembly, fit_state, proposal, comparison, 1, progress)
        shape = None if curve is None else curve.shape.as_dict()
        first = replace(first, details={} if shape is None else {"unknown": shape})
    verdict = seed_verdict(first, stopped, settings, proposal.admitted is not None)
    evidence = proposal.evidence
    before = comparison.test_error
    suggestions = _with_test_errors(options, assembly, fit_state, before, proposal, progress)
    if verdict == "nothing_missing":
        suggestions = ()
    shown = evidence.stage if evidence is not None else proposal.stages[-1]
    advice = advice_for(verdict, stopped, [first], (), settings)
    if verdict == "effect_missing":
        advice = _add_advice(next(iter(suggestions)))
    return Diagnosis(
        verdict,
        comparison,
        suggestions,
        locate_failure(assembly, shown),
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
    fit_state: FitState,
    before: float,
    proposal: Proposal,
    progress: Progress,
) -> tuple[Suggestion, ...]:
    """Work out the test error of the best suggestions, each admitted alone."""
    if proposal.evidence is None:
        return proposal.suggestions
    suggestions = []
    level = assembly.problem.settings.level
    by_label = {r.variant.original.label: r for r in proposal.evidence.ranked}
    for number, suggestion in enumerate(proposal.suggestions):
        if number >= options.tried or suggestion.wald_p_value > level:
            suggestions.append(suggestion)
            continue
        progress(f"trying {suggestion.effect} on the test record")
        if number == 0 and proposal.admitted is not None:
            wider = proposal.admitted.fit_state
        else:
            chosen = by_label[suggestion.effect]
            wider = admit_candidate(assembly, fit_state, proposal.evidence.stage, chosen).fit_state
        stage = last_stage(assembly, wider, all_samples(assembly))
        run = free_run_on_test(assembly, wider.labels, stage.fitted.point.values)
        after = None
        if run is not None:
            names = assembly.problem.model.system.observed
            after = float(np.mean([e.relative for e in run.errors(names).values()]))
        suggestions.append(replace(suggestion, test_error_before=before, test_error_after=after))
    return tuple(suggestions)
