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

from spiral.engine.filter.likelihood import Climbed, Prepared, climbed
from spiral.engine.filter.setup import prepared as filter_prepared
from spiral.engine.filter.task import task_with
from spiral.engine.filter.whitened import Whitened
from spiral.engine.gate import Judgement, Trial, through
from spiral.engine.statistics import whiteness
from spiral.inference.evidence.admission import cannot_be_asked, stepped
from spiral.inference.evidence.assembly import Assembly, Variant, columns, to_model
from spiral.inference.evidence.comparison import compared, prepared, refined
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import tested_keys
from spiral.inference.problem import Problem, Progress
from spiral.inference.strategies.base import Begun, Settled, Step
from spiral.inference.strategy_options import InnovationOptions
from spiral.physics.compile import compile_model
from spiral.types.record import Array
from spiral.types.run import Comparison, Suggestion


@dataclass(frozen=True)
class Offered:
    """Candidates of one round: their variants, one group of columns each, and what they score."""

    variants: tuple[Variant, ...]
    groups: tuple[tuple[int, ...], ...]
    scores: tuple[float, ...]
    energy: float


@dataclass(frozen=True)
class Admission:
    """What a round admits: the state with it, and the refit that its gate asked for, if any."""

    state: FitState
    refit: Climbed | None


def begin(problem: Problem, progress: Progress) -> Begun:
    """The seed at its most likely values and process noise."""
    progress("compiling the model and all candidates")
    settings = replace(problem.settings, phase_knot=0.0)  # the filter tracks the phase itself
    assembly, standing = prepared(replace(problem, settings=settings))
    standing = replace(standing, corrected=False)
    settled = _refitted(assembly, standing, None, progress)
    return Begun(assembly, settled.standing, settled.comparison, settled.details)


def propose(
    options: InnovationOptions,
    assembly: Assembly,
    standing: FitState,
    comparison: Comparison,
    progress: Progress,
) -> Step[Admission]:
    """The candidates scored by the innovations; those that the gates let through."""
    progress("tuning the process noise of the model as it is")
    begun = _prepared(assembly, standing)
    base = climbed(begun, ())
    moving = _moving(assembly, standing)
    absent = _absent(assembly, standing)
    keys = tuple(k for v in absent for k in tested_keys(assembly, v))
    progress(f"scoring {len(absent)} candidates by the innovations")
    parts = base.regression((*moving, *keys)) if base.finite else None
    if parts is None:
        return Step((), {}, stopped="diverged", details={"ended": {"reason": "diverged"}})
    refits: dict[tuple[int, ...], Climbed] = {}

    def gain(group: tuple[int, ...]) -> float:
        chosen = tuple(keys[k] for k in group)
        progress(f"refitting with {chosen[0].rsplit('.', 1)[0]}")
        wider = (*moving, *chosen)
        refits[group] = climbed(begun, wider, None, _bounds(assembly, wider), base.levels)
        rise = 2 * (refits[group].log_likelihood - base.log_likelihood)
        return max(rise, 0.0) if np.isfinite(rise) else 0.0

    trial, offered = _trial(options, assembly, parts, len(moving), absent, keys, gain)
    log: dict[str, Any] = {"process_noise": dict(base.levels)}
    ordered = sorted(options.gate, key=lambda g: not g.guard)
    trial, judgement = through(ordered, trial, log, progress)
    gains = {g: 2 * (c.log_likelihood - base.log_likelihood) for g, c in refits.items()}
    if not trial.kept:
        white = comparison.whiteness_p >= assembly.problem.settings.whiteness_level
        return _ended(options, offered, gains, judgement, white, log)
    return _admission(options, assembly, standing, trial, offered, gains, refits, log)


def _ended(
    options: InnovationOptions,
    offered: Offered,
    gains: Mapping[tuple[int, ...], float],
    judgement: Judgement,
    white: bool,
    log: dict[str, Any],
) -> Step[Admission]:
    """Nothing admitted, and why."""
    log["ended"] = {"reason": judgement.reason or "no_candidate"}
    return Step(
        _suggestions(offered, gains, (), ())[: options.listed],
        dict(list(judgement.refused.items())[: options.listed]),
        stopped="whiteness" if white else "no_candidate",
        details=log,
    )


def _admission(
    options: InnovationOptions,
    assembly: Assembly,
    standing: FitState,
    trial: Trial,
    offered: Offered,
    gains: Mapping[tuple[int, ...], float],
    refits: Mapping[tuple[int, ...], Climbed],
    log: dict[str, Any],
) -> Step[Admission]:
    """The effects whose columns were let through, at the values of their refit."""
    kept = set(trial.kept)
    chosen = [
        (v, g) for v, g in zip(offered.variants, offered.groups, strict=True) if kept & set(g)
    ]
    values = standing.values
    step = trial.fitted(trial.kept).b[trial.active.shape[2] :]
    for variant, group in chosen:
        own = np.array([b for k, b in zip(trial.kept, step, strict=True) if k in group])
        values = stepped(assembly, values, variant, own)
    labels = (*standing.labels, *(v.label for v, _ in chosen))
    wider = replace(standing, labels=labels, values=values)
    near = log.get("innovation", {}).get("alike", ())
    alike = tuple(
        v.original.label
        for v, g in zip(offered.variants, offered.groups, strict=True)
        if trial.names[g[0]] in near
    )
    names = tuple(v.original.label for v, _ in chosen)
    alone = chosen[0][0].companion is None and len(chosen) == 1
    return Step(
        _suggestions(offered, gains, names, alike)[: options.listed],
        log["refused"],
        admitted=names,
        aliases=dict.fromkeys(names, alike),
        meaning="; ".join(v.original.meaning() for v, _ in chosen),
        details=log,
        found=Admission(wider, refits.get(chosen[0][1]) if alone else None),
    )


