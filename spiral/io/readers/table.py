"""Finding a file, and a table of named columns from which numbers are taken."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from spiral.io.readers.moments import seconds_of
from spiral.physics.formulas.observed import with_primes
from spiral.types.errors import InputError, near_misses, similar_files

Array = np.ndarray

DATA_VARIABLE = "SPIRAL_DATA"
MISSING = frozenset(("", "nan", "na", "nat", "none", "null", "<na>", "inf", "-inf", "+inf"))
"""Cells that stand for a number that is not there, in lower case."""
_MOMENTS = "seconds, or moments: 2026-11-30T04:13:40.25, 30.11.2026 04:13:40,25 or 04:13:40.25"
_LISTED = 12
_NAME = 256  # letters that a file's name may have
_UNIT_BEHIND = re.compile(r"\s*(\[(?!\d+\]|\*)[^][]+\]|\((?!\d+\)|\*)[^()]+\))\s*$")  # no index


def find_file(given: str) -> Path:
    """A file as named, or under ``SPIRAL_DATA``.

    Raises
    ------
    InputError : no such file; near misses of the folder are named.
    """
    path = Path(given).expanduser()
    folder = os.environ.get(DATA_VARIABLE)
    places = [path]
    if folder and not path.is_absolute():
        places.append(Path(folder).expanduser() / path)
    for place in places:
        with suppress(OSError):  # a name that is too long for one
            if place.is_file():
                return place
    if any(len(place.name) < _NAME and place.is_dir() for place in places):
        raise InputError(f"{given}: a folder", "a file", f"name one file: {_file_names_in(places)}")
    looked = " or ".join(str(p.parent) for p in places)
    hint = _near_miss_hint(places)
    if not hint and not folder and not path.is_absolute():
        hint = f"give the full path, or set {DATA_VARIABLE} to the folder that holds it"
    raise InputError(f"file {given[:200]!r}", f"a file in {looked}", hint or "check the path")


def _file_names_in(places: list[Path]) -> str:
    names = [p.name for place in places if place.is_dir() for p in sorted(place.iterdir())]
    return ", ".join(names[:5]) or "the folder is empty"


def _near_miss_hint(places: list[Path]) -> str:
    return next((hint for place in places if (hint := similar_files(place))), "")


@dataclass(frozen=True)
class Table:
    """A file's columns, numbers parsed on request.

    Parameters
    ----------
    name : the file as the user named it.
    values : column -> its rows, as numbers, times of day or text.
    units : column -> its unit, where the file names one.
    notes : what was understood of the file, in words.
    first_line : the line of a text file that holds row 0, for messages.
    decimal : the decimal mark of cells that are text.
    """

    name: str
    values: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    first_line: int | None = None
    decimal: str = "."

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self.values)

    def find_column(self, name: str) -> str:
        """The column of this name, its unit behind it or not, in the file or here, or none.

        ``force`` is found in a file with ``force [N]``, and ``force [N]`` in one with ``force``.

        ``x_rate`` and ``x_acceleration`` may stand as equations write them, ``x'`` and ``x''``. A
        ``[1]`` behind the only column of a name is the unit of a pure number, not an index.
        """
        for word in filter(None, (name, with_primes(name))):
            if word in self.values:
                return word
            named = re.compile(rf"{re.escape(word)}\s*[\[(][^][()]*[\])]\s*")
            fitting = (c for c in self.values if c in self.units and named.fullmatch(c))
            if column := next(fitting, ""):
                return column
            numbered = re.compile(rf"{re.escape(word)}\s*[\[(](\d+)[\])]\s*")
            numbers = {m[1]: c for c in self.values if (m := numbered.fullmatch(c))}
            if tuple(numbers) == ("1",):
                return numbers["1"]
        bare = _UNIT_BEHIND.sub("", name)
        return self.find_column(bare) if bare != name else ""

    def starred_numbers(self, starred: str) -> list[str]:
        """Numbers that the star in a column's name may stand for, in their order.

        Raises
        ------
        InputError : no column has a number there.
        """
        head, tail = starred.split("*", 1)
        fitting = (c for c in self.columns if c.startswith(head) and c.endswith(tail))
        inner = [c[len(head) : len(c) - len(tail)] for c in fitting]
        matches = sorted((n for n in inner if n.isdigit()), key=int)
        if not matches:
            raise InputError(
                f"column {starred!r} of {self.name}",
                "a column with a number in the star's place",
                f"columns are {', '.join(self.columns[:12])}",
            )
        return matches

    def rows(self, columns: Mapping[str, str]) -> int:
        """Number of rows, which the columns in use (option -> column) must share.

        Raises
        ------
        InputError : no such column, or columns of different lengths.
        """
        lengths = {c: len(self._column_values(c, option)) for option, c in columns.items()}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{c!r} {n}" for c, n in lengths.items())
            raise InputError(
                f"{self.name}: columns of different lengths ({listed})",
                "columns of one length",
                "name columns of one measurement",
            )
        return next(iter(lengths.values()), 0)

    def column(self, name: str, option: str, start: int, stop: int, missing: bool = False) -> Array:
        """Numbers of one column, rows [start, stop); NaN for empty cells where they are allowed.

        Raises
        ------
        InputError : no such column, text among the numbers, or empty cells.
        """
        values = self._column_values(name, option)[start:stop]
        try:
            numbers, bad = _parse_numbers(values, self.decimal, option == "record.time")
        except OverflowError as error:
            raise InputError(
                f"column {name!r} of {self.name}: dates more than 292 years apart",
                "moments of one measurement",
                "correct the file, or cut the rows out with record.rows",
            ) from error
        if not len(bad):
            return numbers
        cells = [str(cell).strip() for cell in _cells_at(values, bad)]
        texts = [i for i, c in enumerate(cells) if c.lower() not in MISSING]
        if missing and not texts:
            numbers[bad] = np.nan
            return numbers
        worst = texts[0] if texts else 0
        row, cell = start + int(bad[worst]), cells[worst]
        line = f" (line {row + self.first_line})" if self.first_line is not None else ""
        place = f"column {name!r} of {self.name}, row {row}{line}"
        if texts:
            hint = _MOMENTS if option == "record.time" else _text_hint(cell)
            raise InputError(f"{place}: text {cell!r}", "a number", hint)
        where = f"{place}: {cell or 'an empty cell'}"
        raise _missing_values_error(where, option, bad, len(values), (start, row))

    def _column_values(self, name: str, option: str) -> Any:
        if name in self.values:
            return self.values[name]
        near = near_misses(name, self.columns)
        more = ", ..." if len(self.columns) > _LISTED else ""
        raise InputError(
            f"column {name!r} of {self.name} ({option})",
            f"one of its {len(self.columns)} columns: {', '.join(self.columns[:_LISTED])}{more}",
            "did you mean " + " or ".join(repr(n) for n in near) + "?"
            if near
            else f"{option}=COLUMN"
            if " " not in option
            else "name one of these columns",
        )


def _parse_numbers(values: Any, decimal: str, timed: bool = False) -> tuple[Array, Array]:
    """Numbers, NaN where there is none, and the positions of what is not finite.

    ``timed`` : text may also say moments, which become seconds from the first row.
    """
    import pandas as pd

    series = pd.Series(values)
    if pd.api.types.is_datetime64_any_dtype(series):
        parsed: Any = (series - series.iloc[0]).dt.total_seconds()
    elif pd.api.types.is_numeric_dtype(series):
        parsed = series
    else:
        text = series.astype(str).str.strip()
        if decimal != ".":
            text = text.str.replace(decimal, ".", regex=False)
        parsed = pd.to_numeric(text, errors="coerce")
        if timed and parsed.isna().all() and (seconds := seconds_of(text)) is not None:
            parsed = seconds
    numbers = np.array(parsed, dtype=float)
    return numbers, np.flatnonzero(~np.isfinite(numbers))


def _cells_at(values: Any, rows: Array) -> list[Any]:
    import pandas as pd

    return list(pd.Series(values).iloc[rows])


def _missing_values_error(
    where: str, option: str, bad: Array, count: int, before: tuple[int, int]
) -> InputError:
    """The error for empty cells at these rows; ``before``: rows in front of the first of them."""
    if len(bad) == count:
        return InputError(
            f"{where}, as in all {count} rows", "a column of numbers", f"{option}=ANOTHER COLUMN"
        )
    cut = f"cut the gap out with record.rows, for instance rows {list(before)}"
    if option != "record.time":
        cut = f"record.fill_gaps={_longest_run(bad)} interpolates so many in a row; or {cut}"
    if option.startswith("record.channels"):
        cut = f"record.missing=leave_out does without them; {cut}"
    return InputError(f"{where}, one of {len(bad)} missing values", "a number in every row", cut)


def _longest_run(rows: Array) -> int:
    """Length of the longest run of neighbouring rows."""
    return max(len(part) for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1))


def error_first_line(error: Exception) -> str:
    """The first line of an error's message, or its type where it has none."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def _text_hint(cell: str) -> str:
    try:
        float(cell.replace(",", ".", 1))
    except ValueError:
        return "correct the file, or leave the row out with record.rows"
    return "write decimals with a point, or give record.decimal=','"
