"""Studies that hold more than their candidates: a learned curve, or an effect with own states.

A study is compiled once with all candidates that are cheap. What is called for later (in a round
whose residual asks for it) is compiled in a study of its own, from which a standing and an
admission are carried to another by the names of their parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spiral.inference.evidence.admission import Admitted
from spiral.inference.evidence.assembly import (
    Assembly,
    Variant,
    assemble,
    compiled_of,
    first_row,
    with_steps,
)
from spiral.inference.evidence.comparison import substeps_for
from spiral.inference.evidence.fit_state import FitState
from spiral.physics.formulas.laws import laws_of
from spiral.types.effect import Effect
from spiral.types.label import split_variant
from spiral.types.record import Array


def holding(assembly: Assembly, standing: FitState) -> Assembly:
    """A study that has all effects of a standing, late ones too; the same where it has them.

    The standing's values are in its order. Its steps are as fine as the standing wants them, or an
    effect that brings fast states.
    """
    made = having(assembly, standing.labels)
    now, substeps = made.study.series[0].substeps, standing.substeps
    if len(made.study.own):
        substeps = max(substeps, substeps_for(made, standing.values[0]))
    if substeps <= now:
        return made
    return with_steps(made, substeps)


def having(assembly: Assembly, labels: tuple[str, ...]) -> Assembly:
    """A study that has all effects with these compiled labels, at the same steps per sample."""
    known = {*assembly.problem.model.labels, *(v.label for v in assembly.variants)}
    names = {split_variant(x)[0] for x in labels if x not in known}
    if not names:
        return assembly
    if assembly.bare:
        return with_variants(assembly, [_variant(assembly, x) for x in labels if x not in known])
    more = tuple(e for e in assembly.problem.dictionary if e.label in names)
    candidates = (*assembly.problem.candidates, *more)
    return reassembled(assembly, candidates, held_variants(assembly, labels))


def _variant(assembly: Assembly, label: str) -> Variant:
    """A variant by its label, of those offered or of an effect that is called for later."""
    for variant in assembly.offered:
        if variant.label == label:
            return variant
    name, tag = split_variant(label)
    problem = assembly.problem
    effects = (*assembly.later, *problem.dictionary, *laws_of(problem.model.system))
    return variant_of(next(e for e in effects if e.label == name), tag, {})


def with_variants(assembly: Assembly, more: Sequence[Variant]) -> Assembly:
    """A study compiled with further variants, its records as they are."""
    known = {v.label for v in assembly.variants}
    new = tuple({v.label: v for v in more if v.label not in known}.values())
    if not new:
        return assembly
    variants = (*assembly.variants, *new)
    study = replace(assembly.study, compiled=compiled_of(assembly.problem, variants))
    return replace(assembly, study=study, variants=variants)


def emptied(assembly: Assembly) -> Assembly:
    """A bare study with none of its variants compiled."""
    study = replace(assembly.study, compiled=compiled_of(assembly.problem, ()))
    return replace(assembly, study=study, variants=())


def held_variants(assembly: Assembly, labels: tuple[str, ...]) -> tuple[Variant, ...]:
    """Variants of effects with own states among these labels; their shapes stay to be carried."""
    later = {e.label: e for e in assembly.later}
    pairs = [split_variant(label) for label in labels]
    return tuple(variant_of(later[name], tag, {}) for name, tag in pairs if name in later)


def variant_of(effect: Effect, tag: str, shapes: dict[str, float], searched: int = 1) -> Variant:
    """A copy of an effect with its shapes by name, all of which a refit may set free."""
    copy = replace(effect, variant=tag)
    loose = [p for p in effect.parameters if p.role == "shape" and (p.spectrum or p.grid)]
    tuned = tuple(f"{copy.label}.{p.name}" for p in loose)
    values = {f"{copy.label}.{name}": value for name, value in shapes.items()}
    return Variant(copy, effect, values, None, tuned, searched)


def reassembled(
    assembly: Assembly, candidates: tuple[Effect, ...], more: tuple[Variant, ...] = ()
) -> Assembly:
    """The same records with other candidates, at the same steps per sample."""
    problem = replace(assembly.problem, candidates=candidates)
    made = assemble(problem, more=more)
    substeps = assembly.study.series[0].substeps
    if substeps == 1:
        return made
    return with_steps(made, substeps)


def carried(standing: FitState, old: Assembly, new: Assembly) -> FitState:
    """A standing's values in another study's order of parameters."""
    values = first_row(new)
    tail = len(old.study.keys)
    for i, key in enumerate(old.study.keys):
        if key in new.study.keys:
            values[:, new.study.index(key)] = standing.values[:, i]
    values[:, len(new.study.keys) :] = standing.values[:, tail:]
    starts = _in_order(standing.starts, old, new, 0.0)
    spreads = _in_order(standing.spreads, old, new, np.nan)
    return replace(standing, values=values, starts=starts, spreads=spreads)


def _in_order(
    rows: tuple[Array, ...] | None, old: Assembly, new: Assembly, other: float
) -> tuple[Array, ...] | None:
    """Numbers of the states in another study's order; ``other`` for those that are new."""
    if rows is None:
        return None
    before, after = old.study.compiled.traced.states, new.study.compiled.traced.states
    places = [(i, before.index(n)) for i, n in enumerate(after) if n in before]
    found = tuple(np.full(len(after), other) for _ in rows)
    for mine, theirs in zip(found, rows, strict=True):
        for i, j in places:
            mine[i] = theirs[j]
    return found


def moved(admitted: Admitted, old: Assembly, new: Assembly) -> Admitted:
    """An admission on another study: values in its order, the fit's windows as they were."""
    standing = carried(admitted.standing, old, new)
    stage = admitted.stage
    states = old.study.compiled.traced.states
    kept = [states.index(n) for n in new.study.compiled.traced.states]
    starts = tuple(x[:, kept] for x in stage.fitted.point.starts)
    point = replace(stage.fitted.point, values=standing.values, starts=starts)
    stage = replace(stage, fitted=replace(stage.fitted, point=point, reduction=None))
    return Admitted(standing, stage, new.variant(admitted.variant.label))
