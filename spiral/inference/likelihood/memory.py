"""Whether what is missing has memory: a function of the present state against one of its history.

Where no candidate is admitted any more two further models of the machine are fitted, parameters and
noise, on the blocks that select:

    present     as it is, and any force f(q, q', t) without memory at one port, sensors and inputs
                that are a few samples late
    past        the same, and a force with memory there: springs that yield, forces that relax

(``spiral.physics.history``). The port is the one where forces with memory score best. Memory is
told where the past is significant on the blocks that select (Wilks' test, ``settings.level``) and

    log L(past) - log L(present) > log(1 / level)

on the blocks that judge, both with their values from the others and each with the noise as these
have it. Against the true values of ``present`` the ratio would have the expectation one, and so be
above 1 / level with a probability of ``level`` at most (Markov's inequality; the split likelihood
ratio of Wasserman, Ramdas and Balakrishnan 2020); here both are estimates, so its rate of false
alarms is measured (``experiments/memory``). What changes the predictions by less than
``settings.smallest`` standard deviations, or is under a twentieth of the missing force's mean
square, is not told: a curve or a sensor that the present cannot follow exactly leaves that much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
from scipy import special

from spiral.engine.filter.task import Task
from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.own_states import own_of, own_states_along
from spiral.engine.likelihood.predict import Masks, predicted
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.scoring import tested_keys
from spiral.inference.likelihood.fitting import LikelihoodFit, refitted
from spiral.inference.likelihood.judging import most_likely
from spiral.inference.likelihood.scores import Passage, motion_of, ranked_along
from spiral.inference.problem import Progress
from spiral.inference.unknown.holding import carried, variant_of, with_variants
from spiral.inference.unknown.memory import Kind, Loop, Memory
from spiral.physics.history import (
    RELAXING,
    YIELDING,
    LateInput,
    LateReading,
    PresentForce,
    RememberedForce,
)
from spiral.physics.signatures import Along, at_port_along, inputs_seen
from spiral.types.effect import Effect, values_for
from spiral.types.placement import at_every_place
from spiral.types.port import At
from spiral.types.record import Array
from spiral.types.system import has_coordinates, place_name

_LEAST = 0.05  # share of the missing force's mean square from which memory counts
_KEPT = 0.5  # of what an effect does alone: left beside a force with memory if it is no stand-in
_STEPS = 40  # scoring steps, at most, with the filter's gains held
_CLEARLY = 3.0  # times the other's Wald statistic from which one kind of memory is told
_CYCLES, _POINTS = 2.0, 200  # periods of a loop that is kept, and its points


@dataclass(frozen=True)
class _Trial:
    """A model fitted on the blocks that select, in terms of a study of its own."""

    assembly: Assembly
    fit: LikelihoodFit


class Remembered(NamedTuple):
    """What is told of a force with memory, and the ``force`` that stood for it in the fits."""

    memory: Memory
    force: Variant


def memory_of(
    assembly: Assembly,
    base: LikelihoodFit,
    masks: tuple[Masks, Masks],
    progress: Progress,
    rival: LikelihoodFit | None = None,
) -> Remembered | None:
    """The memory of what a model lacks; nothing where none is told, and of a system without forces.

    Parameters
    ----------
    base : the model as it is, fitted on the blocks that select. masks : (select, judge).
    rival : another model without memory that the past must be as much more likely than.
    """
    if not has_coordinates(assembly.problem.model.system):
        return None
    level, (select, judge) = assembly.problem.settings.level, masks
    past = _most_promising(assembly, base, select, level)
    if past is None:
        return None
    progress("asking whether what is missing has memory")
    present = _wider(_Trial(assembly, base), _without_memory(assembly, past), select)
    wide = _wider(present, (past,), select)
    if not (present.fit.estimate.finite and wide.fit.estimate.finite):
        return None
    terms = len(tested_keys(wide.assembly, wide.assembly.variant(past.label)))
    gain = max(wide.fit.height - present.fit.height, 0.0)
    p_value = float(special.chdtrc(terms, 2 * gain))
    others = [present.fit, *([] if rival is None else [rival])]
    alone, *rest = (most_likely(f.estimate, judge, {}).log_likelihood for f in (wide.fit, *others))
    told = alone - max(rest)
    size = np.sqrt(2 * max(told, 0.0) / _readings(base, judge))
    if p_value >= level or not told > -np.log(level):
        return None
    if size < assembly.problem.settings.smallest:
        return None
    found = _described(wide, past, p_value, told)
    return Remembered(found, past) if found.share >= _LEAST else None


def replaced_by_memory(
    assembly: Assembly, base: LikelihoodFit, before: LikelihoodFit, past: Variant,
    labels: Sequence[str], select: Masks,
) -> tuple[str, ...]:  # fmt: skip
    """Which of these effects, held without memory, give way to a force that has it.

    The model is fitted with that force beside them, and so is the model ``before`` them. All of
    them may have stood in for the memory where it alone is more likely than they are, or where
    they add less than half as much log-likelihood beside it as without it; else those of which
    less than half of every amplitude is left.
    """
    with_them, without = (_wider(_Trial(assembly, f), (past,), select) for f in (base, before))
    if not (with_them.fit.estimate.finite and without.fit.estimate.finite):
        return tuple(labels)
    beside, alone = with_them.fit.height - without.fit.height, base.height - before.height
    if not (beside >= _KEPT * alone and base.height >= without.fit.height):
        return tuple(labels)
    return tuple(x for x in labels if not _kept(assembly, base, with_them, x))


def _kept(assembly: Assembly, base: LikelihoodFit, wide: _Trial, label: str) -> bool:
    """Whether half of one of an effect's amplitudes is left in a wider model."""
    keys = tested_keys(assembly, assembly.variant(label))
    before = base.state.values[0, [assembly.study.index(k) for k in keys]]
    after = wide.fit.state.values[0, [wide.assembly.study.index(k) for k in keys]]
    return bool(np.any((before != 0.0) & (after * np.sign(before) >= _KEPT * np.abs(before))))


