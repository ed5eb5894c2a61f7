"""Windows that grow: 64 -> 256 -> 1024 -> whole record, each stage started from the last."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.fit import WindowFit, fit
from spiral.engine.sensitivities import drive_effect_states, run_windows
from spiral.engine.start import smoothed_motion
from spiral.engine.study import CompiledStudy, Layouts, ParameterColumns, Point
from spiral.engine.windows import cut_windows, stage_lengths
from spiral.types.record import Array

_RUNAWAY = 100.0
_FIRM = 10.0  # noise standard deviations that a parameter's whole value must be worth


@dataclass(frozen=True)
class Stage:
    """One window length with its windows and its fit; ``length`` is the longest window."""

    length: int
    layouts: Layouts
    fitted: WindowFit


def layouts_for(study: CompiledStudy, length: int, masks: tuple[Array | None, ...]) -> Layouts:
    """Windows of one length in every record."""
    return tuple(
        cut_windows(s.samples, length, m) for s, m in zip(study.series, masks, strict=True)
    )


def lengths_for(study: CompiledStudy, block: int) -> list[int]:
    """Stage lengths for the longest record."""
    return stage_lengths(max(s.samples for s in study.series), block)


def first_starts(
    study: CompiledStudy, layouts: Layouts, values: Array, window: int = 11
) -> tuple[Array, ...]:
    """Window starts from local polynomials; hidden coordinates begin at zero.

    States that effects bring are driven by that motion along the record: while the amplitude is
    zero nothing else tells where they stand.
    """
    rows = zip(study.series, layouts, strict=True)
    return tuple(
        drive_effect_states(
            study, record, smoothed_motion(study, series, window).states, values[record]
        )[layout.starts]
        for record, (series, layout) in enumerate(rows)
    )


def transfer_window_starts(
    study: CompiledStudy, stage: Stage, layouts: Layouts
) -> tuple[Array, ...]:
    """States of a stage's fitted windows at the samples where other windows begin.

    A sample before the stage's first window takes the state that window starts with.
    """
    starts = []
    for record, (layout, old) in enumerate(zip(layouts, stage.layouts, strict=True)):
        reach = np.diff(np.append(old.starts, study.series[record].samples))
        covering = replace(old, lengths=np.maximum(reach, old.lengths))
        states, _ = run_windows(study, record, covering, stage.fitted.point)
        starts.append(states[np.maximum(layout.starts, old.starts[0])])
    return tuple(starts)


def _has_run_away(before: WindowFit, after: WindowFit, columns: ParameterColumns) -> bool:
    """Whether a parameter that was well determined has moved by a factor of a hundred.

    A model that cannot follow long windows may flee to where its input no longer matters (an
    infinite mass); there the cost is flat and looks converged.
    """
    if before.reduction is None:
        return False
    old, new = (columns.current(f.point.values) for f in (before, after))
    norms = np.linalg.norm(before.reduction.triangle[:-1, :-1], axis=0)
    firm = norms * np.abs(old) > _FIRM
    return bool(np.any(np.abs(new[firm]) > _RUNAWAY * np.abs(old[firm])))


def grow_windows(
    study: CompiledStudy,
    values: Array,
    columns: ParameterColumns,
    bounds: tuple[Array, Array],
    masks: tuple[Array | None, ...],
    lengths: list[int],
    patient: bool = False,
    first: tuple[ParameterColumns, tuple[Array, Array]] | None = None,
    stage: Stage | None = None,
) -> Iterator[Stage]:
    """Yield a stage for each window length, as long as the fits converge.

    The caller may stop taking stages; the last stage that converged is where the model stands.
    A stage that does not converge is yielded too (its ``fitted.converged`` is false) and ends it,
    unless ``patient`` and the model stayed finite. ``first`` are columns that alone move, beside
    the window starts, before all others do. ``stage`` is one of shorter windows to go on from.
    """
    for length in lengths:
        layouts = layouts_for(study, length, masks)
        if stage is None:
            starts = first_starts(study, layouts, values)
            if first is not None:
                starts = fit(study, layouts, Point(values, starts), *first).point.starts
        else:
            starts = transfer_window_starts(study, stage, layouts)
            values = stage.fitted.point.values
        fitted = fit(study, layouts, Point(values, starts), columns, bounds)
        if stage is not None and _has_run_away(stage.fitted, fitted, columns):
            fitted = replace(fitted, converged=False)
        stage = Stage(length, layouts, fitted)
        yield stage
        if not fitted.converged and not (patient and np.isfinite(fitted.cost)):
            return
