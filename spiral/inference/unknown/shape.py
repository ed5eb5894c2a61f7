"""What is missing and in no catalog: which state the missing force follows.

Where no candidate explains what is left, a dictionary of learned effects
(``spiral.physics.learned``: curves over each state) goes through the same scores, gates and refits
as any candidate, so that hidden states and feedback are dealt with. The best one that passes names
the state; its curve is ``spiral.inference.unknown.forcecurve``'s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState, Masks, begin
from spiral.inference.problem import Progress
from spiral.inference.strategy_options import ShootingOptions
from spiral.inference.suggest import Proposal, propose
from spiral.inference.unknown.forcecurve import Unknown, described, from_windows
from spiral.inference.unknown.holding import carried, held_variants, moved, reassembled
from spiral.physics.learned import Learned


@dataclass(frozen=True)
class Found:
    """A learned effect that passed the gates: on ``assembly``, which holds it, by ``proposal``."""

    assembly: Assembly
    proposal: Proposal
    shape: Unknown


def unknown_shape(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
    astray: bool = False,
) -> Found | None:
    """The curve that explains what is left, or nothing where none passes the gates.

    Effects admitted before may only have stood in for the curve, so it is tried from the seed
    first, where they compete with it: should a curve come first, they are let go (and may come
    back in later rounds). Else it is looked for in what they leave.

    Parameters
    ----------
    options : of the windows on which it is looked for.
    assembly, standing : the study, none of whose candidates passes.
    masks : (select, judge), as in ``propose``; the curve is fitted on the half that judges.
    astray : whether what was admitted before leads nowhere, so that only the seed is tried.
    """
    firm = {*assembly.problem.model.labels, *_learned(assembly, standing)}
    kept = tuple(x for x in standing.labels if x in firm)
    starts = [] if astray else [standing]
    if kept != standing.labels:
        starts.insert(0, _fresh(assembly, standing, kept))
    for start in starts or [standing]:
        progress("trying curves over each state")
        found = _found(options, assembly, standing, start, masks, round_number, progress)
        if found is not None:
            return found
    return None


def _fresh(assembly: Assembly, standing: FitState, kept: tuple[str, ...]) -> FitState:
    """The first standing of the seed; curves kept, and shapes of all others, as they were."""
    known = tuple(x for x in kept if x in assembly.problem.model.labels)
    begun, study = begin(assembly, known), assembly.study
    values = begun.values.copy()
    for i, (key, parameter) in enumerate(
        zip(study.keys, study.compiled.traced.parameters, strict=True)
    ):
        owner = key.rsplit(".", 1)[0]
        if (parameter.role == "shape" or owner in kept) and owner not in known:
            values[:, i] = standing.values[:, i]
    return replace(begun, values=values, labels=kept)


def _learned(assembly: Assembly, standing: FitState) -> list[str]:
    """Compiled labels of the curves in a standing."""
    own = {v.label: v.effect for v in assembly.variants}
    return [x for x in standing.labels if isinstance(own.get(x), Learned)]


def _found(
    options: ShootingOptions,
    assembly: Assembly,
    standing: FitState,
    start: FitState,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
) -> Found | None:
    """The curve that comes first from ``start``, against all that ``standing`` has beyond it."""
    present = {v.original.label for v in assembly.variants if v.label in standing.labels}
    taken = {*present, *assembly.problem.model.labels}
    first_port = (e for e in assembly.problem.dictionary if not e.port)
    learned = tuple(e for e in first_port if e.label not in taken)
    if not learned:
        return None
    kept = tuple(c for c in assembly.problem.candidates if c.label in present)
    own = held_variants(assembly, standing.labels)
    wide = reassembled(assembly, (*kept, *learned), own)
    first = propose(options, wide, carried(start, assembly, wide), masks, round_number, progress)
    labels = [e.label for e in learned]
    if first.admitted is None or first.admitted.variant.original.label not in labels:
        return None
    chosen = learned[labels.index(first.admitted.variant.original.label)]
    final = reassembled(assembly, (*assembly.problem.candidates, chosen), own)
    gone = [v for v in assembly.variants if v.label in standing.labels]
    proposal = Proposal(
        first.evidence, first.stages, moved(first.admitted, wide, final), first.aliases,
        first.suggestions, first.rejected,
        tuple(v.original.label for v in gone if v.label not in start.labels),
    )  # fmt: skip
    fit = from_windows(wide, first.admitted, masks[1])
    shape = described(fit, chosen.label, first.suggestions)
    return Found(final, proposal, shape)


def applies(assembly: Assembly) -> bool:
    """Whether there is a curve to try at the first port."""
    return any(not e.port for e in assembly.problem.dictionary)
