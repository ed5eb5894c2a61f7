"""Loops and vectors of four numbers in LLVM instructions.

Matrices that they work on have rows of a multiple of four numbers in memory (``padded_width``),
zeros behind those of use.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numba as nb
from llvmlite import ir

from spiral.physics.emit import DOUBLE, INDEX

LANES = 4
LANE = ir.VectorType(DOUBLE, LANES)
ZEROS = ir.Constant(LANE, [0.0] * LANES)
FUSED: Any = ("contract",)
LOOP: Any = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
"""How Numba compiles a loop over samples: nothing is allocated, so that no reference is counted.

Counts are atomic, and of every view of an array that is passed on in the loop.
"""
INNER: Any = {**LOOP, "inline": "always"}
"""The same for a part of such a loop: an array handed over is seven numbers on the stack."""


@nb.njit(cache=True, nogil=True)
def padded_width(width):
    """Width of a row in memory: the number of its columns rounded up to a multiple of four."""
    return -(-width // LANES) * LANES


def index(value: int) -> ir.Constant:
    """A constant position."""
    return ir.Constant(INDEX, value)


def broadcast_lanes(builder: ir.IRBuilder, value: Any) -> Any:
    """A number in every lane."""
    undefined = ir.Constant(LANE, ir.Undefined)
    one = builder.insert_element(undefined, value, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(one, undefined, places)


def add_product(builder: Any, total: Any, a: Any, b: Any) -> Any:
    """total + a b, numbers or lanes; the flags of a builder are in no stub."""
    return builder.fadd(total, builder.fmul(a, b, flags=FUSED), flags=FUSED)


def load_lanes(builder: ir.IRBuilder, data: Any, place: Any) -> Any:
    """Load four numbers from a place on."""
    return builder.load(_lane_address(builder, data, place), align=8)


def store_lanes(builder: ir.IRBuilder, value: Any, data: Any, place: Any) -> None:
    """Write four numbers from a place on."""
    builder.store(value, _lane_address(builder, data, place), align=8)


def _lane_address(builder: ir.IRBuilder, data: Any, place: Any) -> Any:
    return builder.bitcast(builder.gep(data, [place]), LANE.as_pointer())


@contextmanager
def for_loop(
    builder: ir.IRBuilder, count: Any, step: int = 1, sums: list[Any] | None = None
) -> Iterator[Any]:
    """A loop over 0, step, .. below a count, at least once.

    ``sums`` are loop variables: in the body their entries are the values of this pass, and what
    the body leaves there enters the next one.
    """
    sums = [] if sums is None else sums
    before, body = builder.block, builder.append_basic_block()
    after = builder.append_basic_block()
    builder.branch(body)
    builder.position_at_end(body)
    at = builder.phi(INDEX)
    at.add_incoming(index(0), before)
    carried = []
    for j, value in enumerate(sums):
        phi = builder.phi(value.type)
        phi.add_incoming(value, before)
        carried.append(phi)
        sums[j] = phi
    yield at
    later = builder.add(at, index(step))
    at.add_incoming(later, builder.block)
    for phi, value in zip(carried, sums, strict=True):
        phi.add_incoming(value, builder.block)
    builder.cbranch(builder.icmp_signed("<", later, count), body, after)
    builder.position_at_end(after)
