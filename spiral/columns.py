"""Records from columns of a table: which column is what, in which unit, which rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from spiral.errors import ConfigError, InputError, did_you_mean
from spiral.files import Table
from spiral.record import Array, Record, make_record
from spiral.source import Source
from spiral.system import System
from spiral.units import factor

_TIME_COLUMNS = ("time", "t")


class Columns(Source):
    """Columns of one or several files, each a table of named columns.

    Fields
    ------
    path : a file, or a list of files of one machine; also looked for under ``SPIRAL_DATA``.
    time : the column of time in s; or rate : samples per s where there is none.
    channels, inputs : the system's name -> the file's column; names that agree may be left out.
    units : name of a channel or input (or ``time``) -> its unit; else the unit that the file names.
    rows : [start, stop], zero-based data rows, stop excluded.
    noise : channel -> standard deviation in the system's unit, where it is known.
    offset : name -> what the instrument reads at rest, in the file's unit; it is subtracted.
    separator, decimal : how a text file writes columns and fractions, where that is not found.
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
    separator: str | None = None
    decimal: str | None = None

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

    @abstractmethod
    def read(self, path: str) -> Table:
        """The table of one file."""

    def load(self, system: System) -> tuple[Record, ...]:
        """One record for each file."""
        if not self.path:
            name = self.plugin_name()
            raise ConfigError(
                f"record={name} without a file", "record.path=FILE", "record.path=a.csv"
            )
        paths = [self.path] if isinstance(self.path, str) else list(self.path)
        return tuple(self._one(system, path) for path in paths)

    def _one(self, system: System, path: str) -> Record:
        table = self.read(path)
        channels = self._mapped(table, "channels", system.observed, required=system.observed)
        driving = tuple(i.name for i in system.inputs if i.derived_from is None)
        known = tuple(i.name for i in system.inputs)
        inputs = self._mapped(table, "inputs", known, required=driving)
        columns = {**channels, **inputs}
        clock = self._clock(table)
        start, stop = self._range(
            table,
            {
                **{f"record.channels {k}": c for k, c in channels.items()},
                **{f"record.inputs {k}": c for k, c in inputs.items()},
                **{f"record.{k}": c for k, c in clock.items()},
            },
        )
        units = self._units(table, {**columns, **clock})
        scale = {
            n: factor(u, "s" if n == "time" else system.unit_of(n), n) for n, u in units.items()
        }
        offset = self._offsets(tuple(columns))

        def values(option: str, given: Mapping[str, str]) -> dict[str, Array]:
            return {
                k: scale.get(k, 1.0)
                * (table.column(c, f"record.{option} {k}", start, stop) - offset.get(k, 0.0))
                for k, c in given.items()
            }

        return make_record(
            system,
            Path(path).name + (f" rows [{start}, {stop})" if self.rows else ""),
            self._time(table, clock, start, stop) * scale.get("time", 1.0),
            values("channels", channels),
            values("inputs", inputs),
            dict(self.noise or {}),
            notes=(*table.notes, _told(system, columns, clock, units, self.rate)),
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

    def _range(self, table: Table, columns: Mapping[str, str]) -> tuple[int, int]:
        rows = table.rows(columns)
        if self.rows is None:
            return 0, rows
        start, stop = self.rows
        if not 0 <= start < stop <= rows:
            raise InputError(
                f"record.rows=[{start}, {stop}] of {table.name}",
                f"0 <= start < stop <= {rows}, the number of its data rows",
                f"for instance record.rows='[0,{rows}]'",
            )
        return start, stop

    def _clock(self, table: Table) -> dict[str, str]:
        """``time`` -> its column; empty where the rate is given."""
        if self.rate is not None:
            return {}
        if self.time is not None:
            return {"time": self.time}
        for name in _TIME_COLUMNS:
            if name in table.columns:
                return {"time": name}
        raise InputError(
            f"{table.name}: no column of time among {', '.join(table.columns[:12])}",
            "its name, or the sample rate",
            "record.time=COLUMN, or record.rate=SAMPLES_PER_SECOND",
        )

    def _time(self, table: Table, clock: Mapping[str, str], start: int, stop: int) -> Array:
        if self.rate is not None:
            return np.arange(stop - start) / self.rate
        return table.column(clock["time"], "record.time", start, stop)

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

    def _units(self, table: Table, columns: Mapping[str, str]) -> dict[str, str]:
        """Name -> unit, as configured, else as the file names it."""
        given = dict(self.units or {})
        allowed = (*columns, *(() if "time" in columns else ("time",)))
        for name in given:
            if name not in allowed:
                raise InputError(
                    f"record.units names {name!r}",
                    f"a channel or input of this record: {', '.join(allowed)}",
                    did_you_mean(name, allowed),
                )
        named = {n: table.units[c] for n, c in columns.items() if c in table.units}
        return {**named, **given}


def _told(
    system: System,
    columns: Mapping[str, str],
    clock: Mapping[str, str],
    units: Mapping[str, str],
    rate: float | None,
) -> str:
    """What was taken for what, in words."""
    words = [
        f"time from {clock['time']!r} in {units.get('time', 's')}" if clock else f"{rate:g} Hz"
    ]
    for name, column in columns.items():
        words.append(f"{name} from {column!r} in {units.get(name, system.unit_of(name))}")
    return ", ".join(words)
