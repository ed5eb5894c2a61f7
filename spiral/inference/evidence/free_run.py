"""Free runs: the model integrated over a record, only its initial state and phase fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.fit import WindowFit, fit
from spiral.engine.growth import (
    Stage,
    first_starts,
    grow_windows,
    layouts_for,
    lengths_for,
    transfer_window_starts,
)
from spiral.engine.sensitivities import reduce_windows, residuals, run_windows
from spiral.engine.study import ORIGIN, Point
from spiral.engine.windows import cut_windows
from spiral.inference.evidence.assembly import (
    Assembly,
    columns_with_bounds,
    nuisance_keys,
    with_records,
)
from spiral.types.record import Array
from spiral.types.run import ChannelError

_ORIGINS = 8  # phase origins tried for a record whose own is not known


@dataclass(frozen=True)
class FreeRun:
    """A prediction that never looked at the channels after its settling time.

    Arrays (samples, channels) for each record; ``settled`` is the first sample scored; ``seen``
    is False where a reading is no measurement, or nothing where all are.
    """

    predicted: tuple[Array, ...]
    measured: tuple[Array, ...]
    settled: tuple[int, ...]
    values: Array
    seen: tuple[Array | None, ...]

    def errors(self, names: tuple[str, ...]) -> dict[str, ChannelError]:
        """Error of each channel over all records, relative to its standard deviation."""
        by_channel = {}
        for j, (name, spread) in enumerate(zip(names, self.deviations(), strict=True)):
            miss = np.concatenate([m[:, j] for m in self.misses()])
            with np.errstate(over="ignore", invalid="ignore"):
                rmse = float(np.sqrt(np.nanmean(miss**2))) if np.isfinite(miss).any() else np.inf
            rmse = rmse if np.isfinite(rmse) else np.inf
            by_channel[name] = ChannelError(rmse, rmse / float(spread) if spread > 0 else np.inf)
        return by_channel

    def deviations(self) -> Array:
        """(channels,) standard deviation of what is scored, each record about its own mean."""
        parts = [m[s:] for m, s in zip(self.measured, self.settled, strict=True)]
        about = np.concatenate([part - part.mean(axis=0) for part in parts])
        return np.sqrt(np.mean(about**2, axis=0))

    def is_lost(self, record: int) -> bool:
        """Whether a record's run errs by more than all the motion of a channel."""
        miss = self.misses()[record]
        with np.errstate(all="ignore"):
            off = np.sqrt(np.nanmean(miss**2, axis=0))
        return not bool(np.all(off < self.deviations()))

    def misses(self) -> tuple[Array, ...]:
        """(samples, channels) predicted less measured, of what is scored; NaN where nothing is."""
        parts = zip(self.predicted, self.measured, self.settled, self.seen, strict=True)
        misses = []
        for predicted, measured, first, seen in parts:
            left = np.nan_to_num(predicted, nan=np.inf) - measured
            misses.append((left if seen is None else np.where(seen, left, np.nan))[first:])
        return tuple(misses)


def fit_held_out(
    assembly: Assembly, labels: tuple[str, ...], stage: Stage, masks: tuple[Array | None, ...]
) -> tuple[WindowFit, tuple[Array, ...]]:
    """Residuals on other samples of the fitted records, at the stage's window length."""
    study = assembly.study
    layouts = layouts_for(study, stage.length, masks)
    point = Point(stage.fitted.point.values, transfer_window_starts(study, stage, layouts))
    moving, bounds = columns_with_bounds(assembly, nuisance_keys(assembly, labels))
    fitted = fit(study, layouts, point, moving, bounds, iterations=8)
    return fitted, residuals(study, layouts, fitted.point)


def fit_whole_records(
    assembly: Assembly,
    labels: tuple[str, ...],
    values: Array,
    longest: int | None = None,
    any_origin: bool = False,
    beside: tuple[str, ...] = (),
) -> Stage:
    """Fit only nuisances to whole records, by growing windows; the last stage reached.

    ``any_origin``: the phase origin may lie anywhere, so eight around the circle are tried.
    ``beside`` : further parameters that move.
    """
    study = assembly.study
    nuisances = nuisance_keys(assembly, labels)
    moving, bounds = columns_with_bounds(assembly, (*nuisances, *beside))
    block = min(64, min(s.samples for s in study.series))
    lengths = [n for n in lengths_for(study, block) if longest is None or n <= longest]
    lengths = lengths or [longest or block]
    masks: tuple[Array | None, ...] = (None,) * len(study.series)
    if any_origin and ORIGIN in nuisances:
        values = _best_phase_origins(assembly, values, lengths, masks)
    last: Stage | None = None
    for stage in grow_windows(study, values, moving, bounds, masks, lengths, patient=True):
        if last is None or np.isfinite(stage.fitted.cost):
            last = stage
    assert last is not None
    return last


def _best_phase_origins(
    assembly: Assembly, values: Array, lengths: list[int], masks: tuple[Array | None, ...]
) -> Array:
    """Each record's phase origin to start from: the present one, or the best of eight turns."""
    study = assembly.study
    position = study.index(ORIGIN)
    layouts = layouts_for(study, lengths[min(1, len(lengths) - 1)], masks)
    none, _ = columns_with_bounds(assembly, ())
    starts = first_starts(study, layouts, values)
    best = values.copy()
    for record, series in enumerate(study.series):
        alone = replace(study, series=(series,))
        lowest = np.inf
        for turn in range(_ORIGINS):
            trial = values[record : record + 1].copy()
            trial[:, position] += 2 * np.pi * turn / _ORIGINS
            point = Point(trial, (starts[record],))
            reduction = reduce_windows(alone, (layouts[record],), point, none)
            cost = float(reduction.triangle[-1, -1] ** 2) if reduction.finite else np.inf
            if cost < 0.98 * lowest:
                best[record], lowest = trial[0], cost
    return best


def settled_free_run(
    assembly: Assembly, labels: tuple[str, ...], values: Array, settle: float | None = None
) -> FreeRun:
    """Free run on records: nuisances from the first ``settle`` seconds (all, where None)."""
    study = assembly.study
    if settle is None:
        settled, heads = (0,) * len(study.series), assembly
    else:
        settled = tuple(min(round(settle / s.dt), s.samples // 2) for s in study.series)
        parts = tuple(
            s.record.stretch(0, max(n, 16)) for s, n in zip(study.series, settled, strict=True)
        )
        heads = with_records(assembly, parts, study.series[0].substeps)
    rows = np.repeat(values[:1], len(study.series), axis=0)
    stage = fit_whole_records(heads, labels, rows, any_origin=settle is not None)
    return free_run_from_stage(assembly, stage, settled)


def free_run_from_stage(assembly: Assembly, stage: Stage, settled: tuple[int, ...]) -> FreeRun:
    """Integrate every record from the first window's start of a stage to its end."""
    study = assembly.study
    starts = tuple(x[:1] for x in stage.fitted.point.starts)
    point = Point(stage.fitted.point.values, starts)
    predicted = tuple(
        run_windows(study, r, cut_windows(s.samples, s.samples), point)[1]
        for r, s in enumerate(study.series)
    )
    return FreeRun(
        predicted, tuple(s.y for s in study.series), settled, point.values,
        tuple(s.seen for s in study.series),
    )  # fmt: skip
