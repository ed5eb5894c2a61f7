"""MATLAB files of versions 4 to 7: what they declare is counted before SciPy unpacks them.

A variable of version 5 is an element: a tag (type, bytes) and its content, perhaps deflated. An
array is the elements flags, sizes, name, numbers; a cell or struct holds further arrays instead of
numbers. Source: MathWorks, *MAT-File Format*, chapter 1.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from spiral.io.readers.containers import Allowance, series_in_array
from spiral.types.errors import InputError

_DEPTH = 12
_BLOCK = 1 << 20
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE = 1, 2, 3, 4, 5
_OPAQUE = (16, 17)  # functions and objects of newer classes, which hold no series
_NAME = 1 << 20  # bytes that a name or a list of sizes may take
_COMPLEX = 0x800
_NUMBER = 8  # bytes of a number as it is worked with, whatever the file keeps it as


def read_mat(given: str, path: Path) -> list[tuple[str, np.ndarray]]:
    """Series of a MATLAB file.

    Raises
    ------
    InputError : more than may be unpacked.
    """
    return [pair for k, v in mat_variables(given, path).items() for pair in _flatten_variable(k, v)]


def mat_variables(given: str, path: Path) -> dict[str, Any]:
    """Variables of a MATLAB file by name.

    Raises
    ------
    InputError : more than may be unpacked.
    """
    from scipy.io import loadmat, whosmat

    allowance = Allowance(given, path.stat().st_size)
    with path.open("rb") as file:
        if file.read(10) == b"MATLAB 5.0":
            _Declared(file, allowance).count()
        else:  # version 4, whose arrays lie in the file as they are
            for _, shape, kind in whosmat(path):
                allowance.take(0 if kind == "sparse" else _NUMBER * math.prod(shape))
    variables = loadmat(path, struct_as_record=True)
    return {k: v for k, v in variables.items() if not k.startswith("__")}


def _flatten_variable(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Series inside a variable: cells as ``name[0]``, structs as ``name.field``."""
    if not isinstance(value, np.ndarray) or depth > _DEPTH:
        return
    if value.dtype.names is None and value.dtype != object:
        yield from series_in_array(name, value)
        return
    items = value.ravel(order="F")
    for position, item in enumerate(items):
        if value.dtype.names is None:
            yield from _flatten_variable(f"{name}[{position}]", item, depth + 1)
            continue
        place = name if len(items) == 1 else f"{name}[{position}]"
        for part in value.dtype.names:
            yield from _flatten_variable(f"{place}.{part}", item[part], depth + 1)


class _Declared:
    """A walk over the elements of a file of version 5 that counts what its arrays unpack to."""

    def __init__(self, file: IO[bytes], allowance: Allowance) -> None:
        self._file, self._allowance = file, allowance
        file.seek(126)
        self._order = "<" if file.read(2) == b"IM" else ">"

    def count(self) -> None:
        """Every variable. A file that breaks off is left to the reader, which says so."""
        while len(tag := self._file.read(8)) == 8:
            kind, size = struct.unpack(self._order + "II", tag)
            after = self._file.tell() + size
            if kind == _COMPRESSED:
                self._count_element(_Inflated(self._file, size), 0)
            elif kind == _MATRIX:
                self._count_array(self._file, size, 0)
            self._file.seek(after)

    def _count_element(self, source: Any, depth: int) -> int:
        """One array with its tag; the bytes it takes."""
        tag = source.read(8)
        if len(tag) < 8:
            return 8
        kind, size = struct.unpack(self._order + "II", tag)
        if kind == _MATRIX:
            self._count_array(source, size, depth)
        else:
            _skip_bytes(source, size)
        return 8 + size

    def _count_array(self, source: Any, size: int, depth: int) -> None:
        """Count an array of so many bytes, and what lies in it."""
        flags, used = self._read_short_element(source)
        if len(flags) < 8:  # an empty array, or one that is none
            self._allowance.take(0)
            _skip_bytes(source, size - used)
            return
        first, most = struct.unpack(self._order + "II", flags[:8])
        kind = first & 0xFF
        if kind in _OPAQUE:
            self._allowance.take(size)
            _skip_bytes(source, size - used)
            return
        sizes, more = self._read_short_element(source)
        used += more
        count = len(sizes) // 4
        entries = math.prod(struct.unpack(f"{self._order}{count}I", sizes[: 4 * count]))
        if kind in (_CELL, _STRUCT, _OBJECT):
            self._count_contents(source, size - used, kind, entries, depth)
            return
        each = {_SPARSE: 2 * _NUMBER, _TEXT: 4}.get(kind, _NUMBER)
        count = most if kind == _SPARSE else entries
        self._allowance.take(count * each * (2 if first & _COMPLEX else 1))
        _skip_bytes(source, size - used)

    def _count_contents(self, source: Any, left: int, kind: int, entries: int, depth: int) -> None:
        """The arrays in a cell or struct, after the name and, of structs, the fields' names."""
        parts = []
        for _ in range({_CELL: 1, _STRUCT: 3, _OBJECT: 4}[kind]):
            content, used = self._read_short_element(source)
            parts.append(content)
            left -= used
        fields = 1
        if kind != _CELL:
            length = int.from_bytes(parts[-2], "little" if self._order == "<" else "big")
            fields = len(parts[-1]) // max(length, 1)
        self._allowance.take(8 * entries * fields)
        while left >= 8 and depth < _DEPTH:
            left -= self._count_element(source, depth + 1)
        _skip_bytes(source, left)

    def _read_short_element(self, source: Any) -> tuple[bytes, int]:
        """The content of a short element, and the bytes it takes with its tag and padding."""
        tag = source.read(8)
        if len(tag) < 8:
            return b"", 8
        kind, size = struct.unpack(self._order + "II", tag)
        if kind >> 16:  # four bytes or fewer lie in the tag itself
            return tag[4 : 4 + min(kind >> 16, 4)], 8
        if size > _NAME:
            raise InputError(f"{self._allowance.given}: a name of {size / 1e6:.3g} MB",
                             "a MATLAB file that is whole", "export it anew")  # fmt: skip
        padded = -(-size // 8) * 8
        return source.read(padded)[:size], 8 + padded


class _Inflated:
    """A deflated part of a file, read as far as is asked for."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self._file, self._left, self._packed = file, size, zlib.decompressobj()

    def read(self, count: int) -> bytes:
        """So many bytes, or fewer at the end."""
        unpacked = bytearray()
        while len(unpacked) < count and not self._packed.eof:
            packed = self._packed.unconsumed_tail
            if not packed:
                packed = self._file.read(min(self._left, 65536))
                self._left -= len(packed)
                if not packed:
                    break
            unpacked += self._packed.decompress(packed, count - len(unpacked))
        return bytes(unpacked)


def _skip_bytes(source: Any, count: int) -> None:
    """Pass over so many bytes, never holding more than a block."""
    while count > 0:
        part = len(source.read(min(count, _BLOCK)))
        if not part:
            return
        count -= part
