"""Records from CSV files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from spiral.errors import ConfigError, InputError, did_you_mean
from spiral.files import Table, read_table
from spiral.record import Array, Record, make_record
from spiral.source import Source
from spiral.system import System
from spiral.units import factor

_TIME_COLUMNS = ("time", "t")


class Csv(Source):
    """Columns of one or several CSV files: a line of names, then rows of numbers.

    Fields
    ------
    path : a file, or a list of files of one machine; also looked for under ``SPIRAL_DATA``.
    time : the column of time in s; or rate : samples per s where there is none.
    channels, inputs : the system's name -> the file's column; names that agree may be left out.
    units : name of a channel or input (or ``time``) -> its unit in the file.
    rows : [start, stop], zero-based data rows, stop excluded.
    noise : channel -> standard deviation in the system's unit, where it is known.
    offset : name -> what the instrument reads at rest, in the file's unit; it is subtracted.
    separator, decimal : how the file writes columns and fractions.
    """

    path: str | tuple[str, ...] | None = None
    time: str | None = None
    rate: float | None = None
    channels: Mapping[str, str] | None = None
    inputs: Mapping[str, str] | None = None
    units: Mapping[str, str] | None = None
    rows: tuple[int, int] | None = None
    noise: Mapping[str, float] | None = None
    offset: Mapping[str, float] | None = None
    separator: str = ","
    decimal: str = "."

    def __post_init__(self) -> None:
        if self.time is not None and self.rate is not None:
            raise ConfigError(
                f"both record.time={self.time!r} and record.rate={self.rate:g}",
                "one of them",
                "give the rate only where the file has no column of time",
            )
        if self.rate is not None and not (np.isfinite(self.rate) and self.rate > 0):
            raise ConfigError(f"record.rate={self.rate!r}", "samples per second, above zero")

    def as_test(self) -> Source:
        """The same columns and units; rows are the test's own."""
        return replace(self, rows=None)

    def load(self, system: System) -> tuple[Record, ...]:
        """One record for each file."""
        if not self.path:
            raise ConfigError("record=csv without a file", "record.path=FILE", "record.path=a.csv")
        paths = [self.path] if isinstance(self.path, str) else list(self.path)
        return tuple(self._one(system, path) for path in paths)

    def _one(self, system: System, path: str) -> Record:
        table = read_table(path, self.separator, self.decimal)
        start, stop = self._range(table)
        channels = self._mapped(table, "channels", system.observed, required=system.observed)
        driving = [i.name for i in system.inputs if i.derived_from is None]
        known = tuple(i.name for i in system.inputs)
        inputs = self._mapped(table, "inputs", known, required=tuple(driving))
        scale = self._scales(system, (*channels, *inputs))
        offset = self._offsets((*channels, *inputs))
        name = Path(path).name + (f" rows [{start}, {stop})" if self.rows else "")

        def values(columns: Mapping[str, str], option: str) -> dict[str, Array]:
            return {
                k: scale.get(k, 1.0)
                * (table.column(c, f"record.{option} {k}", start, stop) - offset.get(k, 0.0))
                for k, c in columns.items()
            }

        return make_record(
            system,
            name,
            self._time(table, start, stop) * scale.get("time", 1.0),
            values(channels, "channels"),
            values(inputs, "inputs"),
            dict(self.noise or {}),
        )

    def _offsets(self, names: tuple[str, ...]) -> dict[str, float]:
        given = dict(self.offset or {})
        for name, value in given.items():
            if name not in names:
                raise InputError(
                    f"record.offset names {name!r}",
                    f"a channel or input of this record: {', '.join(names)}",
                    did_you_mean(name, names),
                )
            if not np.isfinite(value):
                raise InputError(f"record.offset of {name!r}: {value}", "a finite number")
        return given

    def _range(self, table: Table) -> tuple[int, int]:
        if self.rows is None:
            return 0, table.rows
        start, stop = self.rows
        if not 0 <= start < stop <= table.rows:
            raise InputError(
                f"record.rows=[{start}, {stop}] of {table.name}",
                f"0 <= start < stop <= {table.rows}, the number of its data rows",
                f"for instance record.rows='[0,{table.rows}]'",
            )
        return start, stop

    def _time(self, table: Table, start: int, stop: int) -> Array:
        if self.rate is not None:
            return np.arange(stop - start) / self.rate
        if self.time is not None:
            return table.column(self.time, "record.time", start, stop)
        for name in _TIME_COLUMNS:
            if name in table.columns:
                return table.column(name, "record.time", start, stop)
        raise InputError(
            f"{table.name}: no column of time among {', '.join(table.columns[:12])}",
            "its name, or the sample rate",
            "record.time=COLUMN, or record.rate=SAMPLES_PER_SECOND",
        )

    def _mapped(
        self, table: Table, option: str, known: tuple[str, ...], required: tuple[str, ...]
    ) -> dict[str, str]:
        """Name -> column: as configured, else columns with the system's own names."""
        given: Mapping[str, str] | None = getattr(self, option)
        if given is None:
            return {n: n for n in known if n in table.columns or n in required}
        for name in given:
            if name not in known:
                raise InputError(
                    f"record.{option} names {name!r}",
                    f"one of the system's {option}: {', '.join(known) or 'none'}",
                    did_you_mean(name, known),
                )
        return dict(given)

    def _scales(self, system: System, names: tuple[str, ...]) -> dict[str, float]:
        """Factor to the system's unit for each name whose unit is given."""
        scales: dict[str, Any] = {}
        for name, unit in (self.units or {}).items():
            if name == "time":
                scales[name] = factor(unit, "s", "time")
            elif name in names:
                scales[name] = factor(unit, system.unit_of(name), name)
            else:
                allowed = (*names, "time")
                raise InputError(
                    f"record.units names {name!r}",
                    f"a channel or input of this record: {', '.join(allowed)}",
                    did_you_mean(name, allowed),
                )
        return scales
