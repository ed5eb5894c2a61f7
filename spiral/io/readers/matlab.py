"""MATLAB files of versions 4 to 7: what they declare is counted before SciPy unpacks them.

SciPy trusts the types of elements, and a wrong one ends the whole process: they are checked, too.

A variable of version 5 is an element: a tag (type, bytes) and its content, perhaps deflated. An
array is the elements flags, sizes, name, numbers; a cell or struct holds further arrays instead of
numbers. Source: MathWorks, *MAT-File Format*, chapter 1.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator, Set
from pathlib import Path
from typing import IO, Any

import numpy as np

from spiral.io.readers.containers import Allowance, series_in_array
from spiral.types.errors import InputError

_DEPTH = 12  # of cells and structs inside each other
_BLOCK = 1 << 20
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE = 1, 2, 3, 4, 5
_OPAQUE = (16, 17)  # functions and objects of newer classes, which hold no series
_INT8, _INT32, _UINT32, _UTF8 = 1, 5, 6, 16
_NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))  # types of elements that hold numbers
_LETTERS = frozenset((1, 2, 3, 4, 16, 17, 18))
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
        names = None
        if file.read(10) == b"MATLAB 5.0":
            names = _Declared(file, allowance).count()
        else:  # version 4, whose arrays lie in the file as they are
            for _, shape, kind in whosmat(path):
                allowance.take(0 if kind == "sparse" else _NUMBER * math.prod(shape))
    variables = loadmat(path, struct_as_record=True, variable_names=names)
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


class _OpaqueError(Exception):
    """A function, or an object of a newer class: it holds no series, and is not read."""


class _Declared:
    """A walk over the elements of a file of version 5 that counts what its arrays unpack to."""

    def __init__(self, file: IO[bytes], allowance: Allowance) -> None:
        self._file, self._allowance = file, allowance
        file.seek(126)
        self._order = "<" if file.read(2) == b"IM" else ">"

    def count(self) -> list[str]:
        """Every variable; the names of those that hold no functions or objects of newer classes.

        A file that breaks off is left to the reader, which says so.
        """
        names = []
        while len(tag := self._file.read(8)) == 8:
            kind, size = struct.unpack(self._order + "II", tag)
            after = self._file.tell() + size
            try:
                if kind == _COMPRESSED:
                    names.append(self._count_element(_Inflated(self._file, size), 0))
                elif kind == _MATRIX:
                    names.append(self._count_array(self._file, size, 0))
            except _OpaqueError:
                self._allowance.take(size)
            self._file.seek(after)
        return names

    def _count_element(self, source: Any, depth: int) -> str:
        """One array with its tag; its name."""
        _, size, _ = self._read_tag(source, {_MATRIX})
        return self._count_array(source, size, depth)

    def _count_array(self, source: Any, size: int, depth: int) -> str:
        """Count an array of so many bytes, and what lies in it; its name."""
        self._allowance.take(0)
        if not size:
            return ""
        if depth > _DEPTH:
            raise self._damaged(f"arrays more than {_DEPTH} deep in each other")
        flags = self._read_short_element(source, {_UINT32})
        if len(flags) < 8:
            raise self._damaged("an array without a class")
        first, most = struct.unpack(self._order + "II", flags[:8])
        kind = first & 0xFF
        if kind in _OPAQUE:
            raise _OpaqueError
        sizes = self._read_short_element(source, {_INT32, _UINT32})
        count = len(sizes) // 4
        entries = math.prod(struct.unpack(f"{self._order}{count}I", sizes[: 4 * count]))
        name = self._read_short_element(source, {_INT8, _UTF8}).decode("latin1")
        if kind in (_CELL, _STRUCT, _OBJECT):
            self._count_contents(source, kind, entries, depth)
            return name
        each = {_SPARSE: 2 * _NUMBER, _TEXT: 4}.get(kind, _NUMBER)
        count = most if kind == _SPARSE else entries
        complex_ = bool(first & _COMPLEX)
        self._allowance.take(count * each * (2 if complex_ else 1))
        places = [{_INT32, _UINT32}] * 2 if kind == _SPARSE else []
        numbers = _LETTERS if kind == _TEXT else _NUMBERS
        for allowed in (*places, numbers, *[numbers] * complex_):
            self._skip_element(source, allowed)
        return name

    def _count_contents(self, source: Any, kind: int, entries: int, depth: int) -> None:
        """The arrays in a cell or struct, after the fields' names of a struct."""
        fields = 1
        if kind == _OBJECT:
            self._read_short_element(source, {_INT8, _UTF8})  # its class
        if kind != _CELL:
            length = self._read_short_element(source, {_INT32, _UINT32})
            names = self._read_short_element(source, {_INT8, _UTF8})
            order: Any = "little" if self._order == "<" else "big"
            fields = len(names) // max(int.from_bytes(length, order), 1)
        self._allowance.take(8 * entries * fields)
        for _ in range(entries * fields):
            self._count_element(source, depth + 1)

    def _read_tag(self, source: Any, allowed: Set[int]) -> tuple[int, int, bytes]:
        """Type, size and, of four bytes or fewer, content of an element; type 0 at the end."""
        tag = source.read(8)
        if len(tag) < 8:
            return 0, 0, b""
        kind, size = struct.unpack(self._order + "II", tag)
        short = kind >> 16
        kind, size = (kind & 0xFFFF, short) if short else (kind, size)
        if kind not in allowed or short > 4:
            raise self._damaged(f"an element of type {kind}, {size} bytes")
        return kind, size, tag[4 : 4 + size] if short else b""

    def _read_short_element(self, source: Any, allowed: Set[int]) -> bytes:
        """The content of a short element of an allowed type."""
        _, size, content = self._read_tag(source, allowed)
        if content or not size:
            return content
        if size > _NAME:
            raise self._damaged(f"a name of {size / 1e6:.3g} MB")
        return source.read(-(-size // 8) * 8)[:size]

    def _skip_element(self, source: Any, allowed: Set[int]) -> None:
        """Pass over an element of an allowed type."""
        _, size, content = self._read_tag(source, allowed)
        if not content:
            _skip_bytes(source, -(-size // 8) * 8)

    def _damaged(self, what: str) -> InputError:
        return InputError(
            f"{self._allowance.given}: {what}", "a MATLAB file that is whole", "export it anew"
        )


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
