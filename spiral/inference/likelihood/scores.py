"""Scores of candidates by their slopes along the predicted motion; none is compiled for it.

The whitened misses e of the model as it is are regressed on their slopes by what moves and by every
candidate's amplitudes, on the blocks that select: the fall of |e|^2 is twice the gain in
log-likelihood of one step.

An effect with states of its own has a frequency that means nothing while its amplitude is zero.
Its own states are driven along the motion for a whole band of frequencies, the misses are resolved
into what each explains, and the largest peaks, refined, are candidates like all others.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.blocks import NO_BLOCKS, Blocks, RowBlocks
from spiral.engine.filter.task import FilterInput
from spiral.engine.leastsquares import triangle
from spiral.engine.likelihood.autoregression import Autoregression, fit_autoregression
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.own_states import arrange_own_states, own_states_along
from spiral.engine.likelihood.predict import Masks, Prediction, predict_readings
from spiral.engine.score import build_score_table, residual_block_samples
from spiral.engine.sensitivities import Reduction
from spiral.inference.evidence.assembly import Assembly, Variant, columns_with_bounds
from spiral.inference.evidence.enlarge import make_variant
from spiral.inference.evidence.scoring import (
    CandidateColumns,
    Parts,
    Ranking,
    active_labels,
    column_owners,
    rank_groups,
    score_groups,
)
from spiral.inference.evidence.spectrum import (
    frequency_ratio,
    frequency_shapes,
    local_maxima,
    other_shapes,
    trial_counts,
    trial_frequencies,
)
from spiral.inference.likelihood.fitting import LikelihoodFit, free_parameters
from spiral.inference.likelihood.predicted_motion import (
    driving_states,
    predicted_motion,
    varied_keys,
)
from spiral.physics.signatures import (
    Own,
    SystemMotion,
    amplitude_names,
    port_motion_along,
    signatures,
)
from spiral.types.effect import Effect
from spiral.types.label import parameter_of
from spiral.types.record import Array

_ROOM = 4_000_000  # numbers of signatures that are in memory at a time
_STRETCH = 8192  # samples over which a candidate's signature is evaluated at once
_HUGE = 1e60  # a slope from which one is no number: own states that run away
_PEAKS = 3  # of the spectrum, whose frequencies are tried
_TOGETHER = 64  # trials that are regressed at once: the work grows with the square of their number
_BETWEEN = np.linspace(-0.8, 0.8, 9)  # steps around a number of repetitions
_FINE = (np.linspace(-0.8, 0.8, 5), np.linspace(-0.3, 0.3, 5))  # steps around a peak


@dataclass(frozen=True)
class FilteredRecords:
    """One pass of the filter over all records; candidates are scored along its predicted motion."""

    assembly: Assembly
    active: tuple[str, ...]
    tasks: tuple[FilterInput, ...]
    parts: tuple[Prediction, ...]
    motions: tuple[SystemMotion, ...]
    masks: Masks
    block: int
    past: Autoregression | None = None


def rank_candidates(
    assembly: Assembly, fit: LikelihoodFit, noise: NoiseModel, masks: Masks, past: bool = False
) -> Ranking | None:
    """Candidates ranked by their score on some blocks; nothing where the filter diverges.

    They are not compiled: their signatures are propagated along the predicted motion. ``past`` :
    beside innovations that follow their own past, what a simple model of the noise leaves of it.
    """
    present = active_labels(assembly, fit.state)

    def absent_variants(filtered: FilteredRecords) -> list[Variant]:
        variants = [v for v in assembly.offered if v.original.label not in present]
        for effect in (e for e in assembly.later if e.label not in present):
            variants += resonance_variants(filtered, effect)
        return variants + repeating_variants(filtered, variants)

    return rank_variants(assembly, fit, noise, masks, absent_variants, past=past)


def rank_variants(
    assembly: Assembly, fit: LikelihoodFit, noise: NoiseModel, masks: Masks,
    offered: Callable[[FilteredRecords], Sequence[Variant]], parts: Parts | None = None,
    past: bool = False,
) -> Ranking | None:  # fmt: skip
    """The variants that ``offered`` gives for a pass of the filter, ranked by their score.

    ``parts`` as in ``rank_groups``, ``past`` as in ``rank_candidates``.
    """
    filtered = _filter_records(assembly, fit, noise, masks)
    if filtered is None:
        return None
    if past:
        filtered = replace(filtered, past=fit_autoregression(filtered.parts, masks))
    reduction, groups = _regress_variants(filtered, offered(filtered))
    first, _ = columns_with_bounds(assembly, filtered.active)
    return rank_groups(reduction, column_owners(assembly, first), groups, filtered.block, parts)


def _filter_records(
    assembly: Assembly, fit: LikelihoodFit, noise: NoiseModel, masks: Masks
) -> FilteredRecords | None:
    prepared, active = fit.estimate.prepared, free_parameters(assembly, fit.state)
    with np.errstate(all="ignore"):
        parts = tuple(predict_readings(task, settings, noise, active, carry=True)
                      for task, settings in prepared)  # fmt: skip
    if not all(p.whole and np.all(np.isfinite(p.slopes)) for p in parts):
        return None
    tasks = tuple(task for task, _ in prepared)
    pairs = zip(tasks, parts, strict=True)
    varied, driving = varied_keys(assembly), driving_states(assembly)
    motions = tuple(predicted_motion(assembly, t, p, varied, driving) for t, p in pairs)
    block = residual_block_samples(tuple(p.whitened for p in parts))
    return FilteredRecords(assembly, active, tasks, parts, motions, masks, block)


def _regress_variants(
    filtered: FilteredRecords, offered: Sequence[Variant], robust: bool = True
) -> tuple[Reduction, list[CandidateColumns]]:
    """The regression of the innovations on all variants with finite slopes, and their groups.

    ``robust`` : with the sums over blocks that Wald's test asks for.
    """
    groups = [_column_group(filtered.assembly, v, len(filtered.parts)) for v in offered]
    with np.errstate(all="ignore"):
        carried = [_prediction_slopes(filtered, r, groups) for r in range(len(filtered.parts))]
        finite = np.all([np.abs(c).max(axis=(0, 1)) < _HUGE for c in carried], axis=0)
    groups, carried = _drop_nonfinite_groups(groups, carried, finite)
    block = filtered.block if robust else 0
    return _reduce_innovations(filtered, carried, block), groups


# --- effects with states of their own, and those that repeat -------------------------------------


def resonance_variants(filtered: FilteredRecords, effect: Effect) -> list[Variant]:
    """Variants of an effect with own states, at the frequencies that explain most."""
    band = trial_frequencies(effect, max(filtered.tasks, key=lambda t: t.series.samples).series)
    near = [frequency_ratio(effect) ** some for some in _FINE]
    usual, others = other_shapes(effect)
    share = _explained_shares(
        filtered, effect, [{**usual, **frequency_shapes(effect, f)} for f in band]
    )
    top = [float(band[k]) for k in local_maxima(share)[:_PEAKS]]
    coarse = _best_trial_per_peak(
        filtered, effect, [[(f * s, o) for s in near[0] for o in others] for f in top]
    )
    chosen = [
        {**o, **frequency_shapes(effect, f)}
        for f, o in _best_trial_per_peak(
            filtered, effect, [[(f * s, o) for s in near[1]] for f, o in coarse]
        )
    ]
    searched = max(len(band) // max(len(chosen), 1), 1)
    return [make_variant(effect, str(i + 1), c, searched) for i, c in enumerate(chosen)]


def repeating_variants(filtered: FilteredRecords, known: Sequence[Variant]) -> list[Variant]:
    """Variants, beyond the grids of those ``known``, of effects that repeat with an angle.

    How often they do is looked for over all that the records show, as a frequency is.
    """
    variants = []
    for effect in dict.fromkeys(v.original for v in known):
        for shape in (p for p in effect.parameters if p.repeats):
            along = [port_motion_along(m, effect)[0][:, 0] for m in filtered.motions]
            counts, step = trial_counts(along, max(shape.grid))
            if not len(counts):
                continue
            share = _explained_shares(filtered, effect, [{shape.name: n} for n in counts])
            top = [counts[k] for k in local_maxima(share)[:_PEAKS]]
            near = [[{shape.name: n + s * step} for s in _BETWEEN] for n in top]
            flat = iter(_explained_shares(filtered, effect, [t for some in near for t in some]))
            best = [max(((next(flat), t) for t in some), key=lambda x: x[0])[1] for some in near]
            searched = max(len(counts) // len(best), 1)
            variants += [make_variant(effect, f"n{i}", t, searched) for i, t in enumerate(best)]
    return variants


def _best_trial_per_peak(
    filtered: FilteredRecords,
    effect: Effect,
    trials: Sequence[Sequence[tuple[float, dict[str, float]]]],
) -> list[tuple[float, dict[str, float]]]:
    """Of the trials (frequency, other shapes) at each peak the one that explains most."""
    flat = [{**o, **frequency_shapes(effect, f)} for some in trials for f, o in some]
    shares = iter(_explained_shares(filtered, effect, flat))
    return [max(((next(shares), t) for t in some), key=lambda x: x[0])[1] for some in trials]


def _explained_shares(
    filtered: FilteredRecords, effect: Effect, trials: Sequence[Mapping[str, float]]
) -> Array:
    """Share of what is left that each trial (shapes by name) explains."""
    offered = [make_variant(effect, str(i + 1), dict(t)) for i, t in enumerate(trials)]
    shares = dict.fromkeys((v.label for v in offered), 0.0)
    for some in (offered[i : i + _TOGETHER] for i in range(0, len(offered), _TOGETHER)):
        reduction, groups = _regress_variants(filtered, some, robust=False)
        table = build_score_table(reduction, len(filtered.active))
        shares |= {g.variant.label: s.explains for g, s in score_groups(table, groups)}
    return np.array(list(shares.values()))


def _own_states_by_label(
    along: SystemMotion, dt: float, groups: Sequence[CandidateColumns]
) -> dict[str, Own]:
    """Own states of every variant that has any, by its label; computed together for one effect."""
    by_label: dict[str, Own] = {}
    keyed = sorted(
        (g.variant for g in groups if g.variant.effect.states), key=lambda v: v.original.label
    )
    for _, some in itertools.groupby(keyed, key=lambda v: v.original.label):
        variants = list(some)
        names = [parameter_of(k) for k in variants[0].shapes]
        shapes = {n: np.array([v.shapes[f"{v.label}.{n}"] for v in variants]) for n in names}
        states = own_states_along(along, dt, variants[0].original, shapes)
        axes = len(along.system.place(variants[0].original).axes)
        for copy, variant in enumerate(variants):
            by_label[variant.label] = arrange_own_states(variant.original, axes, states[copy])
    return by_label


# --- slopes --------------------------------------------------------------------------------------


def _column_group(assembly: Assembly, variant: Variant, records: int) -> CandidateColumns:
    """The columns of a candidate's amplitudes, for each record its own where they have one."""
    port = assembly.problem.model.system.place(variant.effect)
    known = dict(variant.effect.keys(port))
    keys, sides = [], []
    for owner in (variant.effect, variant.companion):
        if owner is None:
            continue
        for name in amplitude_names(variant.effect, port):
            q = known[f"{variant.label}.{name}"]
            count = records if q.scope == "record" else 1
            keys += [f"{owner.label}.{name}"] * count
            sides += [q.lower == 0.0 and variant.companion is None] * count
    return CandidateColumns(variant, tuple(keys), tuple(sides))