def _readings(fit: LikelihoodFit, masks: Masks) -> int:
    """How many readings some blocks hold."""
    rows = [part.spreads > 0 for part in fit.estimate.parts]
    if masks is not None:
        rows = [r if m is None else r[m] for r, m in zip(rows, masks, strict=True)]
    return max(sum(int(r.sum()) for r in rows), 1)


# --- the two models ------------------------------------------------------------------------------


def _most_promising(
    assembly: Assembly, base: LikelihoodFit, select: Masks, level: float
) -> Variant | None:
    """A force with memory at the port where it scores best; nothing where it does nowhere."""
    found = ranked_along(assembly, base, base.estimate.noise, select, _offered)
    if found is None or not found.ranked:
        return None
    best = found.ranked[0]
    return best.variant if best.score.log_p < np.log(level) else None


def _offered(passage: Passage) -> list[Variant]:
    """A force with memory at every port that moves, its shapes by the motion there."""
    found = []
    for effect in at_every_place(passage.assembly.problem.model.system, RememberedForce()):
        moved = [at_port_along(along, effect) for along in passage.motions]
        (middle, reach), (drift, pace) = (
            _scales(np.concatenate([m[i] for m in moved])) for i in (0, 1)
        )
        if reach > 0 and pace > 0:
            shapes = {"middle": middle, "reach": reach, "drift": drift, "pace": pace}
            found.append(variant_of(effect, "", shapes))
    return found


def _scales(values: Array) -> tuple[float, float]:
    """Mean and deviation of a motion (samples, axes); of several axes about zero."""
    middle = float(values.mean()) if values.shape[1] == 1 else 0.0
    return middle, float(np.sqrt(np.mean((values - middle) ** 2)))


def _without_memory(assembly: Assembly, past: Variant) -> tuple[Variant, ...]:
    """Any force without memory at the same port, and sensors and inputs a few samples late."""
    system, series = assembly.problem.model.system, assembly.study.series
    shapes = {k.rsplit(".", 1)[1]: v for k, v in past.shapes.items()}
    length = max(s.samples * s.dt for s in series)
    found = [variant_of(PresentForce(port=past.effect.port), "", {**shapes, "record": length})]
    late: list[Effect] = [LateInput(port=place_name(port)) for port in system.driven]
    for effect in (*at_every_place(system, LateReading()), *late):
        own = {"time": series[0].dt} if effect.states else {}
        found.append(variant_of(effect, "", own))
    return tuple(found)


def _wider(trial: _Trial, variants: Sequence[Variant], select: Masks) -> _Trial:
    """A model with further effects, from zero, its parameters and noise refitted."""
    own, at = with_variants(trial.assembly, variants), trial.fit.estimate
    state = carried(trial.fit.state, trial.assembly, own)
    values = state.values.copy()
    for variant in variants:
        for key, value in variant.shapes.items():
            values[:, own.study.index(key)] = value
    labels = (*state.labels, *(v.label for v in variants))
    state = replace(state, labels=labels, values=values)
    fit = refitted(
        own, state, at.noise, select, _STEPS, True, at.kept, differences=False, like=at.prepared
    )
    return _Trial(own, fit)


# --- what is told of it --------------------------------------------------------------------------


