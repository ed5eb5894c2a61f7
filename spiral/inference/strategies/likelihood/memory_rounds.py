"""When a missing force is tested for memory, and with which models as reference."""

from __future__ import annotations

from dataclasses import replace

from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.admission import drop_effects
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import WARM, LikelihoodFit, fit_by_likelihood
from spiral.inference.likelihood.memory import detect_memory, effects_replaced_by_memory
from spiral.inference.likelihood.noise_selection import select_noise_model
from spiral.inference.nearness import is_near_noise
from spiral.inference.problem import Progress
from spiral.inference.unknown.memory import Memory
from spiral.types.effect import InputEffect
from spiral.types.run import Comparison


def find_missing_memory(
    assembly: Assembly, base: LikelihoodFit, comparison: Comparison, masks: tuple[Masks, Masks],
    progress: Progress,
) -> Memory | None:  # fmt: skip
    """The memory of the missing force; nothing where it has none.

    Effects without memory that were admitted, and a random force or coloured noise beside them, may
    have stood in for it: it is then looked for in what the model without them lacks, too, and must
    be more likely than they are.
    """
    if is_near_noise(comparison, assembly.problem.settings) and not comparison.random:
        return None  # nothing is left that it could explain
    held = {v.label: v for v in assembly.variants if v.label in base.state.labels}
    remembers = any(v.effect.states for v in held.values())
    plain = tuple(
        x for x, v in held.items() if not (v.effect.states or isinstance(v.effect, InputEffect))
    )
    detection = detect_memory(assembly, base, masks, progress)
    if detection is not None and (remembers or not plain):
        return detection.memory
    if not plain:
        return None
    before = _fit_without_effects(assembly, base, plain, masks[0], progress)
    if detection is None and before is not None:
        detection = detect_memory(assembly, before, masks, progress, base)
    if detection is None:
        return None
    if remembers:
        return detection.memory
    given = plain
    if before is not None:
        given = effects_replaced_by_memory(assembly, base, before, detection.force, plain, masks[0])
    return replace(detection.memory, stand_ins=tuple(held[x].original.label for x in given))


def _fit_without_effects(
    assembly: Assembly, base: LikelihoodFit, labels: tuple[str, ...], select: Masks,
    progress: Progress,
) -> LikelihoodFit | None:  # fmt: skip
    """The model without these effects, on the blocks that select; none where it diverges."""
    state = replace(drop_effects(assembly, base.state, labels), noise=None)
    before = select_noise_model(assembly, fit_by_likelihood(assembly, state, rough=True), progress)
    if not before.estimate.finite:
        return None
    return fit_by_likelihood(assembly, before.state, masks=select, steps=WARM, rough=True)
