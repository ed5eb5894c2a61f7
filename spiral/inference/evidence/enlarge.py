"""Studies compiled with further effects, and fit states transferred from one to another.

A study is compiled once with all candidates that are cheap. What a round calls for later (a learned
curve, an effect with states of its own) is compiled in a study of its own; fit states and
admissions are transferred between studies by the names of their parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spiral.engine.series import Series
from spiral.inference.evidence.admission import AdmittedEffect
from spiral.inference.evidence.assembly import (
    Assembly,
    Variant,
    assemble,
    compile_with_variants,
    initial_values,
    with_steps,
)
from spiral.inference.evidence.comparison import substeps_for
from spiral.inference.evidence.fit_state import FitState
from spiral.physics.formulas.laws import laws_of
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import TracedModel
from spiral.types.effect import Effect
from spiral.types.label import split_variant
from spiral.types.record import Array


def enlarge_for(assembly: Assembly, fit_state: FitState) -> Assembly:
    """The study compiled with all effects of a fit state; the same one where it has them.

    The fit state's values are already in its order. Its integration steps are as fine as those of
    the fit state, or finer where an effect brings fast states.
    """
    made = enlarge(assembly, fit_state.labels)
    now, substeps = made.study.series[0].substeps, fit_state.substeps
    if len(made.study.own):
        substeps = max(substeps, substeps_for(made, fit_state.values[0]))
    if substeps <= now:
        return made
    return with_steps(made, substeps)


def enlarge(assembly: Assembly, labels: tuple[str, ...]) -> Assembly:
    """The study compiled with all effects of these labels, at the same steps per sample."""
    known = {*assembly.problem.model.labels, *(v.label for v in assembly.variants)}
    names = {split_variant(x)[0] for x in labels if x not in known}
    if not names:
        return assembly
    if assembly.bare:
        return with_variants(
            assembly, [_find_variant(assembly, x) for x in labels if x not in known]
        )
    asked = (*assembly.problem.dictionary, *assembly.problem.changes())
    more = tuple(e for e in asked if e.label in names)
    candidates = (*assembly.problem.candidates, *more)
    return reassemble(assembly, candidates, own_state_variants(assembly, labels))


def _find_variant(assembly: Assembly, label: str) -> Variant:
    """A variant by its label, of the offered ones or of an effect that is tried later."""
    for variant in assembly.offered:
        if variant.label == label:
            return variant
    name, tag = split_variant(label)
    problem = assembly.problem
    laws = laws_of(problem.model.system)
    offered = (v.original for v in assembly.offered)
    effects = (*assembly.later, *offered, *problem.dictionary, *problem.changes(), *laws)
    return make_variant(next(e for e in effects if e.label == name), tag, {})


def with_variants(assembly: Assembly, more: Sequence[Variant]) -> Assembly:
    """A study compiled with further variants, its records as they are."""
    known = {v.label for v in assembly.variants}
    new = tuple({v.label: v for v in more if v.label not in known}.values())
    if not new:
        return assembly
    variants = (*assembly.variants, *new)
    study = replace(assembly.study, compiled=compile_with_variants(assembly.problem, variants))
    return replace(assembly, study=study, variants=variants)


def without_variants(assembly: Assembly) -> Assembly:
    """A bare study compiled with none of its variants."""
    study = replace(assembly.study, compiled=compile_with_variants(assembly.problem, ()))
    return replace(assembly, study=study, variants=())


def study_with(assembly: Assembly, labels: tuple[str, ...]) -> Assembly:
    """A bare study compiled with these effects beside its seed and no others, in their order.

    What ``assembly`` has beside them (an effect that was let go since) is left out.
    """
    known, seed = {v.label: v for v in assembly.variants}, assembly.problem.model.labels
    wanted = [known.get(x) or _find_variant(assembly, x) for x in labels if x not in seed]
    return with_variants(without_variants(assembly), wanted)


def own_state_variants(assembly: Assembly, labels: tuple[str, ...]) -> tuple[Variant, ...]:
    """Variants of effects with own states among these labels, their shapes still without values."""
    later = {e.label: e for e in assembly.later}
    pairs = [split_variant(label) for label in labels]
    return tuple(make_variant(later[name], tag, {}) for name, tag in pairs if name in later)


def make_variant(effect: Effect, tag: str, shapes: dict[str, float], searched: int = 1) -> Variant:
    """A copy of an effect with its shapes by name, all of which a refit may set free."""
    copy = replace(effect, variant=tag)
    known = (p for p in effect.parameters if p.role == "shape" and not p.choice)
    loose = [p for p in known if p.spectrum or p.grid]
    tuned = tuple(f"{copy.label}.{p.name}" for p in loose)
    values = {f"{copy.label}.{name}": value for name, value in shapes.items()}
    return Variant(copy, effect, values, None, tuned, searched)


def reassemble(
    assembly: Assembly, candidates: tuple[Effect, ...], more: tuple[Variant, ...] = ()
) -> Assembly:
    """The same records with other candidates, at the same steps per sample."""
    problem = replace(assembly.problem, candidates=candidates)
    made = assemble(problem, more=more)
    substeps = assembly.study.series[0].substeps
    if substeps == 1:
        return made
    return with_steps(made, substeps)


def transfer_fit_state(fit_state: FitState, old: Assembly, new: Assembly) -> FitState:
    """A fit state in another study's order of parameters and states."""
    values = initial_values(new)
    tail = len(old.study.keys)
    for i, key in enumerate(old.study.keys):
        if key in new.study.keys:
            values[:, new.study.index(key)] = fit_state.values[:, i]
    values[:, len(new.study.keys) :] = fit_state.values[:, tail:]
    before, after = old.study.compiled.traced.states, new.study.compiled.traced
    starts = reorder_starts(fit_state.starts, before, after, new.study.series)
    spreads = reorder_states(fit_state.spreads, before, after.states, np.nan)
    return replace(fit_state, values=values, starts=starts, spreads=spreads)


