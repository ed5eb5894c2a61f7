"""Covariance algebra of four filters side by side, as LLVM code: one lane for each filter.

    advance      P <- F P F^T + Q of the transition of ``likelihood.transition``, A shared, Phi own
    absorb       one scalar measurement as in ``filter.algebra``, c shared, r own

Entry (i, j) of a matrix in lanes is four numbers in memory: (N, N) is an array of N rows and 4 N
columns, (N,) one of N rows and four. The lower half of P is made and copied to the upper.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

from llvmlite import ir
from numba import types

from spiral.engine.filter.algebra import loop_nonzero_weights
from spiral.physics.compile import ModelFunction, begin_function, end_function, engine_of
from spiral.physics.emit import number
from spiral.physics.lanes import (
    FUSED,
    LANE,
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
_F, _I, _I1 = types.float64, types.int64, types.int64[::1]
ADVANCE = types.FunctionType(types.void(_M, _M, _I1, _I1, _M, _M, _M, _I, _I))
"""advance(A, links, columns, ends, Q, P, W, n, first): W = F P, then P.

``links`` are the entries of Phi at the places of ``transition.compressed_rows``. The rows of A are
padded to a multiple of four; P and W have ``SPARE`` rows more than N, which are overwritten.
"""
ABSORB = types.FunctionType(types.void(_M, _M, _V, _V, _F, _V, _M, _M, _V))
"""absorb(x, P, c, held, before, r, kept, work, e): e = before - c x, x <- x + K e - held before.

