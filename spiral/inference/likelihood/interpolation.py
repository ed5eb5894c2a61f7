"""Interpolation of inputs between samples, selected by likelihood where no record declares it.

A force that a controller holds, that was recorded in few points, or that was made in straight lines
is another force between its samples than a smooth curve through them. What the difference does
looks like an actuator that lags or limits its rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.predict import Masks, predict_cases
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    fit_by_likelihood,
    is_random_force_small,
    prepare_filter_tasks,
)
from spiral.inference.problem import DECISIVE_ODDS, Problem, Progress
from spiral.types.parameter import HELD, Input, Interpolation, Ways
from spiral.types.record import Array

_SHOWN = 1.0  # squared change of the whitened misses from which a record can tell two ways apart
_REACH = 0.1  # share of what a way has to gain that it shows to first order
_STAYS = 0.5  # share of an input's samples that are as the one before, from which it is held
_JUMP = 0.1  # of an input's deviation, above which most of its steps are jumps and no rounding


def held_inputs(problem: Problem) -> Ways:
    """Interpolations to begin with: inputs whose records are staircases are held.

    A staircase is mostly as it was at the sample before, and jumps elsewhere. A smooth curve
    through it rings at each jump, and what that does looks like many things that a machine may
    lack. What a record declares, and what the system holds already, stays.
    """
    return {
        known.name: "zero_order"
        for known in problem.model.system.inputs
        if _is_interpolation_open(problem, known)
        and not _declared_ways(problem, known)
        and known.interpolation not in HELD
        and all(
            known.name in r.inputs and _is_staircase(r.inputs[known.name]) for r in problem.records
        )
    }


def _is_staircase(values: Array) -> bool:
    """Whether values stay at most samples, and jump by more than rounding where they do not."""
    steps = np.abs(np.diff(values))
    jumps = steps[steps > 0]
    stays = len(steps) - len(jumps) >= _STAYS * len(steps)
    return bool(len(jumps) and stays and np.median(jumps) > _JUMP * np.std(values))


def select_input_interpolation(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit with the most likely interpolation of every input between its samples.

    For use where no candidate competes with it. The system's own interpolation stays unless
    another is a hundred times as likely and leaves only a small random force: what a model lacks
    makes wrong interpolations likely too.
    """
    for some in _undeclared_input_groups(assembly.problem):
        least = fit.log_likelihood + float(np.log(DECISIVE_ODDS))
        others = _refit_interpolations(assembly, fit, [some], None, least, progress)
        best = max(
            filter(is_random_force_small, others), key=lambda f: f.log_likelihood, default=fit
        )
        fit = best if best.log_likelihood > least else fit
    return fit


