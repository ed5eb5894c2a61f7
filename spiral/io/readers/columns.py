"""Records from columns of a table: which column is what, in which unit, which rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from spiral.io.readers import own_units, rotor_series
from spiral.io.readers.layout import ColumnLayout
from spiral.io.readers.pulses import Edge
from spiral.io.readers.sampling import (
    FileSeries,
    held_inputs_of,
    interpolate_gaps,
    resample_series,
)
from spiral.io.readers.table import Table
from spiral.types.clock import check_increasing
from spiral.types.errors import ConfigError, InputError, did_you_mean
from spiral.types.fields import construct
from spiral.types.record import Array, Record, check_noise, make_record
from spiral.types.source import Source
from spiral.types.system import System

_TIME_COLUMNS = ("time", "t")
_NOT_RESAMPLED = {
    "missing": "record.fill_gaps=1 interpolates them before the rate is changed",
    "hold": "after an anti-alias filter no input is held",
}


@dataclass(frozen=True)
class SlowRoll:
    """Where a shaft turns slowly: rows of a file, or a range of speed in the file's unit."""

    rows: tuple[int, int] | None = None
    speed: tuple[float, float] | None = None
    path: str | None = None


class Columns(Source):
    """Columns of one or several files, each a table of named columns.

    Fields
    ------
    path : a file, or a list of files of one machine; also looked for under ``SPIRAL_DATA``.
    time : the column of time in s.
    rate : samples per s, where the file has no column of time.
    channels, inputs : the system's name -> the file's column; names that agree may be left out. An
        input may be a number instead (``0`` where nothing drives), in the system's unit. A star
        stands for every number that makes a column, one record for each: ``Y_id[*][0]``.
    units : name of a channel or input (or ``time``) -> its unit; else the unit that the file names.
    rows : [start, stop], zero-based data rows, stop excluded; several such are several records.
    noise : channel -> standard deviation in the system's unit, where it is known.
    offset : name -> what the instrument reads at rest, in the file's unit; it is subtracted.
    separator, decimal : a text file's, what stands between columns and the mark, where not found.
    pulse : the column of a once-per-turn pulse, taken as phase, and as speed where there is none.
    pulse_level : its threshold in the file's unit, where half its height is not right.
    pulse_edge : rising or falling; left out, the edge into the shorter of its two levels.
    rotation : sense of rotation with the first axis to the right and the second one up;
        ``clockwise`` makes speed and phase negative.
    probe_angles : channel -> direction of its probe in degrees, from the first axis towards the
        second; readings are turned to the axes.
    slow_roll : {rows: [start, stop]} or {speed: [low, high]} (in the file's unit), perhaps with
        {path: FILE}: where the shaft turns slowly; mean and 1X there are subtracted everywhere.
    fill_gaps : longest gap, in samples, that is bridged by interpolation; what is put in the place
        of a channel's reading is not taken for one.
    missing : ``refuse`` empty cells, or ``leave_out`` those of channels, at most half of each.
    resample : samples per s to bring the record to, through an anti-alias filter.
    hold : how inputs run between their samples (``types.parameter.Input``), for all or by name;
        left out, as is most likely (``strategy=likelihood``), or as the system says.
    """

    path: str | tuple[str, ...] | None = None
    time: str | None = None
    rate: float | None = None
    channels: Mapping[str, str] | None = None
    inputs: Mapping[str, str] | None = None
    units: Mapping[str, str] | None = None
    rows: tuple[tuple[int, int], ...] | tuple[int, int] | None = None
    noise: Mapping[str, float] | None = None
    offset: Mapping[str, float] | None = None
    separator: str | None = None
    decimal: str | None = None
    pulse: str | None = None
    pulse_level: float | None = None
    pulse_edge: Edge | None = None
    rotation: rotor_series.Rotation = "counterclockwise"
    probe_angles: Mapping[str, float] | None = None
    slow_roll: Mapping[str, Any] | None = None
    fill_gaps: int | None = None
    missing: Literal["refuse", "leave_out"] = "refuse"
    resample: float | None = None
    hold: str | Mapping[str, str] | None = None

    def __post_init__(self) -> None:
        if self.time is not None and self.rate is not None:
            raise ConfigError(
                f"both record.time={self.time!r} and record.rate={self.rate:g}",
                "one of them",
                "give the rate only where the file has no column of time",
            )
        if self.rows is not None and not len(self.rows):
            raise ConfigError("record.rows=[]", "[start, stop], or several such", "or leave it out")
        for name in ("rate", "resample"):
            rate = getattr(self, name)
            if rate is not None and not (np.isfinite(rate) and rate > 0):
                raise ConfigError(f"record.{name}={rate!r}", "samples per second, above zero")
        if self.fill_gaps is not None and self.fill_gaps < 1:
            given = f"record.fill_gaps={self.fill_gaps}"
            raise ConfigError(given, "samples, one or more", "or leave it out")
        for name, told in _NOT_RESAMPLED.items():
            if self.resample is not None and getattr(self, name) not in (None, "refuse"):
                raise ConfigError(f"both record.resample and record.{name}", "one of them", told)
        for name in ("pulse_level", "pulse_edge"):
            if getattr(self, name) is not None and self.pulse is None:
                given = f"record.{name} without a pulse"
                raise ConfigError(given, "record.pulse=COLUMN", "or leave it out")
        self._slow_roll_range()

    def as_test(self) -> Source:
        """The same columns and units; rows are the test's own."""
        return replace(self, rows=None)

    @abstractmethod
    def read(self, path: str) -> Table:
        """The table of one file."""

    def load(self, system: System) -> tuple[Record, ...]:
        """One record for each file, or for each series that a star in a column's name means."""
        if not self.path:
            given = f"record={self.plugin_name()} without a file"
            raise ConfigError(given, "record.path=FILE", "record.path=a.csv")
        paths = [self.path] if isinstance(self.path, str) else list(self.path)
        return tuple(record for path in paths for record in self._file_records(system, path))

    def _file_records(self, system: System, path: str) -> tuple[Record, ...]:
        return self.records_of(system, self.read(path), path)

    @property
    def stretches(self) -> tuple[tuple[int, int] | None, ...]:
        """The stretches of rows of a file, each a record of its own; ``None`` for all rows."""
        if self.rows is None or isinstance(self.rows[0], int):
            return (cast("tuple[int, int] | None", self.rows),)
        return cast("tuple[tuple[int, int], ...]", self.rows)

    def records_of(self, system: System, table: Table, path: str) -> tuple[Record, ...]:
        """The records of a table: one for each stretch of rows, and series that a star means."""
        return tuple(
            one._build_record(system, table, path, stretch)
            for one in self._expand_starred(table)
            for stretch in self.stretches
        )

    def _expand_starred(self, table: Table) -> list[Columns]:
        """One source for each number that a star in a column's name stands for; else itself."""
        names = [*(self.channels or {}).values(), *(self.inputs or {}).values(), self.time or ""]
        starred = [c for c in map(str, names) if "*" in c and c not in table.columns]
        if not starred:
            return [self]
        return [
            replace(
                self,
                channels=_replace_star(self.channels, n),
                inputs=_replace_star(self.inputs, n),
                time=self.time and self.time.replace("*", n),
            )
            for n in table.starred_numbers(starred[0])
        ]

    def _build_record(
        self, system: System, table: Table, path: str, rows: tuple[int, int] | None
    ) -> Record:
        layout = self._resolve_layout(system, table)
        start, stop = _row_range(table, layout.options(), rows, "record.rows")
        series = self._prepared_series(system, table, layout, start, stop)
        series = replace(series, noise=check_noise(dict(self.noise or {}), series.channels))
        wish = self._slow_roll_range()
        if (wish, self.probe_angles, self.resample) != (None, None, None):
            series = rotor_series.check_channels(series)
        if wish is not None:
            series = self._subtract_run_out(system, table, layout, wish, series)
        if self.probe_angles is not None:
            series = rotor_series.rotate_to_axes(system, series, self.probe_angles)
        if self.resample is not None:
            series = resample_series(system, series, self.resample)
        told = _describe_layout(system, layout, self.rate)
        record = make_record(
            system,
            Path(path).name + (f" rows [{start}, {stop})" if rows else ""),
            series.time,
            series.channels,
            series.inputs,
            series.noise,
            notes=(*table.notes, told, *series.notes),
            hold=self.hold,
            filled=series.filled,
        )
        seen = {**record.channels, **{n: record.inputs[n] for n in layout.inputs}}
        doubts = own_units.unit_doubts(system, seen, layout.units)
        return replace(record, doubts={**doubts, **self._rate_doubts(table)})

    def _rate_doubts(self, table: Table) -> dict[str, str]:
        """A question where the rate that was given is not that of a column of time."""
        column = _usual_time_column(table)
        if self.rate is None or not column:
            return {}
        try:
            steps = np.diff(table.column(column, "record.time", 0, table.rows({"": column})))
        except InputError:
            return {}
        step = float(np.median(steps)) if len(steps) else 0.0
        agree = [1 / self.rate, 1e3 / self.rate, 1e6 / self.rate, 1.0]  # s, ms, us, a count of rows
        if step <= 0 or np.ptp(steps) > 0.1 * step or np.isclose(step, agree, rtol=0.01).any():
            return {}
        doubt = (
            f"record.rate={self.rate:g} was taken, but column {column!r} goes on by {step:.4g} a "
            f"row, {1 / step:.4g} samples per s: without record.rate that column is the time"
        )
        return {"time": doubt}

    def _resolve_layout(self, system: System, table: Table) -> ColumnLayout:
        channels = self._resolve_columns(
            table, "channels", system.observed, required=system.observed
        )
        known = tuple(i.name for i in system.inputs)
        driving = tuple(i.name for i in system.inputs if i.derived_from is None)
        if self.pulse is not None:  # phase and perhaps speed come from it
            driving = tuple(n for n in driving if n != "speed")
            if self.inputs is None:
                known = tuple(n for n in known if n != "phase")
        inputs = self._resolve_columns(table, "inputs", known, required=driving)
        constant = {n: float(c) for n, c in inputs.items() if _is_constant(c, table)}
        inputs = {n: c for n, c in inputs.items() if n not in constant}
        clock = self._time_column(table)
        units = self._resolve_units(system, table, {**channels, **inputs, **clock})
        ways = {n: own_units.conversion_to_system(u, system, n) for n, u in units.items()}
        offset = self._check_offsets((*channels, *inputs))
        pulse = {} if self.pulse is None else {"pulse": self.pulse}
        return ColumnLayout(channels, inputs, clock, pulse, units, ways, offset, constant)

    def _prepared_series(
        self, system: System, table: Table, layout: ColumnLayout, start: int, stop: int
    ) -> FileSeries:
        """Rows [start, stop) in the system's units; gaps, pulses and signs as configured."""
        name = Path(table.name).name

        def read_values(option: str, given: Mapping[str, str]) -> dict[str, Array]:
            left_out = option == "channels" and self.missing == "leave_out"
            missing, converted = left_out or self.fill_gaps is not None, {}
            for k, c in given.items():
                read = table.column(c, f"record.{option} {k}", start, stop, missing)
                converted[k] = layout.converted(k, read)
            return converted

        pulse = read_values("pulse", layout.pulse).get("pulse")
        time = layout.converted("time", self._time_values(table, layout.clock, start, stop))
        series = FileSeries(
            name,
            time,
            read_values("channels", layout.channels),
            {
                **read_values("inputs", layout.inputs),
                **{n: np.full(len(time), value) for n, value in layout.constant.items()},
            },
            pulse=pulse,
        )
        if self.resample is not None or self.fill_gaps is not None or self.pulse is not None:
            check_increasing(name, time)
        series = rotor_series.unwrap_phase(series)
        if self.fill_gaps is not None:
            left_out, held = self.missing == "leave_out", held_inputs_of(system)
            series = interpolate_gaps(series, self.fill_gaps, left_out, start, held)
        if self.pulse is not None:
            series = rotor_series.add_pulse_phase(
                system, series, self.pulse, self.pulse_level, self.pulse_edge
            )
        return rotor_series.apply_rotation_sense(system, series, self.rotation)

    def _slow_roll_range(self) -> SlowRoll | None:
        """The stretch of the slow roll, checked."""
        if self.slow_roll is None:
            return None
        stretch: SlowRoll = construct(SlowRoll, self.slow_roll, "record.slow_roll")
        ranges = [stretch.rows, stretch.speed]
        if ranges.count(None) != 1 and not (stretch.path and ranges.count(None) == 2):
            raise ConfigError(
                f"record.slow_roll={dict(self.slow_roll)}",
                "rows or a range of speed; with a path of its own perhaps neither",
                "record.slow_roll='{rows: [0, 2000]}' or record.slow_roll='{speed: [200, 400]}'",
            )
        if stretch.speed is not None and not 0 <= stretch.speed[0] < stretch.speed[1]:
            raise ConfigError(
                f"record.slow_roll speed {list(stretch.speed)}", "[low, high], zero or above"
            )
        return stretch

    def _subtract_run_out(
        self, system: System, table: Table, layout: ColumnLayout, wish: SlowRoll, series: FileSeries
    ) -> FileSeries:
        """Slow-roll vectors of the named stretch, subtracted."""
        slow = series
        if wish.path is not None:
            table = self.read(wish.path)
        if wish.rows is not None or wish.path is not None:
            start, stop = _row_range(table, layout.options(), wish.rows, "record.slow_roll rows")
            slow = self._prepared_series(system, table, layout, start, stop)
        rows = np.arange(len(slow.time))
        if wish.speed is not None:
            low, high = layout.converted("speed", np.asarray(wish.speed, dtype=float))
            rows = rotor_series.slow_roll_rows(slow, low, high)
        vectors = rotor_series.slow_roll_vectors(slow, rows)
        rotor_series.check_slow_roll_speed(slow, rows, series)
        return rotor_series.subtract_run_out(system, series, vectors)

    def _check_offsets(self, names: tuple[str, ...]) -> dict[str, float]:
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

    def _time_column(self, table: Table) -> dict[str, str]:
        """``time`` -> its column; empty where the rate is given."""
        if self.rate is not None:
            return {}
        if self.time is not None:
            return {"time": table.find_column(self.time) or self.time}
        if column := _usual_time_column(table):
            return {"time": column}
        raise InputError(
            f"{table.name}: no column of time among {', '.join(table.columns[:12])}",
            "its name, or the sample rate",
            "record.time=COLUMN, or record.rate=SAMPLES_PER_SECOND",
        )

    def _time_values(self, table: Table, clock: Mapping[str, str], start: int, stop: int) -> Array:
        if self.rate is not None:
            return np.arange(stop - start) / self.rate
        return table.column(clock["time"], "record.time", start, stop)

    def _resolve_columns(
        self, table: Table, option: str, known: tuple[str, ...], required: tuple[str, ...]
    ) -> dict[str, str]:
        """Name -> column: as configured, else columns with the system's own names."""
        given: Mapping[str, str] | None = getattr(self, option)
        if given is None:
            columns = {n: table.find_column(n) for n in known}
            return {n: c or n for n, c in columns.items() if c or n in required}
        for name in given:
            if name not in known:
                raise InputError(
                    f"record.{option} names {name!r}",
                    f"one of the system's {option}: {', '.join(known) or 'none'}",
                    _swapped_names_hint(option, given, table, known) or did_you_mean(name, known),
                )
        agreeing = {n: table.find_column(n) for n in required if n not in given}
        columns = {**given, **{n: c for n, c in agreeing.items() if c}}
        return {n: table.find_column(str(c)) or c for n, c in columns.items()}

    def _resolve_units(
        self, system: System, table: Table, columns: Mapping[str, str]
    ) -> dict[str, str]:
        """Name -> unit, as configured by name or by column, else as the file or model names it."""
        given = dict(self.units or {})
        from_pulse = self.pulse is not None and any(i.name == "speed" for i in system.inputs)
        also = ("time", "speed") if from_pulse else ("time",)
        allowed = tuple(dict.fromkeys((*columns, *also)))
        by_column = {n: given[c] for n, c in columns.items() if c in given and c not in allowed}
        given = {n: u for n, u in given.items() if n in allowed or n not in columns.values()}
        for name in given:
            if name not in allowed:
                raise InputError(
                    f"record.units names {name!r}",
                    f"a channel or input of this record: {', '.join(allowed)}",
                    did_you_mean(name, allowed),
                )
        named = {n: table.units[c] for n, c in columns.items() if c in table.units}
        written = getattr(system, "written_units", {})  # those of a definition that is in SI now
        declared = {n: written[n][0] for n in columns if n in written}
        ends = {n: own_units.unit_at_end(c, system, n) for n, c in columns.items() if n in allowed}
        ends = {n: unit for n, unit in ends.items() if unit}
        return {**declared, **ends, **named, **by_column, **given}


