"""What is missing and in no catalog: which state the missing force follows.

Where no candidate explains what is left, a dictionary of learned effects (``spiral.learned``:
curves over each state) goes through the same scores, gates and refits as any candidate, so that
hidden states and feedback are dealt with. The best one that passes names the state; its curve is
``spiral.forcecurve``'s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from spiral.assembly import Assembly, assemble, first_row, with_records
from spiral.effect import Effect
from spiral.evidence import Admitted, Masks, Standing
from spiral.forcecurve import Unknown, described
from spiral.problem import Progress
from spiral.suggest import Proposal, propose
from spiral.system import MechanicalSystem


@dataclass(frozen=True)
class Found:
    """A learned effect that passed the gates: on ``assembly``, which holds it, by ``proposal``."""

    assembly: Assembly
    proposal: Proposal
    shape: Unknown


def holding(assembly: Assembly, standing: Standing) -> Assembly:
    """A study that has all effects of a standing, learned ones too; the same where it has them."""
    known = {*assembly.problem.model.labels, *(v.label for v in assembly.variants)}
    names = {x.split("#")[0] for x in standing.labels if x not in known}
    if not names:
        return assembly
    more = tuple(e for e in assembly.problem.dictionary if e.label in names)
    return _reassembled(assembly, (*assembly.problem.candidates, *more))


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
    wide = _reassembled(assembly, (*kept, *learned))
    first = propose(wide, carried(standing, assembly, wide), masks, round_number, progress)
    if first.admitted is None:
        return None
    label = first.admitted.variant.original.label
    chosen = next(e for e in learned if e.label == label)
    final = _reassembled(assembly, (*assembly.problem.candidates, chosen))
    proposal = Proposal(
        first.evidence, first.stages, _moved(first.admitted, wide, final), first.aliases,
        first.suggestions, first.rejected,
    )  # fmt: skip
    shape = described(wide, first.admitted, first.suggestions, masks[1])
    return Found(final, proposal, shape)


def _reassembled(assembly: Assembly, candidates: tuple[Effect, ...]) -> Assembly:
    """The same records with other candidates, at the same steps per sample."""
    problem = replace(assembly.problem, candidates=candidates)
    made = assemble(problem)
    substeps = assembly.study.series[0].substeps
    if substeps == 1:
        return made
    return with_records(made, problem.records, substeps, problem.settings.phase_knot)


def carried(standing: Standing, old: Assembly, new: Assembly) -> Standing:
    """A standing's values in another study's order of parameters."""
    values = first_row(new)
    tail = len(old.study.keys)
    for i, key in enumerate(old.study.keys):
        if key in new.study.keys:
            values[:, new.study.index(key)] = standing.values[:, i]
    values[:, len(new.study.keys) :] = standing.values[:, tail:]
    return replace(standing, values=values)


def _moved(admitted: Admitted, old: Assembly, new: Assembly) -> Admitted:
    """An admission on another study: values in its order, the fit's windows as they were."""
    standing = carried(admitted.standing, old, new)
    fitted = admitted.stage.fitted
    point = replace(fitted.point, values=standing.values)
    stage = replace(admitted.stage, fitted=replace(fitted, point=point, reduction=None))
    return Admitted(standing, stage, new.variant(admitted.variant.label))


def applies(assembly: Assembly) -> bool:
    """Whether there is a dictionary to try."""
    mechanical = isinstance(assembly.problem.model.system, MechanicalSystem)
    return mechanical and bool(assembly.problem.dictionary)
