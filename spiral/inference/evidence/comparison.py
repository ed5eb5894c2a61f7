"""A model fitted on windows against measurements: free runs, and the statistics of what is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.fit import covariance, standard_deviations
from spiral.engine.growth import Stage
from spiral.engine.resting import resting_jacobian, steps_for_stability
from spiral.engine.sensitivities import residuals
from spiral.engine.series import steps_per_sample
from spiral.engine.statistics import whiteness
from spiral.inference.evidence.assembly import (
    Assembly,
    assemble,
    columns_with_bounds,
    to_model,
    with_records,
    with_steps,
)
from spiral.inference.evidence.fit_state import (
    FitState,
    Masks,
    fit_growing_windows,
    initial_fit_state,
)
from spiral.inference.evidence.free_run import (
    FreeRun,
    fit_whole_records,
    free_run_from_stage,
    settled_free_run,
)
from spiral.inference.evidence.horizons import errors_on_unseen_records
from spiral.inference.problem import Problem, Progress, silent
from spiral.types.effect import Effect
from spiral.types.model import Model, correlations_by_name
from spiral.types.noise import estimate_noise
from spiral.types.record import Record
from spiral.types.run import Comparison

_SETTLE = 0.1  # share of a test record that settles its nuisances, where no time is given


def prepare_study(
    problem: Problem, candidates: tuple[Effect, ...] | None = None
) -> tuple[Assembly, FitState]:
    """The compiled problem and its first fit state, steps fine enough for its fastest mode."""
    if candidates is not None:
        problem = replace(problem, candidates=candidates)
    assembly = assemble(problem)
    fit_state = initial_fit_state(assembly, problem.model.labels)
    return refine_substeps(assembly, fit_state), fit_state


def refine_substeps(assembly: Assembly, fit_state: FitState) -> Assembly:
    """The same study with steps fine enough for the fastest mode of a fit state."""
    substeps = substeps_for(assembly, fit_state.values[0])
    return assembly if substeps <= 1 else with_steps(assembly, substeps)


def substeps_for(assembly: Assembly, row: np.ndarray) -> int:
    """Steps per sample for the fastest mode at rest, at the largest inputs, and for stability."""
    compiled, exact_to, steps = assembly.study.compiled, assembly.problem.model.system.exact_to, 1
    for series in assembly.study.series:
        modes = np.linalg.eigvals(resting_jacobian(compiled, row, series))
        steps = max(
            steps,
            steps_per_sample(modes, series.dt, exact_to),
            steps_for_stability(compiled, row, series),
        )
    return steps


def last_stage(
    assembly: Assembly, fit_state: FitState, masks: Masks, lengths: list[int] | None = None
) -> Stage:
    """The longest windows whose fit converged (the first, converged or not, if none did)."""
    kept: Stage | None = None
    for stage in fit_growing_windows(assembly, fit_state, masks, lengths):
        if kept is None or stage.fitted.converged:
            kept = stage
    assert kept is not None
    return kept


def standard_errors(assembly: Assembly, fit_state: FitState, stage: Stage) -> dict[str, float]:
    """Standard error of every fitted parameter, inflated where chi2 per dof is above 1."""
    if stage.fitted.reduction is None:
        return {}
    spread = standard_deviations(stage.fitted) * np.sqrt(max(stage.fitted.chi2_per_dof, 1.0))
    return {k: float(spread[i]) for k, i in _first_columns(assembly, fit_state).items()}


def fitted_model(assembly: Assembly, fit_state: FitState, stage: Stage) -> Model:
    """The model of a fit state with a stage's values and their standard errors."""
    values, errors = stage.fitted.point.values, standard_errors(assembly, fit_state, stage)
    return to_model(
        assembly, fit_state.labels, values, errors, fit_state.freed, fit_state.held,
        _error_correlations(assembly, fit_state, stage) if errors else {},
    )  # fmt: skip


def _error_correlations(
    assembly: Assembly, fit_state: FitState, stage: Stage
) -> dict[str, dict[str, float]]:
    """Correlations of the standard errors."""
    first = _first_columns(assembly, fit_state)
    columns = list(first.values())
    return correlations_by_name(tuple(first), covariance(stage.fitted)[np.ix_(columns, columns)])


def _first_columns(assembly: Assembly, fit_state: FitState) -> dict[str, int]:
    """The column of every fitted parameter; of a record's own parameters that of the first."""
    moving, _ = columns_with_bounds(assembly, fit_state.keys(assembly))
    first: dict[str, int] = {}
    for column, position in enumerate(moving.index):
        if position < len(assembly.study.keys):
            first.setdefault(assembly.study.keys[position], column)
    return first