def reorder_starts(
    rows: tuple[Array, ...] | None, before: tuple[str, ...], after: TracedModel,
    series: Sequence[Series],
) -> tuple[Array, ...] | None:  # fmt: skip
    """Initial states in another study's order; new ones begin where they are declared to.

    The store beside a room at 293 K begins as warm, and a slow sensor with what it reads.
    """
    starts = reorder_states(rows, before, after.states, 0.0)
    for start, one in zip(starts or (), series, strict=starts is not None):
        fill_declared_starts(after, start, one.inputs[0], one.y[0], known=before)
    return starts


def reorder_states(
    rows: tuple[Array, ...] | None, before: tuple[str, ...], after: tuple[str, ...], other: float
) -> tuple[Array, ...] | None:
    """Numbers of the states in another study's order; ``other`` for those that are new."""
    if rows is None:
        return None
    places = [(i, before.index(n)) for i, n in enumerate(after) if n in before]
    reordered = tuple(np.full(len(after), other) for _ in rows)
    for mine, theirs in zip(reordered, rows, strict=True):
        for i, j in places:
            mine[i] = theirs[j]
    return reordered


def transfer_admission(admitted: AdmittedEffect, old: Assembly, new: Assembly) -> AdmittedEffect:
    """An admission in another study's order of parameters and states, its windows as they were."""
    fit_state = transfer_fit_state(admitted.fit_state, old, new)
    stage = admitted.stage
    states = old.study.compiled.traced.states
    kept = [states.index(n) for n in new.study.compiled.traced.states]
    starts = tuple(x[:, kept] for x in stage.fitted.point.starts)
    point = replace(stage.fitted.point, values=fit_state.values, starts=starts)
    stage = replace(stage, fitted=replace(stage.fitted, point=point, reduction=None))
    return AdmittedEffect(fit_state, stage, new.variant(admitted.variant.label))
