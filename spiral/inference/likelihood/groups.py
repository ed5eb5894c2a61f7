"""Candidates that the records do not tell apart, and which of them is named first."""

from __future__ import annotations

import numpy as np

from spiral.engine.likelihood.predict import log_likelihood
from spiral.inference.likelihood.candidates import Rival
from spiral.types.effect import SensorEffect


def alike(rivals: list[Rival], odds: float) -> tuple[str, ...]:
    """Rivals that the whole records do not tell from the first one: less than ``odds`` to one."""
    first, *others = rivals

    def worth(rival: Rival) -> float:
        return log_likelihood(rival.fit.estimate.parts) - (rival.gain - rival.worth)

    near = [r for r in others if worth(first) - worth(r) < np.log(odds)]
    return tuple(dict.fromkeys(r.label for r in near if r.label != first.label))


def plainest(
    rival: Rival, aliases: tuple[str, ...], rivals: list[Rival]
) -> tuple[Rival, tuple[str, ...]]:
    """The plainest of a group that the records do not tell apart, and the rest of it.

    A change of the machine comes before one of a sensor, then one of few parameters: an actuator
    that limits its rate far beyond what it is asked for is one that lags.
    """
    group = [rival, *(next(r for r in rivals if r.label == x) for x in aliases)]

    def order(one: Rival) -> tuple[bool, int]:
        effect = one.ranked.variant.original
        return isinstance(effect, SensorEffect), len(effect.parameters)

    chosen = min(group, key=order)
    return chosen, tuple(r.label for r in group if r is not chosen)