def compare_fit(
    assembly: Assembly, fit_state: FitState, stage: Stage, progress: Progress = silent
) -> Comparison:
    """The comparison of a stage's fit: free runs, chi2 and whiteness on all samples."""
    fitted = replace(fit_state, values=stage.fitted.point.values)
    model = fitted_model(assembly, fit_state, stage)
    return compare_fitted_model(
        assembly, fitted, model, stage.length, stage.fitted.converged, progress
    )


def compare_fitted_model(
    assembly: Assembly,
    fit_state: FitState,
    model: Model,
    longest: int | None,
    converged: bool,
    progress: Progress = silent,
) -> Comparison:
    """The comparison of a model with fixed parameters: only each record's nuisances are fitted.

    ``longest`` limits the windows on which chi2 and whiteness are taken.
    """
    problem = assembly.problem
    labels, values = fit_state.labels, fit_state.values
    progress("free run on the test record")
    full = fit_whole_records(assembly, labels, values, longest)
    left = residuals(assembly.study, full.layouts, full.fitted.point)
    names = problem.model.system.observed
    records = tuple(0 for _ in problem.records)
    own = free_run_from_stage(assembly, full, records).errors(names)
    other = with_test_records(assembly, values)
    run = None if other is None else _run_test_records(other, labels, values)
    channels = run.errors(names) if run is not None else own
    white = whiteness(left, problem.settings.lags)
    return Comparison(
        model=model,
        fit_error=float(np.mean([e.relative for e in own.values()])),
        test_error=float(np.mean([e.relative for e in channels.values()])),
        channels=channels,
        noise_floor=_noise_floor(problem.test or problem.records, model, run),
        chi2_per_dof=_chi2_per_dof(assembly, fit_state, full),
        whiteness_p=white.p,
        whiteness_effect=white.effect,
        horizon=int(full.length),
        converged=converged,
        notes=tuple(n for r in problem.records for n in r.remarks),
        spoilt=problem.spoilt_sentences(),
        noise_ratio=noise_over_declared(problem.records),
        unseen=() if other is None or run is None
        else errors_on_unseen_records(assembly, other, model, labels, values, run),
    )  # fmt: skip


def chi2_on_windows(assembly: Assembly, fit_state: FitState, length: int) -> float:
    """Chi2 per degree of freedom on windows of a length; infinite where they run away."""
    full = fit_whole_records(assembly, fit_state.labels, fit_state.values, length)
    return _chi2_per_dof(assembly, fit_state, full) if full.length == length else float("inf")


def _chi2_per_dof(assembly: Assembly, fit_state: FitState, full: Stage) -> float:
    dof = full.fitted.samples - full.fitted.nuisances - len(fit_state.keys(assembly))
    return full.fitted.cost / max(dof, 1)


def free_run_on_test(
    assembly: Assembly, labels: tuple[str, ...], values: np.ndarray
) -> FreeRun | None:
    """Free run on the test records, or nothing where there are none."""
    other = with_test_records(assembly, values)
    return None if other is None else _run_test_records(other, labels, values)


def with_test_records(assembly: Assembly, values: np.ndarray) -> Assembly | None:
    """The study with the test records in place of the fitted ones, steps fine enough for them."""
    problem = assembly.problem
    if not problem.test:
        return None
    other = with_records(assembly, problem.test, 1)
    substeps = max(substeps_for(other, values[0]), assembly.study.series[0].substeps)
    return other if substeps <= 1 else with_records(assembly, problem.test, substeps)


def _run_test_records(other: Assembly, labels: tuple[str, ...], values: np.ndarray) -> FreeRun:
    """Free run on a study whose records are the test records, settled at their beginning."""
    return settled_free_run(other, labels, values, settling_seconds(other))


def settling_seconds(other: Assembly) -> float:
    """Seconds of each test record that fix its own nuisances."""
    settle = other.problem.settle
    return _SETTLE * min(r.samples * r.dt for r in other.problem.test) if settle is None else settle


def noise_over_declared(records: tuple[Record, ...]) -> float | None:
    """Noise estimated from the signal alone over the declared noise, rms over channels."""
    ratios = [
        estimate_noise(r.reading(name)) / declared
        for r in records
        for name, declared in r.noise.items()
        if declared
    ]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def _noise_floor(records: tuple[Record, ...], model: Model, run: FreeRun | None) -> float:
    """Noise over standard deviation, mean over channels: the error of a perfect model."""
    shares = []
    for name in model.system.observed:
        noise = np.mean([r.sigma()[name] ** 2 for r in records])
        first = run.settled if run is not None else (0,) * len(records)
        spread = np.mean(
            [np.var(r.channels[name][s:]) for r, s in zip(records, first, strict=True)]
        )
        shares.append(np.sqrt(noise / spread))
    return float(np.mean(shares))
