"""Candidates that the records cannot distinguish, and which of them is named first."""

from __future__ import annotations

import numpy as np

from spiral.engine.likelihood.predict import log_likelihood
from spiral.inference.likelihood.candidates import Rival
from spiral.types.effect import SensorEffect, is_other_value
from spiral.types.label import make_label

TWIN = 0.98  # share of the gain from which a declared twin counts as one


def indistinguishable_rivals(rivals: list[Rival], odds: float) -> tuple[str, ...]:
    """Effects that the whole records do not distinguish from the first rival's by ``odds`` to one.

    Schwarz's penalty counts, but not that of a sensor effect beside a change of the machine: it
    has parameters for every channel, and still it may be the sensors.
    """
    first, *others = rivals
    near = [r for r in others if log_likelihood_lead(first, r) < np.log(odds)]
    return tuple(dict.fromkeys(r.label for r in near if r.label != first.label))


def log_likelihood_lead(first: Rival, other: Rival) -> float:
    """Lead of the first in log-likelihood on the whole records, less its additional penalty."""
    likely = _log_likelihood_of(first) - _log_likelihood_of(other)
    if _is_sensor_effect(other) and not _is_sensor_effect(first):
        return likely
    return likely - _rival_penalty(first) + _rival_penalty(other)


def _log_likelihood_of(rival: Rival) -> float:
    return log_likelihood(rival.fit.estimate.predictions)


def _rival_penalty(rival: Rival) -> float:
    return rival.gain - rival.worth


def _is_sensor_effect(rival: Rival) -> bool:
    return isinstance(rival.ranked.variant.original, SensorEffect)


def twin_rivals(chosen: Rival, rivals: list[Rival]) -> tuple[str, ...]:
    """Rivals declared as the chosen one's twins (``Effect.twins``) that explain nearly as much."""
    names = chosen.ranked.variant.original.twins
    near = [r for r in rivals if r.gain > TWIN * chosen.gain]
    return tuple(r.label for r in near if r.ranked.variant.original.plugin_name() in names)


def simplest_rival(
    rival: Rival, aliases: tuple[str, ...], rivals: list[Rival]
) -> tuple[Rival, tuple[str, ...]]:
    """The simplest of a group that the records cannot distinguish, and the labels of the others.

    A change of the machine comes before one of a sensor, then one of few parameters, then a special
    case of another: an actuator that limits its rate far beyond what it is asked for is one that
    lags, and a loss that differs by direction, of what flows one way only, is a linear one. Last
    comes that a known parameter is not as it was given.
    """
    group = [rival, *(next(r for r in rivals if r.label == x) for x in aliases)]

    special = {make_label(x, e.port) for e in (r.ranked.variant.original for r in group)
               for x in e.special}  # fmt: skip

    def complexity(one: Rival) -> tuple[bool, bool, int, bool]:
        effect = one.ranked.variant.original
        doubted = is_other_value(effect)  # what was given is trusted
        return doubted, _is_sensor_effect(one), len(effect.parameters), one.label not in special

    chosen = min(group, key=complexity)
    return chosen, tuple(r.label for r in group if r is not chosen)
