"""A file's numbers before any processing, in the system's units, to compare with the record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from spiral.io.readers.columns import Columns
from spiral.io.readers.sampling import FileSeries
from spiral.types.record import Array, Record
from spiral.types.system import System

_SAME = 1e-9  # of a series' range; nearer than which nothing has changed
_DOES = ("offset", "fill_gaps", "resample", "slow_roll", "probe_angles")


def alters_numbers(source: object) -> bool:
    """Whether a source's options change numbers: offsets, gaps, rates, run-out, probe angles."""
    asked = [getattr(source, name, None) for name in _DOES]
    return isinstance(source, Columns) and any(value is not None for value in asked)


def unprocessed_series(source: Columns, system: System) -> FileSeries:
    """The first file's rows in the system's units, before anything is done to them; gaps stay."""
    path = source.path if isinstance(source.path, str) else (source.path or ("",))[0]
    plain = replace(source, offset=None)
    table = source.read(path)
    one = plain._expand_starred(table)[0]
    layout = one._resolve_layout(system, table)
    rows = len(table.values[next(iter(layout.channels.values()))])
    start, stop = source.stretches[0] or (0, rows)

    def read_columns(option: str, given: dict[str, str]) -> dict[str, Array]:
        return {
            k: layout.converted(k, table.column(c, f"record.{option} {k}", start, stop, True))
            for k, c in given.items()
        }

    time = layout.converted("time", one._time_values(table, layout.clock, start, stop))
    channels = read_columns("channels", dict(layout.channels))
    return FileSeries(Path(path).name, time, channels, read_columns("inputs", dict(layout.inputs)))


def altered_series_names(before: FileSeries, record: Record) -> list[str]:
    """Names of the series that reading has changed, channels first."""
    pairs = {**before.channels, **before.inputs}
    read = {**record.channels, **record.inputs}
    return [n for n, old in pairs.items() if n in read and _values_differ(old, record, read[n])]


def _values_differ(old: Array, record: Record, new: Array) -> bool:
    if len(old) != record.samples or not np.isfinite(old).all():
        return True
    return bool(np.max(np.abs(old - new)) > _SAME * (np.ptp(old) or 1.0))