def settle(assembly: Assembly, step: Step[Admission], progress: Progress) -> Settled:
    """Most likely values and process noise with what was admitted."""
    found = step.needed()
    return _refitted(assembly, found.state, found.refit, progress)


def admit(assembly: Assembly, standing: FitState, label: str, progress: Progress) -> Settled:
    """The same with an effect that a person names, in the shape whose refit is most likely."""
    variants = [v for v in _absent(assembly, standing) if v.original.label == label]
    if not variants:
        raise cannot_be_asked(assembly, label)
    found = [
        _refitted(assembly, replace(standing, labels=(*standing.labels, v.label)), None, progress)
        for v in variants
    ]
    return max(found, key=lambda s: s.details.get("log_likelihood", -np.inf))


def _refitted(
    assembly: Assembly, standing: FitState, found: Climbed | None, progress: Progress
) -> Settled:
    """The most likely model with these effects, compared; whiteness is of its innovations."""
    progress("most likely values and process noise")
    if found is None:
        keys = _moving(assembly, standing)
        found = climbed(_prepared(assembly, standing), keys, bounds=_bounds(assembly, keys))
    parts = found.regression(()) if found.finite else None
    values = standing.values if parts is None else _values(standing, found, parts)
    wider = replace(standing, values=values)
    model = to_model(assembly, wider.labels, values, found.errors, wider.freed)
    finite = parts is not None
    comparison = compared(refined(assembly, wider), wider, model, None, finite, progress)
    if parts is None:
        return Settled(wider, comparison)
    left = tuple(p.innovations for p in parts)
    white = whiteness(left, assembly.problem.settings.lags)
    comparison = replace(comparison, whiteness_p=white.p, whiteness_effect=white.effect)
    nis = float(np.mean([np.mean(np.sum(e**2, axis=1)) for e in left]))
    comparison = replace(comparison, innovation_chi2=nis / left[0].shape[1])
    details = {"log_likelihood": found.log_likelihood, "nis_mean": nis}
    return Settled(wider, comparison, details={**details, "process_noise": dict(found.levels)})


def _values(standing: FitState, found: Climbed, parts: tuple[Whitened, ...]) -> Array:
    """(records, parameters) with each record's own as the filter found them in the end."""
    rows = standing.values.copy()
    for row, (task, settings), part in zip(rows, found.prepared, parts, strict=True):
        row[: len(task.keys)] = task.values
        for place, key in enumerate(settings.tracked):
            row[task.keys.index(key)] = part.found.means[-1, len(task.states) + place]
    return rows


def _prepared(assembly: Assembly, standing: FitState) -> Prepared:
    """Every record's task at the standing's values; what belongs to a record is tracked."""
    model, traced = assembly.problem.model, assembly.study.compiled.traced
    tracked = _tracked(assembly, standing)
    narrow = compile_model(traced, tracked)
    rows = np.ascontiguousarray(standing.values[:, : len(traced.keys)])
    return tuple(
        filter_prepared(task_with(model, narrow, row.copy(), record), tracked)
        for row, record in zip(rows, assembly.problem.records, strict=True)
    )


def _tracked(assembly: Assembly, standing: FitState) -> tuple[str, ...]:
    known = dict(assembly.problem.model.pairs)
    keys = standing.keys(assembly)
    return tuple(k for k in keys if k in known and known[k].scope == "record")


def _moving(assembly: Assembly, standing: FitState) -> tuple[str, ...]:
    """Parameters that the likelihood decides: all that move, but for those that are tracked."""
    tracked = _tracked(assembly, standing)
    return tuple(k for k in standing.keys(assembly) if k not in tracked)


def _bounds(assembly: Assembly, keys: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    _, (low, high) = columns(assembly, keys)
    return {k: (float(a), float(b)) for k, a, b in zip(keys, low, high, strict=True)}


def _absent(assembly: Assembly, standing: FitState) -> tuple[Variant, ...]:
    present = {v.original.label for v in assembly.variants if v.label in standing.labels}
    return tuple(v for v in assembly.variants if v.original.label not in present)


def _trial(
    options: InnovationOptions,
    assembly: Assembly,
    parts: tuple[Whitened, ...],
    active: int,
    absent: tuple[Variant, ...],
    keys: tuple[str, ...],
    gain: Callable[[tuple[int, ...]], float],
) -> tuple[Trial, Offered]:
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
    groups = {v.label: tuple(keys.index(k) for k in tested_keys(assembly, v)) for v in absent}
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
    offered = Offered(chosen, picked, scores, float(np.sum(e**2)))
    return replace(bare, kept=kept, groups=picked), offered


def _suggestions(
    offered: Offered,
    gains: Mapping[tuple[int, ...], float],
    admitted: tuple[str, ...],
    alike: tuple[str, ...],
) -> tuple[Suggestion, ...]:
    """All candidates, those admitted first; by twice the gain in log L where refitted."""
    from scipy import special

    def rank(i: int) -> tuple[bool, float, float]:
        group = offered.groups[i]
        first = offered.variants[i].original.label in admitted
        return first, gains.get(group, 0.0), offered.scores[i]

    found = []
    for i in sorted(range(len(offered.groups)), key=rank, reverse=True):
        effect, group = offered.variants[i].original, offered.groups[i]
        statistic = gains.get(group, offered.scores[i])
        found.append(
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
    return tuple(found)
