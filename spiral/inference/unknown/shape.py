"""Finds the state that a missing force follows, and its learned curve.

Where no candidate explains what is left, a dictionary of learned effects
(``spiral.physics.learned``: curves over each state) goes through the same scores, gates and refits
as any candidate, so that hidden states and feedback are dealt with. The best one that passes names
the state; its curve is ``spiral.inference.unknown.forcecurve``'s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.enlarge import (
    own_state_variants,
    reassemble,
    transfer_admission,
    transfer_fit_state,
)
from spiral.inference.evidence.fit_state import FitState, Masks, initial_fit_state
from spiral.inference.problem import Progress
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose_on_windows
from spiral.inference.unknown.forcecurve import Unknown, curve_fit_on_windows, describe_curve
from spiral.physics.learned import Learned
from spiral.types.label import owner_of


@dataclass(frozen=True)
class LearnedEffect:
    """A learned effect that passed the gates: on ``assembly``, which holds it, by ``proposal``."""

    assembly: Assembly
    proposal: Proposal
    shape: Unknown


def find_unknown_shape(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
    astray: bool = False,
) -> LearnedEffect | None:
    """The curve that explains what is left, or nothing where none passes the gates.

    Effects admitted before may only have stood in for the curve, so it is tried from the seed
    first, where they compete with it: should a curve come first, they are let go (and may come
    back in later rounds). Else it is looked for in what they leave.

    Parameters
    ----------
    options : of the windows on which it is looked for.
    assembly, fit_state : the study, none of whose candidates passes.
    masks : (select, judge), as in ``propose_on_windows``; the curve is fitted on the
        half that judges.
    astray : whether what was admitted before leads nowhere, so that only the seed is tried.
    """
    firm = {*assembly.problem.model.labels, *_learned_labels(assembly, fit_state)}
    kept = tuple(x for x in fit_state.labels if x in firm)
    starts = [] if astray else [fit_state]
    if kept != fit_state.labels:
        starts.insert(0, _seed_state_with_curves(assembly, fit_state, kept))
    for start in starts or [fit_state]:
        progress("trying curves over each state")
        curve = _find_curve_from(options, assembly, fit_state, start, masks, round_number, progress)
        if curve is not None:
            return curve
    return None


def _seed_state_with_curves(
    assembly: Assembly, fit_state: FitState, kept: tuple[str, ...]
) -> FitState:
    """The initial fit state of the seed, with the values of curves and all shapes kept."""
    known = tuple(x for x in kept if x in assembly.problem.model.labels)
    begun, study = initial_fit_state(assembly, known), assembly.study
    values = begun.values.copy()
    for i, (key, parameter) in enumerate(
        zip(study.keys, study.compiled.traced.parameters, strict=True)
    ):
        owner = owner_of(key)
        if (parameter.role == "shape" or owner in kept) and owner not in known:
            values[:, i] = fit_state.values[:, i]
    return replace(begun, values=values, labels=kept)


def _learned_labels(assembly: Assembly, fit_state: FitState) -> list[str]:
    """Compiled labels of the curves in a fit state."""
    own = {v.label: v.effect for v in assembly.variants}
    return [x for x in fit_state.labels if isinstance(own.get(x), Learned)]


def _find_curve_from(
    options: ShootingOptions,
    assembly: Assembly,
    fit_state: FitState,
    start: FitState,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
) -> LearnedEffect | None:
    """The curve that comes first from ``start``, against what ``fit_state`` has beyond it."""
    present = {v.original.label for v in assembly.variants if v.label in fit_state.labels}
    taken = {*present, *assembly.problem.model.labels}
    first_port = (e for e in assembly.problem.dictionary if not e.port)
    learned = tuple(e for e in first_port if e.label not in taken)
    if not learned:
        return None
    kept = tuple(c for c in assembly.problem.candidates if c.label in present)
    own = own_state_variants(assembly, fit_state.labels)
    wide = reassemble(assembly, (*kept, *learned), own)
    first = propose_on_windows(
        options, wide, transfer_fit_state(start, assembly, wide), masks, round_number, progress
    )
    labels = [e.label for e in learned]
    if first.admitted is None or first.admitted.variant.original.label not in labels:
        return None
    chosen = learned[labels.index(first.admitted.variant.original.label)]
    final = reassemble(assembly, (*assembly.problem.candidates, chosen), own)
    gone = [v for v in assembly.variants if v.label in fit_state.labels]
    proposal = Proposal(
        first.evidence,
        first.stages,
        transfer_admission(first.admitted, wide, final),
        first.aliases,
        first.suggestions,
        first.rejected,
        tuple(v.original.label for v in gone if v.label not in start.labels),
    )
    fit = curve_fit_on_windows(wide, first.admitted, masks[1])
    shape = describe_curve(fit, chosen.label, first.suggestions)
    return LearnedEffect(final, proposal, shape)


def has_curves_to_try(assembly: Assembly) -> bool:
    """Whether there is a curve to try at the first port."""
    return any(not e.port for e in assembly.problem.dictionary)
