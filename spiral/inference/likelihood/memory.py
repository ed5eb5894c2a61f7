"""Whether the missing force has memory: a function of the present state, or of its history.

Where no candidate is admitted any more two further models of the machine are fitted, parameters and
noise, on the blocks that select:

    present     as it is, and any force f(q, q', t) without memory at one port, sensors and inputs
                that are a few samples late
    past        the same, and a force with memory there: springs that yield, forces that relax

(``spiral.physics.memory_forces``). The port is the one where forces with memory score best. Memory
is reported where the past is significant on the blocks that select (Wilks' test,
``settings.level``) and

    log L(past) - log L(present) > log(1 / level)

on the blocks that judge, both with their values from the others and each with the noise as these
have it. Against the true values of ``present`` the ratio would have the expectation one, and so be
above 1 / level with a probability of ``level`` at most (Markov's inequality; the split likelihood
ratio of Wasserman, Ramdas and Balakrishnan 2020); here both are estimates, so its rate of false
alarms is measured (``experiments/memory``). What changes the predictions by less than
``settings.smallest`` standard deviations, or is under a twentieth of the missing force's mean
square, is not reported: a curve or a sensor that the present cannot follow exactly leaves as
much. Neither is memory beside which a random force has to act that is no answer, and no half of
what it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from scipy import special

from spiral.engine.filter.task import FilterInput
from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.own_states import arrange_own_states, own_states_along
from spiral.engine.likelihood.predict import Masks, predict_readings
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.enlarge import make_variant, transfer_fit_state, with_variants
from spiral.inference.evidence.scoring import amplitude_keys
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    fit_by_likelihood,
    largest_force,
)
from spiral.inference.likelihood.judging import maximise_on_blocks
from spiral.inference.likelihood.predicted_motion import predicted_motion
from spiral.inference.likelihood.scores import FilteredRecords, rank_variants
from spiral.inference.problem import Progress
from spiral.inference.unknown.memory import Kind, Loop, Memory
from spiral.physics.memory_forces import (
    RELAXING,
    YIELDING,
    LateInput,
    LateReading,
    PresentForce,
    RememberedForce,
)
from spiral.physics.signatures import SystemMotion, effect_inputs, port_motion_along
from spiral.types.effect import Effect, values_for
from spiral.types.label import parameter_of
from spiral.types.placement import at_every_place
from spiral.types.port import At, place_name
from spiral.types.record import Array
from spiral.types.system import has_coordinates

_LEAST = 0.05  # share of the missing force's mean square from which memory is reported
_KEPT = 0.5  # of what an effect does alone: left beside a force with memory if it is no stand-in
_STEPS = 40  # scoring steps, at most, with the filter's gains held
_CLEARLY = 3.0  # times the other's Wald statistic from which one kind of memory is told
_CYCLES, _POINTS = 2.0, 200  # periods of a loop that is kept, and its points


@dataclass(frozen=True)
class _Trial:
    """A model fitted on the blocks that select, in terms of a study of its own."""

    assembly: Assembly
    fit: LikelihoodFit


class MemoryResult(NamedTuple):
    """The memory of a missing force as reported, and the ``force`` that modelled it in the fits."""

    memory: Memory
    force: Variant


def detect_memory(
    assembly: Assembly,
    base: LikelihoodFit,
    masks: tuple[Masks, Masks],
    progress: Progress,
    rival: LikelihoodFit | None = None,
) -> MemoryResult | None:
    """The memory of the missing force; nothing where none is significant, or without forces.

    Parameters
    ----------
    base : the model as it is, fitted on the blocks that select. masks : (select, judge).
    rival : another model without memory that the past must be as much more likely than.
    """
    if not has_coordinates(assembly.problem.model.system):
        return None
    level, (select, judge) = assembly.problem.settings.level, masks
    past = _best_memory_force(assembly, base, select, level)
    if past is None:
        return None
    progress("testing whether the missing force has memory")
    present = _refit_with_variants(
        _Trial(assembly, base), _memoryless_variants(assembly, past), select
    )
    wide = _refit_with_variants(present, (past,), select)
    if not (present.fit.estimate.finite and wide.fit.estimate.finite):
        return None
    if _leaves_as_much_to_chance(assembly, present, wide):
        return None
    terms = len(amplitude_keys(wide.assembly, wide.assembly.variant(past.label)))
    gain = max(wide.fit.log_likelihood - present.fit.log_likelihood, 0.0)
    p_value = float(special.chdtrc(terms, 2 * gain))
    others = [present.fit, *([] if rival is None else [rival])]
    alone, *rest = (
        maximise_on_blocks(f.estimate, judge, {}).log_likelihood for f in (wide.fit, *others)
    )
    told = alone - max(rest)
    size = np.sqrt(2 * max(told, 0.0) / _count_readings(base, judge))
    if p_value >= level or not told > -np.log(level):
        return None
    if size < assembly.problem.settings.smallest:
        return None
    memory = _describe_memory(wide, past, p_value, told)
    return MemoryResult(memory, past) if memory.share >= _LEAST else None


def _leaves_as_much_to_chance(assembly: Assembly, present: _Trial, wide: _Trial) -> bool:
    """Whether a random force as large as no answer has acts beside the memory, too.

    One that is above ``settings.random_limit`` and not half as large as without the memory: what is
    missing is something else, to which a history is only nearer than no model.
    """
    before, after = (largest_force(t.fit.estimate.noise) for t in (present, wide))
    return after > max(assembly.problem.settings.random_limit, _KEPT * before)


def effects_replaced_by_memory(
    assembly: Assembly, base: LikelihoodFit, before: LikelihoodFit, past: Variant,
    labels: Sequence[str], select: Masks,
) -> tuple[str, ...]:  # fmt: skip
    """Those memoryless effects that become superfluous beside a force with memory.

    The model is fitted with that force beside them, and so is the model ``before`` them. All of
    them may have stood in for the memory where it alone is more likely than they are, or where
    they add less than half as much log-likelihood beside it as without it; else those of which
    less than half of every amplitude is left.
    """
    with_them, without = (
        _refit_with_variants(_Trial(assembly, f), (past,), select) for f in (base, before)
    )
    if not (with_them.fit.estimate.finite and without.fit.estimate.finite):
        return tuple(labels)
    beside, alone = (
        with_them.fit.log_likelihood - without.fit.log_likelihood,
        base.log_likelihood - before.log_likelihood,
    )
    if not (beside >= _KEPT * alone and base.log_likelihood >= without.fit.log_likelihood):
        return tuple(labels)
    return tuple(x for x in labels if not _is_amplitude_kept(assembly, base, with_them, x))


def _is_amplitude_kept(assembly: Assembly, base: LikelihoodFit, wide: _Trial, label: str) -> bool:
    """Whether half of one of an effect's amplitudes is left in a wider model."""
    keys = amplitude_keys(assembly, assembly.variant(label))
    before = base.state.values[0, [assembly.study.index(k) for k in keys]]
    after = wide.fit.state.values[0, [wide.assembly.study.index(k) for k in keys]]
    return bool(np.any((before != 0.0) & (after * np.sign(before) >= _KEPT * np.abs(before))))


