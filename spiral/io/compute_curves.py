"""Computes the series of the figures.

The union of the compared models is compiled, and initial states and phases are fitted again (not
the parameters). ``spiral.io.curves`` saves the series for the report.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.resting import state_jacobian
from spiral.engine.sensitivities import residuals
from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.assembly import (
    Assembly,
    assemble,
    initial_values,
    to_model,
    with_model_values,
)
from spiral.inference.evidence.comparison import free_run_on_test, refine_substeps
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.free_run import fit_whole_records, free_run_from_stage
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.where.latent import LatentForce, add_latent_force, smoothed_states
from spiral.inference.where.regions import WorstRecord, locate_failure, worst_record_failure
from spiral.inference.where.surface import rank_force_shapes
from spiral.io.curves import FINAL, INPUT, Curves
from spiral.physics.couplings import couplings_of
from spiral.physics.passivity import implausible_signs
from spiral.types.label import owner_of
from spiral.types.model import Model
from spiral.types.record import Array, Record
from spiral.types.run import Comparison, Traces

_RECORDS = 3  # of each part, that are kept
_SPEEDS = 41
_FORMAT = 1


@one_blas_thread
def gather_curves(
    problem: Problem, comparisons: Mapping[str, Comparison], progress: Progress = silent
) -> Curves:
    """All series that figures need, of the models of these comparisons.

    Only initial states and phases of the records are estimated again; parameters are kept.
    """
    wide = _union_model(problem.model, [c.model for c in comparisons.values()])
    final = list(comparisons)[-1]
    asked = problem.running(comparisons[final].between)
    whole = replace(asked, model=wide, candidates=())
    progress("curves for the report")
    assembly = assemble(whole)
    kept: dict[str, Array] = {}
    about: dict[str, Any] = {}
    for name, comparison in comparisons.items():
        narrow = replace(assembly, problem=replace(whole, model=comparison.model))
        values = _zero_absent_amplitudes(narrow, initial_values(narrow), comparison.model)
        narrow = refine_substeps(narrow, FitState(comparison.model.labels, values))
        stage = _fit_nuisances(
            narrow, comparison.model.labels, comparison.model, values, comparison.horizon
        )
        about[name] = _free_curves(kept, narrow, comparison, comparison.model.labels, stage, name)
        about[name] |= _where_curves(kept, narrow, stage, name, wide)
        if name == final:
            about["modes"] = _mode_curves(kept, narrow, stage)
    return _assemble_curves(kept, about, problem, comparisons[final].model)


@one_blas_thread
def free_curves(
    assembly: Assembly, name: str, fit_state: FitState, comparison: Comparison
) -> Curves:
    """Free runs, residuals and modes of one model, with a study's compiled equations.

    They need no missing force and can be drawn at once, before ``gather_curves`` does the rest.
    """
    kept: dict[str, Array] = {}
    values = with_model_values(assembly, fit_state.labels, fit_state.values, comparison.model)
    stage = _fit_nuisances(assembly, fit_state.labels, comparison.model, values, comparison.horizon)
    labels = fit_state.labels
    about: dict[str, Any] = {name: _free_curves(kept, assembly, comparison, labels, stage, name)}
    about["modes"] = _mode_curves(kept, assembly, stage)
    return _assemble_curves(kept, about, assembly.problem, comparison.model, equation=False)


def _assemble_curves(
    kept: dict[str, Array], about: dict[str, Any], problem: Problem, model: Model,
    equation: bool = True,
) -> Curves:  # fmt: skip
    """Curves with their records and all that is said of them."""
    records = _record_curves(kept, problem)
    tests = [a.pop("settled") for a in about.values() if isinstance(a, dict) and "settled" in a]
    for record in records:
        record["settled"] = tests[0] if record["part"] == "test" and tests else 0
    return Curves(_curves_meta(problem, records, about, model, equation), kept)


def _union_model(model: Model, models: list[Model]) -> Model:
    """One model with the effects of all models and an unknown force, so that it compiles once."""
    effects = {e.label: e for m in reversed(models) for e in m.effects}
    bare = Model(model.system, tuple(effects.values()))
    zero = {k: p.start or 0.0 for k, p in bare.pairs}
    for key, parameter in bare.pairs:
        if parameter.role == "shape":
            zero[key] = next((m.values[key] for m in models if key in m.values), zero[key] or 1.0)
        elif not key.startswith("system."):
            zero[key] = 0.0
    return add_latent_force(replace(bare, values=zero))


def _zero_absent_amplitudes(assembly: Assembly, row: Array, model: Model) -> Array:
    """Amplitudes of effects that a model does not have are zero."""
    traced = assembly.study.compiled.traced
    for at, (key, parameter) in enumerate(zip(traced.keys, traced.parameters, strict=True)):
        if key in model.values or key.startswith("system."):
            continue
        row[:, at] = 1.0 if parameter.role == "shape" else 0.0
    return row


def _fit_nuisances(
    assembly: Assembly, labels: tuple[str, ...], model: Model, values: Array, longest: int
) -> Stage:
    """Initial states, phase origins and phase corrections of the fitted records."""
    turning = any("phase" in e.inputs for e in model.effects)
    corrected = assembly.study.correction_keys if turning else ()
    return fit_whole_records(assembly, labels, values, longest, beside=corrected)


def _free_curves(
    kept: dict[str, Array], assembly: Assembly, comparison: Comparison, labels: tuple[str, ...],
    stage: Stage, name: str,
) -> dict[str, Any]:  # fmt: skip
    """Free runs and residuals of one model: those that were compared, where they are at hand."""
    traces = comparison.traces or _model_traces(assembly, labels, stage)
    for number in range(min(len(traces.fitted), _RECORDS)):
        kept[f"{number}.{name}.free"] = traces.fitted[number].astype(np.float32)
        kept[f"{number}.{name}.left"] = traces.left[number].astype(np.float32)
    shown = min(len(traces.fitted), _RECORDS)
    about: dict[str, Any] = {"horizon": int(stage.length)}
    if traces.test:
        about["settled"] = int(traces.settled)
    for number, predicted in enumerate(traces.test[:_RECORDS]):
        kept[f"{shown + number}.{name}.free"] = predicted.astype(np.float32)
    return about


def _model_traces(assembly: Assembly, labels: tuple[str, ...], stage: Stage) -> Traces:
    """Free runs and residuals of a model whose windows were fitted."""
    study = assembly.study
    free = free_run_from_stage(assembly, stage, (0,) * len(study.series))
    left = residuals(study, stage.layouts, stage.fitted.point)
    run = free_run_on_test(assembly, labels, stage.fitted.point.values)
    if run is None:
        return Traces(free.predicted, (), 0, left)
    return Traces(free.predicted, run.predicted, run.settled[0], left)


def _where_curves(
    kept: dict[str, Array], assembly: Assembly, stage: Stage, name: str, wide: Model
) -> dict[str, Any]:
    """The missing force of one model; where it fails, in words."""
    about: dict[str, Any] = {}
    region = worst_record_failure(assembly, stage, wide)
    about["where"] = locate_failure(assembly, stage, region).as_dict()
    if region.missing is not None and region.number < _RECORDS:
        about |= _force_curves(kept, assembly, region, name)
    elif name == FINAL and region.number < _RECORDS:
        about |= _state_curves(kept, assembly, stage, region.number)
    return about


def _state_curves(
    kept: dict[str, Array], assembly: Assembly, stage: Stage, number: int
) -> dict[str, Any]:
    """The states of a system without forces, smoothed."""
    study, values = assembly.study, stage.fitted.point.values
    if not np.isfinite(values).all():
        return {}
    model = to_model(assembly, assembly.problem.model.labels, values[number : number + 1], {})
    series = study.series[number]
    grid = study.inputs(number, values[number])
    smoothed = smoothed_states(model, series.record, grid, series.substeps)
    if smoothed is None:
        return {}
    for name, array in zip(("states", "states_sd"), smoothed, strict=True):
        kept[f"{number}.{FINAL}.{name}"] = array.astype(np.float32)
    return {"hidden": {"record": number, "first": 0}}


def _force_curves(
    kept: dict[str, Array], assembly: Assembly, region: WorstRecord, name: str
) -> dict[str, Any]:
    missing = region.missing
    assert missing is not None
    prefix = f"{region.number}.{name}"
    single = {"force": missing.force, "force_sd": missing.deviation,
              "states": missing.states, "states_sd": missing.spreads}  # fmt: skip
    kept.update({f"{prefix}.{k}": v.astype(np.float32) for k, v in single.items()})
    labels = assembly.problem.model.labels
    owned = [k for k in assembly.study.keys if owner_of(k) in labels]
    ranked = rank_force_shapes(missing, tuple(owned))[:6]
    words = [{**vars(s)} for s in ranked]
    return {"record": region.number, "first": missing.start, "shapes": words,
            "axes": list(missing.axes), "force_unit": missing.unit}  # fmt: skip


def _mode_curves(kept: dict[str, Array], assembly: Assembly, stage: Stage) -> dict[str, Any]:
    """Natural frequencies (Hz) and damping ratios at rest, over speed: eigenvalues of f_x."""
    study = assembly.study
    names = study.compiled.traced.inputs
    values = np.ascontiguousarray(stage.fitted.point.values[0])
    speeds = np.zeros(1)
    if "speed" in names:
        highest = max(float(np.abs(s.record.inputs["speed"]).max()) for s in study.series)
        speeds = np.linspace(0.0, 1.1 * highest, _SPEEDS)
    count = study.state_count // 2
    frequency, damping = np.full((2, len(speeds), count), np.nan)
    for row, speed in enumerate(speeds):
        u = np.zeros(len(names))
        if "speed" in names:
            u[names.index("speed")] = speed
        roots = np.linalg.eigvals(state_jacobian(study.compiled, values, u))
        roots = roots[roots.imag > 0]
        roots = roots[np.argsort(np.abs(roots))][:count]
        frequency[row, : len(roots)] = roots.imag / (2 * np.pi)
        damping[row, : len(roots)] = -roots.real / np.abs(roots)
    kept["modes.speed"], kept["modes.frequency"], kept["modes.damping"] = speeds, frequency, damping
    return {"over_speed": "speed" in names}


def _record_curves(kept: dict[str, Array], problem: Problem) -> list[dict[str, Any]]:
    """Channels and inputs of the records.

    The measured curve is the raw channel: it shows what the sensor gave also where a reading is no
    measurement and is bridged for the fit.
    """
    system = problem.model.system
    chosen = [("fit", r) for r in problem.records[:_RECORDS]]
    chosen += [("test", r) for r in problem.test[:_RECORDS]]
    for number, (_, record) in enumerate(chosen):
        y = np.column_stack([record.channels[c] for c in system.observed])
        kept[f"{number}.y"] = y.astype(np.float32)
        for name, values in record.inputs.items():
            exact = name == "phase"  # a phase of thousands of turns needs all its digits
            kept[f"{number}.{INPUT}.{name}"] = values if exact else values.astype(np.float32)
    return [_describe_record(part, record) for part, record in chosen]


def _describe_record(part: str, record: Record) -> dict[str, Any]:
    return {
        "part": part, "name": record.name, "samples": record.samples, "dt": record.dt,
        "start": float(record.time[0]), "sigma": record.sigma(), "sha256": record.sha256,
        "measured": list(record.measured), "notes": list(record.remarks),
    }  # fmt: skip


def _curves_meta(
    problem: Problem,
    records: list[dict[str, Any]],
    about: dict[str, Any],
    final: Model,
    equation: bool,
) -> dict[str, Any]:
    from spiral.io.export.equation import equation_text as written
    from spiral.io.mathml import mathml

    system = problem.model.system
    states = [
        {"name": s.name, "unit": s.unit, "hidden": s.name not in system.observed}
        for s in system.states
    ]
    return {
        "format": _FORMAT,
        "system": system.plugin_name(),
        "meaning": system.meaning(),
        "channels": [{"name": c, "unit": system.unit_of(c)} for c in system.observed],
        "inputs": [{"name": i.name, "unit": i.unit} for i in system.inputs],
        "states": states,
        "records": records,
        "models": about,
        "equation": written(final) if equation else "",
        "mathml": mathml(final) if equation else [],
        "signs": implausible_signs(final) if equation else {},
        "sketch": asdict(couplings_of(final)) if equation else {},
        "latent": LatentForce.meaning(),
    }
