"""One pass over the records: signatures of all columns, initial states eliminated.

Each window's rows [J_x0 | J_p | r] are reduced by QR as they are made, a bounded piece at a time,
so that memory does not grow with record length times columns. The initial state is eliminated by
a rank-revealing step (a direction of the state that the window does not show is left alone).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spiral.engine.blocks import NO_BLOCKS, Blocks, GramBlocks
from spiral.engine.elimination import (
    eliminate_initial_states,
    gram_matrices,
    merge_blocks,
    project_gram_matrices,
    scatter_blocks,
    scatter_columns,
    triangle_of,
)
from spiral.engine.kernel import advance_windows, drive_states, trajectories
from spiral.engine.series import Series
from spiral.engine.study import CompiledStudy, Layouts, ParameterColumns, Point
from spiral.engine.threads import run_in_threads
from spiral.engine.windows import WindowLayout
from spiral.types.record import Array

_PIECE = 4096  # samples in memory at a time
_ENOUGH = 4  # batches from which threads pay
_CURVATURE = 0.05  # rad per knot^2: expected second difference of a phase correction


@dataclass(frozen=True)
class Reduction:
    """A pass, reduced.

    ``triangle`` (columns + 1, columns + 1): R of the QR decomposition of [J_p | r] with all
    initial states projected out; ``cost`` the sum of squares of r before any step; ``samples`` the
    residuals counted; ``elimination`` per record (windows, states, columns + 1), the minimum-norm
    map with x0 step = e[:, -1] - e[:, :-1] @ step; ``blocks`` the projected
    rows by blocks, or none.
    """

    triangle: Array
    cost: float
    samples: int
    nuisances: int
    elimination: tuple[Array, ...]
    blocks: Blocks

    @property
    def finite(self) -> bool:
        """Whether the model stayed finite in every window."""
        return bool(np.isfinite(self.cost))


@dataclass(frozen=True)
class _Batch:
    """Windows of one record with equal length, reduced together."""

    record: int
    windows: Array
    length: int


@dataclass(frozen=True)
class _ReducedBatch:
    """One batch: rows left after elimination, the elimination, Gram blocks, cost and rank."""

    rows: Array
    eliminated: Array
    grams: Array
    cost: float
    rank: int

    @classmethod
    def diverged_batch(cls) -> _ReducedBatch:
        """A batch whose model did not stay finite."""
        none = np.zeros((0, 0))
        return cls(none, none, none, np.inf, 0)


def reduce_windows(
    study: CompiledStudy, layouts: Layouts, point: Point, columns: ParameterColumns, block: int = 0
) -> Reduction:
    """Integrate all windows with sensitivities and reduce them.

    Parameters
    ----------
    columns : the parameters differentiated.
    block : samples in a Gram block; 0 makes none.
    """
    point.check_study(study)
    weights = [s.weight(layout.mask) for s, layout in zip(study.series, layouts, strict=True)]
    batches = list(_window_batches(layouts))

    grids = [study.inputs(r, row) for r, row in enumerate(point.values)]

    def reduce_batch(batch: _Batch) -> _ReducedBatch:
        weight, grid = weights[batch.record], grids[batch.record]
        return _reduce_batch(study, layouts, point, columns, batch, weight, grid, block)

    results = list(zip(batches, _map_batches(reduce_batch, batches), strict=True))
    width, n = columns.count + 1, study.state_count
    samples = int(sum(np.count_nonzero(w) for w in weights))
    elimination = tuple(np.zeros((len(x), n, width)) for x in point.starts)
    priors = (curvature_prior(study, columns, point.values), columns.prior(point.values))
    prior = np.concatenate(priors)
    cost = sum(reduced.cost for _, reduced in results) + float(np.sum(prior[:, -1] ** 2))
    if not np.isfinite(cost):
        return Reduction(np.zeros((width, width)), np.inf, samples, 0, elimination, NO_BLOCKS)
    parts, blocks = [prior], []
    for batch, reduced in results:
        seen = np.append(columns.local(batch.record), width - 1)
        at = np.ix_(batch.windows, np.arange(n), seen)
        elimination[batch.record][at] = reduced.eliminated
        parts.append(triangle_of(scatter_columns(reduced.rows, seen, width)))
        blocks.append(scatter_blocks(reduced.grams, seen, width))
    return Reduction(
        triangle=triangle_of(np.concatenate(parts)),
        cost=cost,
        samples=samples,
        nuisances=sum(reduced.rank for _, reduced in results),
        elimination=elimination,
        blocks=GramBlocks(np.concatenate(blocks)),
    )


def curvature_prior(study: CompiledStudy, columns: ParameterColumns, values: Array) -> Array:
    """Rows [J | r] of the prior on phase corrections: second differences of 0.05 rad per knot^2."""
    plain = len(study.keys)
    rows = [np.zeros((0, columns.count + 1))]
    for record, series in enumerate(study.series):
        count = series.splines.count
        own = np.flatnonzero((columns.index >= plain) & (columns.record == record))
        if count < 3 or not len(own):
            continue
        bend = np.diff(np.eye(count), n=2, axis=0) / _CURVATURE
        block = np.zeros((count - 2, columns.count + 1))
        block[:, own] = bend[:, columns.index[own] - plain]
        block[:, -1] = -bend @ values[record, plain : plain + count]
        rows.append(block)
    return np.concatenate(rows)


def residuals(study: CompiledStudy, layouts: Layouts, point: Point) -> tuple[Array, ...]:
    """Weighted residuals (samples, channels) of each record; zero where nothing counts."""
    weighted = []
    for record, (series, layout) in enumerate(zip(study.series, layouts, strict=True)):
        states, readings = run_windows(study, record, layout, point)
        weight = series.weight(layout.mask)
        written = np.isfinite(readings) if np.isfinite(states[layout.starts]).all() else True
        with np.errstate(invalid="ignore", over="ignore"):
            weighted.append(np.where(written & (weight > 0), weight * (series.y - readings), 0.0))
    return tuple(weighted)


def run_windows(
    study: CompiledStudy, record: int, layout: WindowLayout, point: Point
) -> tuple[Array, Array]:
    """States and readings of one record, window by window; infinite throughout on divergence."""
    point.check_study(study)
    series = study.series[record]
    states = np.full((series.samples, study.state_count), np.nan)
    readings = np.full_like(series.y, np.nan)
    ok = trajectories(
        study.compiled.rate_value, study.compiled.output_value,
        np.ascontiguousarray(point.starts[record]), layout.starts, layout.lengths,
        np.ascontiguousarray(point.values[record : record + 1]),
        study.inputs(record, point.values[record]), series.substeps, series.dt, states, readings,
    )  # fmt: skip
    if not ok:
        states[:], readings[:] = np.inf, np.inf
    return states, readings


def drive_effect_states(study: CompiledStudy, record: int, states: Array, row: Array) -> Array:
    """States (samples, n) of a record, those that effects bring integrated along all others.

    They begin at zero; where one of them runs away they are left at zero.
    """
    own = study.own
    if not len(own):
        return states
    series, filled = study.series[record], np.ascontiguousarray(states)
    ok = drive_states(
        study.compiled.rate_value, filled, own, np.ascontiguousarray(row[None, :]),
        study.inputs(record, row), series.substeps, series.dt,
    )  # fmt: skip
    if not ok:
        filled[:, own] = 0.0
    return filled


def _map_batches(work, batches: list[_Batch]) -> list:
    if len(batches) < _ENOUGH:
        return [work(batch) for batch in batches]
    return run_in_threads(work, batches)


def _window_batches(layouts: Layouts) -> Iterator[_Batch]:
    for record, layout in enumerate(layouts):
        for length in np.unique(layout.lengths):
            same = np.flatnonzero(layout.lengths == length)
            group = max(1, _PIECE // int(length))
            for first in range(0, len(same), group):
                yield _Batch(record, same[first : first + group], int(length))


def _advance_batch(
    study: CompiledStudy,
    series: Series,
    grid: Array,
    x: Array,
    s: Array,
    starts: Array,
    length: int,
    values: Array,
    local: Array,
    weight: Array,
    rows: Array,
) -> bool:
    splines = series.splines
    return advance_windows(
        study.compiled.rate, study.compiled.output, x, s, np.ascontiguousarray(starts), length,
        np.ascontiguousarray(values), local, study.phase, splines.first, splines.weights, grid,
        series.substeps, series.dt, series.y, weight, rows,
    )  # fmt: skip


def _reduce_batch(
    study: CompiledStudy,
    layouts: Layouts,
    point: Point,
    columns: ParameterColumns,
    batch: _Batch,
    weight: Array,
    grid: Array,
    block: int,
) -> _ReducedBatch:
    """Integrate one batch piece by piece, keeping its triangle and its Gram blocks."""
    series = study.series[batch.record]
    starts = layouts[batch.record].starts[batch.windows].copy()
    local = columns.index[columns.local(batch.record)]
    n, count, channels = study.state_count, len(starts), series.y.shape[1]
    width = n + len(local) + 1
    x = point.starts[batch.record][batch.windows].copy()
    s = np.zeros((count, n, width - 1))
    s[:, :, :n] = np.eye(n)
    triangle = np.zeros((count, 0, width))
    raw: list[Array] = []
    cost = 0.0
    for first in range(0, batch.length, _PIECE):
        piece = min(_PIECE, batch.length - first)
        rows = np.empty((count, piece * channels, width))
        values = point.values[batch.record]
        at = starts + first
        ok = _advance_batch(study, series, grid, x, s, at, piece, values, local, weight, rows)
        if not ok or not np.isfinite(rows).all():
            return _ReducedBatch.diverged_batch()
        cost += float(np.sum(rows[:, :, -1] ** 2))
        if block:
            raw.append(gram_matrices(rows, block * channels))
        triangle = triangle_of(np.concatenate([triangle, rows], axis=1))
    left, eliminated, rank = eliminate_initial_states(triangle, n)
    kept = np.zeros((0, width - n, width - n))
    if block:
        projected = project_gram_matrices(np.concatenate(raw, axis=1), eliminated)
        kept = merge_blocks(projected, block, batch.length)
    return _ReducedBatch(left, eliminated, kept, cost, rank)
