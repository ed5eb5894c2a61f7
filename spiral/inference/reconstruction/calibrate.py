"""Calibrate a model on whole records, hidden states free, before its states are reconstructed.

Where every parameter has a value to start from:

1. a filter that tracks all free parameters as states goes over the first record (it follows the
   measurement sample by sample, so a model that is 20 % off does not lose it);
2. a smoother gives hidden states to start windows from;
3. Gauss-Newton on windows of 1024 samples, then on whole records with one initial state each.

The sum of squares has more than one valley where two bearings can share a stiffness in two ways, so
the first record is fitted from the given values and from what the filter finds with little and with
much process noise; the best of the three goes on.

Where a parameter has no value, growing windows from the balance of forces, as ``compare`` does.
Machine parameters are shared by all records; a phase origin is each record's own where the phase
was not measured.

The standard errors are the Cramer-Rao bound at the estimate, sqrt diag (J^T J / sigma^2)^-1 with
the initial states projected out, for the declared noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.descent import ColumnMix, descend
from spiral.engine.filter.extended import filter_record
from spiral.engine.filter.setup import choose_levels, smoothed_states, with_level
from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import FilterInput, prepare_task, with_record
from spiral.engine.fit import WindowFit, covariance
from spiral.engine.growth import Stage, layouts_for, transfer_window_starts
from spiral.engine.sensitivities import reduce_windows
from spiral.engine.study import ORIGIN, ParameterColumns, Point
from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.admission import TOLD
from spiral.inference.evidence.assembly import (
    Assembly,
    columns_with_bounds,
    to_model,
    unknown_keys,
    with_steps,
)
from spiral.inference.evidence.comparison import last_stage, prepare_study, standard_errors
from spiral.inference.evidence.fit_state import FitState, all_samples
from spiral.inference.problem import Problem, Progress, silent
from spiral.types.model import Model
from spiral.types.record import Array

# Process noise of the passes that track the parameters, for each start that is tried.
_LEVELS: tuple[tuple[float, ...], ...] = ((), (0.03, 0.003), (0.3,))
_SCAN = 0.03  # the same where one common factor is looked for
_DOUBT = 0.3  # first doubt of a parameter, as a share of its value
_TURN = 0.2  # the same of an angle, rad
_LENGTH = 1024


@dataclass(frozen=True)
class Calibration:
    """A fitted model, for each record with its own values; ``horizon`` the longest window reached.

    ``grids`` are inputs as of ``stage_inputs`` with their substeps, as the fit corrected them.
    ``untold`` are parameters whose standard error is over half their value: these records do not
    determine them. ``fitted`` is the last fit, with the covariance of its ``columns``.
    """

    models: tuple[Model, ...]
    grids: tuple[tuple[Array, int], ...]
    converged: bool
    horizon: int
    chi2_per_dof: float
    untold: tuple[str, ...] = ()
    fitted: WindowFit | None = None
    keys: tuple[str, ...] = ()
    columns: ParameterColumns | None = None

    @property
    def model(self) -> Model:
        """The model with the first record's values."""
        return self.models[0]


@one_blas_thread
def calibrate(
    problem: Problem, progress: Progress = silent, together: tuple[str, ...] = ()
) -> Calibration:
    """Fit every parameter that the problem's model lets move, on all samples of its records.

    ``together``: parameters that keep their ratios, moved by one common factor.
    """
    assembly, fit_state = prepare_study(problem, ())
    if unknown_keys(assembly, fit_state.keys(assembly)):
        progress("calibrating on growing windows, hidden states free")
        stage = last_stage(assembly, fit_state, all_samples(assembly))
    else:
        assembly, stage = _calibrate_from_filter(assembly, fit_state, progress, together)
    return _calibration_result(assembly, fit_state, stage)


