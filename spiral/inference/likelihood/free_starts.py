"""Where free runs begin: by the head of a record, around where the first fitted record was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.filter.setup import smoothed
from spiral.engine.filter.task import Task
from spiral.engine.fit import fit
from spiral.engine.growth import Stage, layouts_for
from spiral.engine.likelihood.fit import Maximum
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import predicted
from spiral.engine.study import Point
from spiral.inference.evidence.assembly import Assembly, columns, nuisance_keys, with_records
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.horizons import doubts, task_for
from spiral.inference.evidence.judge import FreeRun, run_free
from spiral.inference.likelihood.beginnings import begun_near
from spiral.inference.likelihood.fitting import force_levels
from spiral.types.model import Model
from spiral.types.record import Array

_STEPS = 8  # of least squares that refine a start
_SHORTEST = 16  # samples of a settling part


def free_runs(
    assembly: Assembly, state: FitState, model: Model, settle: float | None, usual: Array | None
) -> tuple[FreeRun, tuple[Array, ...]]:
    """Free runs over the records of a study, and the states (1, n) that they begin with.

    ``settle`` seconds tell where each begins, looked for around ``usual`` states.
    """
    series = assembly.study.series
    settled = tuple(
        0 if settle is None else min(max(round(settle / s.dt), _SHORTEST), s.samples // 2)
        for s in series
    )
    heads = assembly
    if settle is not None:
        parts = tuple(
            replace(s.record.part(0, n, s.record.name), noise=s.record.sigma())
            for s, n in zip(series, settled, strict=True)
        )
        heads = with_records(assembly, parts, series[0].substeps)
    rows = state.values if settle is None else np.repeat(state.values[:1], len(series), axis=0)
    starts, values = [], rows.copy()
    followed = nuisances(assembly, state, model)
    for r, head in enumerate(heads.study.series):
        task = task_for(heads, model, rows[r], head.record, head.substeps)
        if usual is not None and len(usual) == len(task.states):
            task = replace(task, start=np.where(np.isnan(usual), task.start, usual))
        if settle is None and state.starts is not None:
            task = replace(task, start=state.starts[r])
        if not followed and state.noise is not None:
            task = begun_near(task, state.noise)
        means = _smoothed(task, state.noise, followed, settle is not None)
        starts.append(means[0][None, : len(task.states)].copy())
        for place, key in enumerate(followed):
            values[r, task.keys.index(key)] = means[-1, len(task.states) + place]
    begun, refined = _refined(heads, state, Point(values, tuple(starts)))
    run = run_free(assembly, refined, settled)
    if refined is not begun and not all(np.isfinite(p).all() for p in run.predicted):
        refined, run = begun, run_free(assembly, begun, settled)
    return run, refined.fitted.point.starts


def usual_states(estimate: Maximum) -> Array | None:
    """(n,) where hidden states are on average over the first fitted record; nan for measured ones.

    A filter that begins at zero (a substrate that is not there) may be led to where the model has
    no future.
    """
    task, settings = estimate.prepared[0]
    run = predicted(task, settings, estimate.noise, keep=True)
    if not run.whole:
        return None
    means = run.means[:, : len(task.states)].mean(axis=0)
    return np.where([n in task.compiled.traced.channels for n in task.states], np.nan, means)


def _smoothed(
    task: Task, noise: NoiseModel | None, tracked: tuple[str, ...], anywhere: bool
) -> Array:
    """(samples, states and tracked parameters) by all of the record.

    Where nothing is known of the record yet its phase origin is looked for all around.
    """
    levels = None if noise is None else force_levels(noise)
    given = {} if anywhere else doubts(tracked)
    return smoothed(task, levels, tracked, given)


def _refined(heads: Assembly, state: FitState, point: Point) -> tuple[Stage, Stage]:
    """Starts and nuisances as they are, and by least squares over whole heads if that is better.

    A head that hardly tells a hidden state may have one from where the model has no future.
    """
    study = heads.study
    whole = max(s.samples for s in study.series)
    layouts = layouts_for(study, whole, (None,) * len(study.series))
    moving, bounds = columns(heads, nuisance_keys(heads, state.labels))
    with np.errstate(all="ignore"):
        begun = fit(study, layouts, point, moving, bounds, iterations=0)
        found = fit(study, layouts, point, moving, bounds, iterations=_STEPS)
    as_it_is = Stage(whole, layouts, begun)
    return as_it_is, Stage(whole, layouts, found) if found.cost <= begun.cost else as_it_is


def nuisances(assembly: Assembly, state: FitState, model: Model) -> tuple[str, ...]:
    """Parameters that belong to a record and that a filter follows."""
    known = dict(model.pairs)
    return tuple(k for k in nuisance_keys(assembly, state.labels) if k in known)
