"""The largest random force that records would not show, and what it makes of a free run.

A force too small to be told from none still carries whatever a machine integrates. With l the level
of the white force on a group of states, all else at its most likely values, it may be as large as

    log L(l) = log L(best) - 2

(one in forty, one-sided; Wilks). What it adds to a free run's variance is a doubt like that of the
parameters.
"""

from __future__ import annotations

import numpy as np

from spiral.engine.likelihood.fit import Maximum
from spiral.engine.likelihood.free_spread import free_spread
from spiral.engine.likelihood.noise import OWN
from spiral.engine.likelihood.predict import likelihood_of
from spiral.types.record import Array

_FALL = 2.0  # of log L
_FIRST, _FACTOR = 1e-4, 3.0  # least level that is tried, and from one to the next


def hidden_force_spread(at: Maximum, samples: int) -> Array:
    """(channels,) rms of a free run of so many samples that larger forces may add.

    At most as much as two motions differ that know nothing of one another.
    """
    task, settings = at.prepared[0]
    known = free_spread(task, settings, at.noise, samples) ** 2
    most = np.zeros_like(known)
    for term in (t for t in at.noise.terms if t.kind == "force"):
        larger = at.noise.with_values({term.size: _largest(at, term.size)})
        spread = free_spread(task, settings, larger, samples)
        more = np.where(np.isfinite(known), spread**2 - known, 0.0)
        most = np.maximum(most, more)
    return np.minimum(np.sqrt(most), np.sqrt(2.0) * task.series.deviations)


def _largest(at: Maximum, size: str) -> float:
    """The largest level of one force that costs no more than ``_FALL``."""
    known, lost = at.noise.values[size], 0.0
    level = max(known, _FIRST / _FACTOR)
    while level < OWN:
        further = min(level * _FACTOR, OWN)
        fell = at.log_likelihood - likelihood_of(at.prepared, at.noise.with_values({size: further}))
        if fell > _FALL:
            way = (_FALL - lost) / (fell - lost)
            return float(max(known, level * (further / level) ** way))
        level, lost = further, max(fell, 0.0)
    return float(max(known, OWN))
