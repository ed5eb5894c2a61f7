"""Candidates that the records do not tell apart, and which of them is named first."""

from __future__ import annotations

import numpy as np

from spiral.engine.likelihood.predict import log_likelihood
from spiral.inference.likelihood.candidates import Rival
from spiral.types.effect import SensorEffect
from spiral.types.label import make_label

_TWIN = 0.98  # share of the gain from which one that should do the same does


def alike(rivals: list[Rival], odds: float) -> tuple[str, ...]:
    """Rivals that the whole records do not tell from the first one: less than ``odds`` to one.

    The price of their numbers counts, but not of a sensor's beside a change of the machine: it has
    a number for every channel, and still it may be the sensors.
    """
    first, *others = rivals
    near = [r for r in others if lead(first, r) < np.log(odds)]
    return tuple(dict.fromkeys(r.label for r in near if r.label != first.label))


def lead(first: Rival, other: Rival) -> float:
    """By how much the first is more likely on the whole records, beyond its numbers' price."""
    likely = _height(first) - _height(other)
    if _of_sensors(other) and not _of_sensors(first):
        return likely
    return likely - _price(first) + _price(other)


def _height(rival: Rival) -> float:
    return log_likelihood(rival.fit.estimate.parts)


def _price(rival: Rival) -> float:
    return rival.gain - rival.worth


def _of_sensors(rival: Rival) -> bool:
    return isinstance(rival.ranked.variant.original, SensorEffect)


def twins(chosen: Rival, rivals: list[Rival]) -> tuple[str, ...]:
    """Rivals elsewhere that do the same as the chosen one, and explain nearly as much."""
    names = chosen.ranked.variant.original.twins
    near = [r for r in rivals if r.gain > _TWIN * chosen.gain]
    return tuple(r.label for r in near if r.ranked.variant.original.plugin_name() in names)


def plainest(
    rival: Rival, aliases: tuple[str, ...], rivals: list[Rival]
) -> tuple[Rival, tuple[str, ...]]:
    """The plainest of a group that the records do not tell apart, and the rest of it.

    A change of the machine comes before one of a sensor, then one of few parameters, then a special
    case of another: an actuator that limits its rate far beyond what it is asked for is one that
    lags, and a loss that differs by direction, of what flows one way only, is a linear one.
    """
    group = [rival, *(next(r for r in rivals if r.label == x) for x in aliases)]

    special = {make_label(x, e.port) for e in (r.ranked.variant.original for r in group)
               for x in e.special}  # fmt: skip

    def order(one: Rival) -> tuple[bool, int, bool]:
        effect = one.ranked.variant.original
        return _of_sensors(one), len(effect.parameters), one.label not in special

    chosen = min(group, key=order)
    return chosen, tuple(r.label for r in group if r is not chosen)
