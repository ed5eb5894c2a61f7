"""When the memory of what is missing is asked for, and beside which models."""

from __future__ import annotations

from dataclasses import replace

from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.admission import let_go
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import WARM, LikelihoodFit, refitted
from spiral.inference.likelihood.ladder import climbed_ladder
from spiral.inference.likelihood.memory import memory_of
from spiral.inference.nearness import near_noise
from spiral.inference.problem import Progress
from spiral.inference.unknown.memory import Memory
from spiral.types.effect import InputEffect
from spiral.types.run import Comparison


def missing_memory(
    assembly: Assembly, base: LikelihoodFit, comparison: Comparison, masks: tuple[Masks, Masks],
    progress: Progress,
) -> Memory | None:  # fmt: skip
    """The memory of what is missing, where it has any.

    Effects without memory that were admitted, and a random force or coloured noise beside them, may
    have stood in for it: it is then looked for in what the model without them lacks, too, and must
    be more likely than they are.
    """
    if near_noise(comparison, assembly.problem.settings) and not comparison.random:
        return None  # nothing is left that it could explain
    found = memory_of(assembly, base, masks, progress)
    held = {v.label: v.effect for v in assembly.variants if v.label in base.state.labels}
    gone = tuple(x for x, e in held.items() if not (e.states or isinstance(e, InputEffect)))
    if found is not None or not gone:
        return found
    before = refitted(assembly, replace(let_go(assembly, base.state, gone), noise=None), rough=True)
    before = climbed_ladder(assembly, before, progress)
    if not before.estimate.finite:
        return None
    before = refitted(assembly, before.state, masks=masks[0], steps=WARM, rough=True)
    return memory_of(assembly, before, masks, progress, base)
