"""A large random force on hidden states told from a smaller one with a memory on one state.

A white force on a state that no sensor sees reaches the readings through the machine, and is
coloured there. A force with a correlation time on a state that is measured looks the same: misses
are white with either. The first may have to be as large as the machine's own forces where the
second is small; so where a fit ends with a force that is no explanation, the second is tried.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spiral.engine.filter.noise import groups
from spiral.engine.filter.task import Task
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    is_white,
    largest_force,
    price,
    taken_on,
)
from spiral.inference.likelihood.ladder import ODDS, first_gusts, shared_groups, tuned
from spiral.inference.problem import Progress

_FITTED = 2  # models of the noise that are fitted together with the parameters


def with_smaller_forces(
    assembly: Assembly, found: LikelihoodFit, progress: Progress
) -> LikelihoodFit | None:
    """The fit with one force with a memory in place of those above ``settings.random_limit``.

    Of the groups of states, and of single states, the likeliest. It is taken where it is below that
    limit, leaves white misses, and the odds against it are less than 100 to one once all numbers
    are paid for. Nothing where no force is as large, or none is taken.
    """
    limit, at = assembly.problem.settings.random_limit, found.estimate
    if not at.finite or not largest_force(at.noise) > limit:
        return None
    progress("asking whether a smaller random force with a memory explains as much")
    noises = list(_smaller(at.prepared[0][0], at.noise, limit))
    looks = sorted((tuned(at.prepared, n) for n in noises), key=lambda m: -m.log_likelihood)
    best: LikelihoodFit | None = None
    for look in looks[:_FITTED]:
        trial = taken_on(assembly, found, look.noise, rough=True) if look.finite else found
        more = price(len(trial.estimate.noise.names) - len(at.noise.names), at.prepared)
        likely = trial.height - more > found.height - np.log(ODDS)
        small = largest_force(trial.estimate.noise) <= limit
        if not (likely and small and is_white(assembly, trial)):
            continue
        if best is None or trial.height > best.height:
            best = trial
    return best


def _smaller(task: Task, noise: NoiseModel, limit: float) -> Iterator[NoiseModel]:
    """The noise with one force with a memory in place of large forces and all that have one."""
    kept = noise.of(
        t for t in noise.terms
        if t.kind != "gust" and not (t.kind == "force" and noise.values[t.size] > limit)
    )  # fmt: skip
    states = (task.states[i] for s in shared_groups(task).values() for i in s)
    for where in (*groups(task), *states):
        one = NoiseTerm("gust", where)
        for values in first_gusts(task, (one,)):
            yield kept.added((one,), values)