def _count_readings(fit: LikelihoodFit, masks: Masks) -> int:
    """Number of readings within the masked samples, at least one."""
    rows = [part.spreads > 0 for part in fit.estimate.predictions]
    if masks is not None:
        rows = [r if m is None else r[m] for r, m in zip(rows, masks, strict=True)]
    return max(sum(int(r.sum()) for r in rows), 1)


# --- the two models ------------------------------------------------------------------------------


def _best_memory_force(
    assembly: Assembly, base: LikelihoodFit, select: Masks, level: float
) -> Variant | None:
    """A force with memory at the port where it scores best; nothing where it does nowhere."""
    ranking = rank_variants(assembly, base, base.estimate.noise, select, _memory_force_variants)
    if ranking is None or not ranking.ranked:
        return None
    best = ranking.ranked[0]
    return best.variant if best.score.log_p < np.log(level) else None


def _memory_force_variants(filtered: FilteredRecords) -> list[Variant]:
    """A force with memory at every port that moves, its shapes by the motion there."""
    variants = []
    for effect in at_every_place(filtered.assembly.problem.model.system, RememberedForce()):
        moved = [port_motion_along(along, effect) for along in filtered.motions]
        (middle, reach), (drift, pace) = (
            _mean_and_deviation(np.concatenate([m[i] for m in moved])) for i in (0, 1)
        )
        if reach > 0 and pace > 0:
            shapes = {"middle": middle, "reach": reach, "drift": drift, "pace": pace}
            variants.append(make_variant(effect, "", shapes))
    return variants


