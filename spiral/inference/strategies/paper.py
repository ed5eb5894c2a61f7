"""``strategy=paper``: the evidence as published, from differentiated data (Algorithm 1).

derivatives -> residual of the current model -> guard -> learned residual -> projection onto the
library -> Gate 1, refinements, Gate 2 with roll-back -> annotation -> joint refit.

Where the paper contradicts itself or says nothing, see docs/method.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.gate import Judgement, Trial, through
from spiral.inference.evidence.admission import cannot_be_asked
from spiral.inference.evidence.assembly import Assembly, assemble, first_row, to_model
from spiral.inference.evidence.comparison import compared, refined
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
    design,
    differentiated,
    equations,
    with_coefficients,
)
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import Begun, Settled, Step
from spiral.inference.strategy_options import PaperOptions
from spiral.types.learner import Learned, learned
from spiral.types.library import Term, terms_of
from spiral.types.record import Array
from spiral.types.run import Stopped

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


def begin(options: PaperOptions, problem: Problem, progress: Progress) -> Begun:
    """Derivatives, equations and columns of the study; the seed by joint least squares."""
    progress("compiling the model and the library")
    assembly = assemble(problem)
    terms = terms_of(options.library, problem.model.system)
    labels = problem.model.labels
    known = FitState(labels, first_row(assembly), corrected=False)
    offered = {v.original.label for v in assembly.variants if not v.effect.undirected()}
    active = [k for k in known.keys(assembly) if k in _amplitudes(assembly)]
    wanted = [t for t in terms if t.effect.label in offered and t.key not in active]
    found = equations(assembly, (*active, *(t.key for t in wanted)))
    progress("estimating derivatives")
    samples = differentiated(assembly, options.derivative)
    columns, target = design(found, samples, known.values)
    split = _split(options, samples)
    kept = Regression(
        samples, found, terms, columns, target, column_names(found, samples), split,
        regressor(problem.model.system, assembly.study.compiled.traced),
    )  # fmt: skip
    assembly = replace(assembly, kept=kept)
    settled = _refitted(options, assembly, known, progress)
    assembly = refined(assembly, settled.standing)
    return Begun(assembly, settled.standing, settled.comparison, settled.details)


def _kept(assembly: Assembly) -> Regression:
    """What ``begin`` keeps with the study."""
    assert isinstance(assembly.kept, Regression)
    return assembly.kept


def _amplitudes(assembly: Assembly) -> set[str]:
    """Every key that enters the balance of forces linearly: amplitudes, and a system's own."""
    traced = assembly.study.compiled.traced
    origin = "system.phase_origin"
    pairs = zip(traced.keys, traced.parameters, strict=True)
    return {k for k, p in pairs if p.role == "amplitude" and k != origin}


def _split(options: PaperOptions, samples: Samples) -> Array:
    """(N,) True for training samples (paper: 70 %)."""
    count = len(samples.states)
    share = 1.0 - options.train
    if options.split == "tail":
        return np.arange(count) < round(count * options.train)
    block = np.arange(count) // options.block
    return np.floor((block + 1) * share) == np.floor(block * share)


# --- the current model as a regression -----------------------------------------------------------


def _active(kept: Regression, standing: FitState, assembly: Assembly) -> list[int]:
    """Columns of the current model; the pair of an unbalance counts as two."""
    keys = set(standing.keys(assembly))
    return [i for i, n in enumerate(kept.names) if n.split(" ")[0] in keys]


def _trial(options: PaperOptions, assembly: Assembly, standing: FitState) -> Trial:
    kept = _kept(assembly)
    active = _active(kept, standing, assembly)
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


def _refitted(
    options: PaperOptions, assembly: Assembly, standing: FitState, progress: Progress
) -> Settled:
    """Joint least squares on the training samples (paper, eq. joint_ols), and the comparison."""
    kept = _kept(assembly)
    progress("joint least squares on the training samples")
    trial = _trial(options, assembly, standing)
    names = tuple(kept.names[i] for i in _active(kept, standing, assembly))
    log, errors = model_log(trial, names, {t.key: t for t in kept.terms})
    values = with_coefficients(
        kept.equations, kept.samples, standing.values, names, trial.before.b, assembly.study
    )
    wider = replace(standing, values=values)
    model = to_model(assembly, wider.labels, values, errors)
    model = replace(model, fixed=(*model.fixed, *wider.held))
    finite = bool(np.all(np.isfinite(values)))
    comparison = compared(refined(assembly, wider), wider, model, None, finite, progress)
    return Settled(wider, comparison, details=log)


# --- one round -----------------------------------------------------------------------------------


