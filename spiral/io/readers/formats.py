"""Files of numbers read into tables of named columns; which reader is told by the content.

Arrays inside containers are addressed as in the file's own language: ``group/name`` (HDF5, TDMS;
``sheet/column`` of a workbook where several sheets hold tables),
``struct.field`` and ``cell[0]`` (MATLAB). A matrix is a set of series along its longer side:
``name[1]`` is the second one, counted from zero.
"""

from __future__ import annotations

import codecs
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from spiral.io.readers.containers import (
    Allowance,
    Hdf5,
    npz_arrays,
    parquet_columns,
    series_in_array,
)
from spiral.io.readers.dialect import Dialect, find_dialect, units_in_names
from spiral.io.readers.limits import time_limit, within_seconds
from spiral.io.readers.matlab import read_mat
from spiral.io.readers.table import Table, error_first_line, find_file
from spiral.io.readers.workbook import SEPARATOR, is_workbook, sheet_texts
from spiral.types.errors import ConfigError, InputError

EXTRA = "formats"
_HEAD = 65536
_HDF5 = b"\x89HDF\r\n\x1a\n"
_EXTENSIONS = {
    ".mat": "mat", ".npz": "npz", ".parquet": "parquet", ".h5": "hdf5", ".hdf5": "hdf5",
    ".hdf": "hdf5", ".uff": "uff", ".unv": "uff", ".tdms": "tdms", ".xlsx": "xlsx",
}  # fmt: skip
_WORDS = {
    "mat": "a MATLAB file (version 5 to 7.3)", "npz": "an NPZ file", "parquet": "a Parquet file",
    "hdf5": "an HDF5 file", "uff": "a UFF file", "tdms": "a TDMS file",
    "xlsx": "an Excel workbook",
}  # fmt: skip


def read_table(
    given: str, separator: str | None = None, decimal: str | None = None, only_text: bool = False
) -> Table:
    """The table in a file, named as it is or under ``SPIRAL_DATA``.

    Parameters
    ----------
    separator, decimal : how a text file writes columns and fractions; found where left out.
    only_text : refuse what is neither text nor Parquet.

    Raises
    ------
    InputError : a missing, empty or broken file, one with no column of numbers, or one that takes
        longer to read than a file of its size may.
    ConfigError : a library that reads this format is not installed.
    MemoryError : more numbers than there is memory.
    """
    path = find_file(given)
    with within_seconds(time_limit(path.stat().st_size)):
        return _add_units_in_names(_read_by_format(given, path, separator, decimal, only_text))


def _read_by_format(
    given: str, path: Path, separator: str | None, decimal: str | None, only_text: bool
) -> Table:
    """The table of a file by its reader."""
    head = _read_head(given, path)
    kind = detect_format(head, path.suffix)
    if kind == "npz" and is_workbook(path):
        kind = "xlsx"
    if kind == "text" or (only_text and kind != "parquet"):
        return read_text(given, path, head, separator, decimal)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table = _READERS[kind](given, path)
    except (InputError, ConfigError, MemoryError):
        raise
    except Exception as error:  # each library raises a family of its own
        raise InputError(
            f"{given}: {error_first_line(error)}", f"{_WORDS[kind]} that is whole", "export it anew"
        ) from error
    if not table.columns:
        raise InputError(f"{given}: {_WORDS[kind]} without a series", "columns of numbers")
    return table


def _add_units_in_names(table: Table) -> Table:
    """The table with the units that its columns' names hold, where the file says no other."""
    return replace(table, units={**units_in_names(table.columns), **table.units})


def detect_format(head: bytes, suffix: str) -> str:
    """The format of a file by its first bytes, else by its extension, else text."""
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"MATLAB 5.0"):
        return "mat"
    if head.startswith((b"MATLAB 7.3", _HDF5)) or head[512:520] == _HDF5:
        return "hdf5"
    if head.startswith(b"TDSm"):
        return "tdms"
    if head.startswith(b"PK\x03\x04"):
        return "npz"
    if head.startswith(b"    -1"):
        return "uff"
    return _EXTENSIONS.get(suffix.lower(), "text")


def is_text(path: Path) -> bool:
    """Whether a file is read as text, whatever stands between its columns."""
    try:
        head = _read_head(path.name, path)
        return detect_format(head, path.suffix) == "text" and bool(_detect_encoding("", head))
    except InputError:
        return False


