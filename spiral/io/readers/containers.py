"""Arrays of untrusted HDF5, NPZ and Parquet files: limited size, no link cycles or other files.

What a file declares is counted before it is unpacked. Links that lead nowhere, in a circle or into
another file are left out and named.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from spiral.types.errors import InputError

UNPACKED = 400_000_000  # bytes that any file may unpack to, however small it is
_RATIO = 8  # of unpacked to packed bytes, which measured numbers hardly exceed
_ITEMS = 20_000  # groups, datasets and cells that are looked at
_DEPTH = 12
_NUMBER, _OBJECT = 16, 100  # bytes of a number and of an object in a column, read and handed on
_FLOAT = 8  # bytes of a number as it is worked with, whatever the file keeps it as
_LONGEST = 400  # letters of a cell of text that may stand for a number or a time
_NAMED = 5  # items left out that are named


@dataclass
class Allowance:
    """How much of a file may still be looked at and unpacked, and what was left out of it."""

    given: str
    size: int
    bytes: int = 0
    items: int = 0
    left_out: list[str] = field(default_factory=list)

    def take(self, count: int, passing: int = 0) -> None:
        """Count one item that unpacks to so many bytes, and takes more while it is read.

        Raises
        ------
        InputError : too many of either.
        """
        self.items, self.bytes = self.items + 1, self.bytes + count
        most = max(UNPACKED, _RATIO * self.size)
        needed = self.bytes + passing
        if needed > most:
            raise InputError(
                f"{self.given}: {self.size / 1e6:.3g} MB that unpack to {needed / 1e9:.3g} GB "
                "or more", f"at most {most / 1e9:.3g} GB of numbers", "keep the columns you need",
            )  # fmt: skip
        if self.items > _ITEMS:
            raise InputError(f"{self.given}: more than {_ITEMS} arrays and groups",
                             "a file of measurements", "keep the groups you need")  # fmt: skip

    def take_array(self, count: int, dtype: np.dtype[Any], passing: int = 0) -> None:
        """Count an array of so many items, whose numbers are worked with as float64.

        Raises
        ------
        InputError : too many.
        """
        self.take(count * item_bytes(dtype), passing)

    def notes(self) -> tuple[str, ...]:
        """What was left out, in words."""
        if not self.left_out:
            return ()
        more = ", ..." if len(self.left_out) > _NAMED else ""
        return (f"{Path(self.given).name}: left out {', '.join(self.left_out[:_NAMED])}{more}",)


def item_bytes(dtype: np.dtype[Any]) -> int:
    """Bytes of an item where it is read or worked with, whichever is more."""
    return max(dtype.itemsize, _FLOAT * len(dtype.names or "x"))


def series_in_array(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """The one-dimensional series of an array: itself, the lines of a matrix, a record's fields."""
    array = np.asarray(value)
    if array.dtype.names and array.ndim == 1:
        for part in array.dtype.names:
            yield from series_in_array(f"{name}.{part}", array[part])
        return
    if array.dtype.kind not in "biuf" or array.size < 2:
        return
    lines = np.squeeze(array)
    if lines.ndim == 1:
        yield name, lines
    elif lines.ndim == 2:
        lines = lines if lines.shape[0] < lines.shape[1] else lines.T
        yield from ((f"{name}[{i}]", line) for i, line in enumerate(lines))


def npz_arrays(given: str, path: Path) -> dict[str, np.ndarray]:
    """Arrays of an NPZ file, whose table of contents says how large each is.

    Raises
    ------
    InputError : no NPZ file, Python objects in it, or more than may be unpacked.
    """
    if not zipfile.is_zipfile(path):
        raise InputError(f"{given}: no NPZ file", "named arrays in an NPZ file", "numpy.savez")
    allowance = Allowance(given, path.stat().st_size)
    with zipfile.ZipFile(path) as packed:
        for member in packed.infolist():
            allowance.take(max(member.file_size, _declared_bytes(packed, member)))
    with np.load(path, allow_pickle=False) as arrays:
        return {name: _load_array(given, arrays, name) for name in arrays.files}


