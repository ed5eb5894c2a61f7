"""The inputs of a fit: one compiled model, the records, and a point (values, window starts)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from spiral.engine.series import Series, rows_at_stages
from spiral.engine.windows import WindowLayout
from spiral.physics.compile import CompiledModel
from spiral.types.label import owner_of, parameter_of
from spiral.types.record import Array

CORRECTION = "phase_correction"
ORIGIN = "system.phase_origin"


@dataclass(frozen=True)
class CompiledStudy:
    """One compiled model (the seed and all candidates) and the records of one machine."""

    compiled: CompiledModel
    series: tuple[Series, ...]

    @property
    def keys(self) -> tuple[str, ...]:
        """Full names of all parameters, in the order of arrays."""
        return self.compiled.traced.keys

    @property
    def state_count(self) -> int:
        """Number of states."""
        return len(self.compiled.traced.states)

    @property
    def own(self) -> Array:
        """Positions of the states that effects bring."""
        names = self.compiled.traced.states
        return np.array([i for i, n in enumerate(names) if "." in n], dtype=np.int64)

    @property
    def corrections(self) -> int:
        """Coefficients of the phase correction that follow the parameters in arrays of values."""
        return max(s.splines.count for s in self.series)

    @property
    def correction_keys(self) -> tuple[str, ...]:
        """Names of the coefficients of the phase correction."""
        return tuple(f"{CORRECTION}.{k}" for k in range(self.corrections))

    @property
    def phase(self) -> Array:
        """Position of the phase origin and number of parameters, as the integrator wants them."""
        position = self.keys.index(ORIGIN) if ORIGIN in self.keys else 0
        return np.array([position, len(self.keys)], dtype=np.int64)

    def index(self, key: str) -> int:
        """Position of a parameter, or of a coefficient of the phase correction."""
        if key.startswith(f"{CORRECTION}."):
            return len(self.keys) + int(parameter_of(key))
        return self.keys.index(key)

    def inputs(self, record: int, row: Array) -> Array:
        """Inputs of a record as of ``stage_inputs``, its phase corrected by a row of values."""
        series = self.series[record]
        if not series.splines.count:
            return series.inputs
        corrected = series.inputs.copy()
        position = self.compiled.traced.inputs.index("phase")
        corrected[:, position] += rows_at_stages(series.splines.value(row[len(self.keys) :]))
        return corrected


@dataclass(frozen=True)
class Point:
    """Parameter values and window starts of a fit.

    ``values`` (records, parameters): machine parameters are equal in all rows; ``starts``: for
    each record (windows, states), the state at each window's first sample.
    """

    values: Array
    starts: tuple[Array, ...]

    def check_study(self, study: CompiledStudy) -> None:
        """Raise for a point of another study: compiled loops check no array bounds.

        Raises
        ------
        ValueError : other numbers of records or states, or too few parameters.
        """
        (records, count), states = self.values.shape, {x.shape[1] for x in self.starts}
        wanted, known = len(study.series), len(study.keys)
        if records != wanted or count < known or states - {study.state_count}:
            raise ValueError(
                f"a point of {records} records, {count} values and {sorted(states)} states in a "
                f"study of {wanted}, {known} and {study.state_count}"
            )


@dataclass(frozen=True)
class ParameterColumns:
    """The parameters that move: one global column each.

    ``index`` are positions of parameters; ``record`` is the record a column belongs to, or -1
    where all records share it; ``width`` the standard deviation with which each is held at zero
    (infinite: not at all; none given: none is).
    """

    index: Array
    record: Array
    width: Array | None = None

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self.index)

    def local(self, record: int) -> Array:
        """Global columns that a record sees."""
        return np.flatnonzero((self.record < 0) | (self.record == record))

    def apply_step(self, values: Array, step: Array) -> Array:
        """Values after a step in these columns."""
        new = values.copy()
        for column, delta in enumerate(step):
            if self.record[column] < 0:
                new[:, self.index[column]] += delta
            else:
                new[self.record[column], self.index[column]] += delta
        return new

    def average_shared_values(self, values: Array) -> Array:
        """Values (records, keys) with one value, the records' mean, where all share a column.

        A step moves all rows of a shared column alike: rows which begin apart would stay apart.
        """
        new = values.copy()
        shared = self.index[self.record < 0]
        new[:, shared] = values[:, shared].mean(axis=0)
        return new

    def prior(self, values: Array) -> Array:
        """Rows [J | r] of the Gaussian prior at zero on columns of finite ``width``."""
        held = np.zeros(0, dtype=np.int64)
        if self.width is not None:
            held = np.flatnonzero(np.isfinite(self.width))
        rows = np.zeros((len(held), self.count + 1))
        if self.width is not None:
            rows[np.arange(len(held)), held] = 1.0 / self.width[held]
            rows[:, -1] = -self.current(values)[held] / self.width[held]
        return rows

    def current(self, values: Array) -> Array:
        """The present value of each column."""
        return np.array(
            [values[max(r, 0), i] for i, r in zip(self.index, self.record, strict=True)]
        )


def columns_for(study: CompiledStudy, keys: Iterable[str], shared_origin: bool) -> ParameterColumns:
    """Columns for parameters by name: nuisances of a record get one column for each record."""
    keys = tuple(keys)
    corrected = any(k.startswith(f"{CORRECTION}.") for k in keys)
    index: list[int] = []
    record: list[int] = []
    for key in keys:
        position = study.index(key)
        if position >= len(study.keys):
            number = position - len(study.keys)
            having = [r for r, s in enumerate(study.series) if number < s.splines.count]
            index += [position] * len(having)
            record += having
            continue
        own = study.compiled.traced.parameters[position].scope == "record"
        own = own and not (shared_origin and key == ORIGIN)
        for r in range(len(study.series)) if own else [-1]:
            if own and corrected and position == study.phase[0] and study.series[r].splines.count:
                continue  # the record's correction holds its origin as well
            index.append(position)
            record.append(r)
    return ParameterColumns(np.array(index, dtype=np.int64), np.array(record, dtype=np.int64))


Layouts = tuple[WindowLayout, ...]


def column_owner(key: str) -> str:
    """The label of the effect that a column belongs to; the phase origin is the unbalance's."""
    return "unbalance" if key == ORIGIN else owner_of(key)
