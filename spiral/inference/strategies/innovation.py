"""``strategy=innovation``: evidence from the innovations of a filter on the full system.

whitened innovations and their slopes -> score of every candidate -> gates (likelihood ratio after a
refit) -> admission -> most likely values and process noise.

A candidate may act on states that no sensor sees: the filter carries it to the channels. Where
process noise is real, this is the likelihood to use; a free run over the record is not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.filter.innovation_fit import FilterInputs, TunedTasks, climb_likelihood
from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import build_task
from spiral.engine.filter.whitened import WhitenedRecord
from spiral.engine.gate import Judgement, Trial, run_gates
from spiral.engine.statistics import whiteness
from spiral.inference.evidence.admission import refit_start_values, untestable_effect_error
from spiral.inference.evidence.assembly import Assembly, Variant, columns_with_bounds, to_model
from spiral.inference.evidence.comparison import (
    compare_fitted_model,
    prepare_study,
    refine_substeps,
)
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import amplitude_keys
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import RefittedModel, StartedStudy, Step
from spiral.inference.strategy_options import InnovationOptions
from spiral.physics.compile import compile_model
from spiral.types.record import Array
from spiral.types.run import Comparison, Suggestion


@dataclass(frozen=True)
class OfferedCandidates:
    """Candidates of one round: their variants, one group of columns each, and what they score."""

    variants: tuple[Variant, ...]
    groups: tuple[tuple[int, ...], ...]
    scores: tuple[float, ...]
    energy: float


@dataclass(frozen=True)
class Admission:
    """What a round admits: the state with it, and the refit that its gate asked for, if any."""

    state: FitState
    refit: TunedTasks | None


def begin(problem: Problem, progress: Progress) -> StartedStudy:
    """The seed at its most likely values and process noise."""
    progress("compiling the model and all candidates")
    settings = replace(problem.settings, phase_knot=0.0)  # the filter tracks the phase itself
    assembly, fit_state = prepare_study(replace(problem, settings=settings))
    fit_state = replace(fit_state, corrected=False)
    settled = _settle_refit(assembly, fit_state, None, progress)
    return StartedStudy(assembly, settled.fit_state, settled.comparison, settled.details)


def propose(
    options: InnovationOptions,
    assembly: Assembly,
    fit_state: FitState,
    comparison: Comparison,
    progress: Progress,
) -> Step[Admission]:
    """The candidates scored by the innovations; those that the gates let through."""
    progress("tuning the process noise of the model as it is")
    begun = _prepare_records(assembly, fit_state)
    base = climb_likelihood(begun, ())
    moving = _estimated_keys(assembly, fit_state)
    absent = _absent_variants(assembly, fit_state)
    keys = tuple(k for v in absent for k in amplitude_keys(assembly, v))
    progress(f"scoring {len(absent)} candidates by the innovations")
    parts = base.regression((*moving, *keys)) if base.finite else None
    if parts is None:
        return Step((), {}, stopped="diverged", details={"ended": {"reason": "diverged"}})
    refits: dict[tuple[int, ...], TunedTasks] = {}

    def refit_gain(group: tuple[int, ...]) -> float:
        chosen = tuple(keys[k] for k in group)
        progress(f"refitting with {chosen[0].rsplit('.', 1)[0]}")
        wider = (*moving, *chosen)
        refits[group] = climb_likelihood(
            begun, wider, None, _parameter_bounds(assembly, wider), base.levels
        )
        rise = 2 * (refits[group].log_likelihood - base.log_likelihood)
        return max(rise, 0.0) if np.isfinite(rise) else 0.0

    trial, offered = _make_trial(options, assembly, parts, len(moving), absent, keys, refit_gain)
    log: dict[str, Any] = {"process_noise": dict(base.levels)}
    ordered = sorted(options.gate, key=lambda g: not g.guard)
    trial, judgement = run_gates(ordered, trial, log, progress)
    gains = {g: 2 * (c.log_likelihood - base.log_likelihood) for g, c in refits.items()}
    if not trial.kept:
        white = comparison.whiteness_p >= assembly.problem.settings.whiteness_level
        return _step_without_admission(options, offered, gains, judgement, white, log)
    return _step_with_admission(options, assembly, fit_state, trial, offered, gains, refits, log)


def _step_without_admission(
    options: InnovationOptions,
    offered: OfferedCandidates,
    gains: Mapping[tuple[int, ...], float],
    judgement: Judgement,
    white: bool,
    log: dict[str, Any],
) -> Step[Admission]:
    """The step of a round that admits nothing, and why."""
    log["ended"] = {"reason": judgement.reason or "no_candidate"}
    return Step(
        _make_suggestions(offered, gains, (), ())[: options.listed],
        dict(list(judgement.refused.items())[: options.listed]),
        stopped="whiteness" if white else "no_candidate",
        details=log,
    )


def _step_with_admission(
    options: InnovationOptions,
    assembly: Assembly,
    fit_state: FitState,
    trial: Trial,
    offered: OfferedCandidates,
    gains: Mapping[tuple[int, ...], float],
    refits: Mapping[tuple[int, ...], TunedTasks],
    log: dict[str, Any],
) -> Step[Admission]:
    """The effects whose columns were let through, at the values of their refit."""
    kept = set(trial.kept)
    chosen = [
        (v, g) for v, g in zip(offered.variants, offered.groups, strict=True) if kept & set(g)
    ]
    values = fit_state.values
    step = trial.fitted(trial.kept).b[trial.active.shape[2] :]
    for variant, group in chosen:
        own = np.array([b for k, b in zip(trial.kept, step, strict=True) if k in group])
        values = refit_start_values(assembly, values, variant, own)
    labels = (*fit_state.labels, *(v.label for v, _ in chosen))
    wider = replace(fit_state, labels=labels, values=values)
    near = log.get("innovation", {}).get("alike", ())
    alike = tuple(
        v.original.label
        for v, g in zip(offered.variants, offered.groups, strict=True)
        if trial.names[g[0]] in near
    )
    names = tuple(v.original.label for v, _ in chosen)
    alone = chosen[0][0].companion is None and len(chosen) == 1
    return Step(
        _make_suggestions(offered, gains, names, alike)[: options.listed],
        log["refused"],
        admitted=names,
        aliases=dict.fromkeys(names, alike),
        meaning="; ".join(v.original.meaning() for v, _ in chosen),
        details=log,
        result=Admission(wider, refits.get(chosen[0][1]) if alone else None),
    )


def settle(assembly: Assembly, step: Step[Admission], progress: Progress) -> RefittedModel:
    """Most likely values and process noise with what was admitted."""
    admission = step.required_result()
    return _settle_refit(assembly, admission.state, admission.refit, progress)


def admit(assembly: Assembly, fit_state: FitState, label: str, progress: Progress) -> RefittedModel:
    """The same with an effect that a person names, in the shape whose refit is most likely."""
    variants = [v for v in _absent_variants(assembly, fit_state) if v.original.label == label]
    if not variants:
        raise untestable_effect_error(assembly, label)
    refits = [
        _settle_refit(
            assembly, replace(fit_state, labels=(*fit_state.labels, v.label)), None, progress
        )
        for v in variants
    ]
    return max(refits, key=lambda s: s.log_likelihood)


def _settle_refit(
    assembly: Assembly, fit_state: FitState, fit: TunedTasks | None, progress: Progress
) -> RefittedModel:
    """The most likely model with these effects, compared; whiteness is of its innovations."""
    progress("most likely values and process noise")
    if fit is None:
        keys = _estimated_keys(assembly, fit_state)
        fit = climb_likelihood(
            _prepare_records(assembly, fit_state), keys, bounds=_parameter_bounds(assembly, keys)
        )
    parts = fit.regression(()) if fit.finite else None
    values = fit_state.values if parts is None else _filtered_values(fit_state, fit, parts)
    wider = replace(fit_state, values=values)
    model = to_model(assembly, wider.labels, values, fit.errors, wider.freed)
    finite = parts is not None
    comparison = compare_fitted_model(
        refine_substeps(assembly, wider), wider, model, None, finite, progress
    )
    if parts is None:
        return RefittedModel(wider, comparison)
    left = tuple(p.innovations for p in parts)
    white = whiteness(left, assembly.problem.settings.lags)
    comparison = replace(comparison, whiteness_p=white.p, whiteness_effect=white.effect)
    nis = float(np.mean([np.mean(np.sum(e**2, axis=1)) for e in left]))
    comparison = replace(comparison, innovation_chi2=nis / left[0].shape[1])
    details: dict[str, Any] = {"log_likelihood": fit.log_likelihood, "nis_mean": nis}
    details["process_noise"] = dict(fit.levels)
    return RefittedModel(wider, comparison, details=details, log_likelihood=fit.log_likelihood)


def _filtered_values(
    fit_state: FitState, fit: TunedTasks, parts: tuple[WhitenedRecord, ...]
) -> Array:
    """(records, parameters) with a record's own parameters as the filter tracked them last."""
    rows = fit_state.values.copy()
    for row, (task, settings), part in zip(rows, fit.prepared, parts, strict=True):
        row[: len(task.keys)] = task.values
        for place, key in enumerate(settings.tracked):
            row[task.keys.index(key)] = part.filter_pass.means[-1, len(task.states) + place]
    return rows


