"""What is missing and in no catalog: which state the missing force follows.

Where no candidate explains what is left, a dictionary of learned effects (``spiral.learned``:
curves over each state) goes through the same scores, gates and refits as any candidate, so that
hidden states and feedback are dealt with. The best one that passes names the state; its curve is
``spiral.forcecurve``'s.
"""

from __future__ import annotations

from dataclasses import dataclass

from spiral.assembly import Assembly
from spiral.evidence import Masks, Standing
from spiral.forcecurve import Unknown, described
from spiral.holding import carried, held_variants, moved, reassembled
from spiral.problem import Progress
from spiral.suggest import Proposal, propose
from spiral.system import MechanicalSystem


@dataclass(frozen=True)
class Found:
    """A learned effect that passed the gates: on ``assembly``, which holds it, by ``proposal``."""

    assembly: Assembly
    proposal: Proposal
    shape: Unknown


def unknown_shape(
    assembly: Assembly,
    standing: Standing,
    masks: tuple[Masks, Masks],
    round_number: int,
    progress: Progress,
) -> Found | None:
    """The curve that explains what is left, or nothing where none passes the gates.

    Parameters
    ----------
    assembly, standing : the study, none of whose candidates passes.
    masks : (select, judge), as in ``propose``; the curve is fitted on the half that judges.
    """
    present = {v.original.label for v in assembly.variants if v.label in standing.labels}
    taken = {*present, *assembly.problem.model.labels}
    learned = tuple(e for e in assembly.problem.dictionary if e.label not in taken)
    if not learned:
        return None
    progress("trying curves over each state")
    kept = tuple(c for c in assembly.problem.candidates if c.label in present)
    own = held_variants(assembly, standing.labels)
    wide = reassembled(assembly, (*kept, *learned), own)
    first = propose(wide, carried(standing, assembly, wide), masks, round_number, progress)
    if first.admitted is None:
        return None
    label = first.admitted.variant.original.label
    chosen = next(e for e in learned if e.label == label)
    final = reassembled(assembly, (*assembly.problem.candidates, chosen), own)
    proposal = Proposal(
        first.evidence, first.stages, moved(first.admitted, wide, final), first.aliases,
        first.suggestions, first.rejected,
    )  # fmt: skip
    shape = described(wide, first.admitted, first.suggestions, masks[1])
    return Found(final, proposal, shape)


def applies(assembly: Assembly) -> bool:
    """Whether there is a dictionary to try."""
    mechanical = isinstance(assembly.problem.model.system, MechanicalSystem)
    return mechanical and bool(assembly.problem.dictionary)
