"""A model fitted on windows against measurements: free runs, and the statistics of what is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.fit import standard_deviations
from spiral.engine.growth import Stage
from spiral.engine.sensitivities import residuals
from spiral.engine.statistics import whiteness
from spiral.inference.evidence.assembly import (
    Assembly,
    assemble,
    columns,
    to_model,
    with_records,
    with_steps,
)
from spiral.inference.evidence.fit_state import FitState, Masks, begin, grown
from spiral.inference.evidence.horizons import unseen
from spiral.inference.evidence.judge import FreeRun, free_run, run_free, whole
from spiral.inference.problem import Problem, Progress, silent
from spiral.types.effect import Effect
from spiral.types.model import Model
from spiral.types.noise import estimate_noise
from spiral.types.record import Record
from spiral.types.run import Comparison

_SETTLE = 0.1  # share of a test record that settles its nuisances, where no time is given
_STEP = 0.3  # largest phase advance per integration step, rad


def prepared(
    problem: Problem, candidates: tuple[Effect, ...] | None = None
) -> tuple[Assembly, FitState]:
    """The problem assembled with its first standing, steps fine enough for its fastest mode."""
    if candidates is not None:
        problem = replace(problem, candidates=candidates)
    assembly = assemble(problem)
    standing = begin(assembly, problem.model.labels)
    return refined(assembly, standing), standing


def refined(assembly: Assembly, standing: FitState) -> Assembly:
    """The same study with steps fine enough for the fastest mode of a standing."""
    substeps = substeps_for(assembly, standing.values[0])
    return assembly if substeps <= 1 else with_steps(assembly, substeps)


def substeps_for(assembly: Assembly, row: np.ndarray) -> int:
    """Steps per sample that keep |eigenvalue| dt below 0.3 at rest, at the largest inputs."""
    study = assembly.study
    n, count = study.state_count, len(study.keys)
    a, b = np.zeros((n, n)), np.zeros((n, count))
    fastest = 0.0
    for series in study.series:
        size = np.abs(series.inputs).max(axis=0) if series.inputs.size else np.zeros(0)
        study.compiled.rate(np.full(n, 1e-12), size, np.ascontiguousarray(row), np.empty(n), a, b)
        if np.all(np.isfinite(a)):
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(a)).max()) * series.dt)
    return int(np.clip(np.ceil(fastest / _STEP), 1, 32))


def last_stage(
    assembly: Assembly, standing: FitState, masks: Masks, lengths: list[int] | None = None
) -> Stage:
    """The longest windows whose fit converged (the first, converged or not, if none did)."""
    kept: Stage | None = None
    for stage in grown(assembly, standing, masks, lengths):
        if kept is None or stage.fitted.converged:
            kept = stage
    assert kept is not None
    return kept


def standard_errors(assembly: Assembly, standing: FitState, stage: Stage) -> dict[str, float]:
    """Standard error of every fitted parameter, inflated where chi2 per dof is above 1."""
    moving, _ = columns(assembly, standing.keys(assembly))
    if stage.fitted.reduction is None:
        return {}
    spread = standard_deviations(stage.fitted) * np.sqrt(max(stage.fitted.chi2_per_dof, 1.0))
    errors: dict[str, float] = {}
    for i, position in enumerate(moving.index):
        if position >= len(assembly.study.keys):
            continue
        errors.setdefault(assembly.study.keys[position], float(spread[i]))
    return errors


def fitted_model(assembly: Assembly, standing: FitState, stage: Stage) -> Model:
    """The model of a standing with a stage's values and their standard errors."""
    values, errors = stage.fitted.point.values, standard_errors(assembly, standing, stage)
    return to_model(assembly, standing.labels, values, errors, standing.freed, standing.held)


def judged(
    assembly: Assembly, standing: FitState, stage: Stage, progress: Progress = silent
) -> Comparison:
    """The comparison of a fitted standing: free runs, chi2 and whiteness on all samples."""
    fitted = replace(standing, values=stage.fitted.point.values)
    model = fitted_model(assembly, standing, stage)
    return compared(assembly, fitted, model, stage.length, stage.fitted.converged, progress)


def compared(
    assembly: Assembly,
    standing: FitState,
    model: Model,
    longest: int | None,
    converged: bool,
    progress: Progress = silent,
) -> Comparison:
    """The comparison of a model whose parameters stand: only records' own nuisances are fitted.

    ``longest`` limits the windows on which chi2 and whiteness are taken.
    """
    problem = assembly.problem
    labels, values = standing.labels, standing.values
    progress("free run on the test record")
    full = whole(assembly, labels, values, longest)
    left = residuals(assembly.study, full.layouts, full.fitted.point)
    names = problem.model.system.observed
    records = tuple(0 for _ in problem.records)
    own = run_free(assembly, full, records).errors(names)
    other = with_test(assembly, values)
    run = None if other is None else _free(other, labels, values)
    channels = run.errors(names) if run is not None else own
    white = whiteness(left, problem.settings.lags)
    return Comparison(
        model=model,
        fit_error=float(np.mean([e.relative for e in own.values()])),
        test_error=float(np.mean([e.relative for e in channels.values()])),
        channels=channels,
        noise_floor=_noise_floor(problem.test or problem.records, model, run),
        chi2_per_dof=_per_dof(assembly, standing, full),
        whiteness_p=white.p,
        whiteness_effect=white.effect,
        horizon=int(full.length),
        converged=converged,
        notes=tuple(n for r in problem.records for n in r.remarks),
        spoilt=tuple(n for r in problem.records for n in r.spoilt_words),
        noise_ratio=stated_ratio(problem.records),
        unseen=() if other is None or run is None
        else unseen(assembly, other, model, labels, values, run),
    )  # fmt: skip


def chi2_on(assembly: Assembly, standing: FitState, length: int) -> float:
    """Chi2 per degree of freedom on windows of a length; infinite where they run away."""
    full = whole(assembly, standing.labels, standing.values, length)
    return _per_dof(assembly, standing, full) if full.length == length else float("inf")


def _per_dof(assembly: Assembly, standing: FitState, full: Stage) -> float:
    dof = full.fitted.samples - full.fitted.nuisances - len(standing.keys(assembly))
    return full.fitted.cost / max(dof, 1)


def test_run(assembly: Assembly, labels: tuple[str, ...], values: np.ndarray) -> FreeRun | None:
    """Free run on the test records, or nothing where there are none."""
    other = with_test(assembly, values)
    return None if other is None else _free(other, labels, values)


def with_test(assembly: Assembly, values: np.ndarray) -> Assembly | None:
    """The study with the test records in place of the fitted ones, steps fine enough for them."""
    problem = assembly.problem
    if not problem.test:
        return None
    other = with_records(assembly, problem.test, 1)
    substeps = max(substeps_for(other, values[0]), assembly.study.series[0].substeps)
    return other if substeps <= 1 else with_records(assembly, problem.test, substeps)


def _free(other: Assembly, labels: tuple[str, ...], values: np.ndarray) -> FreeRun:
    """Free run on the records of a study that is at the test records."""
    return free_run(other, labels, values, settling(other))


def settling(other: Assembly) -> float:
    """Seconds of each test record that fix its own nuisances."""
    settle = other.problem.settle
    return _SETTLE * min(r.samples * r.dt for r in other.problem.test) if settle is None else settle


def stated_ratio(records: tuple[Record, ...]) -> float | None:
    """Noise that the records show without a model over what they declare, rms over channels."""
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
