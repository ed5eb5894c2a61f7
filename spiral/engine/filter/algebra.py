"""Covariance algebra of the filters as LLVM code that takes four numbers (lanes) at a time.

    product      C = A B
    lower        the lower half of C = A B, where C is symmetric
    sparse       C = A B of a matrix A with few entries that are not zero
    absorb       one scalar measurement: s = c P c^T + r, K = P c^T / s, x <- x + K e,
                 P <- (I - K c) P (I - K c)^T + K r K^T, and beside it d = c S + h_p,
                 S <- S - K d

Matrices have rows and columns of a multiple of four, zeros behind those of use
(``spiral.physics.lanes``). P and S stand side by side in one matrix M = [P | S], so that both are
carried by one product.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

from llvmlite import ir
from numba import types

from spiral.physics.compile import ModelFunction, begin_function, end_function, engine_of
from spiral.physics.emit import DOUBLE, number
from spiral.physics.lanes import (
    FUSED,
    LANES,
    ZEROS,
    add_product,
    broadcast_lanes,
    for_loop,
    index,
    load_lanes,
    store_lanes,
)

_V, _M = types.float64[::1], types.float64[:, ::1]
_F, _I = types.float64, types.int64
_I1 = types.int64[::1]
PRODUCT = types.FunctionType(types.void(_M, _M, _M, _I, _I))
"""product(A, B, C, rows, inner): C = A B in these rows, sums over ``inner``; C is another array."""
SPARSE = types.FunctionType(types.void(_V, _I1, _I1, _M, _M, _I))
"""sparse(values, columns, ends, B, C, first): rows of C, and of B, from ``first`` on.

The entries of row i of A are ``values[ends[i]:ends[i + 1]]``, in these ``columns``; C is another
array.
"""
ABSORB = types.FunctionType(types.float64(_V, _M, _M, _M, _I, _F, _F, _V, _V))
"""absorb(x, M, C, D, j, r, e, gain, work) -> s, with row j of C.

