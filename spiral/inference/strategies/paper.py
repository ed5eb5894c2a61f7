"""``strategy=paper``: the evidence as published, from differentiated data (Algorithm 1).

derivatives -> residual of the current model -> guard -> learned residual -> projection onto the
library -> Gate 1, refinements, Gate 2 with roll-back -> annotation -> joint refit.

Where the paper contradicts itself or says nothing, see docs/method.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.gate import Judgement, Trial, run_gates
from spiral.inference.evidence.admission import untestable_effect_error
from spiral.inference.evidence.assembly import Assembly, assemble, initial_values, to_model
from spiral.inference.evidence.comparison import compare_fitted_model, refine_substeps
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.paper.halton import (
    Regressor,
    box_points,
    project_surface,
    regressor,
    trajectory_points,
)
from spiral.inference.paper.log import closure_log, model_log, suggestions, term_log
from spiral.inference.paper.regression import (
    Equations,
    Samples,
    column_names,
    design_matrix,
    differentiate_records,
    regression_equations,
    with_coefficients,
)
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import RefittedModel, StartedStudy, Step
from spiral.inference.strategy_options import PaperOptions
from spiral.types.label import owner_of
from spiral.types.learner import Learned, learned
from spiral.types.library import Term, terms_of
from spiral.types.record import Array
from spiral.types.run import StopReason

ENDED = {
    "white": "the residual is white (guard)",
    "no_term_passes_gate_1": "Gate 1 passes no term",
    "no_term_passes_a_refinement": "no term passes a refinement of Gate 2",
    "gate_2_f_not_significant": "the partial F of Gate 2 is not significant",
    "rolled_back": "the validation error rises: rolled back",
    "no_robust_t": "no term has a significant robust t",
    "likelihood_not_higher": "no term makes the record significantly more likely",
    "": "no term of the library is left",
}
"""The paper's reasons for ending, and those of its refinements."""


@dataclass(frozen=True)
class Regression:
    """What stays the same in all rounds: samples, columns of every amplitude, and the split."""

    samples: Samples
    equations: Equations
    terms: tuple[Term, ...]
    columns: Array
    target: Array
    names: tuple[str, ...]
    train: Array
    regressor: Regressor


def begin(options: PaperOptions, problem: Problem, progress: Progress) -> StartedStudy:
    """Derivatives, equations and columns of the study; the seed by joint least squares."""
    progress("compiling the model and the library")
    assembly = assemble(problem)
    terms = terms_of(options.library, problem.model.system)
    labels = problem.model.labels
    known = FitState(labels, initial_values(assembly), corrected=False)
    offered = {v.original.label for v in assembly.variants if not v.effect.undirected()}
    active = [k for k in known.keys(assembly) if k in _amplitude_keys(assembly)]
    wanted = [t for t in terms if t.effect.label in offered and t.key not in active]
    balance = regression_equations(assembly, (*active, *(t.key for t in wanted)))
    progress("estimating derivatives")
    samples = differentiate_records(assembly, options.derivative)
    columns, target = design_matrix(balance, samples, known.values)
    split = _training_mask(options, samples)
    kept = Regression(
        samples, balance, terms, columns, target, column_names(balance, samples), split,
        regressor(problem.model.system, assembly.study.compiled.traced),
    )  # fmt: skip
    assembly = replace(assembly, kept=kept)
    settled = _refit_jointly(options, assembly, known, progress)
    assembly = refine_substeps(assembly, settled.fit_state)
    return StartedStudy(assembly, settled.fit_state, settled.comparison, settled.details)


def _kept_regression(assembly: Assembly) -> Regression:
    """The regression that ``begin`` stores with the study."""
    assert isinstance(assembly.kept, Regression)
    return assembly.kept


def _amplitude_keys(assembly: Assembly) -> set[str]:
    """Every key that enters the balance of forces linearly: amplitudes, and a system's own."""
    traced = assembly.study.compiled.traced
    origin = "system.phase_origin"
    pairs = zip(traced.keys, traced.parameters, strict=True)
    return {k for k, p in pairs if p.role == "amplitude" and k != origin}