def read_text(
    given: str, path: Path | BytesIO, head: bytes, separator: str | None = None,
    decimal: str | None = None,
) -> Table:  # fmt: skip
    """A table from a text file: a line of names, perhaps a row of units, rows of numbers."""
    encoding = _detect_encoding(given, head)
    text = codecs.getincrementaldecoder(encoding)("replace").decode(head)
    if len(head) == _HEAD and "\n" in text:
        text = text[: text.rindex("\n") + 1]
    dialect = find_dialect(given, text, separator, decimal)
    frame = _parse_rows(given, path, dialect, encoding)
    filled = frame.notna().any(axis=1).to_numpy()
    if filled.any():  # blank lines at the end are no rows
        frame = frame.iloc[: len(filled) - int(filled[::-1].argmax())]
    words = dialect.in_words() + {"utf-16": ", UTF-16", "cp1252": ", Latin-1"}.get(encoding, "")
    if head.startswith(codecs.BOM_UTF8):
        words += ", byte order mark left out"
    values = {str(name): frame[name] for name in dialect.names}
    notes = (f"{Path(given).name}: {words}",)
    return Table(given, values, dialect.units, notes, dialect.first + 1, dialect.decimal)


def _parse_rows(given: str, path: Path | BytesIO, dialect: Dialect, encoding: str) -> Any:
    """The rows of a text file under its names, as a DataFrame."""
    import pandas as pd

    padding = [f"\0{i}" for i in range(len(dialect.names), dialect.width)]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # cells without a name
            return pd.read_csv(
                path, sep=dialect.separator, decimal=dialect.decimal, skipinitialspace=True,
                low_memory=False, skip_blank_lines=False, encoding=encoding, index_col=False,
                encoding_errors="replace", header=None, names=[*dialect.names, *padding],
                skiprows=dialect.first, compression=None,
            )  # fmt: skip
    except (pd.errors.EmptyDataError, pd.errors.ParserError, pd.errors.ParserWarning,
            ValueError, TypeError, OverflowError) as error:  # fmt: skip
        if "out of memory" in str(error):
            raise MemoryError from error
        raise InputError(
            f"{given}: rows with other numbers of cells than the line of names "
            f"({error_first_line(error)})",
            "as many cells in every row",
            f"read as: {dialect.in_words()}; correct with record.separator and record.decimal",
        ) from error


