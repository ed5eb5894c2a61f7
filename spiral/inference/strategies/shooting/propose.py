"""``strategy=shooting``: evidence from trajectories, fitted on windows.

Every round fits on one half of the blocks, scores all candidates, passes them through the gates
on the other half, and reports estimates refitted on that other half.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from spiral.engine.growth import Stage
from spiral.inference.evidence.admission import (
    AdmittedEffect,
    admit_candidate,
    drop_effects,
    is_second_order_remainder,
    with_effects,
)
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import compare_fit, last_stage, prepare_study
from spiral.inference.evidence.enlarge import (
    enlarge,
    enlarge_for,
    transfer_admission,
    transfer_fit_state,
)
from spiral.inference.evidence.fit_state import FitState, Masks, all_samples, half_masks
from spiral.inference.evidence.scoring import amplitude_keys
from spiral.inference.identifiability.parameters import find_entanglement
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import AddedEffects, RefittedModel, StartedStudy, Step
from spiral.inference.strategies.shooting.resonances import propose_with_own_states, widen_study
from spiral.inference.strategies.shooting.retire import prefer_simplest_alias, superfluous_labels
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose_on_windows, suggestions_by_evidence
from spiral.inference.unknown.shape import LearnedEffect, find_unknown_shape, has_curves_to_try
from spiral.types.effect import Effect
from spiral.types.run import Comparison, StopReason, Suggestion


def begin(problem: Problem, progress: Progress) -> StartedStudy:
    """The seed fitted on growing windows of the half that judges."""
    progress("compiling the model and all candidates")
    assembly, fit_state = prepare_study(problem)
    tangle = find_entanglement(assembly, fit_state)
    comparison = _refit_and_compare(assembly, fit_state, half_masks(assembly)[1], progress)
    groups = () if tangle is None else tangle.groups
    return StartedStudy(assembly, fit_state, comparison, refused=tangle is not None, groups=groups)


def propose_candidate(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    comparison: Comparison,
    number: int,
    progress: Progress,
) -> Step[Proposal]:
    """The candidate that one half of the blocks selects and the other half confirms."""
    begun, assembly = assembly, enlarge_for(assembly, fit_state)
    masks = half_masks(assembly)
    proposal = propose_on_windows(options, assembly, fit_state, masks, number, progress)
    level = assembly.problem.settings.whiteness_level
    white = comparison.whiteness_p >= level
    proposal = propose_with_own_states(
        options, assembly, fit_state, proposal, white, masks, number, progress
    )
    proposal = prefer_simplest_alias(options, assembly, fit_state, proposal, masks[1])
    if proposal.admitted is not None:
        return _admitting_step(
            fit_state, assembly, _transfer_to_study(begun, proposal.wide or assembly, proposal)
        )
    stopped = _stop_reason(proposal, comparison, level)
    details = _step_details(proposal)
    curve = find_unknown_curve(options, assembly, fit_state, proposal, comparison, number, progress)
    if curve is not None:
        details["unknown"] = curve.shape.as_dict()
    if curve is not None and assembly.problem.settings.learned:
        step = _admitting_step(
            fit_state, assembly, _transfer_to_study(begun, curve.assembly, curve.proposal)
        )
        return replace(step, details={**step.details, **details})
    return Step(
        proposal.suggestions, proposal.rejected, stopped=stopped, details=details, result=proposal
    )


def find_unknown_curve(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    proposal: Proposal,
    comparison: Comparison,
    number: int,
    progress: Progress,
) -> LearnedEffect | None:
    """The shape of what no candidate explains; nothing where what is left is white.

    Where effects admitted before have led astray (the fit diverges, or the free run does), it
    starts from the seed.
    """
    white = comparison.whiteness_p >= assembly.problem.settings.whiteness_level
    seed = assembly.problem.model.labels
    astray = proposal.diverged or not np.isfinite(comparison.fit_error + comparison.test_error)
    if white or not has_curves_to_try(assembly) or (proposal.diverged and fit_state.labels == seed):
        return None
    return find_unknown_shape(
        options, assembly, fit_state, half_masks(assembly), number, progress, astray
    )


def _step_details(proposal: Proposal) -> dict[str, Any]:
    """What the record cannot separate, and amplitudes held at zero for it."""
    details: dict[str, Any] = {
        "not_separable": {k: list(v) for k, v in proposal.not_separable.items()}
    }
    if proposal.admitted is not None and proposal.admitted.held:
        details["held"] = list(proposal.admitted.held)
    return details


def _transfer_to_study(begun: Assembly, place: Assembly, proposal: Proposal) -> Proposal:
    """The proposal with its admission in the study that goes on, not in that of its evidence.

    That study has what was compiled at first and what the new fit state holds beyond it, without
    curves or resonances that were only tried, or that were let go.
    """
    admitted = proposal.admitted
    assert admitted is not None
    final = enlarge(begun, admitted.fit_state.labels)
    if final is place:
        return proposal
    return replace(proposal, admitted=transfer_admission(admitted, place, final))


def _admitting_step(fit_state: FitState, place: Assembly, proposal: Proposal) -> Step[Proposal]:
    assert proposal.admitted is not None
    effect = proposal.admitted.variant.original
    return Step(
        proposal.suggestions,
        proposal.rejected,
        admitted=(effect.label,),
        aliases={effect.label: proposal.aliases},
        second_order=is_second_order_remainder(effect, place, fit_state),
        meaning=effect.meaning(),
        details=_step_details(proposal),
        result=proposal,
    )


def ranked_suggestions(step: Step[Proposal]) -> tuple[Suggestion, ...]:
    """All candidates by their evidence on the same windows."""
    proposal = step.required_result()
    if proposal.evidence is None:
        return proposal.suggestions
    return suggestions_by_evidence(proposal.evidence, proposal.admitted, proposal.aliases)


def choose(
    assembly: Assembly, fit_state: FitState, step: Step[Proposal], label: str
) -> Step[Proposal]:
    """Another candidate at the windows on which all were scored; no gate is asked."""
    proposal = step.required_result()
    evidence = proposal.evidence
    assert evidence is not None
    begun, assembly = assembly, enlarge_for(assembly, fit_state)
    study, there = assembly, fit_state
    if proposal.wide is not None:
        study, there = proposal.wide, transfer_fit_state(fit_state, assembly, proposal.wide)
    wanted = next(r for r in evidence.ranked if r.variant.original.label == label)
    admitted = admit_candidate(study, there, evidence.stage, wanted)
    others = (*step.admitted, *proposal.aliases)
    aliases = tuple(o for o in others if o != label) if label in others else ()
    chosen = replace(proposal, admitted=admitted, aliases=aliases)
    return _admitting_step(fit_state, study, _transfer_to_study(begun, study, chosen))


def settle(assembly: Assembly, step: Step[Proposal], progress: Progress) -> RefittedModel:
    """Refit and compare after an admission, letting go of effects it has made superfluous."""
    proposal = step.required_result()
    latest = proposal.admitted
    assert latest is not None
    begun, assembly = assembly, enlarge_for(assembly, latest.fit_state)
    mask = half_masks(assembly)[1]
    assert proposal.evidence is not None
    comparison = _refit_and_compare(assembly, latest.fit_state, mask, progress)
    if not np.isfinite(comparison.chi2_per_dof):
        latest = replace(latest, fit_state=_with_zero_amplitudes(assembly, latest))
        comparison = _refit_and_compare(assembly, latest.fit_state, mask, progress)
    gone = superfluous_labels(assembly, latest, comparison.model, mask, proposal.evidence.block)
    if not gone:
        return RefittedModel(latest.fit_state, comparison, proposal.dropped)
    fit_state = drop_effects(assembly, latest.fit_state, gone)
    comparison = _refit_and_compare(assembly, fit_state, mask, progress)
    retired = tuple(assembly.variant(x).original.label for x in gone)
    fit_state = transfer_fit_state(fit_state, assembly, enlarge(begun, fit_state.labels))
    return RefittedModel(fit_state, comparison, (*proposal.dropped, *retired))


def _with_zero_amplitudes(assembly: Assembly, latest: AdmittedEffect) -> FitState:
    """The fit state with the new effect's amplitudes at zero, so that short windows converge.

    Fitted to long windows of a model that is far off, a softening spring may let the short windows
    of the other half run away; from zero they find their own value, and windows grow again.
    """
    values = latest.fit_state.values.copy()
    for key in amplitude_keys(assembly, latest.variant):
        values[:, assembly.study.index(key)] = 0.0
    return replace(latest.fit_state, values=values)


def _refit_and_compare(
    assembly: Assembly,
    fit_state: FitState,
    mask: Masks,
    progress: Progress,
) -> Comparison:
    """Refit on the half that did not select, and compare."""
    progress("refitting on the half that did not select")
    stage = last_stage(assembly, fit_state, mask)
    refitted = replace(fit_state, values=stage.fitted.point.values)
    return compare_fit(assembly, refitted, stage, progress)


def _stop_reason(proposal: Proposal, comparison: Comparison, level: float) -> StopReason:
    if proposal.diverged:
        return "diverged"
    return "whiteness" if comparison.whiteness_p >= level else "no_candidate"


def fit_before_and_after(
    problem: Problem, effects: tuple[Effect, ...], progress: Progress
) -> AddedEffects:
    """The model before and after effects added by hand, each fitted to all samples."""
    clock = time.perf_counter()
    assembly, fit_state_before = prepare_study(problem, effects)
    masks = all_samples(assembly)
    progress("fitting before")
    stage = last_stage(assembly, fit_state_before, masks)
    fit_state_before = replace(fit_state_before, values=stage.fitted.point.values)
    before = compare_fit(assembly, fit_state_before, stage, progress)
    spent = time.perf_counter() - clock
    assembly, fit_state = _admit_without_gates(assembly, fit_state_before, stage, effects, progress)
    progress("fitting after")
    stage = last_stage(assembly, fit_state, masks)
    fit_state = replace(fit_state, values=stage.fitted.point.values)
    return AddedEffects(before, compare_fit(assembly, fit_state, stage, progress), spent)


def _admit_without_gates(
    assembly: Assembly,
    fit_state: FitState,
    stage: Stage,
    effects: tuple[Effect, ...],
    progress: Progress,
) -> tuple[Assembly, FitState]:
    """Admit effects without gates; those with states of their own bring a study that holds them.

    Their frequencies are free from then on: beside an amplitude the long windows tell them well.
    """
    late = tuple(e for e in effects if e.states)
    if not late:
        return assembly, with_effects(assembly, fit_state, effects, progress)
    progress("resolving what is left into resonances and lags")
    wide, _ = widen_study(assembly, fit_state, stage, late)
    wider = with_effects(wide, transfer_fit_state(fit_state, assembly, wide), effects, progress)
    final = enlarge(assembly, wider.labels)
    chosen = (v for v in final.variants if v.label in wider.labels and v.original in late)
    tuned = tuple(k for v in chosen for k in v.tuned if k not in wider.freed)
    wider = replace(transfer_fit_state(wider, wide, final), freed=(*wider.freed, *tuned))
    return enlarge_for(final, wider), wider
