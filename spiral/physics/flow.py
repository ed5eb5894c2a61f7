"""The flow of a model over a sample, with its slopes, as machine code.

    x <- classical Runge-Kutta of x' = f(x, u, p)
    S <- the same steps of S' = f_x S + [0 | f_p],   S = d x / d(x at the start, p)

which differentiates the Runge-Kutta map itself. The Jacobian's entries go straight from ``emit``
into the products: those that are zero by the structure of the model cost nothing, and the others
are in no memory. Columns of S are taken four at a time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir
from numba import types

from spiral.physics.compile import (
    MODEL_FUNCTION,
    ModelFunction,
    engine_of,
    write_function,
)
from spiral.physics.emit import DOUBLE, Node
from spiral.physics.lanes import (
    LANES,
    ZEROS,
    add_product,
    broadcast_lanes,
    for_loop,
    index,
    load_lanes,
    store_lanes,
)
from spiral.physics.steps import StepWriter
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept

_V, _M, _T = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
FLOW_FUNCTION = types.FunctionType(
    types.void(
        _V, _M, types.int64, types.int64, types.int64, types.float64, _V, _M, _T, types.int64
    )
)
"""flow(x, u, at, stride, substeps, step, p, S, work, first).

``x`` (at least n) and ``S`` (n, columns a multiple of four) are advanced in place by ``substeps``
of length ``step``; inputs of step i are rows at + i stride of ``u``, and the two behind it (start,
middle and end). ``work`` (3, n, columns of S) is scratch that begins as zero and is kept from call
to call. The columns of S are the slopes from number ``first`` on (0: by the states first; n: by the
parameters alone); where S has fewer columns than these, the last ones are left out.
"""


@dataclass(frozen=True)
class Flow:
    """``advance`` a model over samples, columns of S in the order of ``by``; its ``output``."""

    advance: Any
    output: Any


@kept(128)
def compile_flow(traced: TracedModel, by: tuple[str, ...]) -> Flow:
    """The flow with slopes by all states, then by the parameters ``by``, and the output.

    Raises
    ------
    PluginError : a function that has no machine code.
    """
    module = ir.Module("flow")
    columns = [traced.keys.index(k) for k in by]
    _FlowWriter(module, traced, columns).write()
    write_function(module, "output", traced, traced.output, columns)
    engine = engine_of(module)
    return Flow(
        ModelFunction(FLOW_FUNCTION, engine, "advance"),
        ModelFunction(MODEL_FUNCTION, engine, "output"),
    )


class _FlowWriter(StepWriter):
    """Writes ``advance``: the columns of S by fours, at every stage of a step."""

    def __init__(self, module: ir.Module, traced: TracedModel, columns: Sequence[int]) -> None:
        super().__init__(module, "advance", FLOW_FUNCTION, traced, columns)
        b = self.builder
        self.s, self.work = (b.extract_value(self.args[i], 4) for i in (7, 8))
        self.left_out = self.args[9]
        self.width = b.extract_value(self.args[7], [5, 1])
        self.layer = b.mul(self.width, index(self.n))
        self.nowhere = b.alloca(DOUBLE)

    def use_stage(self, nodes: Sequence[Node], first: Any, point: Any, gain: Any) -> None:
        """J (S + point S') + [0 | f_p], added to the sums."""
        b, n = self.builder, self.n
        direct = [any(k >= n for k in node.slopes) for node in nodes]
        for i, node in enumerate(nodes):
            for k, slope in node.slopes.items():
                if k >= n:
                    column = b.sub(index(k), self.left_out)  # which is n at most
                    place = b.gep(self._row(self.work, i, 2), [column])
                    there = b.icmp_signed("<", column, self.width)
                    b.store(slope, b.select(there, place, self.nowhere))
        needed = sorted({k for node in nodes for k in node.slopes if k < n})
        entries = [{k: broadcast_lanes(b, v) for k, v in m.slopes.items() if k < n} for m in nodes]
        along, weight = broadcast_lanes(b, point), broadcast_lanes(b, gain)
        with for_loop(b, self.width, LANES) as c:
            trial = {}
            for k in needed:
                rates = b.select(first, ZEROS, self._load_lanes(self.work, k, 0, c))
                trial[k] = add_product(b, self._load_lanes(self.s, k, 0, c), along, rates)
            for i in range(n):
                value = self._load_lanes(self.work, i, 2, c) if direct[i] else ZEROS
                for k, entry in entries[i].items():
                    value = add_product(b, value, entry, trial[k])
                sums = b.select(first, ZEROS, self._load_lanes(self.work, i, 1, c))
                self._store_lanes(value, self.work, i, 0, c)
                self._store_lanes(add_product(b, sums, weight, value), self.work, i, 1, c)

    def finish_step(self, sixth: Any) -> None:
        """S <- S + step / 6 of the sums."""
        b, sixth = self.builder, broadcast_lanes(self.builder, sixth)
        with for_loop(b, self.width, LANES) as c:
            for i in range(self.n):
                now, sums = self._load_lanes(self.s, i, 0, c), self._load_lanes(self.work, i, 1, c)
                self._store_lanes(add_product(b, now, sixth, sums), self.s, i, 0, c)

    def _row(self, data: Any, i: int, layer: int) -> Any:
        b = self.builder
        place = b.add(b.mul(self.layer, index(layer)), b.mul(self.width, index(i)))
        return b.gep(data, [place])

    def _load_lanes(self, data: Any, i: int, layer: int, column: Any) -> Any:
        return load_lanes(self.builder, self._row(data, i, layer), column)

    def _store_lanes(self, value: Any, data: Any, i: int, layer: int, column: Any) -> None:
        store_lanes(self.builder, value, self._row(data, i, layer), column)