def _read_head(given: str, path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise InputError(f"{given}: {error.strerror}", "a file that can be read") from error
    if not head.strip():
        raise InputError(
            f"{given}: an empty file" if not head else f"{given}: only blank lines",
            "a line of names, then rows of numbers",
        )
    return head


def _detect_encoding(given: str, head: bytes) -> str:
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if any(byte < 9 for byte in head):
        raise InputError(
            f"{given}: a binary file",
            "a text file with separated columns",
            "record=file reads MAT, NPZ, HDF5, Parquet, UFF, TDMS and xlsx; else export it as CSV",
        )
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8-sig"


def _make_table(given: str, kind: str, series: Iterator[tuple[str, Any]], **more: Any) -> Table:
    values = dict(series)
    return Table(given, values, notes=(f"{Path(given).name}: {_WORDS[kind]}",), **more)


def _read_parquet(given: str, path: Path) -> Table:
    allowance = Allowance(given, path.stat().st_size)
    table = _make_table(given, "parquet", iter(parquet_columns(path, allowance)))
    return replace(table, notes=(*table.notes, *allowance.notes()))


def _read_npz(given: str, path: Path) -> Table:
    return _make_table(
        given,
        "npz",
        (
            pair
            for name, array in npz_arrays(given, path).items()
            for pair in series_in_array(name, array)
        ),
    )


def _read_mat(given: str, path: Path) -> Table:
    return _make_table(given, "mat", iter(read_mat(given, path)))


def _read_hdf5(given: str, path: Path) -> Table:
    h5py = _import_library("h5py", given)
    walk = Hdf5(h5py, Allowance(given, path.stat().st_size))
    with h5py.File(path, "r") as file:
        series = list(walk.series(file))
    table = _make_table(given, "hdf5", iter(series), units=walk.units)
    return replace(table, notes=(*table.notes, *walk.allowance.notes()))


def _read_uff(given: str, path: Path) -> Table:
    """Time responses of type 58: ``data[0]``, ``data[1]`` ... in the file's order, and ``time``."""
    pyuff = _import_library("pyuff", given)
    sets = pyuff.UFF(str(path)).read_sets()
    sets = sets if isinstance(sets, list) else [sets]
    functions = [s for s in sets if s.get("type") == 58 and not np.iscomplexobj(s["data"])]
    if not functions:
        kinds = sorted({str(s.get("type")) for s in sets})
        raise InputError(
            f"{given}: no series of type 58 (there are {', '.join(kinds) or 'no sets'})",
            "real functions of time",
            "export time responses, not spectra",
        )
    series: list[tuple[str, Any]] = [(f"data[{i}]", s["data"]) for i, s in enumerate(functions)]
    first = np.asarray(functions[0]["x"])
    if all(np.array_equal(first, s["x"]) for s in functions):
        series.append(("time", first))
    listed = ", ".join(f"data[{i}] {_describe_response(s)}" for i, s in enumerate(functions[:12]))
    table = _make_table(given, "uff", iter(series))
    return Table(given, table.values, notes=(f"{table.notes[0]}: {listed}",))


def _describe_response(function: dict[str, Any]) -> str:
    identity = str(function.get("id1", "")).strip()
    node = f"node {function.get('rsp_node', '?')} direction {function.get('rsp_dir', '?')}"
    return f"{identity} ({node})" if identity and identity.upper() != "NONE" else node


def _read_tdms(given: str, path: Path) -> Table:
    """Channels as ``group/name``; ``time`` from the sample interval where all have the same."""
    nptdms = _import_library("nptdms", given)
    allowance = Allowance(given, path.stat().st_size)
    units: dict[str, str] = {}
    series: list[tuple[str, Any]] = []
    steps = set()
    with nptdms.TdmsFile.open(path) as file:
        for channel in (c for group in file.groups() for c in group.channels()):
            allowance.take_array(len(channel), channel.dtype)
            name = f"{channel.group_name}/{channel.name}"
            for label, values in series_in_array(name, channel[:]):
                series.append((label, values))
                unit = str(channel.properties.get("unit_string", "")).strip()
                if unit:
                    units[label] = unit
                steps.add((len(values), float(channel.properties.get("wf_increment", 0.0))))
    if len(steps) == 1 and min(steps)[1] > 0:
        count, step = steps.pop()
        series.append(("time", step * np.arange(count)))
    return _make_table(given, "tdms", iter(series), units=units)


def _read_workbook(given: str, path: Path) -> Table:
    """The columns of the only sheet with numbers by their names, of several as ``sheet/column``."""
    tables: dict[str, Table] = {}
    refused: dict[str, InputError] = {}
    for sheet, text in sheet_texts(given, path, _import_library("openpyxl", given)):
        rows = text.encode()
        try:
            named = f"{given}, sheet {sheet!r}"
            tables[sheet] = read_text(named, BytesIO(rows), rows[:_HEAD], SEPARATOR, ".")
        except InputError as error:
            refused[sheet] = error
    if refused and not tables:
        raise next(iter(refused.values()))
    one = len(tables) == 1
    series = {c if one else f"{n}/{c}": v for n, t in tables.items() for c, v in t.values.items()}
    units = {c if one else f"{n}/{c}": u for n, t in tables.items() for c, u in t.units.items()}
    left = f"; left out {', '.join(map(repr, refused))}" if refused else ""
    words = f"{Path(given).name}: {_WORDS['xlsx']}, sheet {', '.join(map(repr, tables))}{left}"
    lines = {t.first_line for t in tables.values()}
    return Table(given, series, units, (words,), lines.pop() if one else None)


def _import_library(name: str, given: str) -> Any:
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"{given} without the library {name}",
            f"the extra {EXTRA!r} of spiral-po",
            f"pip install 'spiral-po[{EXTRA}]'",
        ) from error


_READERS: dict[str, Callable[[str, Path], Table]] = {
    "parquet": _read_parquet, "mat": _read_mat, "npz": _read_npz, "hdf5": _read_hdf5,
    "uff": _read_uff, "tdms": _read_tdms, "xlsx": _read_workbook,
}  # fmt: skip