def _calibrate_from_filter(
    assembly: Assembly, fit_state: FitState, progress: Progress, together: tuple[str, ...]
) -> tuple[Assembly, Stage]:
    """Start values and hidden states from filters, then windows, then whole records."""
    problem = assembly.problem
    keys = tuple(k for k in fit_state.keys(assembly) if k in assembly.study.keys)
    progress("calibrating: a filter tracks the parameters")
    given = prepare_task(problem.model, problem.records[0])
    if together:
        first = _scan_common_factor(given, together)
    else:
        alone = replace(assembly, problem=replace(problem, records=problem.records[:1]))
        starts = [_track_parameters(given, keys, levels) for levels in _LEVELS]
        tried = [_descend_windows(alone, fit_state, start, together, progress) for start in starts]
        best = min(tried, key=lambda trial: trial[1].fitted.cost)
        if len(problem.records) == 1:
            return best
        row = best[1].fitted.point.values[0]
        first = given.with_values(dict(zip(given.keys, map(float, row), strict=False)))
    return _descend_windows(assembly, fit_state, first, together, progress)


def _descend_windows(
    assembly: Assembly,
    fit_state: FitState,
    first: FilterInput,
    together: tuple[str, ...],
    progress: Progress,
) -> tuple[Assembly, Stage]:
    """Windows, then whole records, from a task's values and the smoother's hidden states."""
    problem = assembly.problem
    tasks, levels = _record_tasks(problem, first, ORIGIN in fit_state.keys(assembly))
    substeps = max(t.series.substeps for t in tasks)
    assembly = with_steps(assembly, substeps)
    study = assembly.study
    moving, bounds = columns_with_bounds(assembly, fit_state.keys(assembly))
    values = np.pad(np.stack([t.values for t in tasks]), ((0, 0), (0, study.corrections)))
    values = moving.average_shared_values(values)
    mix = _common_factor_mix(assembly, moving, values, together)
    states = [smoothed_states(task, levels)[:, : study.state_count] for task in tasks]
    longest = max(s.samples for s in study.series)
    stage: Stage | None = None
    for length in (n for n in (_LENGTH, longest) if n == longest or 4 * n <= longest):
        progress(f"calibrating on windows of {length} samples")
        layouts = layouts_for(study, length, all_samples(assembly))
        if stage is None:
            starts = tuple(x[w.starts].copy() for x, w in zip(states, layouts, strict=True))
        else:
            starts, values = (
                transfer_window_starts(study, stage, layouts),
                stage.fitted.point.values,
            )
        fitted = descend(study, layouts, Point(values, starts), moving, bounds, mix)
        stage = Stage(length, layouts, fitted)
    assert stage is not None
    return assembly, stage


def _record_tasks(
    problem: Problem, first: FilterInput, turning: bool
) -> tuple[list[FilterInput], dict[str, float]]:
    """One task for each record at the values of the first, whose process noise serves for all."""
    tuned, settings = filter_prepared(first, (ORIGIN,) if turning else None)
    levels = choose_levels(tuned, settings, None)
    tasks = [first, *(with_record(first, r) for r in problem.records[1:])]
    return [_with_own_origin(task, levels) if turning else task for task in tasks], levels


def _track_parameters(
    first: FilterInput, keys: tuple[str, ...], levels: tuple[float, ...]
) -> FilterInput:
    """Parameters tracked as states over the record, once for each level of process noise."""
    known = dict(zip(first.keys, first.values, strict=True))
    named = tuple(k for k in keys if known[k] or k == ORIGIN)
    for level in levels if named else ():
        doubt = {k: _TURN if k == ORIGIN else _DOUBT * abs(known[k]) for k in named}
        task, settings = filter_prepared(first, named, doubt)
        filter_pass = filter_record(
            task, with_level(task, settings, dict.fromkeys(_noise_groups(task), level))
        )
        last = filter_pass.means[-1, len(task.states) :]
        if filter_pass.done < task.series.samples or not np.all(np.isfinite(last)):
            break
        known |= dict(zip(named, map(float, last), strict=True))
        first = with_record(first.with_values(known), first.series.record)
    return first


