"""Calls of C functions by their address, and locks, for compiled loops."""

from __future__ import annotations

from typing import Any

import numba as nb
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

_FLOATS, _WHOLE = types.CPointer(types.float64), types.CPointer(types.int64)
KERNEL = types.void(_WHOLE, _FLOATS, _FLOATS, _WHOLE, types.int64, _FLOATS, _FLOATS)
"""kernel(whole, numbers, arguments, columns, count, values, slopes).

``whole`` and ``numbers`` are a program's own. ``values`` (rows) are written, and ``slopes`` (count,
rows) by the arguments numbered in ``columns``.
"""
_POINTER = ir.IntType(64)


def _invoke(typingctx: Any, address: Any, given: Any) -> Any:

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        values = [builder.extract_value(args[1], i) for i in range(len(given))]
        kind = ir.FunctionType(ir.IntType(32), [v.type for v in values])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), values)

    return types.int32(types.int64, given), codegen


def _compare_exchange(typingctx: Any, address: Any, due: Any, new: Any) -> Any:

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        place = builder.inttoptr(args[0], _POINTER.as_pointer())
        pair = builder.cmpxchg(place, args[1], args[2], "acq_rel", "monotonic")
        return builder.extract_value(pair, 1)

    return types.boolean(types.int64, types.int64, types.int64), codegen


invoke: Any = intrinsic(_invoke)
"""invoke(address, given): the status of a C function for a tuple of integers and floats."""
exchanged: Any = intrinsic(_compare_exchange)
"""exchanged(address, due, new): whether the integer there was ``due``; then it is ``new`` now."""
carray: Any = getattr(nb, "carray")  # noqa: B009  (of which the stubs of Numba know nothing)


@nb.njit(cache=True, nogil=True)
def evaluate_along(address, whole, numbers, given, columns, values, slopes):
    """A kernel at every row of ``given`` (points, arguments).

    ``values`` (points, rows), ``slopes`` (points, columns, rows).
    """
    for i in range(len(given)):
        invoke(
            address,
            (
                whole.ctypes.data, numbers.ctypes.data, given[i].ctypes.data,
                columns.ctypes.data, len(columns), values[i].ctypes.data, slopes[i].ctypes.data,
            ),
        )  # fmt: skip


def store(into, first, values):
    """``into[first:] = values``, of a tuple, a list or an array; in compiled code alone."""
    raise NotImplementedError


@overload(store)
def _overload_store(into, first, values):
    if not isinstance(values, types.BaseTuple):
        return _store_all
    return _store_none if len(values) == 0 else _store_tuple


def _store_all(into, first, values):
    for i in range(len(into)):
        into[i] = values[i]


def _store_none(into, first, values):
    return None


def _store_tuple(into, first, values):
    into[first] = values[0]
    store(into, first + 1, values[1:])
