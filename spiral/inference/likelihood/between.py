"""How inputs run between their samples, where no record says: the likelihood decides.

A force that a controller holds, that was recorded in few points, or that was made in straight lines
is another force between its samples than a smooth curve through them. What the difference does
looks like an actuator that lags or limits its rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import get_args

import numpy as np

from spiral.engine.likelihood.predict import Masks, all_predicted
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.fitting import LikelihoodFit, explains, refitted, subjects
from spiral.inference.problem import Problem, Progress
from spiral.types.parameter import Input, Interpolation

Ways = Mapping[str, Interpolation]

_ODDS = 100.0  # to one, for which an input runs in another way than its system says
_SHOWN = 1.0  # squared change of the whitened misses from which a record can tell two ways apart


def with_likely_inputs(
    assembly: Assembly, found: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit with every input run between its samples in the way that is most likely.

    Asked where no candidate can be held against it. The system's own way stands unless another is
    a hundred times as likely and the model explains the records with it: what a model lacks makes
    wrong ways likely too.
    """
    for some in _together(assembly.problem):
        least = found.height + float(np.log(_ODDS))
        others = _others(assembly, found, some, None, least, progress)
        best = max(filter(explains, others), key=lambda f: f.height, default=found)
        found = best if best.height > least else found
    return found


def with_own_inputs(assembly: Assembly, found: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """The fit with inputs run as their system says again, where another way is not needed now."""
    for known in assembly.problem.model.system.inputs:
        if known.name not in found.state.between:
            continue
        progress(_asking((known,)))
        state = replace(found.state, between=_with(found, (known,), known.interpolation))
        least = found.height - float(np.log(_ODDS))
        own = refitted(assembly, state, rough=True, least=least)
        found = own if own.height > least else found
    return found


def run_otherwise(
    assembly: Assembly, found: LikelihoodFit, state: FitState, least: float, progress: Progress
) -> list[LikelihoodFit]:
    """Fits of another state than a fit's own (of one with an effect less), inputs run otherwise.

    ``least`` : log-likelihood from which they are of use.
    """
    fits: list[LikelihoodFit] = []
    for some in _together(assembly.problem):
        for ways in _other_ways(found, some):
            progress(_asking(some))
            other = replace(state, between=ways)
            fits.append(refitted(assembly, other, rough=True, least=least))
    return fits


def likelier_inputs(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, least: float, progress: Progress
) -> LikelihoodFit | None:
    """The fit with inputs run in another way, where that makes most of the samples that count.

    ``least`` : log-likelihood that something else (a candidate) makes of them.
    """
    needed = base.height + max(least, float(np.log(_ODDS)))
    fits = [
        fit
        for some in _together(assembly.problem)
        for fit in _others(assembly, base, some, masks, needed, progress)
    ]
    best = max(fits, key=lambda f: f.height, default=None)
    return None if best is None or best.height < needed else best


def _together(problem: Problem) -> list[tuple[Input, ...]]:
    """Inputs whose way no record declares and that nothing follows from: each, then all at once.

    What one controller gives runs in one way; beside another input that runs otherwise none of them
    may look right alone.
    """
    known = problem.model.system.inputs
    free = tuple(i for i in known if _open(problem, i))
    return [*((i,) for i in free), *((free,) if len(free) > 1 else ())]


def _others(
    assembly: Assembly, found: LikelihoodFit, some: tuple[Input, ...], masks: Masks,
    least: float, progress: Progress,
) -> list[LikelihoodFit]:  # fmt: skip
    """Fits with inputs run in each other way that changes what is predicted.

    A way is fitted where it changes the whitened misses, in squares and summed, by one; ``least``
    is the log-likelihood from which it is of use.
    """
    fits: list[LikelihoodFit] = []
    for ways in _other_ways(found, some) if found.estimate.finite else ():
        state = replace(found.state, between=ways)
        if _differs(assembly, found, state):
            progress(_asking(some))
            fits.append(refitted(assembly, state, masks=masks, rough=True, least=least))
    return fits


def _other_ways(found: LikelihoodFit, some: tuple[Input, ...]) -> Iterator[Ways]:
    """The ways of a fit with these inputs run in each way that one of them has not."""
    for way in get_args(Interpolation):
        if any(way != _way(found, known) for known in some):
            yield _with(found, some, way)


def _asking(some: tuple[Input, ...]) -> str:
    return f"asking how {' and '.join(i.name for i in some)} run between samples"


def _open(problem: Problem, known: Input) -> bool:
    declared = any(known.name in r.hold for r in (*problem.records, *problem.test))
    return not (declared or known.derivative or known.derived_from)


def _way(found: LikelihoodFit, known: Input) -> Interpolation:
    return found.state.between.get(known.name, known.interpolation)


def _with(found: LikelihoodFit, some: tuple[Input, ...], way: Interpolation) -> Ways:
    """The ways of a fit with these; the system's own need not be told."""
    gone = {i.name for i in some}
    others: dict[str, Interpolation] = {
        k: w for k, w in found.state.between.items() if k not in gone
    }
    others.update((i.name, way) for i in some if way != i.interpolation)
    return others


def _differs(assembly: Assembly, found: LikelihoodFit, other: FitState) -> bool:
    """Whether the same values and noise predict otherwise, by more than the records' noise."""
    at = found.estimate
    trial = all_predicted([(subjects(assembly, other), at.noise)])[0]
    if not all(p.whole for p in trial):
        return True
    changes = ((t.misses - p.misses) * p.weight for p, t in zip(at.parts, trial, strict=True))
    return sum(float(np.sum(c**2)) for c in changes) > _SHOWN
