"""Whether a model's slopes by its states stay the same over a sample.

Within a gap, or where dry friction slides, a model is linear: its slopes, and with them the
transition over the sample, are those of other samples like it. The function advances x as the flow
does and keeps the least and the largest of every slope f_x that is no constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from llvmlite import ir
from numba import types

from spiral.physics.compile import (
    ModelFunction,
    begin_function,
    end_function,
    engine_of,
)
from spiral.physics.emit import Node
from spiral.physics.lanes import index
from spiral.physics.steps import StepWriter
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept

_V, _M = types.float64[::1], types.float64[:, ::1]
BOUNDS_FUNCTION = types.FunctionType(
    types.void(_V, _M, types.int64, types.int64, types.int64, types.float64, _V, _M)
)
"""bounds(x, u, at, stride, substeps, step, p, range): as ``FLOW_FUNCTION``, without S.

``range`` (2, slopes that vary), in and out: the least and the largest of each so far.
"""


@dataclass(frozen=True)
class SlopeBounds:
    """The function, and the number of slopes that vary with states or inputs."""

    advance: Any
    count: int


@kept(128)
def compile_slope_bounds(traced: TracedModel) -> SlopeBounds:
    """The function of one model."""
    module = ir.Module("bounds")
    writer = _BoundsWriter(module, "advance", BOUNDS_FUNCTION, traced, ())
    writer.write()
    return SlopeBounds(ModelFunction(BOUNDS_FUNCTION, engine_of(module), "advance"), writer.count)


@kept(1)
def no_slope_bounds() -> SlopeBounds:
    """A function that does nothing, of a model that nobody asks."""
    module = ir.Module("nothing")
    builder, _ = begin_function(module, "advance", BOUNDS_FUNCTION)
    end_function(builder)
    return SlopeBounds(ModelFunction(BOUNDS_FUNCTION, engine_of(module), "advance"), 0)


class _BoundsWriter(StepWriter):
    """Writes the least and the largest of slopes that vary, over all stages of all steps."""

    count = 0

    def use_stage(self, nodes: Sequence[Node], first: Any, point: Any, gain: Any) -> None:
        """Widen the range of every slope that is made of states or inputs."""
        b = self.builder
        constant = dict.fromkeys((id(v) for v in self.given.values()), True)
        slopes = {id(s): s for node in nodes for s in node.slopes.values()}
        varying = [s for s in slopes.values() if not _is_constant(s, constant)]
        data, width = (b.extract_value(self.args[7], place) for place in (4, [5, 1]))
        for i, slope in enumerate(varying):
            for row, sign in enumerate("<>"):
                place = b.gep(data, [b.add(b.mul(width, index(row)), index(i))])
                known = b.load(place)
                further = b.fcmp_ordered(sign, slope, known)
                b.store(b.select(further, slope, known), place)
        self.count = len(varying)


def _is_constant(value: Any, known: dict[int, bool]) -> bool:
    """Whether an instruction's value is made of constants and parameters alone."""
    if not isinstance(value, ir.Instruction):
        return isinstance(value, ir.Constant)
    if id(value) not in known:
        loaded = isinstance(value, ir.LoadInstr | ir.PhiInstr)
        known[id(value)] = not loaded and all(
            _is_constant(o, known) or isinstance(o, ir.Function) for o in value.operands
        )
    return known[id(value)]
