"""Finding a file, and reading a table of text into columns of numbers."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spiral.errors import InputError, did_you_mean, near_misses

if TYPE_CHECKING:
    import pandas as pd

Array = np.ndarray

DATA_VARIABLE = "SPIRAL_DATA"
_OTHER_SEPARATORS = {";": "a semicolon", "\t": "a tab", "|": "a bar"}


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
        if place.is_file():
            return place
    if any(place.is_dir() for place in places):
        raise InputError(f"{given}: a folder", "a file", f"name one file: {_inside(places)}")
    looked = " or ".join(str(p.parent) for p in places)
    hint = _near(places)
    if not hint and not folder and not path.is_absolute():
        hint = f"give the full path, or set {DATA_VARIABLE} to the folder that holds it"
    raise InputError(f"file {given!r}", f"a file in {looked}", hint or "check the path")


def _inside(places: list[Path]) -> str:
    names = [p.name for place in places if place.is_dir() for p in sorted(place.iterdir())]
    return ", ".join(names[:5]) or "the folder is empty"


def _near(places: list[Path]) -> str:
    for place in places:
        if place.parent.is_dir():
            names = [p.name for p in place.parent.iterdir() if p.is_file()]
            near = near_misses(place.name, names)
            if near:
                return "did you mean " + " or ".join(str(place.parent / n) for n in near) + "?"
    return ""


@dataclass(frozen=True)
class Table:
    """A file's columns as text, numbers parsed on request.

    ``first_line`` is the line of the file that holds data row 0, for messages.
    """

    name: str
    frame: pd.DataFrame
    first_line: int = 2

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns; unnamed ones are left out."""
        names = [str(c).strip() for c in self.frame.columns]
        return tuple(n for n in names if n and not n.startswith("Unnamed:"))

    @property
    def rows(self) -> int:
        """Number of data rows."""
        return len(self.frame)

    def column(self, name: str, option: str, start: int, stop: int) -> Array:
        """Numbers of one column, rows [start, stop).

        Raises
        ------
        InputError : no such column, text among the numbers, or empty cells.
        """
        if name not in self.columns:
            raise InputError(
                f"column {name!r} of {self.name} ({option})",
                f"one of its columns: {', '.join(self.columns[:12])}",
                _column_hint(name, self.columns),
            )
        position = [str(c).strip() for c in self.frame.columns].index(name)
        return self._numbers(name, self.frame.iloc[start:stop, position], start)

    def _numbers(self, name: str, values: pd.Series, start: int) -> Array:
        import pandas as pd

        if not pd.api.types.is_numeric_dtype(values):
            parsed: Any = pd.to_numeric(values.astype(str).str.strip(), errors="coerce")
        else:
            parsed = values
        numbers = np.asarray(parsed, dtype=float)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if not len(bad):
            return numbers
        row = start + int(bad[0])
        cell = str(values.iloc[bad[0]]).strip()
        place = f"column {name!r} of {self.name}, row {row} (line {row + self.first_line})"
        if cell.lower() in ("", "nan", "na", "none", "null", "inf", "-inf"):
            raise InputError(
                f"{place}: {cell or 'an empty cell'}, one of {len(bad)} missing values",
                "a number in every row",
                f"cut the gap out with record.rows, for instance rows [{start}, {row}]",
            )
        raise InputError(f"{place}: text {cell!r}", "a number", _text_hint(cell, row))


def _column_hint(name: str, columns: tuple[str, ...]) -> str:
    if columns and all(_is_number(c) for c in columns):
        return "the first line holds numbers: add a line with the columns' names"
    return did_you_mean(name, columns)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _text_hint(cell: str, row: int) -> str:
    if _is_number(cell.replace(",", ".", 1)):
        return "write decimals with a point, or give record.decimal=','"
    if row == 0:
        return f"if row 0 holds units, start below it: record.rows='[1, STOP]' (got {cell!r})"
    return "correct the file, or leave the row out with record.rows"


def read_table(given: str, separator: str = ",", decimal: str = ".") -> Table:
    """A table from a CSV file (a line of names, then rows) or a Parquet file.

    Raises
    ------
    InputError : missing, empty, binary or broken files.
    """
    import pandas as pd

    path = find_file(given)
    if path.suffix == ".parquet":
        try:
            return Table(given, pd.read_parquet(path), first_line=0)
        except Exception as error:  # pyarrow raises a family of its own
            raise InputError(f"{given}: {_first(error)}", "a Parquet file") from error
    _check_text(given, path, separator)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # cells without a name
            frame = pd.read_csv(
                path, sep=separator, decimal=decimal, skipinitialspace=True, low_memory=False,
                skip_blank_lines=False, encoding="utf-8-sig", index_col=False,
                encoding_errors="replace",
            )  # fmt: skip
    except pd.errors.EmptyDataError as error:
        raise InputError(f"{given}: no columns", "a line of names, then numbers") from error
    except (pd.errors.ParserError, pd.errors.ParserWarning, ValueError, TypeError) as error:
        raise InputError(
            f"{given}: rows with other numbers of cells than the line of names ({_first(error)})",
            "as many cells in every row",
            f"check record.separator={separator!r} and record.decimal={decimal!r}",
        ) from error
    if not len(frame):
        raise InputError(f"{given}: a line of names and no rows", "rows of numbers")
    return Table(given, frame)


def _check_text(given: str, path: Path, separator: str) -> None:
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError as error:
        raise InputError(f"{given}: {error.strerror}", "a file that can be read") from error
    if not head.strip():
        raise InputError(
            f"{given}: an empty file" if not head else f"{given}: only blank lines",
            "a line of names, then rows of numbers",
        )
    if b"\0" in head or any(byte < 9 for byte in head):
        raise InputError(
            f"{given}: a binary file", "a text file with separated columns", "export it as CSV"
        )
    names = head.decode("utf-8", errors="replace").splitlines()[0]
    for other, word in _OTHER_SEPARATORS.items():
        if other in names and separator not in names:
            raise InputError(
                f"{given}: one column named {names[:60]!r}",
                f"columns separated by {separator!r}",
                f"the separator looks like {word}: record.separator='{other}'",
            )


def _first(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