def _usual_time_column(table: Table) -> str:
    """The column that is called as one of time is; empty where none is."""
    return next((c for n in _TIME_COLUMNS if (c := table.find_column(n))), "")


def _row_range(
    table: Table, columns: Mapping[str, str], rows: tuple[int, int] | None, option: str
) -> tuple[int, int]:
    """The rows asked for, or all, of a table whose columns have one length."""
    count = table.rows(columns)
    start, stop = rows or (0, count)
    if not 0 <= start < stop <= count and rows is not None:
        raise InputError(
            f"{option}=[{start}, {stop}] of {table.name}",
            f"0 <= start < stop <= {count}, the number of its data rows",
            f"for instance {option}='[0,{count}]'",
        )
    return start, stop


def _replace_star(names: Mapping[str, str] | None, number: str) -> Mapping[str, str] | None:
    """Columns with a number in place of their star."""
    return names and {k: str(c).replace("*", number) for k, c in names.items()}


def _swapped_names_hint(
    option: str, given: Mapping[str, str], table: Table, known: tuple[str, ...]
) -> str:
    """A hint where columns stand before the names that they are for; empty where they do not."""
    pairs = {str(c): n for n, c in given.items()}
    if not all(n in known and table.find_column(c) for n, c in pairs.items()):
        return ""
    words = ", ".join(f"{n}: {c}" for n, c in pairs.items())
    return f"the system's own name comes first: record.{option}='{{{words}}}'"


def _is_constant(given: str, table: Table) -> bool:
    """Whether an input's column is a number, and no column is called so."""
    try:
        return given not in table.columns and bool(np.isfinite(float(given)))
    except ValueError:
        return False


def _describe_layout(system: System, layout: ColumnLayout, rate: float | None) -> str:
    """What was taken for what, in words."""
    clock, units = layout.clock, layout.units
    words = [
        f"time from {clock['time']!r} in {units.get('time', 's')}" if clock else f"{rate:g} Hz"
    ]
    for name, column in (*layout.channels.items(), *layout.inputs.items()):
        unit = units.get(name, system.unit_of(name))
        zero = layout.conversion.get(name, (1.0, 0.0))[1]
        own = f" (0 is {zero:g} {system.unit_of(name)})" if zero else ""
        words.append(f"{name} from {column!r}" + (f" in {unit}" if unit else "") + own)
    for name, value in layout.constant.items():
        words.append(f"{name} {value:g} {system.unit_of(name)}".rstrip() + " throughout")
    return ", ".join(words)