def _drop_nonfinite_groups(
    groups: list[CandidateColumns], carried: list[Array], finite: Array
) -> tuple[list[CandidateColumns], list[Array]]:
    """The groups and columns without candidates whose slopes overflow."""
    kept, at, first = [], [], 0
    for group in groups:
        own = list(range(first, first := first + len(group.keys)))
        if finite[own].all():
            kept.append(group)
            at += own
    return kept, [c[:, :, at] for c in carried]


def _prediction_slopes(
    filtered: FilteredRecords, record: int, groups: Sequence[CandidateColumns]
) -> Array:
    """Slopes of predictions by the candidates' amplitudes at zero, (samples, channels, columns).

    Some candidates at a time, each over as many samples at once as there is room for: an effect's
    equation costs more to call than to evaluate.
    """
    task, part = filtered.tasks[record], filtered.parts[record]
    owns = _own_states_by_label(filtered.motions[record], task.series.dt, groups)
    samples, m = part.misses.shape
    by_amplitude = np.zeros((samples, m, sum(len(g.keys) for g in groups)))
    most = max(_ROOM // ((len(task.states) + m) * min(samples, _STRETCH)), 1)
    first = 0
    for some in _batches(groups, most):
        last = first + sum(len(g.keys) for g in some)
        by_amplitude[:, :, first:last] = _batch_slopes(filtered, record, some, owns)
        first = last
    return by_amplitude


def _batches(groups: Sequence[CandidateColumns], most: int) -> Iterator[list[CandidateColumns]]:
    """The groups in their order, in batches of at most so many columns, or of one group."""
    batch: list[CandidateColumns] = []
    for group in groups:
        if batch and sum(len(g.keys) for g in batch) + len(group.keys) > most:
            yield batch
            batch = []
        batch.append(group)
    if batch:
        yield batch


def _batch_slopes(
    filtered: FilteredRecords,
    record: int,
    groups: Sequence[CandidateColumns],
    owns: Mapping[str, Own],
) -> Array:
    """As ``_prediction_slopes``, of some candidates whose own states are known."""
    from spiral.engine.likelihood.signatures_kernel import propagate_signatures

    task, part = filtered.tasks[record], filtered.parts[record]
    along, samples, m = filtered.motions[record], *part.misses.shape
    width, n = sum(len(g.keys) for g in groups), len(task.states)
    by_amplitude = np.zeros((samples, m, width))
    slopes = np.zeros((part.means.shape[1], width))
    chunk = max(_ROOM // ((n + m) * width), 256)
    for first in range(0, samples, chunk):
        last = min(first + chunk, samples)
        where = slice(first, min(last + 1, samples))
        pushes, readings = _signature_columns(along.part(where), groups, owns, where, record, width)
        propagate_signatures(
            part.transitions[first:last], part.gains[first:last], part.rows[first:last],
            pushes, readings, slopes, 0.5 * task.series.dt, by_amplitude[first:last],
        )  # fmt: skip
    return by_amplitude


def _signature_columns(
    along: SystemMotion,
    groups: Sequence[CandidateColumns],
    owns: Mapping[str, Own],
    where: slice,
    record: int,
    width: int,
) -> tuple[Array, Array]:
    """Slopes of rates (columns, samples, n) and readings (columns, samples, channels)."""
    count, n = along.states.shape
    rates, readings = np.zeros((width, count, n)), np.zeros((width, count, along.readings.shape[1]))
    at = 0
    for group in groups:
        variant = group.variant
        shapes = {parameter_of(k): v for k, v in variant.shapes.items()}
        own = {
            n: tuple(p[where] for p in v) if isinstance(v, tuple) else v[where]
            for n, v in owns.get(variant.label, {}).items()
        }
        parts = [signatures(along, variant.original, shapes, own=own)]
        if variant.companion is not None:
            parts.append(signatures(along, variant.original, shapes, np.pi / 2))
        width_each = sum(p[0].shape[2] for p in parts)
        copies = len(group.keys) // width_each
        place = at + record if copies > 1 else at
        for pushes, told in parts:
            for j in range(pushes.shape[2]):
                rates[place], readings[place] = pushes[:, :, j], told[:, :, j]
                place += copies
        at += len(group.keys)
    return rates, readings


def _reduce_innovations(
    filtered: FilteredRecords, carried: Sequence[Array], block: int
) -> Reduction:
    """Whitened innovations and slopes as a triangle, with their rows in blocks, or without."""
    rows, lengths, masks = [], [], filtered.masks
    for r, (part, own) in enumerate(zip(filtered.parts, carried, strict=True)):
        chosen = None if masks is None else masks[r]
        mask = np.ones(len(part.misses), dtype=bool) if chosen is None else chosen
        weight = part.weight[..., None]
        whole = np.concatenate(
            [part.slopes * weight, own * weight, part.whitened[..., None]], axis=2
        )
        whole = whole if filtered.past is None else filtered.past.whiten(whole)
        seen = whole[mask]
        rows.append(seen.reshape(-1, whole.shape[2]))
        if block:
            lengths += [seen.shape[1] * int(mask[at : at + block].sum())
                        for at in range(0, len(mask), block)]  # fmt: skip
    upper, _ = triangle(rows)
    cost, samples = sum(float(x[:, -1] @ x[:, -1]) for x in rows), sum(map(len, rows))
    return Reduction(upper, cost, samples, 0, (), _row_blocks(rows, lengths))


def _row_blocks(rows: Sequence[Array], lengths: Sequence[int]) -> Blocks:
    """The rows in blocks of these lengths, of which empty ones are none; none where no length."""
    if not lengths:
        return NO_BLOCKS
    own = np.array([n for n in lengths if n])
    columns = np.ascontiguousarray(np.concatenate(rows).T)
    return RowBlocks(columns, np.cumsum(own) - own)
