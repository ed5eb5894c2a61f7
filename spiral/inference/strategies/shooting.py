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
from spiral.inference.evidence.admission import Admitted, admit, let_go, second_order, with_effects
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import judged, last_stage, prepared
from spiral.inference.evidence.fit_state import FitState, Masks, all_samples, half_masks
from spiral.inference.evidence.scoring import tested_keys
from spiral.inference.identifiability.parameters import entangled
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import Added, Begun, Settled, Step
from spiral.inference.strategies.resolved import remembered, widened
from spiral.inference.strategies.retire import simplest, superfluous
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, by_evidence, propose
from spiral.inference.unknown.holding import carried, having, holding, moved
from spiral.inference.unknown.shape import Found, applies, unknown_shape
from spiral.types.effect import Effect
from spiral.types.run import Comparison, Stopped, Suggestion


def begin(problem: Problem, progress: Progress) -> Begun:
    """The seed fitted on growing windows of the half that judges."""
    progress("compiling the model and all candidates")
    assembly, standing = prepared(problem)
    tangle = entangled(assembly, standing)
    comparison = _judge(assembly, standing, half_masks(assembly)[1], progress)
    groups = () if tangle is None else tangle.groups
    return Begun(assembly, standing, comparison, refused=tangle is not None, groups=groups)


def propose_one(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    comparison: Comparison,
    number: int,
    progress: Progress,
) -> Step[Proposal]:
    """The candidate that one half of the blocks selects and the other half confirms."""
    begun, assembly = assembly, holding(assembly, standing)
    masks = half_masks(assembly)
    proposal = propose(options, assembly, standing, masks, number, progress)
    level = assembly.problem.settings.whiteness_level
    white = comparison.whiteness_p >= level
    proposal = remembered(options, assembly, standing, proposal, white, masks, number, progress)
    proposal = simplest(options, assembly, standing, proposal, masks[1])
    if proposal.admitted is not None:
        return _step(standing, assembly, _in_place(begun, proposal.wide or assembly, proposal))
    stopped = _why_stopped(proposal, comparison, level)
    details = _details(proposal)
    found = curve_of(options, assembly, standing, proposal, comparison, number, progress)
    if found is not None:
        details["unknown"] = found.shape.as_dict()
    if found is not None and assembly.problem.settings.learned:
        step = _step(standing, assembly, _in_place(begun, found.assembly, found.proposal))
        return replace(step, details={**step.details, **details})
    return Step(
        proposal.suggestions, proposal.rejected, stopped=stopped, details=details, found=proposal
    )


def curve_of(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    proposal: Proposal,
    comparison: Comparison,
    number: int,
    progress: Progress,
) -> Found | None:
    """The shape of what no candidate explains; nothing where what is left is white.

    Where effects admitted before have led astray (the fit diverges, or the free run does), it
    starts from the seed.
    """
    white = comparison.whiteness_p >= assembly.problem.settings.whiteness_level
    seed = assembly.problem.model.labels
    astray = proposal.diverged or not np.isfinite(comparison.fit_error + comparison.test_error)
    if white or not applies(assembly) or (proposal.diverged and standing.labels == seed):
        return None
    return unknown_shape(
        options, assembly, standing, half_masks(assembly), number, progress, astray
    )


def _details(proposal: Proposal) -> dict[str, Any]:
    """What the record cannot separate, and amplitudes held at zero for it."""
    details: dict[str, Any] = {
        "not_separable": {k: list(v) for k, v in proposal.not_separable.items()}
    }
    if proposal.admitted is not None and proposal.admitted.held:
        details["held"] = list(proposal.admitted.held)
    return details


def _in_place(begun: Assembly, place: Assembly, proposal: Proposal) -> Proposal:
    """The proposal with its admission in the study that goes on, not in that of its evidence.

    It has what was compiled at first and what the new standing holds beyond it: no curves or
    resonances tried beside it, none that it lets go.
    """
    admitted = proposal.admitted
    assert admitted is not None
    final = having(begun, admitted.standing.labels)
    if final is place:
        return proposal
    return replace(proposal, admitted=moved(admitted, place, final))


def _step(standing: FitState, place: Assembly, proposal: Proposal) -> Step[Proposal]:
    assert proposal.admitted is not None
    effect = proposal.admitted.variant.original
    return Step(
        proposal.suggestions,
        proposal.rejected,
        admitted=(effect.label,),
        aliases={effect.label: proposal.aliases},
        second_order=second_order(effect, place, standing),
        meaning=effect.meaning(),
        details=_details(proposal),
        found=proposal,
    )


def ranked(step: Step[Proposal]) -> tuple[Suggestion, ...]:
    """All candidates by their evidence on the same windows."""
    proposal = step.needed()
    if proposal.evidence is None:
        return proposal.suggestions
    return by_evidence(proposal.evidence, proposal.admitted, proposal.aliases)


def choose(
    assembly: Assembly, standing: FitState, step: Step[Proposal], label: str
) -> Step[Proposal]:
    """Another candidate at the windows on which all were scored; no gate is asked."""
    proposal = step.needed()
    evidence = proposal.evidence
    assert evidence is not None
    begun, assembly = assembly, holding(assembly, standing)
    study, there = assembly, standing
    if proposal.wide is not None:
        study, there = proposal.wide, carried(standing, assembly, proposal.wide)
    wanted = next(r for r in evidence.ranked if r.variant.original.label == label)
    admitted = admit(study, there, evidence.stage, wanted)
    others = (*step.admitted, *proposal.aliases)
    aliases = tuple(o for o in others if o != label) if label in others else ()
    chosen = replace(proposal, admitted=admitted, aliases=aliases)
    return _step(standing, study, _in_place(begun, study, chosen))


def settle(assembly: Assembly, step: Step[Proposal], progress: Progress) -> Settled:
    """Refit and compare after an admission, letting go of effects it has made superfluous."""
    proposal = step.needed()
    latest = proposal.admitted
    assert latest is not None
    begun, assembly = assembly, holding(assembly, latest.standing)
    mask = half_masks(assembly)[1]
    assert proposal.evidence is not None
    comparison = _judge(assembly, latest.standing, mask, progress)
    if not np.isfinite(comparison.chi2_per_dof):
        latest = replace(latest, standing=_without_amplitudes(assembly, latest))
        comparison = _judge(assembly, latest.standing, mask, progress)
    gone = superfluous(assembly, latest, comparison.model, mask, proposal.evidence.block)
    if not gone:
        return Settled(latest.standing, comparison, proposal.dropped)
    standing = let_go(assembly, latest.standing, gone)
    comparison = _judge(assembly, standing, mask, progress)
    retired = tuple(assembly.variant(x).original.label for x in gone)
    standing = carried(standing, assembly, having(begun, standing.labels))
    return Settled(standing, comparison, (*proposal.dropped, *retired))


def _without_amplitudes(assembly: Assembly, latest: Admitted) -> FitState:
    """The standing with the new effect's amplitudes at zero, where short windows must not diverge.

    Fitted to long windows of a model that is far off, a softening spring may let the short windows
    of the other half run away; from zero they find their own value, and windows grow again.
    """
    values = latest.standing.values.copy()
    for key in tested_keys(assembly, latest.variant):
        values[:, assembly.study.index(key)] = 0.0
    return replace(latest.standing, values=values)


def _judge(
    assembly: Assembly,
    standing: FitState,
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


def added(problem: Problem, effects: tuple[Effect, ...], progress: Progress) -> Added:
    """The model before and after effects added by hand, each fitted to all samples."""
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
    return Added(before, judged(assembly, standing, stage, progress), spent)


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
