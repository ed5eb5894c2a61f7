"""Moments and times of day in text, as a logger writes them, in seconds from the first one.

``2026-11-30T04:13:40.25``, with a zone or without; ``30.11.2026 04:13:40,25``; ``04:13:40.25``. Of
``11/30/2026`` the column itself says whether the day or the month stands first: by a number above
12, or by one date throughout. Where it does not, nothing is guessed.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np

Array = np.ndarray

_CLOCK = r"(\d{1,3}):(\d{2})(?::(\d{2}(?:[.,]\d+)?))?"
_OF_DAY = re.compile(_CLOCK)
_DATED = re.compile(rf"(\d{{1,2}})([./-])(\d{{1,2}})\2(\d{{4}})[ T]+{_CLOCK}(?: ?([AaPp][Mm]))?")
_DAY = 86400.0


def seconds_of(text: Any) -> Array | None:
    """(rows,) seconds since the first row of a pandas series of text; nothing where it is no time.

    Empty cells are NaN. A time of day that passes midnight goes on.
    """
    cells = text.where(text.str.len() > 0)
    some = cells.dropna()
    if some.empty or not re.match(r"\d", some.iloc[0]):
        return None
    for read in (_iso_seconds, _seconds_of_day, _dated_seconds):
        seconds = read(cells)
        if seconds is not None and np.isfinite(seconds).any():
            return seconds - seconds[np.isfinite(seconds)][0]
    return None


def _iso_seconds(cells: Any) -> Array | None:
    import pandas as pd

    if not re.match(r"\d{4}-\d{2}-\d{2}", cells.dropna().iloc[0]):
        return None
    moments: Any = pd.to_datetime(cells, format="ISO8601", errors="coerce", utc=True)
    return _unless_lost(cells, (moments - moments.min()).dt.total_seconds().to_numpy(float))


def _seconds_of_day(cells: Any) -> Array | None:
    found = cells.str.fullmatch(_OF_DAY)
    if not bool(found.dropna().all()):
        return None
    seconds = _clock_seconds(cells.str.extract(_OF_DAY))
    steps = np.diff(seconds[np.isfinite(seconds)])
    passed = np.zeros(len(seconds))
    passed[np.isfinite(seconds)] = _DAY * np.concatenate([[0], np.cumsum(steps < -_DAY / 2)])
    return seconds + passed


def _dated_seconds(cells: Any) -> Array | None:
    import pandas as pd

    parts = cells.str.extract(_DATED)
    if parts[0].isna().to_numpy()[cells.notna().to_numpy()].any():
        return None
    first, second = (_number_array(parts[i]) for i in (0, 2))
    dotted = bool((parts[1].dropna() == ".").all())
    one_date = len(cells.str.extract(r"^(\S+)")[0].dropna().unique()) == 1
    day_first = dotted or bool(np.nanmax(first) > 12)
    if not (day_first or one_date or np.nanmax(second) > 12):
        return None
    day, month = (first, second) if day_first else (second, first)
    fields = pd.DataFrame({"year": _number_array(parts[3]), "month": month, "day": day})
    dates: Any = pd.to_datetime(fields, errors="coerce")
    if one_date and dates.isna().to_numpy()[cells.notna().to_numpy()].any():
        return None
    clock = _clock_seconds(parts[[4, 5, 6]])
    half = parts[7].str.lower()
    if half.notna().any():
        clock = clock % (_DAY / 2) + np.where(half == "pm", _DAY / 2, 0.0)
    since = (dates - dates.min()).dt.total_seconds().to_numpy(float)
    return _unless_lost(cells, since + clock)


def _clock_seconds(parts: Any) -> Array:
    hours, minutes, seconds = (parts.iloc[:, i] for i in range(3))
    fine = np.nan_to_num(_number_array(seconds.str.replace(",", ".")))
    return 3600.0 * _number_array(hours) + 60.0 * _number_array(minutes) + fine


def _number_array(text: Any) -> Array:
    import pandas as pd

    numbers: Any = pd.to_numeric(text)
    return numbers.to_numpy(float)


def _unless_lost(cells: Any, seconds: Array) -> Array | None:
    """The seconds, unless a cell with text became none."""
    return None if np.isnan(seconds[cells.notna().to_numpy()]).any() else seconds
