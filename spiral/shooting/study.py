"""What a fit moves: one compiled model, the records, and a point (values and window starts)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from spiral.compile import Compiled
from spiral.record import Array
from spiral.shooting.series import Series
from spiral.shooting.windows import Layout


@dataclass(frozen=True)
class Study:
    """One compiled model (the seed and all candidates) and the records of one machine."""

    compiled: Compiled
    series: tuple[Series, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """Full names of all parameters, in the order of arrays."""
        return self.compiled.traced.keys

    @property
    def state_count(self) -> int:
        """Number of states."""
        return len(self.compiled.traced.states)

    def index(self, key: str) -> int:
        """Position of a parameter."""
        return self.keys.index(key)


@dataclass(frozen=True)
class Point:
    """Where a fit stands.

    ``values`` (records, parameters): machine parameters are equal in all rows; ``starts``: for
    each record (windows, states), the state at each window's first sample.
    """

    values: Array
    starts: tuple[Array, ...]


@dataclass(frozen=True)
class Columns:
    """The parameters that move: one global column each.

    ``index`` are positions of parameters; ``record`` is the record a column belongs to, or -1
    where all records share it.
    """

    index: Array
    record: Array

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self.index)

    def local(self, record: int) -> Array:
        """Global columns that a record sees."""
        return np.flatnonzero((self.record < 0) | (self.record == record))

    def moved(self, values: Array, step: Array) -> Array:
        """Values after a step in these columns."""
        new = values.copy()
        for column, delta in enumerate(step):
            if self.record[column] < 0:
                new[:, self.index[column]] += delta
            else:
                new[self.record[column], self.index[column]] += delta
        return new

    def current(self, values: Array) -> Array:
        """The present value of each column."""
        return np.array(
            [values[max(r, 0), i] for i, r in zip(self.index, self.record, strict=True)]
        )


def columns_for(study: Study, keys: Iterable[str], shared_origin: bool) -> Columns:
    """Columns for parameters by name: nuisances of a record get one column for each record."""
    index: list[int] = []
    record: list[int] = []
    for key in keys:
        position = study.index(key)
        own = study.compiled.traced.parameters[position].scope == "record" and not shared_origin
        for r in range(len(study.series)) if own else [-1]:
            index.append(position)
            record.append(r)
    return Columns(np.array(index, dtype=np.int64), np.array(record, dtype=np.int64))


def with_starts(point: Point, starts: tuple[Array, ...]) -> Point:
    """The same values with other window starts."""
    return replace(point, starts=starts)


Layouts = tuple[Layout, ...]