def restore_declared_interpolation(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit with the system's own interpolation again, where another is no longer needed."""
    for known in assembly.problem.model.system.inputs:
        if known.name not in fit.state.between:
            continue
        progress(_progress_message((known,)))
        ways = _replace_interpolation(fit, (known,), _own_way(assembly.problem, known))
        state = replace(fit.state, between=ways)
        least = fit.log_likelihood - float(np.log(DECISIVE_ODDS))
        own = fit_by_likelihood(assembly, state, rough=True, least=least)
        fit = own if own.log_likelihood > least else fit
    return fit


def fit_with_other_interpolations(
    assembly: Assembly, fit: LikelihoodFit, state: FitState, least: float, progress: Progress
) -> list[LikelihoodFit]:
    """Fits of ``state`` (for example a fit's own without one effect) with other interpolations.

    Of those alone that to first order gain a tenth of what they have to.

    ``least`` : log-likelihood under which a fit may stop early.
    """
    fits: list[LikelihoodFit] = []
    problem = assembly.problem
    base = fit_by_likelihood(assembly, state, steps=0)
    enough = _REACH * (least - base.log_likelihood)
    for some, ways in _other_interpolations(problem, fit, _undeclared_input_groups(problem)):
        other = replace(state, between=ways)
        shown = _misses_beside(assembly, base, other, None) if base.estimate.finite else None
        if shown is not None and shown.gain < enough:
            continue
        progress(_progress_message(some))
        fits.append(fit_by_likelihood(assembly, other, rough=True, least=least))
    return fits


def likelier_interpolation_fit(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, least: float, progress: Progress
) -> LikelihoodFit | None:
    """The likeliest fit with another input interpolation; nothing where it gains too little.

    It has to gain over ``base`` at least ``least``, the best candidate's gain, and the log odds.
    A random force that had filled in for the wrong interpolation takes long to go: the likeliest
    is fitted on where it is decisively likelier than ``base`` alone.
    """
    odds = float(np.log(DECISIVE_ODDS))
    needed = base.log_likelihood + max(least, odds)
    groups = _undeclared_input_groups(assembly.problem)
    fits = _refit_interpolations(assembly, base, groups, masks, needed, progress)
    best = max(fits, key=lambda f: f.log_likelihood, default=None)
    if best is not None and base.log_likelihood + odds < best.log_likelihood < needed:
        best = fit_by_likelihood(assembly, best.state, best.estimate.noise, masks, rough=True)
    return None if best is None or best.log_likelihood < needed else best


def _undeclared_input_groups(problem: Problem) -> list[tuple[Input, ...]]:
    """Inputs whose interpolation is open (``_is_interpolation_open``): each, then all.

    Inputs from one controller share one interpolation; with the others still wrong, changing one
    alone may look no better.
    """
    known = problem.model.system.inputs
    free = tuple(i for i in known if _is_interpolation_open(problem, i))
    return [*((i,) for i in free), *((free,) if len(free) > 1 else ())]


def _refit_interpolations(
    assembly: Assembly, fit: LikelihoodFit, groups: Sequence[tuple[Input, ...]], masks: Masks,
    least: float, progress: Progress,
) -> list[LikelihoodFit]:  # fmt: skip
    """Fits with each other interpolation of these groups of inputs that may be likelier.

    ``least`` is the log-likelihood under which a fit may stop early.
    """
    fits: list[LikelihoodFit] = []
    others = _other_interpolations(assembly.problem, fit, groups)
    for some, ways in others if fit.estimate.finite else ():
        state = replace(fit.state, between=ways)
        if _may_be_likelier(assembly, fit, state, masks):
            progress(_progress_message(some))
            fits.append(fit_by_likelihood(assembly, state, masks=masks, rough=True, least=least))
    return fits


def _other_interpolations(
    problem: Problem, fit: LikelihoodFit, groups: Sequence[tuple[Input, ...]]
) -> Iterator[tuple[tuple[Input, ...], Ways]]:
    """Each group with the fit's interpolations, the group's set to each that some have not.

    Those that an earlier group has led to are left out.
    """
    seen: list[Ways] = []
    for some in groups:
        for way in get_args(Interpolation):
            if not all(_may_run(problem, known, way) for known in some):
                continue
            ways = _replace_interpolation(fit, some, way)
            if (
                any(way != _current_interpolation(problem, fit, k) for k in some)
                and ways not in seen
            ):
                seen.append(ways)
                yield some, ways


def _progress_message(some: tuple[Input, ...]) -> str:
    return f"trying interpolations of {' and '.join(i.name for i in some)} between samples"


def _is_interpolation_open(problem: Problem, known: Input) -> bool:
    """Whether an input may run another way: of one that is held, how late it acts."""
    closed = _declared_ways(problem, known) - {"zero_order"}
    return not (closed or known.derivative or known.derived_from)


def _declared_ways(problem: Problem, known: Input) -> set[Interpolation]:
    return {r.hold[known.name] for r in (*problem.records, *problem.test) if known.name in r.hold}


def _may_run(problem: Problem, known: Input, way: Interpolation) -> bool:
    """Whether an input may run this way: one that a record declares to be held only so."""
    return way in HELD or not _declared_ways(problem, known)


def _current_interpolation(problem: Problem, fit: LikelihoodFit, known: Input) -> Interpolation:
    return fit.state.between.get(known.name, _own_way(problem, known))


def _own_way(problem: Problem, known: Input) -> Interpolation:
    """The interpolation that a record declares, else the system's."""
    declared = _declared_ways(problem, known)
    return min(declared) if declared else known.interpolation


def _replace_interpolation(fit: LikelihoodFit, some: tuple[Input, ...], way: Interpolation) -> Ways:
    """A fit's interpolations with these inputs changed; the system's own are left out."""
    gone = {i.name for i in some}
    others: dict[str, Interpolation] = {k: w for k, w in fit.state.between.items() if k not in gone}
    others.update((i.name, way) for i in some if way != i.interpolation)
    return others


def _may_be_likelier(assembly: Assembly, fit: LikelihoodFit, other: FitState, masks: Masks) -> bool:
    """Whether another state with the same values and noise misses less, parameters refitted.

    To first order, where the squared changes sum to more than ``_SHOWN``. Also where its filter
    runs away.
    """
    beside = _misses_beside(assembly, fit, other, masks)
    return beside is None or (beside.changed > _SHOWN and beside.gain > 0)


@dataclass(frozen=True)
class _MissesBeside:
    """Another state's whitened misses: squares that changed, and what is gained to first order."""

    changed: float
    gain: float


def _misses_beside(
    assembly: Assembly, fit: LikelihoodFit, other: FitState, masks: Masks
) -> _MissesBeside | None:
    """The misses of another state with the same values and noise; nothing where it runs away.

    Its gain is half the squares of whitened misses that the slopes by the parameters do not
    explain, which it has fewer of.
    """
    at = fit.estimate
    trial = predict_cases([(prepare_filter_tasks(assembly, other), at.noise)])[0]
    if not all(p.whole for p in trial):
        return None
    parts = zip(at.predictions, trial, masks or [None] * len(trial), strict=True)
    rows = [
        np.stack([p.whitened, t.misses * p.weight, *np.moveaxis(p.columns, -1, 0)], axis=-1)[
            slice(None) if mask is None else mask
        ]
        for p, t, mask in parts
    ]
    own, others, *slopes = np.concatenate([r.reshape(-1, r.shape[-1]) for r in rows]).T
    changed = float(np.sum((others - own) ** 2))
    if changed <= _SHOWN:
        return _MissesBeside(changed, 0.0)
    x = np.array([c for c in slopes if np.isfinite(c).all()]).reshape(-1, len(own)).T
    gain = 0.5 * (least_squares(x, own).rss - least_squares(x, others).rss)
    return _MissesBeside(changed, float(gain))