``kept`` (N + 1 rows) out: K and s. ``work`` (2 N rows) is scratch.
"""
SPARE = LANES


@dataclass(frozen=True)
class LaneAlgebra:
    """The compiled functions."""

    advance: Any
    absorb: Any


@cache
def compiled_lane_algebra() -> LaneAlgebra:
    """The functions, compiled once for a process."""
    module = ir.Module("lane_algebra")
    _write_advance(module)
    _write_absorb(module)
    engine = engine_of(module)
    return LaneAlgebra(
        ModelFunction(ADVANCE, engine, "advance"), ModelFunction(ABSORB, engine, "absorb")
    )


@dataclass(frozen=True)
class _Lanes:
    """A matrix in lanes while code is written: its memory, and how many entries a row has."""

    b: Any
    data: Any
    columns: Any

    def _at(self, i: Any, j: Any) -> Any:
        return self.b.mul(index(LANES), self.b.add(self.b.mul(i, self.columns), j))

    def load(self, i: Any, j: Any) -> Any:
        return load_lanes(self.b, self.data, self._at(i, j))

    def store(self, value: Any, i: Any, j: Any) -> None:
        store_lanes(self.b, value, self.data, self._at(i, j))


def _write_advance(module: ir.Module) -> None:
    b: Any
    b, args = begin_function(module, "advance", ADVANCE)
    size, n, first = b.extract_value(args[0], [5, 1]), args[7], args[8]
    q, p, w = (_Lanes(b, b.extract_value(a, 4), size) for a in args[4:7])
    a, links = b.extract_value(args[0], 4), _Lanes(b, b.extract_value(args[1], 4), index(1))
    phi = (links, *(b.extract_value(x, 4) for x in args[2:4]))
    tracked, noise = b.sub(first, n), b.sub(b.extract_value(args[3], [5, 0]), index(1))
    with for_loop(b, n, LANES) as i, for_loop(b, size) as j:
        _sum_model_rows(b, a, size, i, lambda k: p.load(k, j), lambda v, r: w.store(v, r, j))
    with _loop_any(b, tracked) as i, for_loop(b, size) as j:
        w.store(p.load(b.add(n, i), j), b.add(n, i), j)
    with _loop_any(b, noise) as i, for_loop(b, size) as j:
        _sum_noise_row(b, phi, i, lambda c: p.load(b.add(first, c), j),
                       lambda v: w.store(v, b.add(first, i), j))  # fmt: skip
    with for_loop(b, size) as i, for_loop(b, _lesser(b, n, b.add(i, index(1))), LANES) as j:
        _sum_model_rows(b, a, size, j, lambda k: w.load(i, k), lambda v, r: p.store(v, i, r))
    with for_loop(b, size) as i, _loop_any(b, tracked) as j:
        p.store(w.load(i, b.add(n, j)), i, b.add(n, j))
    with _loop_any(b, noise) as i, for_loop(b, b.add(i, index(1))) as j:
        row = b.add(first, i)
        _sum_noise_row(b, phi, j, lambda c: w.load(row, b.add(first, c)),
                       lambda v: p.store(v, row, b.add(first, j)))  # fmt: skip
    with for_loop(b, size) as i, for_loop(b, b.add(i, index(1))) as j:
        now = b.fadd(p.load(i, j), q.load(i, j))
        p.store(now, i, j)
        p.store(now, j, i)
    end_function(b)


@contextmanager
def _loop_any(b: Any, count: Any) -> Iterator[Any]:
    """A loop that may have no pass."""
    with b.if_then(b.icmp_signed(">", count, index(0))), for_loop(b, count) as i:
        yield i


def _lesser(b: Any, one: Any, other: Any) -> Any:
    return b.select(b.icmp_signed("<", one, other), one, other)


def _sum_model_rows(b: Any, a: Any, size: Any, row: Any, other: Any, put: Any) -> None:
    """Four sums over k of A[row + r, k] other(k), each put in its row."""
    rows = [b.add(row, index(r)) for r in range(LANES)]
    at, sums = [b.mul(r, size) for r in rows], [ZEROS] * LANES
    with for_loop(b, size, sums=sums) as k:
        here = other(k)
        for r in range(LANES):
            weight = broadcast_lanes(b, b.load(b.gep(a, [b.add(at[r], k)])))
            sums[r] = add_product(b, sums[r], weight, here)
    for total, r in zip(sums, rows, strict=True):
        put(total, r)


def _sum_noise_row(b: Any, phi: tuple[Any, Any, Any], row: Any, other: Any, put: Any) -> None:
    """The sum over the entries of a row of Phi, each times other(column)."""
    links, columns, ends = phi
    begin, end = (b.load(b.gep(ends, [b.add(row, index(more))])) for more in (0, 1))
    put(ZEROS)
    count = b.sub(end, begin)
    with b.if_then(b.icmp_signed(">", count, index(0))):
        sums = [ZEROS]
        with for_loop(b, count, sums=sums) as e:
            at = b.add(begin, e)
            value = other(b.load(b.gep(columns, [at])))
            sums[0] = add_product(b, sums[0], links.load(at, index(0)), value)
        put(sums[0])


def _write_absorb(module: ir.Module) -> None:
    """P c^T, s and e; K and the mean; T = P - (P c^T)(P c^T)^T / s and t = T c^T - K r."""
    b: Any
    b, args = begin_function(module, "absorb", ABSORB)
    data = [b.extract_value(x, 4) if k != 4 else x for k, x in enumerate(args)]
    size, none = b.extract_value(args[0], [5, 0]), index(0)
    x, kept, pc = (_Lanes(b, data[k], index(1)) for k in (0, 6, 7))
    rest = b.gep(data[7], [b.mul(index(LANES), size)])
    p, t = _Lanes(b, data[1], size), _Lanes(b, rest, index(1))
    before, r = broadcast_lanes(b, data[4]), load_lanes(b, data[5], none)
    s, e = _weigh(b, data[2], size, (x, p, pc), r, before)
    over = b.fdiv(broadcast_lanes(b, number(1.0)), s)
    kept.store(s, size, none)
    store_lanes(b, e, data[8], none)
    with for_loop(b, size) as i:
        own = b.fmul(pc.load(i, none), over, flags=FUSED)
        kept.store(own, i, none)
        moved = add_product(b, x.load(i, none), own, e)
        held = b.fmul(broadcast_lanes(b, b.load(b.gep(data[3], [i]))), before, flags=FUSED)
        x.store(b.fsub(moved, held, flags=FUSED), i, none)
        t.store(b.fmul(b.fneg(r), own, flags=FUSED), i, none)
    with loop_nonzero_weights(b, data[2], size) as (k, weight):
        wide, other = broadcast_lanes(b, weight), pc.load(k, none)
        with for_loop(b, size) as i:
            less = b.fsub(p.load(k, i), b.fmul(b.fmul(pc.load(i, none), other), over))
            t.store(add_product(b, t.load(i, none), wide, less), i, none)
    _write_downdate(b, size, p, (pc, kept, t), over)
    end_function(b)


def _weigh(b: Any, c: Any, size: Any, parts: tuple[_Lanes, ...], r: Any, before: Any) -> Any:
    """s = c P c^T + r and e = before - c x; P c^T is left in its place."""
    x, p, pc = parts
    none, s, e = index(0), b.alloca(LANE), b.alloca(LANE)
    with for_loop(b, size) as i:
        pc.store(ZEROS, i, none)
    with loop_nonzero_weights(b, c, size) as (k, weight):
        wide = broadcast_lanes(b, weight)
        with for_loop(b, size) as i:
            pc.store(add_product(b, pc.load(i, none), wide, p.load(k, i)), i, none)
    b.store(r, s)
    b.store(before, e)
    with loop_nonzero_weights(b, c, size) as (k, weight):
        wide = broadcast_lanes(b, weight)
        b.store(add_product(b, b.load(s), wide, pc.load(k, none)), s)
        less = b.fmul(wide, x.load(k, none), flags=FUSED)
        b.store(b.fsub(b.load(e), less, flags=FUSED), e)
    return b.load(s), b.load(e)


def _write_downdate(b: Any, size: Any, p: _Lanes, vectors: tuple[_Lanes, ...], over: Any) -> None:
    """P <- T - (t K^T + K t^T) / 2 with T = P - (P c^T)(P c^T)^T / s."""
    pc, kept, t = vectors
    none, half = index(0), broadcast_lanes(b, number(-0.5))
    with for_loop(b, size) as i:
        t.store(b.fmul(half, t.load(i, none)), i, none)
    with for_loop(b, size) as i:
        other, own, turned = (v.load(i, none) for v in (pc, kept, t))
        with for_loop(b, b.add(i, index(1))) as j:
            both = b.fmul(b.fmul(pc.load(j, none), other), over)
            now = b.fsub(p.load(i, j), both)
            now = add_product(b, now, kept.load(j, none), turned)
            now = add_product(b, now, t.load(j, none), own)
            p.store(now, i, j)
            p.store(now, j, i)
