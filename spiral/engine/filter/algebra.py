"""What a filter does with its covariance, as machine code over four numbers at a time.

    product      C = A B
    absorb       one scalar measurement: s = c P c^T + r, K = P c^T / s, x <- x + K e,
                 P <- (I - K c) P (I - K c)^T + K r K^T

Matrices have rows and columns of a multiple of four, zeros behind those of use
(``spiral.physics.lanes``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from llvmlite import ir
from numba import types

from spiral.physics.compile import ModelFunction, ended, engine_of, started
from spiral.physics.emit import number
from spiral.physics.lanes import (
    FUSED,
    LANES,
    ZEROS,
    add_product,
    counted,
    index,
    lane,
    put,
    spread,
)

_V, _M = types.float64[::1], types.float64[:, ::1]
PRODUCT = types.FunctionType(types.void(_M, _M, _M))
"""product(A, B, C): C = A B; C is neither of them."""
ABSORB = types.FunctionType(types.float64(_V, _M, _V, types.float64, types.float64, _V, _V))
"""absorb(x, P, c, r, e, gain, work) -> s; x, P and gain are written, ``work`` is scratch."""

_ROWS, _WIDE = 4, 3  # rows, and lanes of columns, of the block of C that is held in registers


@dataclass(frozen=True)
class Algebra:
    """The compiled functions."""

    product: Any
    absorb: Any


@cache
def algebra() -> Algebra:
    """The functions, compiled once for a process."""
    module = ir.Module("algebra")
    _write_product(module)
    _write_absorb(module)
    engine = engine_of(module)
    return Algebra(
        ModelFunction(PRODUCT, engine, "product"), ModelFunction(ABSORB, engine, "absorb")
    )


def _write_product(module: ir.Module) -> None:
    """Blocks of four rows and up to twelve columns of C, each a sum over the columns of A."""
    b, (first, second, out) = started(module, "product", PRODUCT)
    left, right, result = (b.extract_value(m, 4) for m in (first, second, out))
    rows, inner = b.extract_value(first, [5, 0]), b.extract_value(first, [5, 1])
    width = b.extract_value(second, [5, 1])
    block = LANES * _WIDE
    full = b.mul(b.sdiv(width, index(block)), index(block))
    with b.if_then(b.icmp_signed(">", full, index(0))), counted(b, full, block) as column:
        _columns(b, (left, right, result), (rows, inner, width), column, _WIDE)
    with b.if_then(b.icmp_signed("<", full, width)):
        rest = b.sub(width, full)
        with counted(b, rest, LANES) as more:
            _columns(b, (left, right, result), (rows, inner, width), b.add(full, more), 1)
    ended(b)


def _columns(
    b: ir.IRBuilder, data: tuple[Any, ...], shape: tuple[Any, ...], column: Any, lanes: int
) -> None:
    left, right, result = data
    rows, inner, width = shape
    with counted(b, rows, _ROWS) as row:
        at = [b.mul(b.add(row, index(i)), inner) for i in range(_ROWS)]
        sums = [ZEROS] * (_ROWS * lanes)
        with counted(b, inner, sums=sums) as k:
            start = b.add(b.mul(k, width), column)
            others = [lane(b, right, b.add(start, index(LANES * j))) for j in range(lanes)]
            for i in range(_ROWS):
                own = spread(b, b.load(b.gep(left, [b.add(at[i], k)])))
                for j in range(lanes):
                    sums[i * lanes + j] = add_product(b, sums[i * lanes + j], own, others[j])
        for i in range(_ROWS):
            start = b.add(b.mul(b.add(row, index(i)), width), column)
            for j in range(lanes):
                put(b, sums[i * lanes + j], result, b.add(start, index(LANES * j)))


def _write_absorb(module: ir.Module) -> None:
    """P c^T and s; T = P - (P c^T)(P c^T)^T / s and t = T c^T - K r; P <- T - (t K^T + K t^T) / 2.

    T c^T = K r but for rounding: the last step is what keeps P positive (Joseph's form).
    """
    b: Any
    b, args = started(module, "absorb", ABSORB)
    x, p, c, gain, work = (b.extract_value(args[i], 4) for i in (0, 1, 2, 5, 6))
    r, miss = args[3:5]
    size = b.extract_value(args[1], [5, 1])
    spent = [r]
    with counted(b, size, LANES) as column:
        sums = [ZEROS]
        with counted(b, size, sums=sums) as k:
            own = spread(b, b.load(b.gep(c, [k])))
            sums[0] = add_product(b, sums[0], own, lane(b, p, b.add(b.mul(k, size), column)))
        put(b, sums[0], work, column)
    with counted(b, size, sums=spent) as k:
        spent[0] = add_product(b, spent[0], b.load(b.gep(c, [k])), b.load(b.gep(work, [k])))
    inverse = b.fdiv(number(1.0), spent[0])
    over, moved, back = spread(b, inverse), spread(b, miss), spread(b, b.fneg(r))
    half = spread(b, number(-0.5))
    with counted(b, size, LANES) as column:
        own = lane(b, work, column)
        weight = b.fmul(own, over, flags=FUSED)
        put(b, weight, gain, column)
        put(b, add_product(b, lane(b, x, column), weight, moved), x, column)
        left = [b.fmul(back, weight, flags=FUSED)]
        with counted(b, size, sums=left) as k:
            place = b.add(b.mul(k, size), column)
            both = b.fmul(own, spread(b, b.load(b.gep(work, [k]))), flags=FUSED)
            less = b.fsub(lane(b, p, place), b.fmul(both, over))
            put(b, less, p, place)
            left[0] = add_product(b, left[0], spread(b, b.load(b.gep(c, [k]))), less)
        put(b, b.fmul(half, left[0]), work, b.add(size, column))
    rest = b.gep(work, [size])  # -t / 2, behind P c^T
    with counted(b, size, LANES) as column:
        own, weight = lane(b, rest, column), lane(b, gain, column)
        with counted(b, size) as k:
            place = b.add(b.mul(k, size), column)
            now = add_product(b, lane(b, p, place), weight, spread(b, b.load(b.gep(rest, [k]))))
            put(b, add_product(b, now, own, spread(b, b.load(b.gep(gain, [k])))), p, place)
    b.ret(spent[0])
