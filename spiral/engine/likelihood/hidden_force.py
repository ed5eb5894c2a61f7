"""The largest random force that records would not show, and its effect on a free run.

A force too small to be told from none still carries whatever a machine integrates. With l the level
of the white force on a group of states, all else at its most likely values, it may be as large as

    log L(l) = log L(best) - 2

(one in forty, one-sided; Wilks). What it adds to a free run's variance is a doubt like that of the
parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.free_spread import free_spread
from spiral.engine.likelihood.noise import OWN, NoiseModel
from spiral.engine.likelihood.predict import total_log_likelihood
from spiral.types.record import Array

_FALL = 2.0  # of log L
_FIRST, _FACTOR = 1e-4, 3.0  # least level that is tried, and from one to the next


def larger_forces(at: MaximumLikelihood) -> tuple[NoiseModel, ...]:
    """The noise with each white force as large as the records would not show, the others kept.

    Without forces that are as large already.
    """
    forces = (t.size for t in at.noise.terms if t.kind == "force")
    levels = ((size, _largest_level(at, size)) for size in forces)
    return tuple(
        at.noise.with_values({size: level})
        for size, level in levels
        if level > at.noise.values[size]
    )


def hidden_force_spread(
    task: FilterInput, settings: FilterSettings, known: Array, larger: Sequence[NoiseModel]
) -> Array:
    """(samples, channels) that ``larger_forces`` may add to a spread ``known`` of a free run."""
    most = np.zeros_like(known)
    for other in larger:
        most = np.maximum(most, free_spread(task, settings, other).rms ** 2 - known**2)
    return np.sqrt(most)


def _largest_level(at: MaximumLikelihood, size: str) -> float:
    """The largest level of one force that costs no more than ``_FALL``."""
    known, lost = at.noise.values[size], 0.0
    level = max(known, _FIRST / _FACTOR)
    while level < OWN:
        further = min(level * _FACTOR, OWN)
        fell = at.log_likelihood - total_log_likelihood(
            at.prepared, at.noise.with_values({size: further})
        )
        if fell > _FALL:
            way = (_FALL - lost) / (fell - lost)
            return float(max(known, level * (further / level) ** way))
        level, lost = further, max(fell, 0.0)
    return float(max(known, OWN))
