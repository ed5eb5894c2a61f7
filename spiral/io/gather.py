"""The curves of models that were compared: what ``curves`` keeps, computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from spiral.engine.filter.task import linearised
from spiral.engine.growth import Stage
from spiral.engine.sensitivities import residuals
from spiral.engine.threads import one_blas_thread
from spiral.inference.evidence.assembly import (
    Assembly,
    assemble,
    first_row,
    placed,
    to_model,
)
from spiral.inference.evidence.comparison import refined, test_run
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.judge import run_free, whole
from spiral.inference.problem import Problem, Progress, silent
from spiral.inference.where.latent import LatentForce, smoothed_states, with_latent
from spiral.inference.where.regions import Seen, seen, where
from spiral.inference.where.surface import shapes
from spiral.io.curves import FINAL, Curves
from spiral.physics.couplings import couplings_of
from spiral.physics.passivity import implausible
from spiral.types.model import Model
from spiral.types.record import Array, Record
from spiral.types.run import Comparison, Traces

_RECORDS = 3  # of each part, that are kept
_SPEEDS = 41
_FORMAT = 1


@one_blas_thread
def gather(
    problem: Problem, comparisons: Mapping[str, Comparison], progress: Progress = silent
) -> Curves:
    """All curves of the models that these comparisons judged.

    Only the records' own nuisances are estimated again; the parameters stand as they are.
    """
    wide = _wide(problem.model, [c.model for c in comparisons.values()])
    final = list(comparisons)[-1]
    asked = problem.running(comparisons[final].between)
    whole = replace(asked, model=wide, candidates=())
    progress("curves for the report")
    assembly = assemble(whole)
    kept: dict[str, Array] = {}
    about: dict[str, Any] = {}
    for name, comparison in comparisons.items():
        narrow = replace(assembly, problem=replace(whole, model=comparison.model))
        values = _zeroed(narrow, first_row(narrow), comparison.model)
        narrow = refined(narrow, FitState(comparison.model.labels, values))
        stage = _settled(
            narrow, comparison.model.labels, comparison.model, values, comparison.horizon
        )
        about[name] = _free_curves(kept, narrow, comparison, comparison.model.labels, stage, name)
        about[name] |= _where_curves(kept, narrow, stage, name, wide)
        if name == final:
            about["modes"] = _modes(kept, narrow, stage)
    return _whole(kept, about, problem, comparisons[final].model)


@one_blas_thread
def free_curves(
    assembly: Assembly, name: str, standing: FitState, comparison: Comparison
) -> Curves:
    """The curves of one model that need no missing force, with a study's own compilation.

    Free runs, residuals and modes: all there is to draw at once, before ``gather`` does the rest.
    """
    kept: dict[str, Array] = {}
    values = placed(assembly, standing.labels, standing.values, comparison.model)
    stage = _settled(assembly, standing.labels, comparison.model, values, comparison.horizon)
    labels = standing.labels
    about: dict[str, Any] = {name: _free_curves(kept, assembly, comparison, labels, stage, name)}
    about["modes"] = _modes(kept, assembly, stage)
    return _whole(kept, about, assembly.problem, comparison.model, equation=False)


def _whole(
    kept: dict[str, Array], about: dict[str, Any], problem: Problem, model: Model,
    equation: bool = True,
) -> Curves:  # fmt: skip
    """Curves with their records and all that is said of them."""
    records = _records(kept, problem)
    tests = [a.pop("settled") for a in about.values() if isinstance(a, dict) and "settled" in a]
    for record in records:
        record["settled"] = tests[0] if record["part"] == "test" and tests else 0
    return Curves(_meta(problem, records, about, model, equation), kept)


def _wide(model: Model, models: list[Model]) -> Model:
    """One model with every effect of all, and an unknown force: compiled once."""
    effects = {e.label: e for m in reversed(models) for e in m.effects}
    bare = Model(model.system, tuple(effects.values()))
    zero = {k: p.start or 0.0 for k, p in bare.pairs}
    for key, parameter in bare.pairs:
        if parameter.role == "shape":
            zero[key] = next((m.values[key] for m in models if key in m.values), zero[key] or 1.0)
        elif not key.startswith("system."):
            zero[key] = 0.0
    return with_latent(replace(bare, values=zero))


def _zeroed(assembly: Assembly, row: Array, model: Model) -> Array:
    """Amplitudes of effects that a model does not have are zero."""
    traced = assembly.study.compiled.traced
    for at, (key, parameter) in enumerate(zip(traced.keys, traced.parameters, strict=True)):
        if key in model.values or key.startswith("system."):
            continue
        row[:, at] = 1.0 if parameter.role == "shape" else 0.0
    return row


def _settled(
    assembly: Assembly, labels: tuple[str, ...], model: Model, values: Array, longest: int
) -> Stage:
    """Initial states, phase origins and phase corrections of the fitted records."""
    turning = any("phase" in e.inputs for e in model.effects)
    corrected = assembly.study.correction_keys if turning else ()
    return whole(assembly, labels, values, longest, beside=corrected)


def _free_curves(
    kept: dict[str, Array], assembly: Assembly, comparison: Comparison, labels: tuple[str, ...],
    stage: Stage, name: str,
) -> dict[str, Any]:  # fmt: skip
    """Free runs and residuals of one model: those that were compared, where they are at hand."""
    found = comparison.traces or _traced(assembly, labels, stage)
    for number in range(min(len(found.fitted), _RECORDS)):
        kept[f"{number}.{name}.free"] = found.fitted[number].astype(np.float32)
        kept[f"{number}.{name}.left"] = found.left[number].astype(np.float32)
    shown = min(len(found.fitted), _RECORDS)
    about: dict[str, Any] = {"horizon": int(stage.length)}
    if found.test:
        about["settled"] = int(found.settled)
    for number, predicted in enumerate(found.test[:_RECORDS]):
        kept[f"{shown + number}.{name}.free"] = predicted.astype(np.float32)
    return about


def _traced(assembly: Assembly, labels: tuple[str, ...], stage: Stage) -> Traces:
    """Free runs and residuals of a model whose windows were fitted."""
    study = assembly.study
    free = run_free(assembly, stage, (0,) * len(study.series))
    left = residuals(study, stage.layouts, stage.fitted.point)
    run = test_run(assembly, labels, stage.fitted.point.values)
    if run is None:
        return Traces(free.predicted, (), 0, left)
    return Traces(free.predicted, run.predicted, run.settled[0], left)


def _where_curves(
    kept: dict[str, Array], assembly: Assembly, stage: Stage, name: str, wide: Model
) -> dict[str, Any]:
    """The missing force of one model; where it fails, in words."""
    about: dict[str, Any] = {}
    found = seen(assembly, stage, wide)
    about["where"] = where(assembly, stage, found).as_dict()
    if found.missing is not None and found.number < _RECORDS:
        about |= _force_curves(kept, assembly, found, name)
    elif name == FINAL and found.number < _RECORDS:
        about |= _state_curves(kept, assembly, stage, found.number)
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
    found = smoothed_states(model, series.record, grid, series.substeps)
    if found is None:
        return {}
    for name, array in zip(("states", "states_sd"), found, strict=True):
        kept[f"{number}.{FINAL}.{name}"] = array.astype(np.float32)
    return {"hidden": {"record": number, "first": 0}}


def _force_curves(
    kept: dict[str, Array], assembly: Assembly, found: Seen, name: str
) -> dict[str, Any]:
    missing = found.missing
    assert missing is not None
    prefix = f"{found.number}.{name}"
    single = {"force": missing.force, "force_sd": missing.deviation,
              "states": missing.states, "states_sd": missing.spreads}  # fmt: skip
    kept.update({f"{prefix}.{k}": v.astype(np.float32) for k, v in single.items()})
    labels = assembly.problem.model.labels
    owned = [k for k in assembly.study.keys if k.rsplit(".", 1)[0] in labels]
    ranked = shapes(missing, tuple(owned))[:6]
    words = [{**vars(s)} for s in ranked]
    return {"record": found.number, "first": missing.start, "shapes": words,
            "axes": list(missing.axes), "force_unit": missing.unit}  # fmt: skip


def _modes(kept: dict[str, Array], assembly: Assembly, stage: Stage) -> dict[str, Any]:
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
        roots = np.linalg.eigvals(linearised(study.compiled, values, u))
        roots = roots[roots.imag > 0]
        roots = roots[np.argsort(np.abs(roots))][:count]
        frequency[row, : len(roots)] = roots.imag / (2 * np.pi)
        damping[row, : len(roots)] = -roots.real / np.abs(roots)
    kept["modes.speed"], kept["modes.frequency"], kept["modes.damping"] = speeds, frequency, damping
    return {"over_speed": "speed" in names}


def _records(kept: dict[str, Array], problem: Problem) -> list[dict[str, Any]]:
    system = problem.model.system
    chosen = [("fit", r) for r in problem.records[:_RECORDS]]
    chosen += [("test", r) for r in problem.test[:_RECORDS]]
    for number, (_, record) in enumerate(chosen):
        y = np.column_stack([record.channels[c] for c in system.observed])
        kept[f"{number}.y"] = y.astype(np.float32)
        for name, values in record.inputs.items():
            exact = name == "phase"  # a phase of thousands of turns needs all its digits
            kept[f"{number}.{name}"] = values if exact else values.astype(np.float32)
    return [_about(part, record) for part, record in chosen]


def _about(part: str, record: Record) -> dict[str, Any]:
    return {
        "part": part, "name": record.name, "samples": record.samples, "dt": record.dt,
        "start": float(record.time[0]), "sigma": record.sigma(), "sha256": record.sha256,
        "measured": list(record.measured), "notes": list(record.remarks),
    }  # fmt: skip


def _meta(
    problem: Problem,
    records: list[dict[str, Any]],
    about: dict[str, Any],
    final: Model,
    equation: bool,
) -> dict[str, Any]:
    from spiral.io.export.equation import equation as written
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
        "signs": implausible(final) if equation else {},
        "sketch": asdict(couplings_of(final)) if equation else {},
        "latent": LatentForce.meaning(),
    }
