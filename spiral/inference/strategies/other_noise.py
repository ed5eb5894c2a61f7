"""Another model of what is random, where nothing that is missing explains what is left.

Noise may grow with its reading; and a random force that is no explanation may be one with a memory,
smaller and on one state alone.
"""

from __future__ import annotations

from dataclasses import replace

from spiral.inference.evidence.assembly import Assembly, with_records
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.departures import growths
from spiral.inference.likelihood.fitting import (
    WORTH,
    LikelihoodFit,
    explains,
    is_white,
    largest_force,
    refitted,
)
from spiral.inference.likelihood.smaller_forces import with_smaller_forces
from spiral.inference.likelihood.starts import best_fit
from spiral.inference.problem import Progress
from spiral.inference.strategies.admission import finished, settled_on
from spiral.inference.strategies.base import Settled


def counted(
    assembly: Assembly, found: LikelihoodFit, progress: Progress
) -> tuple[Assembly, LikelihoodFit] | None:
    """A study and fit in which readings count by such noise; nothing where it is not likelier.

    What a model lacks makes misses grow with the motion too, but leaves them coloured: they must be
    white with such noise, and no large random force be wanted.
    """
    growth = growths(found.estimate)
    if not growth or any(r.growth for r in assembly.problem.records):
        return None
    progress("fitting with noise that grows with its reading")
    problem = assembly.problem.with_growth(growth)
    other = with_records(assembly, problem.records, assembly.study.series[0].substeps)
    other = replace(other, problem=problem)
    begun = replace(found.state, noise=None, starts=None, spreads=None)
    grown = finished(other, best_fit(other, begun, progress), progress)
    better = grown.height > found.height + WORTH
    return (other, grown) if better and explains(grown) and is_white(other, grown) else None


def settled_with_growth(
    assembly: Assembly, state: FitState, base: LikelihoodFit, progress: Progress
) -> Settled | None:
    """The model as it is with such noise; ``base`` is its fit to a part of the samples."""
    if not growths(base.estimate):
        return None
    found = counted(assembly, refitted(assembly, state, rough=True), progress)
    if found is None:
        return None
    other, grown = found
    return settled_on(other, grown, progress)


def settled_with_smaller_forces(
    assembly: Assembly, state: FitState, progress: Progress
) -> Settled | None:
    """The model as it is, beside forces with a memory where those it has are too large to explain.

    Nothing where they are not, or where the record does not have it so.
    """
    limit = assembly.problem.settings.random_limit
    if state.noise is None or not largest_force(state.noise) > limit:
        return None
    found = with_smaller_forces(assembly, refitted(assembly, state, rough=True), progress)
    if found is None:
        return None
    found = finished(assembly, found, progress)
    if largest_force(found.estimate.noise) > limit:
        return None
    return settled_on(assembly, found, progress)
