"""Stretches of long records, on which a search is made before the whole records decide.

Which terms a noise model needs, which start leads furthest and which candidate explains most is
told by some thousand samples; values, errors, tests on unseen data and the decision are of the
whole records. Stretches are taken over the range of the readings' energy, the quietest to the
liveliest, so that they show all regimes. There are none where they would not show the motion: where
readings change more from stretch to stretch than within them (a level that follows the day).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.series import Series
from spiral.inference.problem import Problem
from spiral.types.record import Array

# Stretches of so many samples, the first that serves: long ones where a record has long pauses.
_LENGTHS = ((4, 2048), (2, 4096), (1, 8192), (1, 16_384), (1, 32_768))
_WORTH = 2.0  # times the samples of an excerpt that records have at least of which one is made
_WITHIN = 0.5  # share of every reading's variance that stretches show within themselves, at least


class Stretch(NamedTuple):
    """Samples [first, last) of a record, by its place."""

    record: int
    first: int
    last: int


@dataclass(frozen=True)
class Excerpt:
    """What a study of some stretches knows of the whole records.

    Fields
    ------
    problem, series, expected : of the whole records. stretches : of which the study is.
    tasks : filter tasks of the whole records, whose scales of the states are those of the
        stretches: sizes of the noise then mean the same in both.
    states, starts, spreads : names of the states, initial states and spreads of the whole records,
        where a fit has found any.
    """

    problem: Problem
    series: tuple[Series, ...]
    expected: tuple[Array, ...]
    stretches: tuple[Stretch, ...]
    tasks: tuple[FilterInput, ...]
    states: tuple[str, ...]
    starts: tuple[Array, ...] | None
    spreads: tuple[Array, ...] | None

    @property
    def scales(self) -> tuple[FilterInput, ...]:
        """The task of each stretch's record."""
        return tuple(self.tasks[s.record] for s in self.stretches)


def representative_stretches(series: Sequence[Series]) -> tuple[Stretch, ...]:
    """Stretches that stand for the records; none where the records are short or too slow for it."""
    samples = sum(s.samples for s in series)
    for count, length in _LENGTHS:
        if samples < _WORTH * count * length:
            break
        blocks = [
            Stretch(r, first, first + length)
            for r, s in enumerate(series)
            for first in range(0, s.samples - length + 1, length)
        ]
        if len(blocks) < count:
            continue
        variances = np.array([np.var(series[b.record].y[b.first : b.last], axis=0) for b in blocks])
        whole = sum(s.samples * np.var(s.y, axis=0) for s in series) / samples
        if np.all(variances.mean(axis=0) >= _WITHIN * whole):
            order = np.argsort(np.sum(variances / np.maximum(whole, 1e-300), axis=1), kind="stable")
            places = np.linspace(len(blocks) - 1, 0, count).round().astype(int)
            return tuple(sorted(blocks[order[i]] for i in places))
    return ()
