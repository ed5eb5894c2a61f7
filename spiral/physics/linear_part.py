"""The linear part of a model with many states, and what is left of its rates beside it.

    x' = A(p, u) x + r(x_S, u, p)

A holds no state, r depends on few states S: a structure with springs, gaps and friction at some of
its places. The form of the expressions decides, as in ``linearity``: sums, and products of which
one factor holds states.
"""

from __future__ import annotations

from collections.abc import Iterator
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
        self.place = {s: i for i, s in enumerate(traced.x)}
        self._free: dict[sp.Basic, bool] = {}
        parts: dict[tuple[int, int], list[sp.Expr]] = {}
        left: list[list[sp.Expr]] = [[] for _ in traced.rate]
        for i, rate in enumerate(traced.rate):
            for state, weight in self._terms(rate, sp.Integer(1)):
                if state is None:
                    left[i].append(weight)
                else:
                    parts.setdefault((i, self.place[state]), []).append(weight)
        self.matrix = {at: sp.Add(*weights) for at, weights in parts.items()}
        self.rest = [sp.Add(*terms) for terms in left]
        free = set().union(*(r.free_symbols for r in self.rest))
        self.moving = {i for s, i in self.place.items() if s in free}
        used = set().union(*(w.free_symbols for w in self.matrix.values()))
        known = dict(zip(traced.p, traced.keys, strict=True))
        known |= dict(zip(traced.u, traced.inputs, strict=True))
        self.names = frozenset(name for symbol, name in known.items() if symbol in used)

    def _terms(self, term: Any, weight: Any) -> Iterator[tuple[Any, Any]]:
        """A state and its weight for each linear term; nothing, and the term, for what is left."""
        if term in self.place:
            yield term, weight
        elif not self._holds_states(term):
            yield None, weight * term
        elif isinstance(term, sp.Add):
            for part in term.args:
                yield from self._terms(part, weight)
        else:
            inner = [a for a in term.args if self._holds_states(a)]
            if isinstance(term, sp.Mul) and len(inner) == 1:
                others = [a for a in term.args if a is not inner[0]]
                yield from self._terms(inner[0], weight * sp.Mul(*others))
            else:
                yield None, weight * term

    def _holds_states(self, term: Any) -> bool:
        """Whether a term contains a state; asked once for each."""
        if (known := self._free.get(term)) is None:
            known = term in self.place or any(map(self._holds_states, term.args))
            self._free[term] = known
        return known