def _load_array(given: str, arrays: Any, name: str) -> np.ndarray:
    """One array; Python objects are never loaded, since loading them runs what they hold."""
    try:
        return arrays[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise InputError(
            f"{given}: {name!r} holds Python objects", "arrays of numbers",
            f"numpy.savez(FILE, {name}=numpy.asarray({name}, float))",
        ) from error  # fmt: skip


def _declared_bytes(packed: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Bytes of the numbers that an array's own head promises; none where it has no such head."""
    with packed.open(member) as file:
        try:
            version = np.lib.format.read_magic(file)
            reads = np.lib.format
            head = reads.read_array_header_1_0 if version == (1, 0) else reads.read_array_header_2_0
            shape, _, dtype = head(file)
        except ValueError:
            return 0
    return math.prod(shape) * item_bytes(dtype)


def parquet_columns(path: Path, allowance: Allowance) -> list[tuple[str, Any]]:
    """Columns of a Parquet file, whose footer says how many rows there are.

    A column of one value takes a few bytes, however many rows it has. Text is read as a dictionary,
    so that a value that repeats is held once; columns of lists and structs are left out and named.

    Raises
    ------
    InputError : more than may be unpacked.
    """
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as opened:
        about, schema = opened.metadata, opened.schema_arrow
    nested = {f.name for f in schema if pa.types.is_nested(f.type)}
    plain = {f.name for f in schema if pa.types.is_primitive(f.type)}
    kept = [name for name in schema.names if name not in nested]
    text = set(kept) - plain
    allowance.left_out += [f"{name} (lists or structs)" for name in schema.names if name in nested]
    for group in map(about.row_group, range(about.num_row_groups)):
        columns = map(group.column, range(group.num_columns))
        allowance.take(sum(column.total_uncompressed_size for column in columns))
    allowance.take(about.num_rows * (_NUMBER * len(plain) + _OBJECT * len(text)))
    with pq.ParquetFile(path, read_dictionary=list(text)) as opened:
        frame = opened.read(columns=kept).to_pandas()
    columns_read = []
    for column in frame.columns:
        name, values = str(column), frame[column]
        shared = isinstance(values.dtype, pd.CategoricalDtype)
        words = map(str, values.dtype.categories) if shared else ()
        if max(map(len, words), default=0) > _LONGEST:
            allowance.left_out.append(f"{name} (long texts)")
            continue
        columns_read.append((name, values.astype(object) if name in text else values))
    return columns_read


def _follow_link(group: Any, key: str) -> Any:
    """What a name of a group leads to, or nothing."""
    try:
        return group.get(key)
    except (KeyError, OSError, RuntimeError):  # links that lead to one another
        return None


@dataclass
class Hdf5:
    """A walk through an HDF5 file: ``units`` of its series as their attributes say."""

    h5py: Any
    allowance: Allowance
    units: dict[str, str] = field(default_factory=dict)

    def series(self, group: Any, prefix: str = "", inside: tuple[Any, ...] = ()) -> Iterator[Any]:
        """Series of a group; ``inside`` are the groups that it lies in."""
        for key in group:
            if key.startswith("#"):
                continue
            name = prefix + key
            if isinstance(group.get(key, getlink=True), self.h5py.ExternalLink):
                self.allowance.left_out.append(f"{name} (a link into another file)")
                continue
            item = _follow_link(group, key)
            if item is None:
                self.allowance.left_out.append(f"{name} (a link to nothing)")
                continue
            yield from self._item_series(name, item, (*inside, group))

    def _item_series(self, name: str, item: Any, inside: tuple[Any, ...]) -> Iterator[Any]:
        """Series of a group, a dataset, or the cells and structs of MATLAB 7.3."""
        if len(inside) > _DEPTH:
            return
        if isinstance(item, self.h5py.Group):
            self.allowance.take(0)
            if any(item == outer for outer in inside):
                self.allowance.left_out.append(f"{name} (a link to a group that it lies in)")
                return
            separator = "." if "MATLAB_class" in item.attrs else "/"
            yield from self.series(item, name + separator, inside)
        elif isinstance(item, self.h5py.Dataset):
            yield from self._dataset_series(name, item, inside)

    def _dataset_series(self, name: str, item: Any, inside: tuple[Any, ...]) -> Iterator[Any]:
        if item.external or item.is_virtual:
            self.allowance.left_out.append(f"{name} (kept in another file)")
            return
        reference = self.h5py.check_ref_dtype(item.dtype) is not None
        if not reference and item.dtype.kind not in "biufV":  # text and the like
            return
        if "MATLAB_class" in item.attrs and "MATLAB_empty" in item.attrs:
            return
        piece = math.prod(item.chunks or (0,)) * item.dtype.itemsize  # is unpacked whole
        self.allowance.take_array(item.size, item.dtype, piece)
        if reference:
            # MATLAB counts the cells along columns; HDF5 holds the transposed array.
            for position, cell in enumerate(np.asarray(item[()]).ravel()):
                if cell:
                    yield from self._item_series(
                        f"{name}[{position}]", item.file[cell], (*inside, item)
                    )
            return
        unit = item.attrs.get("units", item.attrs.get("unit", ""))
        for label, values in series_in_array(name, item[()]):
            if isinstance(unit, str | bytes) and unit:
                said = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
                self.units[label] = said
            yield label, values
