"""Candidates, or directions of them, that the model's own parameters can take over on a record.

A common gain of all sensors and a larger unbalance give one motion; an offset and a constant load
as well. Such a direction has no signature of its own, and no statistic can find it: it is named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.types.record import Array

_ALIKE = 1e-3  # sine of the angle to the model's signatures under which there is nothing to tell
_SHARE = 0.1  # of the largest part in a combination, from which a parameter takes part in it


@dataclass(frozen=True)
class InseparableDirections:
    """What of a group of columns lies in the span of the active ones.

    ``with_`` are the active columns (indices) that take it over; ``held`` those of the group's own
    columns (positions in it) that must stay at zero for the others to be determined; ``whole``
    where nothing is left.
    """

    with_: tuple[int, ...] = ()
    held: tuple[int, ...] = ()
    whole: bool = False


def inseparable_part(triangle: Array, active: int, group: tuple[int, ...]) -> InseparableDirections:
    """The part of a candidate's columns that the model's active columns can imitate.

    Parameters
    ----------
    triangle : R of [active | candidates | residual].
    active : number of active columns. group : columns of the candidate, counted from there.
    """
    at = active + np.array(group, dtype=np.int64)
    own = _unit_columns(triangle[:, at])
    if not np.any(own):
        return InseparableDirections()
    left = own[active:]
    free = _independent_columns(left)
    if len(free) == len(at):
        return InseparableDirections()
    held = tuple(i for i in range(len(at)) if i not in free)
    _, sizes, right = np.linalg.svd(left, full_matrices=True)
    null = right[int(np.sum(sizes > _ALIKE)) :]
    taking: set[int] = set()
    model = _unit_columns(triangle[:active, :active])
    for direction in null:
        parts, *_ = np.linalg.lstsq(model, own[:active] @ direction, rcond=1e-10)
        size = np.abs(parts)
        if len(size) and size.max() > _ALIKE:
            taking.update(int(i) for i in np.flatnonzero(size > _SHARE * size.max()))
    return InseparableDirections(tuple(sorted(taking)), held, not free)


def _unit_columns(columns: Array) -> Array:
    """The columns at length one; those of nothing as they are."""
    norms = np.linalg.norm(columns, axis=0)
    return columns / np.where(norms == 0, 1.0, norms)


def _independent_columns(columns: Array) -> list[int]:
    """Columns that add a direction to those before them."""
    kept: list[int] = []
    basis = np.zeros((len(columns), 0))
    for i, column in enumerate(columns.T):
        rest = column - basis @ (basis.T @ column)
        size = float(np.linalg.norm(rest))
        if size > _ALIKE:
            kept.append(i)
            basis = np.column_stack([basis, rest / size])
    return kept
