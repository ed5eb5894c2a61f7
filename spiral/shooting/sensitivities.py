"""One pass over the records: signatures of all columns, initial states eliminated.

Each window's rows [J_x0 | J_p | r] are reduced by QR as they are made, a bounded piece at a time,
so that memory does not grow with record length times columns. The initial state is eliminated by
a rank-revealing step (a direction of the state that the window does not show is left alone).
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from spiral.record import Array
from spiral.shooting.kernel import advance, trajectories
from spiral.shooting.series import Series
from spiral.shooting.study import Columns, Layouts, Point, Study
from spiral.shooting.windows import Layout

_PIECE = 4096  # samples in memory at a time
_RANK = 1e-9  # relative singular value under which a direction of the initial state is unseen
_THREADS = 2


@dataclass(frozen=True)
class Reduction:
    """A pass, reduced.

    ``triangle`` (columns + 1, columns + 1): R of the QR decomposition of [J_p | r] with all
    initial states projected out; ``cost`` the sum of squares of r before any step; ``samples`` the
    residuals counted; ``elimination`` per record (windows, states, columns + 1), the minimum-norm
    map with x0 step = e[:, -1] - e[:, :-1] @ step; ``blocks`` (blocks, columns + 1, columns + 1):
    Gram matrices of the projected rows, or empty.
    """

    triangle: Array
    cost: float
    samples: int
    nuisances: int
    elimination: tuple[Array, ...]
    blocks: Array

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


def reduce(
    study: Study, layouts: Layouts, point: Point, columns: Columns, block: int = 0
) -> Reduction:
    """Integrate all windows with sensitivities and reduce them.

    Parameters
    ----------
    columns : the parameters differentiated.
    block : samples in a Gram block; 0 makes none.
    """
    weights = [s.weight(layout.mask) for s, layout in zip(study.series, layouts, strict=True)]
    batches = list(_batches(layouts))

    def work(batch: _Batch) -> tuple[Array, Array, Array, float, int]:
        return _reduce_batch(study, layouts, point, columns, batch, weights[batch.record], block)

    results = _parallel(work, batches)
    width = columns.count + 1
    elimination = [np.zeros((len(x), study.state_count, width)) for x in point.starts]
    blocks: list[Array] = []
    parts: list[Array] = []
    cost, nuisances = 0.0, 0
    for batch, (rows, eliminated, grams, squares, rank) in zip(batches, results, strict=True):
        seen = np.append(columns.local(batch.record), width - 1)
        target = elimination[batch.record]
        target[np.ix_(batch.windows, np.arange(study.state_count), seen)] = eliminated
        parts.append(_scatter(rows, seen, width))
        if block:
            blocks.append(_scatter_blocks(grams, seen, width))
        cost += squares
        nuisances += rank
    samples = int(sum(np.count_nonzero(w) for w in weights))
    finite = np.isfinite(cost)
    return Reduction(
        triangle=_triangle(np.concatenate(parts)) if finite else np.zeros((width, width)),
        cost=cost if finite else np.inf,
        samples=samples,
        nuisances=nuisances,
        elimination=tuple(elimination),
        blocks=np.concatenate(blocks) if block and finite else np.zeros((0, width, width)),
    )


def residuals(study: Study, layouts: Layouts, point: Point) -> tuple[Array, ...]:
    """Weighted residuals (samples, channels) of each record; zero where nothing counts."""
    found = []
    for record, (series, layout) in enumerate(zip(study.series, layouts, strict=True)):
        states, readings = run_windows(study, record, layout, point)
        weight = series.weight(layout.mask)
        written = np.isfinite(readings) if np.isfinite(states[layout.starts]).all() else True
        with np.errstate(invalid="ignore", over="ignore"):
            found.append(np.where(written & (weight > 0), weight * (series.y - readings), 0.0))
    return tuple(found)


def run_windows(study: Study, record: int, layout: Layout, point: Point) -> tuple[Array, Array]:
    """States and readings of one record, window by window; infinite throughout on divergence."""
    series = study.series[record]
    states = np.full((series.samples, study.state_count), np.nan)
    readings = np.full_like(series.y, np.nan)
    ok = trajectories(
        study.compiled.rate_value, study.compiled.output_value,
        np.ascontiguousarray(point.starts[record]), layout.starts, layout.lengths,
        np.ascontiguousarray(point.values[record : record + 1]), series.inputs, series.substeps,
        series.dt, states, readings,
    )  # fmt: skip
    if not ok:
        states[:], readings[:] = np.inf, np.inf
    return states, readings


def _parallel(work, batches: list[_Batch]) -> list:
    if len(batches) < 2 * _THREADS:
        return [work(batch) for batch in batches]
    with ThreadPoolExecutor(_THREADS) as pool:
        return list(pool.map(work, batches))


def _batches(layouts: Layouts) -> Iterator[_Batch]:
    for record, layout in enumerate(layouts):
        for length in np.unique(layout.lengths):
            same = np.flatnonzero(layout.lengths == length)
            group = max(1, _PIECE // int(length))
            for first in range(0, len(same), group):
                yield _Batch(record, same[first : first + group], int(length))


def _advance(study, series: Series, x, s, starts, length, values, local, weight, rows) -> bool:
    return advance(
        study.compiled.rate, study.compiled.output, x, s, np.ascontiguousarray(starts), length,
        np.ascontiguousarray(values), local, series.inputs, series.substeps, series.dt, series.y,
        weight, rows,
    )  # fmt: skip


def _reduce_batch(
    study: Study, layouts: Layouts, point: Point, columns: Columns, batch: _Batch,
    weight: Array, block: int,
) -> tuple[Array, Array, Array, float, int]:  # fmt: skip
    """Rows left after elimination, the elimination, Gram blocks, cost and rank of one batch."""
    series = study.series[batch.record]
    starts = layouts[batch.record].starts[batch.windows].copy()
    local = columns.index[columns.local(batch.record)]
    n, count, channels = study.state_count, len(starts), series.y.shape[1]
    width = n + len(local) + 1
    x = point.starts[batch.record][batch.windows].copy()
    s = np.zeros((count, n, width - 1))
    s[:, :, :n] = np.eye(n)
    triangle = np.zeros((count, 0, width))
    grams: list[Array] = []
    cost = 0.0
    for first in range(0, batch.length, _PIECE):
        piece = min(_PIECE, batch.length - first)
        rows = np.empty((count, piece * channels, width))
        ok = _advance(study, series, x, s, starts + first, piece, point.values[batch.record],
                      local, weight, rows)
        if not ok or not np.isfinite(rows).all():
            empty = np.zeros((count, n, width - n))
            return np.zeros((0, width - n)), empty, np.zeros((0, width - n, width - n)), np.inf, 0
        cost += float(np.sum(rows[:, :, -1] ** 2))
        if block:
            grams.append(_grams(rows, block * channels))
        triangle = np.linalg.qr(np.concatenate([triangle, rows], axis=1), mode="r")
    left, eliminated, rank = _eliminate(triangle, n)
    projected = np.zeros((0, width - n, width - n))
    if block:
        projected = _merged(_project(np.concatenate(grams, axis=1), eliminated), block, batch)
    return left, eliminated, projected, cost, rank


def _eliminate(triangle: Array, n: int) -> tuple[Array, Array, int]:
    """Project the first n columns out of each window's triangle, as far as they have rank."""
    head, tail = triangle[:, :n, :n], triangle[:, :n, n:]
    scale = np.linalg.norm(head, axis=1, keepdims=True)
    scale[scale == 0] = 1.0
    left, values, right = np.linalg.svd(head / scale)
    seen = values > _RANK * values[:, :1]
    rotated = np.swapaxes(left, 1, 2) @ tail
    inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    eliminated = np.swapaxes(right, 1, 2) @ (inverse[:, :, None] * rotated)
    eliminated /= np.swapaxes(scale, 1, 2)
    unseen = np.where(seen[:, :, None], 0.0, rotated)
    rows = np.concatenate([unseen, triangle[:, n:, n:]], axis=1)
    return rows.reshape(-1, tail.shape[2]), eliminated, int(seen.sum())