def _prepare_records(assembly: Assembly, fit_state: FitState) -> FilterInputs:
    """Every record's filter task at the fit state's values; a record's own parameters tracked."""
    model, traced = assembly.problem.model, assembly.study.compiled.traced
    tracked = _tracked_keys(assembly, fit_state)
    narrow = compile_model(traced, tracked)
    rows = np.ascontiguousarray(fit_state.values[:, : len(traced.keys)])
    return tuple(
        filter_prepared(build_task(model, narrow, row.copy(), record), tracked)
        for row, record in zip(rows, assembly.problem.records, strict=True)
    )


def _tracked_keys(assembly: Assembly, fit_state: FitState) -> tuple[str, ...]:
    known = dict(assembly.problem.model.pairs)
    keys = fit_state.keys(assembly)
    return tuple(k for k in keys if k in known and known[k].scope == "record")


def _estimated_keys(assembly: Assembly, fit_state: FitState) -> tuple[str, ...]:
    """Parameters that the likelihood decides: all that move, but for those that are tracked."""
    tracked = _tracked_keys(assembly, fit_state)
    return tuple(k for k in fit_state.keys(assembly) if k not in tracked)


def _parameter_bounds(assembly: Assembly, keys: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    _, (low, high) = columns_with_bounds(assembly, keys)
    return {k: (float(a), float(b)) for k, a, b in zip(keys, low, high, strict=True)}


def _absent_variants(assembly: Assembly, fit_state: FitState) -> tuple[Variant, ...]:
    present = {v.original.label for v in assembly.variants if v.label in fit_state.labels}
    return tuple(v for v in assembly.variants if v.original.label not in present)


def _make_trial(
    options: InnovationOptions,
    assembly: Assembly,
    parts: tuple[WhitenedRecord, ...],
    active: int,
    absent: tuple[Variant, ...],
    keys: tuple[str, ...],
    gain: Callable[[tuple[int, ...]], float],
) -> tuple[Trial, OfferedCandidates]:
    """The whitened innovations as a regression; of each effect's variants the best is offered."""
    e = np.concatenate([p.innovations for p in parts])
    slopes = np.concatenate([p.columns for p in parts])
    record = np.repeat(np.arange(len(parts)), [len(p.innovations) for p in parts])
    size = np.concatenate([np.linalg.norm(s.y, axis=1) for s in assembly.study.series])
    block, held = np.arange(len(e)) // options.block, 1 - options.train
    bare = Trial(
        names=keys, kept=tuple(range(len(keys))), target=e, active=slopes[..., :active],
        candidates=slopes[..., active:], residual=e,
        train=np.floor((block + 1) * held) == np.floor(block * held),
        amplitude=size, record=record, tests=len(absent), gain=gain,
    )  # fmt: skip
    groups = {v.label: tuple(keys.index(k) for k in amplitude_keys(assembly, v)) for v in absent}
    falls = bare.falls(tuple(groups.values())) if groups else {}
    price = float(np.log(e.size))
    worth = {x: falls[g] - price * len(g) for x, g in groups.items()}
    best: dict[str, Variant] = {}
    for variant in absent:
        name = variant.original.label
        if name not in best or worth[variant.label] > worth[best[name].label]:
            best[name] = variant
    chosen = tuple(best.values())
    picked = tuple(groups[v.label] for v in chosen)
    kept = tuple(sorted(k for g in picked for k in g))
    scores = tuple(falls[g] for g in picked)
    offered = OfferedCandidates(chosen, picked, scores, float(np.sum(e**2)))
    return replace(bare, kept=kept, groups=picked), offered


def _make_suggestions(
    offered: OfferedCandidates,
    gains: Mapping[tuple[int, ...], float],
    admitted: tuple[str, ...],
    alike: tuple[str, ...],
) -> tuple[Suggestion, ...]:
    """All candidates, those admitted first; by twice the gain in log L where refitted."""
    from scipy import special

    def sort_key(i: int) -> tuple[bool, float, float]:
        group = offered.groups[i]
        first = offered.variants[i].original.label in admitted
        return first, gains.get(group, 0.0), offered.scores[i]

    suggestions = []
    for i in sorted(range(len(offered.groups)), key=sort_key, reverse=True):
        effect, group = offered.variants[i].original, offered.groups[i]
        statistic = gains.get(group, offered.scores[i])
        suggestions.append(
            Suggestion(
                effect=effect.label,
                meaning=effect.meaning(),
                aliases=alike if effect.label in admitted else (),
                p_value=float(special.chdtrc(len(group), max(statistic, 0.0))),
                statistic=statistic,
                wald_p_value=float(special.chdtrc(len(group), max(offered.scores[i], 0.0))),
                explains=offered.scores[i] / max(offered.energy, 1e-300),
            )
        )
    return tuple(suggestions)