def _mean_and_deviation(values: Array) -> tuple[float, float]:
    """Mean and deviation of a motion (samples, axes); of several axes about zero."""
    middle = float(values.mean()) if values.shape[1] == 1 else 0.0
    return middle, float(np.sqrt(np.mean((values - middle) ** 2)))


def _memoryless_variants(assembly: Assembly, past: Variant) -> tuple[Variant, ...]:
    """Any force without memory at the same port, and sensors and inputs a few samples late."""
    system, series = assembly.problem.model.system, assembly.study.series
    shapes = {parameter_of(k): v for k, v in past.shapes.items()}
    length = max(s.samples * s.dt for s in series)
    variants = [make_variant(PresentForce(port=past.effect.port), "", {**shapes, "record": length})]
    late: list[Effect] = [LateInput(port=place_name(port)) for port in system.driven]
    for effect in (*at_every_place(system, LateReading()), *late):
        own = {"time": series[0].dt} if effect.states else {}
        variants.append(make_variant(effect, "", own))
    return tuple(variants)


def _refit_with_variants(trial: _Trial, variants: Sequence[Variant], select: Masks) -> _Trial:
    """A model refitted with further effects, their amplitudes from zero."""
    own, at = with_variants(trial.assembly, variants), trial.fit.estimate
    state = transfer_fit_state(trial.fit.state, trial.assembly, own)
    values = state.values.copy()
    for variant in variants:
        for key, value in variant.shapes.items():
            values[:, own.study.index(key)] = value
    labels = (*state.labels, *(v.label for v in variants))
    state = replace(state, labels=labels, values=values)
    fit = fit_by_likelihood(
        own, state, at.noise, select, _STEPS, True, at.kept, differences=False, like=at.prepared
    )
    return _Trial(own, fit)


# --- what is told of it --------------------------------------------------------------------------


def _describe_memory(trial: _Trial, past: Variant, p_value: float, told: float) -> Memory:
    port = trial.assembly.problem.model.system.place(past.effect)
    forces = [_forces_along(trial, past, r) for r in range(len(trial.fit.estimate.prepared))]
    whole = sum(float(np.sum(f.missing**2)) for f in forces)
    kept = sum(float(np.sum(f.remembered**2)) for f in forces)
    count = sum(f.remembered.shape[0] for f in forces)
    first = forces[0]
    return Memory(
        port=port.name,
        kind=_memory_kind(trial, past),
        size=float(np.sqrt(kept / count)),
        share=kept / whole if whole > 0 else 0.0,
        unit=port.force_unit,
        position_unit=port.position_unit,
        p_value=p_value,
        log_ratio=told,
        loops=tuple(
            _largest_loop(axis, first.position[:, i], first.missing[:, i], first.period)
            for i, axis in enumerate(port.axes)
        ),
    )


@dataclass(frozen=True)
class _MissingForces:
    """What is missing beside a spring and a damper along one record, (samples, axes) each.

    ``remembered`` is what of it no function of the present explains; ``period`` of the motion in
    samples.
    """

    position: Array
    missing: Array
    remembered: Array
    period: float


