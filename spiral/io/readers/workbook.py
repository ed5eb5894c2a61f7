"""Sheets of untrusted Excel workbooks (xlsx, xlsm) as text, to be read like other tables in text.

Cells hold the values that were there when the file was saved; no formula is computed. What the
archive declares is counted before it is unpacked.
"""

from __future__ import annotations

import datetime as dt
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spiral.io.readers.containers import Allowance
from spiral.types.errors import InputError

_UNPACKED = 200_000_000  # bytes of XML that a workbook may unpack to
_MARK = "xl/workbook."
_OTHERS = ("content.xml", "Index/Document.iwa")  # of ODS, of Numbers
SEPARATOR = "\t"


def is_workbook(path: Path) -> bool:
    """Whether a zip archive holds a workbook of any program, not arrays."""
    return any(name.startswith((_MARK, *_OTHERS)) for name in _unpacked_sizes(path))


def sheet_texts(given: str, path: Path, openpyxl: Any) -> Iterator[tuple[str, str]]:
    """The name of each sheet that has cells, and its rows as lines, cells parted by tabs.

    Raises
    ------
    InputError : a workbook of another program, or one that unpacks to too much.
    """
    sizes = _unpacked_sizes(path)
    if f"{_MARK}xml" not in sizes:
        raise InputError(
            f"{given}: a spreadsheet that is no Excel workbook (xlsx)",
            "CSV or xlsx",
            "save it as one of these in the program that made it",
        )
    if (unpacked := sum(sizes.values())) > _UNPACKED:
        raise InputError(
            f"{given}: a workbook of {unpacked / 1e6:.0f} MB when unpacked",
            f"at most {_UNPACKED / 1e6:.0f} MB",
            "save the sheet as CSV",
        )
    allowance = Allowance(given, path.stat().st_size)
    with path.open("rb") as file:  # its name may end in anything
        book = openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # what the sheet says of its size is not to be trusted
            lines = [_line_of(row) for row in sheet.iter_rows(values_only=True)]
            width = max((line.count(SEPARATOR) for line in lines), default=0)
            while lines and not lines[-1]:
                lines.pop()
            allowance.take(sum(map(len, lines)) + width * len(lines))
            lines = [line + SEPARATOR * (width - line.count(SEPARATOR)) for line in lines]
            text = "\n".join(lines).rstrip()
            if text:
                yield sheet.title, text + "\n"


def _unpacked_sizes(path: Path) -> dict[str, int]:
    """What an archive declares of its members, in bytes; nothing where it is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {member.filename: member.file_size for member in archive.infolist()}
    except (zipfile.BadZipFile, OSError):
        return {}


def _line_of(row: tuple[Any, ...]) -> str:
    """A row as text, without the empty cells at its end."""
    filled = len(row)
    while filled and row[filled - 1] is None:
        filled -= 1
    return SEPARATOR.join(_cell_text(value) for value in row[:filled])


def _cell_text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, dt.timedelta):
        return repr(value.total_seconds())
    if isinstance(value, (dt.datetime, dt.date, dt.time)):
        return value.isoformat()
    return " ".join(value.split()) if isinstance(value, str) else repr(value)