def _grams(rows: Array, size: int) -> Array:
    """Gram matrices of consecutive groups of ``size`` rows in each window."""
    count, total, width = rows.shape
    size = min(size, total)
    whole = total // size
    cutoff = (whole - 1) * size
    body = rows[:, :cutoff].reshape(count, whole - 1, size, width)
    last = rows[:, cutoff:]  # a short rest is joined to the last group
    joined = (np.swapaxes(last, -1, -2) @ last)[:, None]
    if whole == 1:
        return joined
    return np.concatenate([np.swapaxes(body, -1, -2) @ body, joined], axis=1)


def _project(grams: Array, eliminated: Array) -> Array:
    """T^T G T with T = [-elimination; identity], for every block of every window."""
    count, _, size = eliminated.shape
    transform = np.concatenate([-eliminated, np.broadcast_to(np.eye(size), (count, size, size))], 1)
    return np.swapaxes(transform, 1, 2)[:, None] @ grams @ transform[:, None]


def _merged(grams: Array, block: int, batch: _Batch) -> Array:
    """Blocks of all windows in order; short windows are added up to whole blocks."""
    flat = grams.reshape(-1, *grams.shape[2:])
    group = max(1, block // batch.length)
    flat = flat[np.abs(flat[:, -1, -1]) > 0]
    if group == 1 or len(flat) < 2:
        return flat
    edges = np.arange(0, len(flat), group)
    return np.add.reduceat(flat, edges, axis=0)


def _scatter(rows: Array, seen: Array, width: int) -> Array:
    if len(seen) == width:
        return _triangle(rows)
    full = np.zeros((len(rows), width))
    full[:, seen] = rows
    return _triangle(full)


def _scatter_blocks(grams: Array, seen: Array, width: int) -> Array:
    if len(seen) == width:
        return grams
    full = np.zeros((len(grams), width, width))
    full[:, seen[:, None], seen[None, :]] = grams
    return full


def _triangle(rows: Array) -> Array:
    width = rows.shape[1]
    if len(rows) < width:
        rows = np.concatenate([rows, np.zeros((width - len(rows), width))])
    return np.linalg.qr(rows, mode="r")
