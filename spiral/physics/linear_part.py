"""The linear part of a model with many states, and what is left of its rates beside it.

    x' = A(p, u) x + r(x_S, u, p)

A holds no state, r depends on few states S: a structure with springs, gaps and friction at some of
its places. The form of the expressions decides (``linearity.LinearTerms``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp
from llvmlite import ir

from spiral.physics.compile import (
    MODEL_FUNCTION,
    VALUE_FUNCTION,
    ModelFunction,
    engine_of,
    write_function,
)
from spiral.physics.linearity import LinearTerms, names_of
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept
from spiral.types.record import Array

_MOST = 6
"""States that r may depend on: its equation is solved in these, twice as many unknowns."""


@dataclass(frozen=True)
class LinearPart:
    """A and r of a model, compiled.

    Fields
    ------
    names : parameters and inputs that A depends on.
    moving : the states S.
    rest : r with its slopes by states; those by states beside S are not written.
    sources : x' with its slopes by the parameters that were asked for.
    """

    names: frozenset[str]
    moving: Array
    rest: Any
    sources: Any
    _entries: Array
    _values: Any

    def matrix(self, n: int, inputs: Array, values: Array) -> Array:
        """(n, n) A at values of inputs and parameters."""
        entries = np.zeros(len(self._entries))
        self._values(np.zeros(n), np.array(inputs), values, entries)
        whole = np.zeros((n, n))
        whole[self._entries[:, 0], self._entries[:, 1]] = entries
        return whole


@kept(128)
def linear_part(traced: TracedModel, by: tuple[str, ...]) -> LinearPart | None:
    """The linear part of a model, slopes by parameters ``by``; nothing where r has many states."""
    split = _Split(traced)
    moving = sorted(split.moving)
    if not 0 < len(moving) <= _MOST:
        return None
    module, columns = ir.Module("linear_part"), [traced.keys.index(k) for k in by]
    write_function(module, "matrix", traced, list(split.matrix.values()), None)
    write_function(module, "rest", traced, split.rest, [])
    write_function(module, "sources", traced, traced.rate, columns, by_states=False)
    engine = engine_of(module)
    return LinearPart(
        split.names,
        np.array(moving, dtype=np.int64),
        ModelFunction(MODEL_FUNCTION, engine, "rest"),
        ModelFunction(MODEL_FUNCTION, engine, "sources"),
        np.array(list(split.matrix)),
        ModelFunction(VALUE_FUNCTION, engine, "matrix"),
    )


class _Split:
    """Entries of A, r, the states of r, and the names that A depends on."""

    def __init__(self, traced: TracedModel) -> None:
        linear, place = LinearTerms(traced), {s: i for i, s in enumerate(traced.x)}
        parts: dict[tuple[int, int], list[sp.Expr]] = {}
        left: list[list[sp.Expr]] = [[] for _ in traced.rate]
        for i, rate in enumerate(traced.rate):
            for state, factors in linear.of(rate):
                product = sp.Mul(*factors)
                if state is None:
                    left[i].append(product)
                else:
                    parts.setdefault((i, place[state]), []).append(product)
        self.matrix = {at: sp.Add(*weights) for at, weights in parts.items()}
        self.rest = [sp.Add(*terms) for terms in left]
        free = set().union(*(r.free_symbols for r in self.rest))
        self.moving = {i for s, i in place.items() if s in free}
        used = set().union(*(w.free_symbols for w in self.matrix.values()))
        self.names = names_of(traced, used)
