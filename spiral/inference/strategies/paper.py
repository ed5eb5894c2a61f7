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
from spiral.inference.problem import Problem, Progress, Published
from spiral.inference.strategies.base import Begun, Settled, Step, Strategy
from spiral.types.learner import Learned, learned
from spiral.types.library import Term, terms_of
from spiral.types.record import Array
from spiral.types.run import Comparison, Stopped

_BLOCK = 256

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


def _begin(problem: Problem, progress: Progress) -> Begun:
    published = _of(problem)
    progress("compiling the model and the library")
    assembly = assemble(problem)
    terms = terms_of(published.library, problem.model.system)
    labels = problem.model.labels
    known = FitState(labels, first_row(assembly), corrected=False)
    offered = {v.original.label for v in assembly.variants if not v.effect.undirected()}
    active = [k for k in known.keys(assembly) if k in _amplitudes(assembly)]
    wanted = [t for t in terms if t.effect.label in offered and t.key not in active]
    found = equations(assembly, (*active, *(t.key for t in wanted)))
    progress("estimating derivatives")
    samples = differentiated(assembly, published.derivative)
    columns, target = design(found, samples, known.values)
    split = _split(samples, published)
    kept = Regression(
        samples, found, terms, columns, target, column_names(found, samples), split,
        regressor(problem.model.system, assembly.study.compiled.traced),
    )  # fmt: skip
    assembly = replace(assembly, regression=kept)
    settled = _refitted(assembly, known, progress)
    assembly = refined(assembly, settled.standing)
    return Begun(assembly, settled.standing, settled.comparison, settled.details)


def _of(problem: Problem) -> Published:
    assert problem.published is not None
    return problem.published


def _amplitudes(assembly: Assembly) -> set[str]:
    """Every key that enters the balance of forces linearly: amplitudes, and a system's own."""
    traced = assembly.study.compiled.traced
    origin = "system.phase_origin"
    pairs = zip(traced.keys, traced.parameters, strict=True)
    return {k for k, p in pairs if p.role == "amplitude" and k != origin}


def _split(samples: Samples, published: Published) -> Array:
    """(N,) True for training samples (paper: 70 %)."""
    count = len(samples.states)
    share = 1.0 - published.sampling.train
    if published.sampling.split == "tail":
        return np.arange(count) < round(count * published.sampling.train)
    block = np.arange(count) // _BLOCK
    return np.floor((block + 1) * share) == np.floor(block * share)


# --- the current model as a regression -----------------------------------------------------------


def _active(kept: Regression, standing: FitState, assembly: Assembly) -> list[int]:
    """Columns of the current model; the pair of an unbalance counts as two."""
    keys = set(standing.keys(assembly))
    return [i for i, n in enumerate(kept.names) if n.split(" ")[0] in keys]


def _trial(assembly: Assembly, standing: FitState) -> Trial:
    kept: Regression = assembly.regression
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
        seed=_of(assembly.problem).sampling.seed,
    )
    return replace(bare, residual=kept.target - bare.active @ bare.before.b)


def _refitted(assembly: Assembly, standing: FitState, progress: Progress) -> Settled:
    """Joint least squares on the training samples (paper, eq. joint_ols), and the comparison."""
    kept: Regression = assembly.regression
    progress("joint least squares on the training samples")
    trial = _trial(assembly, standing)
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


def _propose(
    assembly: Assembly,
    standing: FitState,
    comparison: Comparison,
    number: int,
    progress: Progress,
) -> Step:
    published, trial = _of(assembly.problem), _trial(assembly, standing)
    if not trial.kept:
        return _ended(trial, {}, Judgement((), {}), None)
    log: dict[str, Any] = {}
    for gate in (g for g in published.gates if g.guard):
        progress(f"guard {gate.plugin_name()}")
        judgement = gate.judge(trial)
        log[gate.plugin_name()] = dict(judgement.log)
        if not judgement.kept:
            return _ended(trial, log, judgement, None)
    function = None
    if published.sampling.sampling != "samples":
        function, trial = _learned(assembly, standing, trial, log, progress)
    tests = [g for g in published.gates if not g.guard]
    trial, judgement = through(tests, trial, log, progress)
    if not trial.kept:
        if function is not None and published.library.closure:
            xi = _xi(assembly)
            log["closure"] = closure_log(trial, function.predict(xi))
        return _ended(trial, log, judgement, function)
    return _admission(assembly, standing, trial, log)


def _xi(assembly: Assembly) -> Array:
    kept: Regression = assembly.regression
    return kept.regressor.of(kept.samples.states, kept.samples.inputs)


def _learned(
    assembly: Assembly, standing: FitState, trial: Trial, log: dict[str, Any], progress: Progress
) -> tuple[Learned, Trial]:
    """Steps 2 to 4: learn the residual, and project it onto the library."""
    published, kept = _of(assembly.problem), assembly.regression
    options = published.sampling
    progress(f"learning the residual ({published.learner.plugin_name()})")
    function = learned(
        published.learner, _xi(assembly), trial.residual, trial.train, options.seed, progress
    )
    log["learner"] = {"name": published.learner.plugin_name(), **function.log}
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
    trial: Trial, log: dict[str, Any], judgement: Judgement, function: Learned | None
) -> Step:
    """Nothing admitted: why, in the paper's words and in the contract's."""
    log["ended"] = {
        "reason": judgement.reason or "library_exhausted",
        "text": ENDED[judgement.reason],
    }
    stopped: Stopped = "whiteness" if judgement.reason == "white" else "no_candidate"
    shown = dict(list(judgement.refused.items())[:5])
    return Step((), shown, stopped=stopped, details=log)


def _admission(assembly: Assembly, standing: FitState, trial: Trial, log: dict[str, Any]) -> Step:
    """Terms that passed, as effects of the model with their physical origin."""
    kept: Regression = assembly.regression
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
        suggestions(trial, by_key, aliases),
        {},
        admitted=labels,
        aliases=aliases,
        meaning=meaning,
        details=log,
        found=replace(wider, held=held),
    )


def _owner(key: str) -> str:
    return key.rsplit(".", 1)[0]


def _settle(assembly: Assembly, step: Step, progress: Progress) -> Settled:
    return _refitted(assembly, step.found, progress)


PAPER = Strategy("paper", _begin, _propose, _settle)