def _described(trial: _Trial, past: Variant, p_value: float, told: float) -> Memory:
    port = trial.assembly.problem.model.system.place(past.effect)
    forces = [_forces(trial, past, r) for r in range(len(trial.fit.estimate.prepared))]
    whole = sum(float(np.sum(f.missing**2)) for f in forces)
    kept = sum(float(np.sum(f.remembered**2)) for f in forces)
    count = sum(f.remembered.shape[0] for f in forces)
    first = forces[0]
    return Memory(
        port=port.name,
        kind=_kind(trial, past),
        size=float(np.sqrt(kept / count)),
        share=kept / whole if whole > 0 else 0.0,
        unit=port.force_unit,
        position_unit=port.position_unit,
        p_value=p_value,
        log_ratio=told,
        loops=tuple(
            _loop(axis, first.position[:, i], first.missing[:, i], first.period)
            for i, axis in enumerate(port.axes)
        ),
    )


@dataclass(frozen=True)
class _Forces:
    """What is missing beside a spring and a damper along one record, (samples, axes) each.

    ``remembered`` is what of it no function of the present explains; ``period`` of the motion in
    samples.
    """

    position: Array
    missing: Array
    remembered: Array
    period: float


def _forces(trial: _Trial, past: Variant, record: int) -> _Forces:
    task, settings = trial.fit.estimate.prepared[record]
    part = predicted(task, settings, trial.fit.estimate.noise, keep=True)
    along = motion_of(trial.assembly, task, part)
    position, velocity = at_port_along(along, past.effect)
    remembered = _remembered(task, along, past)
    present = next(v.effect for v in trial.assembly.variants if isinstance(v.effect, PresentForce))
    at, u = At(tuple(position.T), tuple(velocity.T), SimpleNamespace()), inputs_seen(along, 0.0)
    p = values_for(present, along.system.place(past.effect).axes, _values(task))
    missing = remembered + _stacked(present.force(at, u, p), len(position))
    for i, terms in enumerate(present.terms(at, u, p)):
        own = [np.ones(len(position)), position[:, i], velocity[:, i]]
        missing[:, i] = _beside(own, missing[:, i])
        remembered[:, i] = _beside([*own, *terms], remembered[:, i])
    time = float(np.sqrt(np.var(position) / np.var(velocity)))
    return _Forces(position, missing, remembered, 2 * np.pi * time / task.series.dt)


def _remembered(task: Task, along: Along, past: Variant) -> Array:
    """(samples, axes) the force with memory along a motion."""
    effect, values = past.effect, _values(task)
    axes = along.system.place(effect).axes
    shapes = {k.rsplit(".", 1)[1]: np.array([v]) for k, v in past.shapes.items()}
    states = own_states_along(along, task.series.dt, effect, shapes)[0]
    own = SimpleNamespace(**own_of(effect, len(axes), states))
    assert isinstance(effect, RememberedForce)
    given = effect.force(At((0.0,) * len(axes), (0.0,) * len(axes), own), SimpleNamespace(),
                         values_for(effect, axes, values))  # fmt: skip
    return _stacked(given, len(along.states))


def _values(task: Task) -> Mapping[str, float]:
    return dict(zip(task.keys, map(float, task.values), strict=True))


def _stacked(forces: Sequence[Array], count: int) -> Array:
    return np.stack([np.broadcast_to(f, (count,)) for f in forces], axis=1).copy()


def _beside(columns: Sequence[Array], force: Array) -> Array:
    """What is left of a force once these columns have taken what they can."""
    x = np.stack([np.broadcast_to(c, force.shape) for c in columns], axis=1)
    return force - x @ least_squares(x, force).b


def _kind(trial: _Trial, past: Variant) -> Kind:
    """Whether the force yields, whatever the speed, or relaxes in time, where one is clear."""
    found = [_wald(trial, past, names) for names in (YIELDING, RELAXING)]
    if found[0] > _CLEARLY * found[1]:
        return "yields"
    return "relaxes" if found[1] > _CLEARLY * found[0] else "either"


def _wald(trial: _Trial, past: Variant, names: Sequence[str]) -> float:
    """Wald's statistic of some amplitudes: b^T V^-1 b."""
    at = trial.fit.estimate
    assert at.solved is not None
    chosen = [
        i for i, k in enumerate(at.keys)
        if k.startswith(f"{past.label}.by_") and k.rsplit(".by_", 1)[1].startswith(tuple(names))
        and at.solved.kept[i]
    ]  # fmt: skip
    if not chosen:
        return 0.0
    b = np.array([at.values[at.keys[i]] for i in chosen])
    rows = at.solved.inverse[chosen]
    return float(b @ np.linalg.pinv(rows @ rows.T) @ b)


def _loop(axis: str, position: Array, force: Array, period: float) -> Loop:
    """Force over position around the largest motion, in order of time."""
    half = max(int(_CYCLES * period / 2), 8)
    farthest = int(np.argmax(np.abs(position - position.mean())))
    middle = int(np.clip(farthest, half, max(len(position) - half, half)))
    part = slice(max(middle - half, 0), middle + half)
    step = max(len(position[part]) // _POINTS, 1)
    return Loop(axis, position[part][::step], force[part][::step])