Row j of D is h_p before and d after; x, M and gain are written, ``work`` is scratch.
"""

_ROWS, _WIDE = 4, 3  # rows, and lanes of columns, of the block of C that is held in registers


@dataclass(frozen=True)
class Algebra:
    """The compiled functions."""

    product: Any
    lower: Any
    sparse: Any
    absorb: Any


@cache
def compiled_algebra() -> Algebra:
    """The functions, compiled once for a process."""
    module = ir.Module("algebra")
    _write_product(module, "product", lower=False)
    _write_product(module, "lower", lower=True)
    _write_sparse(module)
    _write_absorb(module)
    engine = engine_of(module)
    return Algebra(
        ModelFunction(PRODUCT, engine, "product"),
        ModelFunction(PRODUCT, engine, "lower"),
        ModelFunction(SPARSE, engine, "sparse"),
        ModelFunction(ABSORB, engine, "absorb"),
    )


def _write_product(module: ir.Module, name: str, lower: bool) -> None:
    """Blocks of four rows and up to twelve columns of C, each a sum over the columns of A.

    ``lower``: no columns beyond the block on the diagonal.
    """
    b, (first, second, out, rows, inner) = begin_function(module, name, PRODUCT)
    data = tuple(b.extract_value(m, 4) for m in (first, second, out))
    strides = tuple(b.extract_value(m, [5, 1]) for m in (first, second, out))
    with for_loop(b, rows, _ROWS) as row:
        width = b.add(row, index(_ROWS)) if lower else strides[1]
        for column, lanes in _blocks_of_columns(b, width):
            _write_block(b, data, strides, inner, row, column, lanes)
    end_function(b)


def _blocks_of_columns(b: ir.IRBuilder, width: Any) -> Iterator[tuple[Any, int]]:
    """Loops over a row: its columns in blocks of twelve, then in fours."""
    block = index(LANES * _WIDE)
    full = b.mul(b.sdiv(width, block), block)
    with b.if_then(b.icmp_signed(">", full, index(0))), for_loop(b, full, LANES * _WIDE) as at:
        yield at, _WIDE
    rest = b.sub(width, full)
    with b.if_then(b.icmp_signed("<", full, width)), for_loop(b, rest, LANES) as more:
        yield b.add(full, more), 1


def _write_block(
    b: ir.IRBuilder, data: tuple[Any, ...], strides: tuple[Any, ...], inner: Any, row: Any,
    column: Any, lanes: int,
) -> None:  # fmt: skip
    """Four rows and some lanes of columns of C."""
    left, right, result = data
    rows = [b.add(row, index(i)) for i in range(_ROWS)]
    at = [b.mul(r, strides[0]) for r in rows]
    sums = [ZEROS] * (_ROWS * lanes)
    with for_loop(b, inner, sums=sums) as k:
        start = b.add(b.mul(k, strides[1]), column)
        others = [load_lanes(b, right, b.add(start, index(LANES * j))) for j in range(lanes)]
        for i in range(_ROWS):
            own = broadcast_lanes(b, b.load(b.gep(left, [b.add(at[i], k)])))
            for j in range(lanes):
                sums[i * lanes + j] = add_product(b, sums[i * lanes + j], own, others[j])
    for i in range(_ROWS):
        start = b.add(b.mul(rows[i], strides[2]), column)
        for j in range(lanes):
            store_lanes(b, sums[i * lanes + j], result, b.add(start, index(LANES * j)))


def _write_sparse(module: ir.Module) -> None:
    """Row by row of C, each a sum over the entries of the row of A."""
    b: Any
    b, args = begin_function(module, "sparse", SPARSE)
    values, columns, ends, other, out = (b.extract_value(a, 4) for a in args[:5])
    first, width = args[5], b.extract_value(args[3], [5, 1])
    rows = b.sub(b.extract_value(args[2], [5, 0]), index(1))
    with b.if_then(b.icmp_signed(">", rows, index(0))), for_loop(b, rows) as i:
        begin, end = (b.load(b.gep(ends, [b.add(i, index(more))])) for more in (0, 1))
        count, start = b.sub(end, begin), b.mul(b.add(first, i), width)
        for column, lanes in _blocks_of_columns(b, width):
            places = [b.add(b.add(start, column), index(LANES * j)) for j in range(lanes)]
            for place in places:
                store_lanes(b, ZEROS, out, place)
            with b.if_then(b.icmp_signed(">", count, index(0))):
                sums = [ZEROS] * lanes
                with for_loop(b, count, sums=sums) as e:
                    at = b.add(begin, e)
                    row = b.add(first, b.load(b.gep(columns, [at])))
                    weight = broadcast_lanes(b, b.load(b.gep(values, [at])))
                    here = b.add(b.mul(row, width), column)
                    for j in range(lanes):
                        more = load_lanes(b, other, b.add(here, index(LANES * j)))
                        sums[j] = add_product(b, sums[j], weight, more)
                for place, total in zip(places, sums, strict=True):
                    store_lanes(b, total, out, place)
    end_function(b)


def _write_absorb(module: ir.Module) -> None:
    """[P c^T | c S] and s; T = P - (P c^T)(P c^T)^T / s and t = T c^T - K r.

    P <- T - (t K^T + K t^T) / 2. T c^T = K r but for rounding: the last step is what keeps P
    positive (Joseph's form). Rows of M that a reading does not weigh, most of them, are only read
    where they are written.
    """
    b: Any
    b, args = begin_function(module, "absorb", ABSORB)
    x, m, gain, work = (b.extract_value(args[i], 4) for i in (0, 1, 7, 8))
    size, total = (b.extract_value(args[1], [5, i]) for i in (0, 1))
    c, d = (
        b.gep(b.extract_value(a, 4), [b.mul(args[4], b.extract_value(a, [5, 1]))])
        for a in args[2:4]
    )
    r, miss = args[5:7]
    spent = b.alloca(DOUBLE)
    with for_loop(b, total, LANES) as column:
        store_lanes(b, ZEROS, work, column)
    with loop_nonzero_weights(b, c, size) as (k, weight), for_loop(b, total, LANES) as column:
        row = load_lanes(b, m, b.add(b.mul(k, total), column))
        added = add_product(b, load_lanes(b, work, column), broadcast_lanes(b, weight), row)
        store_lanes(b, added, work, column)
    b.store(r, spent)
    with loop_nonzero_weights(b, c, size) as (k, weight):
        b.store(add_product(b, b.load(spent), weight, b.load(b.gep(work, [k]))), spent)
    over = broadcast_lanes(b, b.fdiv(number(1.0), b.load(spent)))
    moved, back = broadcast_lanes(b, miss), broadcast_lanes(b, b.fneg(r))
    rest = b.gep(work, [total])
    with for_loop(b, size, LANES) as column:
        own = b.fmul(load_lanes(b, work, column), over, flags=FUSED)
        store_lanes(b, own, gain, column)
        store_lanes(b, add_product(b, load_lanes(b, x, column), own, moved), x, column)
        store_lanes(b, b.fmul(back, own, flags=FUSED), rest, column)
    with loop_nonzero_weights(b, c, size) as (k, weight):  # rest = t
        other = broadcast_lanes(b, b.load(b.gep(work, [k])))
        with for_loop(b, size, LANES) as column:
            place, own = b.add(b.mul(k, total), column), load_lanes(b, work, column)
            less = _downdate_lanes(b, m, place, own, other, over)
            added = add_product(b, load_lanes(b, rest, column), broadcast_lanes(b, weight), less)
            store_lanes(b, added, rest, column)
    _write_update(b, (m, d, gain, work, rest), (size, total), over)
    b.ret(b.load(spent))


def _write_update(b: Any, data: tuple[Any, ...], shape: tuple[Any, Any], over: Any) -> None:
    """d <- h_p + c S, and M = [P | S] row by row as ``_write_absorb`` says."""
    m, d, gain, work, rest = data
    size, total = shape
    half, beside = broadcast_lanes(b, number(-0.5)), b.sub(total, size)
    with b.if_then(b.icmp_signed(">", beside, index(0))), for_loop(b, beside, LANES) as column:
        store_lanes(
            b,
            b.fadd(load_lanes(b, d, column), load_lanes(b, b.gep(work, [size]), column)),
            d,
            column,
        )
    with for_loop(b, size, LANES) as column:
        store_lanes(b, b.fmul(half, load_lanes(b, rest, column)), rest, column)
    with for_loop(b, size) as k:
        start = b.mul(k, total)
        other, own, turned = (broadcast_lanes(b, b.load(b.gep(v, [k]))) for v in (work, gain, rest))
        with for_loop(b, size, LANES) as column:
            place = b.add(start, column)
            now = _downdate_lanes(b, m, place, load_lanes(b, work, column), other, over)
            now = add_product(b, now, load_lanes(b, gain, column), turned)
            store_lanes(b, add_product(b, now, load_lanes(b, rest, column), own), m, place)
        with b.if_then(b.icmp_signed(">", beside, index(0))), for_loop(b, beside, LANES) as column:
            place = b.add(b.add(start, size), column)
            less = b.fmul(own, load_lanes(b, d, column), flags=FUSED)
            store_lanes(b, b.fsub(load_lanes(b, m, place), less, flags=FUSED), m, place)


def _downdate_lanes(b: Any, m: Any, place: Any, own: Any, other: Any, over: Any) -> Any:
    """Four numbers of T = P - (P c^T)(P c^T)^T / s."""
    both = b.fmul(own, other, flags=FUSED)
    return b.fsub(load_lanes(b, m, place), b.fmul(both, over))


@contextmanager
def loop_nonzero_weights(b: Any, c: Any, size: Any) -> Iterator[tuple[Any, Any]]:
    """A loop over the entries of a reading's row c that are not zero: k and c_k."""
    with for_loop(b, size) as k:
        weight = b.load(b.gep(c, [k]))
        with b.if_then(b.fcmp_unordered("!=", weight, number(0.0))):
            yield k, weight