def _scan_common_factor(first: FilterInput, together: tuple[str, ...]) -> FilterInput:
    """The common factor with the highest likelihood of the innovations, between 0.5 and 2."""
    from scipy.optimize import minimize_scalar

    at = [first.keys.index(k) for k in together]

    def scaled_task(log_factor: float) -> FilterInput:
        factor = float(np.exp(log_factor))
        return first.with_values({first.keys[i]: factor * first.values[i] for i in at})

    def cost(log_factor: float) -> float:
        task, settings = filter_prepared(scaled_task(log_factor))
        levels = dict.fromkeys(_noise_groups(task), _SCAN)
        filter_pass = filter_record(task, with_level(task, settings, levels))
        return -filter_pass.log_likelihood if filter_pass.done == task.series.samples else 1e12

    best = minimize_scalar(cost, bounds=(-np.log(2), np.log(2)), options={"xatol": 1e-3})
    return with_record(scaled_task(float(best.x)), first.series.record)  # type: ignore[attr-defined]


def _noise_groups(task: FilterInput) -> tuple[str, ...]:
    from spiral.engine.filter.noise import noise_groups

    return tuple(noise_groups(task))


def _with_own_origin(task: FilterInput, levels: Mapping[str, float]) -> FilterInput:
    """The task with its record's phase origin, as a filter that tracks it finds it."""
    task, settings = filter_prepared(task, (ORIGIN,))
    filter_pass = filter_record(task, with_level(task, settings, levels))
    if filter_pass.done < task.series.samples:
        return task
    return task.with_values({ORIGIN: float(filter_pass.means[-1, -1])})


def _common_factor_mix(
    assembly: Assembly, moving: ParameterColumns, values: Array, together: tuple[str, ...]
) -> ColumnMix | None:
    """One common factor for some columns; the others move alone."""
    if not together:
        return None
    study = assembly.study
    names = [study.keys[i] if i < len(study.keys) else "" for i in moving.index]
    tied = np.array([n in together for n in names])
    common = np.where(tied, moving.current(values), 0.0)
    return ColumnMix(np.column_stack([common, np.eye(len(names))[:, ~tied]]))


@one_blas_thread
def cramer_rao(problem: Problem) -> dict[str, float]:
    """Smallest standard error an unbiased fit can have, at the problem's own parameter values.

    Initial states are those of the truth where the records know it, else of a smoother.
    """
    assembly, fit_state = prepare_study(problem, ())
    tasks = [prepare_task(problem.model, r) for r in problem.records]
    substeps = max(t.series.substeps for t in tasks)
    assembly = with_steps(assembly, substeps)
    study = assembly.study
    names = study.compiled.traced.states
    starts = tuple(
        np.array([[t.series.record.truth[n][0] for n in names]])
        if all(n in t.series.record.truth for n in names)
        else smoothed_states(t)[:1, : study.state_count]
        for t in tasks
    )
    layouts = layouts_for(study, max(s.samples for s in study.series), all_samples(assembly))
    moving, _ = columns_with_bounds(assembly, fit_state.keys(assembly))
    point = Point(fit_state.values, starts)
    reduction = reduce_windows(study, layouts, point, moving)
    spread = np.sqrt(np.diag(covariance(WindowFit.from_reduction(point, reduction, True, 0))))
    return {
        study.keys[i]: float(error)
        for i, error in zip(moving.index, spread, strict=True)
        if i < len(study.keys)
    }


def _calibration_result(assembly: Assembly, fit_state: FitState, stage: Stage) -> Calibration:
    values, study = stage.fitted.point.values, assembly.study
    errors = standard_errors(assembly, fit_state, stage)
    models = tuple(
        to_model(assembly, fit_state.labels, values[r : r + 1], errors)
        for r in range(len(study.series))
    )
    return Calibration(
        models=models,
        grids=tuple((study.inputs(r, values[r]), s.substeps) for r, s in enumerate(study.series)),
        converged=stage.fitted.converged,
        horizon=int(stage.length),
        chi2_per_dof=stage.fitted.chi2_per_dof,
        untold=undetermined_parameters(models[0]),
        fitted=stage.fitted,
        keys=tuple(k for k in fit_state.keys(assembly) if k in study.keys),
        columns=columns_with_bounds(assembly, fit_state.keys(assembly))[0],
    )


def undetermined_parameters(model: Model) -> tuple[str, ...]:
    """Fitted parameters with a standard error over half their value (angles: half a radian)."""
    known = dict(model.pairs)
    return tuple(
        key
        for key, error in model.errors.items()
        if not error <= TOLD * (1.0 if known[key].unit == "rad" else abs(model.values[key]))
    )