def propose(
    options: PaperOptions, assembly: Assembly, standing: FitState, progress: Progress
) -> Step[FitState]:
    """Algorithm 1 up to the annotation: what passes all gates, at what the loop ends otherwise."""
    trial = _trial(options, assembly, standing)
    if not trial.kept:
        return _ended(options, trial, {}, Judgement((), {}))
    log: dict[str, Any] = {}
    for gate in (g for g in options.gate if g.guard):
        progress(f"guard {gate.plugin_name()}")
        judgement = gate.judge(trial)
        log[gate.plugin_name()] = dict(judgement.log)
        if not judgement.kept:
            return _ended(options, trial, log, judgement)
    function = None
    if options.sampling != "samples":
        function, trial = _learned(options, assembly, standing, trial, log, progress)
    tests = [g for g in options.gate if not g.guard]
    trial, judgement = through(tests, trial, log, progress)
    if not trial.kept:
        if function is not None and options.library.closure:
            xi = _xi(assembly)
            log["closure"] = closure_log(trial, function.predict(xi))
        return _ended(options, trial, log, judgement)
    return _admission(options, assembly, standing, trial, log)


def _xi(assembly: Assembly) -> Array:
    kept = _kept(assembly)
    return kept.regressor.of(kept.samples.states, kept.samples.inputs)


def _learned(
    options: PaperOptions,
    assembly: Assembly,
    standing: FitState,
    trial: Trial,
    log: dict[str, Any],
    progress: Progress,
) -> tuple[Learned, Trial]:
    """Steps 2 to 4: learn the residual, and project it onto the library."""
    kept = _kept(assembly)
    progress(f"learning the residual ({options.learner.plugin_name()})")
    function = learned(
        options.learner, _xi(assembly), trial.residual, trial.train, options.seed, progress
    )
    log["learner"] = {"name": options.learner.plugin_name(), **function.log}
    progress(f"projecting onto {len(trial.names)} terms of the library")
    if options.sampling == "box":
        points = box_points(kept.regressor, kept.samples, options.points, options.seed)
    else:
        points = trajectory_points(kept.samples, trial.train)
    at = tuple(kept.equations.keys.index(n) for n in trial.names)
    surface = project_surface(
        function, kept.regressor, kept.equations, at, points, standing.values[0]
    )
    log["projection"] = {"sampling": options.sampling, "points": surface.points, "r2": surface.r2}
    return function, replace(trial, surface=surface)


def _ended(
    options: PaperOptions, trial: Trial, log: dict[str, Any], judgement: Judgement
) -> Step[FitState]:
    """Nothing admitted: why, in the paper's words and in the contract's."""
    log["ended"] = {
        "reason": judgement.reason or "library_exhausted",
        "text": ENDED[judgement.reason],
    }
    stopped: Stopped = "whiteness" if judgement.reason == "white" else "no_candidate"
    shown = dict(list(judgement.refused.items())[: options.listed])
    return Step((), shown, stopped=stopped, details=log)


def _admission(
    options: PaperOptions, assembly: Assembly, standing: FitState, trial: Trial, log: dict[str, Any]
) -> Step[FitState]:
    """Terms that passed, as effects of the model with their physical origin."""
    kept = _kept(assembly)
    by_key = {t.key: t for t in kept.terms}
    chosen = tuple(trial.names[k] for k in trial.kept)
    log["admitted"] = term_log(trial, by_key)
    labels = tuple(dict.fromkeys(by_key[k].effect.label for k in chosen))
    new = tuple(x for x in labels if x not in standing.labels)
    wider = replace(standing, labels=(*standing.labels, *new))
    free = set(chosen)
    held = tuple(
        k
        for k in replace(wider, held=()).keys(assembly)
        if k in _amplitudes(assembly) and (k in standing.held or _owner(k) in new) and k not in free
    )
    meaning = "; ".join(dict.fromkeys(by_key[k].mechanism for k in chosen))
    aliases: dict[str, tuple[str, ...]] = dict.fromkeys(labels, ())
    for cluster in log.get("correlation_cluster", {}).get("clusters", ()):
        if cluster["carried"] in free:
            label = _owner(cluster["carried"])
            others = [_owner(k) for k in cluster["members"] if _owner(k) not in labels]
            aliases[label] = tuple(dict.fromkeys((*aliases[label], *others)))
    return Step(
        suggestions(trial, by_key, aliases)[: options.listed],
        {},
        admitted=labels,
        aliases=aliases,
        meaning=meaning,
        details=log,
        found=replace(wider, held=held),
    )


def _owner(key: str) -> str:
    return key.rsplit(".", 1)[0]


def settle(
    options: PaperOptions, assembly: Assembly, step: Step[FitState], progress: Progress
) -> Settled:
    """Joint least squares with the admitted terms."""
    return _refitted(options, assembly, step.needed(), progress)


def admit(
    options: PaperOptions, assembly: Assembly, standing: FitState, label: str, progress: Progress
) -> Settled:
    """The same with the terms of an effect that a person names; its other amplitudes are held."""
    kept = _kept(assembly)
    free = {t.key for t in kept.terms if t.effect.label == label}
    if not free & {n.split(" ")[0] for n in kept.names}:
        raise cannot_be_asked(assembly, label)
    wider = replace(standing, labels=(*standing.labels, label))
    own = {k for k in wider.keys(assembly) if k in _amplitudes(assembly) and _owner(k) == label}
    wider = replace(wider, held=(*standing.held, *sorted(own - free)))
    return _refitted(options, assembly, wider, progress)