def _forces_along(trial: _Trial, past: Variant, record: int) -> _MissingForces:
    task, settings = trial.fit.estimate.prepared[record]
    part = predict_readings(task, settings, trial.fit.estimate.noise, keep=True)
    along = predicted_motion(trial.assembly, task, part)
    position, velocity = port_motion_along(along, past.effect)
    remembered = _memory_force_along(task, along, past)
    present = next(v.effect for v in trial.assembly.variants if isinstance(v.effect, PresentForce))
    at, u = At(tuple(position.T), tuple(velocity.T), SimpleNamespace()), effect_inputs(along, 0.0)
    p = values_for(present, along.system.place(past.effect).axes, _values_by_key(task))
    missing = remembered + _stack_axes(present.force(at, u, p), len(position))
    for i, terms in enumerate(present.terms(at, u, p)):
        own = [np.ones(len(position)), position[:, i], velocity[:, i]]
        missing[:, i] = _regress_out(own, missing[:, i])
        remembered[:, i] = _regress_out([*own, *terms], remembered[:, i])
    time = float(np.sqrt(np.var(position) / np.var(velocity)))
    return _MissingForces(position, missing, remembered, 2 * np.pi * time / task.series.dt)


def _memory_force_along(task: FilterInput, along: SystemMotion, past: Variant) -> Array:
    """(samples, axes) the force with memory along a motion."""
    effect, values = past.effect, _values_by_key(task)
    axes = along.system.place(effect).axes
    shapes = {parameter_of(k): np.array([v]) for k, v in past.shapes.items()}
    states = own_states_along(along, task.series.dt, effect, shapes)[0]
    own = SimpleNamespace(**arrange_own_states(effect, len(axes), states))
    assert isinstance(effect, RememberedForce)
    given = effect.force(At((0.0,) * len(axes), (0.0,) * len(axes), own), SimpleNamespace(),
                         values_for(effect, axes, values))  # fmt: skip
    return _stack_axes(given, len(along.states))


def _values_by_key(task: FilterInput) -> Mapping[str, float]:
    return dict(zip(task.keys, map(float, task.values), strict=True))


def _stack_axes(forces: Sequence[Array], count: int) -> Array:
    return np.stack([np.broadcast_to(f, (count,)) for f in forces], axis=1).copy()


def _regress_out(columns: Sequence[Array], force: Array) -> Array:
    """The residual of a force regressed on these columns."""
    x = np.stack([np.broadcast_to(c, force.shape) for c in columns], axis=1)
    return force - x @ least_squares(x, force).b


def _memory_kind(trial: _Trial, past: Variant) -> Kind:
    """Whether the force yields, whatever the speed, or relaxes in time, where one is clear."""
    statistics = [_wald_statistic(trial, past, names) for names in (YIELDING, RELAXING)]
    if statistics[0] > _CLEARLY * statistics[1]:
        return "yields"
    return "relaxes" if statistics[1] > _CLEARLY * statistics[0] else "either"


def _wald_statistic(trial: _Trial, past: Variant, names: Sequence[str]) -> float:
    """Wald's statistic of some amplitudes: b^T V^-1 b."""
    at = trial.fit.estimate
    assert at.regression is not None
    chosen = [
        i for i, k in enumerate(at.keys)
        if k.startswith(f"{past.label}.by_") and k.rsplit(".by_", 1)[1].startswith(tuple(names))
        and at.regression.kept[i]
    ]  # fmt: skip
    if not chosen:
        return 0.0
    b = np.array([at.values[at.keys[i]] for i in chosen])
    rows = at.regression.inverse[chosen]
    return float(b @ np.linalg.pinv(rows @ rows.T) @ b)


def _largest_loop(axis: str, position: Array, force: Array, period: float) -> Loop:
    """A loop of force over position around the largest motion, in order of time."""
    half = max(int(_CYCLES * period / 2), 8)
    farthest = int(np.argmax(np.abs(position - position.mean())))
    middle = int(np.clip(farthest, half, max(len(position) - half, half)))
    part = slice(max(middle - half, 0), middle + half)
    step = max(len(position[part]) // _POINTS, 1)
    return Loop(axis, position[part][::step], force[part][::step])