def _training_mask(options: PaperOptions, samples: Samples) -> Array:
    """(N,) True for training samples (paper: 70 %)."""
    count = len(samples.states)
    share = 1.0 - options.train
    if options.split == "tail":
        return np.arange(count) < round(count * options.train)
    block = np.arange(count) // options.block
    return np.floor((block + 1) * share) == np.floor(block * share)


# --- the current model as a regression -----------------------------------------------------------


def _active_columns(kept: Regression, fit_state: FitState, assembly: Assembly) -> list[int]:
    """Columns of the current model; the pair of an unbalance counts as two."""
    keys = set(fit_state.keys(assembly))
    return [i for i, n in enumerate(kept.names) if n.split(" ")[0] in keys]


def _make_trial(options: PaperOptions, assembly: Assembly, fit_state: FitState) -> Trial:
    kept = _kept_regression(assembly)
    active = _active_columns(kept, fit_state, assembly)
    chosen = set(active)
    library = {t.key for t in kept.terms}
    others = [i for i, n in enumerate(kept.names) if i not in chosen and n in library]
    at = kept.samples
    moving = at.states[:, kept.regressor.states[: len(kept.regressor.states) // 2]]
    bare = Trial(
        names=tuple(kept.names[i] for i in others),
        kept=tuple(range(len(others))),
        target=kept.target,
        active=kept.columns[..., active],
        candidates=kept.columns[..., others],
        residual=kept.target,
        train=kept.train,
        amplitude=np.linalg.norm(moving, axis=1),
        record=at.record,
        seed=options.seed,
    )
    return replace(bare, residual=kept.target - bare.active @ bare.before.b)


def _refit_jointly(
    options: PaperOptions, assembly: Assembly, fit_state: FitState, progress: Progress
) -> RefittedModel:
    """Joint least squares on the training samples (paper, eq. joint_ols), and the comparison."""
    kept = _kept_regression(assembly)
    progress("joint least squares on the training samples")
    trial = _make_trial(options, assembly, fit_state)
    names = tuple(kept.names[i] for i in _active_columns(kept, fit_state, assembly))
    log, errors = model_log(trial, names, {t.key: t for t in kept.terms})
    values = with_coefficients(
        kept.equations, kept.samples, fit_state.values, names, trial.before.b, assembly.study
    )
    wider = replace(fit_state, values=values)
    model = to_model(assembly, wider.labels, values, errors)
    model = replace(model, fixed=(*model.fixed, *wider.held))
    finite = bool(np.all(np.isfinite(values)))
    comparison = compare_fitted_model(
        refine_substeps(assembly, wider), wider, model, None, finite, progress
    )
    return RefittedModel(wider, comparison, details=log)


# --- one round -----------------------------------------------------------------------------------


def propose(
    options: PaperOptions, assembly: Assembly, fit_state: FitState, progress: Progress
) -> Step[FitState]:
    """Algorithm 1 up to the annotation: what passes all gates, or why the loop ends."""
    trial = _make_trial(options, assembly, fit_state)
    if not trial.kept:
        return _step_without_admission(options, trial, {}, Judgement((), {}))
    log: dict[str, Any] = {}
    for gate in (g for g in options.gate if g.guard):
        progress(f"guard {gate.plugin_name()}")
        judgement = gate.judge(trial)
        log[gate.plugin_name()] = dict(judgement.log)
        if not judgement.kept:
            return _step_without_admission(options, trial, log, judgement)
    function = None
    if options.sampling != "samples":
        function, trial = _learn_residual(options, assembly, fit_state, trial, log, progress)
    tests = [g for g in options.gate if not g.guard]
    trial, judgement = run_gates(tests, trial, log, progress)
    if not trial.kept:
        if function is not None and options.library.closure:
            xi = _regressor_values(assembly)
            log["closure"] = closure_log(trial, function.predict(xi))
        return _step_without_admission(options, trial, log, judgement)
    return _step_with_admission(options, assembly, fit_state, trial, log)


def _regressor_values(assembly: Assembly) -> Array:
    kept = _kept_regression(assembly)
    return kept.regressor.of(kept.samples.states, kept.samples.inputs)


def _learn_residual(
    options: PaperOptions,
    assembly: Assembly,
    fit_state: FitState,
    trial: Trial,
    log: dict[str, Any],
    progress: Progress,
) -> tuple[Learned, Trial]:
    """Steps 2 to 4: learn the residual, and project it onto the library."""
    kept = _kept_regression(assembly)
    progress(f"learning the residual ({options.learner.plugin_name()})")
    function = learned(
        options.learner,
        _regressor_values(assembly),
        trial.residual,
        trial.train,
        options.seed,
        progress,
    )
    log["learner"] = {"name": options.learner.plugin_name(), **function.log}
    progress(f"projecting onto {len(trial.names)} terms of the library")
    if options.sampling == "box":
        points = box_points(kept.regressor, kept.samples, options.points, options.seed)
    else:
        points = trajectory_points(kept.samples, trial.train)
    at = tuple(kept.equations.keys.index(n) for n in trial.names)
    surface = project_surface(
        function, kept.regressor, kept.equations, at, points, fit_state.values[0]
    )
    log["projection"] = {"sampling": options.sampling, "points": surface.points, "r2": surface.r2}
    return function, replace(trial, surface=surface)


def _step_without_admission(
    options: PaperOptions, trial: Trial, log: dict[str, Any], judgement: Judgement
) -> Step[FitState]:
    """Nothing admitted: why, in the paper's words and in the contract's."""
    log["ended"] = {
        "reason": judgement.reason or "library_exhausted",
        "text": ENDED[judgement.reason],
    }
    stopped: StopReason = "whiteness" if judgement.reason == "white" else "no_candidate"
    shown = dict(list(judgement.refused.items())[: options.listed])
    return Step((), shown, stopped=stopped, details=log)


def _step_with_admission(
    options: PaperOptions,
    assembly: Assembly,
    fit_state: FitState,
    trial: Trial,
    log: dict[str, Any],
) -> Step[FitState]:
    """Terms that passed, as effects of the model with their physical origin."""
    kept = _kept_regression(assembly)
    by_key = {t.key: t for t in kept.terms}
    chosen = tuple(trial.names[k] for k in trial.kept)
    log["admitted"] = term_log(trial, by_key)
    labels = tuple(dict.fromkeys(by_key[k].effect.label for k in chosen))
    new = tuple(x for x in labels if x not in fit_state.labels)
    wider = replace(fit_state, labels=(*fit_state.labels, *new))
    free = set(chosen)
    held = tuple(
        k
        for k in replace(wider, held=()).keys(assembly)
        if k in _amplitude_keys(assembly)
        and (k in fit_state.held or owner_of(k) in new)
        and k not in free
    )
    meaning = "; ".join(dict.fromkeys(by_key[k].mechanism for k in chosen))
    aliases: dict[str, tuple[str, ...]] = dict.fromkeys(labels, ())
    for cluster in log.get("correlation_cluster", {}).get("clusters", ()):
        if cluster["carried"] in free:
            label = owner_of(cluster["carried"])
            others = [owner_of(k) for k in cluster["members"] if owner_of(k) not in labels]
            aliases[label] = tuple(dict.fromkeys((*aliases[label], *others)))
    return Step(
        suggestions(trial, by_key, aliases)[: options.listed],
        {},
        admitted=labels,
        aliases=aliases,
        meaning=meaning,
        details=log,
        result=replace(wider, held=held),
    )


def settle(
    options: PaperOptions, assembly: Assembly, step: Step[FitState], progress: Progress
) -> RefittedModel:
    """Joint least squares with the admitted terms."""
    return _refit_jointly(options, assembly, step.required_result(), progress)


def admit(
    options: PaperOptions, assembly: Assembly, fit_state: FitState, label: str, progress: Progress
) -> RefittedModel:
    """The same with the terms of an effect that a person names; its other amplitudes are held."""
    kept = _kept_regression(assembly)
    free = {t.key for t in kept.terms if t.effect.label == label}
    if not free & {n.split(" ")[0] for n in kept.names}:
        raise untestable_effect_error(assembly, label)
    wider = replace(fit_state, labels=(*fit_state.labels, label))
    own = {
        k for k in wider.keys(assembly) if k in _amplitude_keys(assembly) and owner_of(k) == label
    }
    wider = replace(wider, held=(*fit_state.held, *sorted(own - free)))
    return _refit_jointly(options, assembly, wider, progress)
