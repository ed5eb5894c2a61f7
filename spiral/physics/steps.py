"""Runge-Kutta steps of a model over a sample as machine code, for what is made at their stages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from spiral.physics.compile import begin_function, element_address, end_function, load_symbols
from spiral.physics.emit import DOUBLE, Emitter, Node, number
from spiral.physics.lanes import add_product, for_loop, index
from spiral.physics.trace import TracedModel


class StepWriter:
    """Writes a function that advances x by classical Runge-Kutta steps.

    Its first arguments are x, u, at, stride, substeps, step, p: ``x`` (at least n) is advanced in
    place by ``substeps`` of length ``step``; inputs of step i are rows at + i stride of ``u``, and
    the two behind it (start, middle and end). ``use_stage`` writes what else is made of the rates
    and their slopes at each of the four stages, ``finish_step`` what follows them; ``columns`` are
    the parameters by which slopes are made, beside those by all states.
    """

    def __init__(
        self, module: ir.Module, name: str, kind: Any, traced: TracedModel, columns: Sequence[int]
    ) -> None:
        self.traced, self.columns, self.n = traced, columns, len(traced.x)
        self.builder, self.args = begin_function(module, name, kind)
        b = self.builder
        self.x, self.u, self.p = (b.extract_value(self.args[i], 4) for i in (0, 1, 6))
        self.at, self.stride, self.substeps, self.step = self.args[2:6]
        self.inputs = b.extract_value(self.args[1], [5, 1])
        size = ir.ArrayType(DOUBLE, max(self.n, 1))
        self.slope, self.total = (b.gep(b.alloca(size), [index(0)] * 2) for _ in range(2))

    def write(self) -> None:
        """The whole function."""
        b, traced = self.builder, self.traced
        used = set().union(*(e.free_symbols for e in traced.rate))
        self.given = load_symbols(b, self.p, traced.p, used)
        half, sixth = (b.fmul(self.step, number(w)) for w in (0.5, 1 / 6))
        with for_loop(b, self.substeps) as sub:
            row = b.add(self.at, b.mul(sub, self.stride))
            with for_loop(b, index(4)) as stage:
                self._write_stage(row, stage, half, used)
            for i in range(self.n):
                place, total = (
                    element_address(b, self.x, i),
                    b.load(element_address(b, self.total, i)),
                )
                b.store(add_product(b, b.load(place), sixth, total), place)
            self.finish_step(sixth)
        end_function(b)

    def use_stage(self, nodes: Sequence[Node], first: Any, point: Any, gain: Any) -> None:
        """Use the rates (``nodes``) at one stage.

        That is ``point`` after the start of the step; ``gain`` is its weight in sixths of a step,
        ``first`` whether it is the first.
        """
        raise NotImplementedError

    def finish_step(self, sixth: Any) -> None:
        """Follow the four stages; ``sixth`` of the step's length."""

    def _write_stage(self, row: Any, stage: Any, half: Any, used: set[Any]) -> None:
        """Rates and their slopes at one point of the step, added to the sums."""
        b, traced = self.builder, self.traced
        first, last = (b.icmp_signed("==", stage, index(i)) for i in (0, 3))
        zero = number(0.0)
        point = b.select(first, zero, b.select(last, self.step, half))
        gain = b.select(b.or_(first, last), number(1.0), number(2.0))
        reached = b.add(row, b.lshr(b.add(stage, index(1)), index(1)))
        inputs = b.gep(self.u, [b.mul(reached, self.inputs)])
        here = {}
        for i, symbol in enumerate(traced.x):
            slope = b.select(first, zero, b.load(element_address(b, self.slope, i)))
            here[symbol] = add_product(b, b.load(element_address(b, self.x, i)), point, slope)
        symbols = {**here, **load_symbols(b, inputs, traced.u, used), **self.given}
        active = {s: i for i, s in enumerate(traced.x)}
        active |= {traced.p[j]: self.n + c for c, j in enumerate(self.columns)}
        emitter = Emitter(b, symbols, active)
        nodes = [emitter.node(e) for e in traced.rate]
        for i, node in enumerate(nodes):
            b.store(node.value, element_address(b, self.slope, i))
            place = element_address(b, self.total, i)
            so_far = b.select(first, zero, b.load(place))
            b.store(add_product(b, so_far, gain, node.value), place)
        self.use_stage(nodes, first, point, gain)
