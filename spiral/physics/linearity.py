"""Terms of a model's rates that are linear in its states, and what their coefficients hold."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import sympy as sp

from spiral.physics.trace import TracedModel
from spiral.types.cache import kept


@kept(128)
def jacobian_names(traced: TracedModel) -> frozenset[str] | None:
    """Names of the parameters and inputs that d rate / d state depends on.

    Nothing where it depends on states (``LinearTerms``). What is linear in another form (a fraction
    that would cancel) counts as one that depends on them.
    """
    linear, symbols = LinearTerms(traced), set[sp.Basic]()
    for state, factors in (term for rate in traced.rate for term in linear.of(rate)):
        if state is not None:
            symbols.update(*map(linear.free_symbols, factors))
        elif any(map(linear.holds_states, factors)):
            return None
    return names_of(traced, symbols)


def names_of(traced: TracedModel, symbols: set[sp.Basic]) -> frozenset[str]:
    """Names of those parameters and inputs whose symbols are among these."""
    known = dict(zip(traced.p, traced.keys, strict=True))
    known |= dict(zip(traced.u, traced.inputs, strict=True))
    return frozenset(name for symbol, name in known.items() if symbol in symbols)


class LinearTerms:
    """The terms of expressions, each a product of factors and of a state, or one that is not.

    The form of the expressions decides: sums, and products of which one factor at most holds
    states. What a term contains is asked once for each term: the inverse of a mass matrix of six
    coordinates repeats the same ones all over.
    """

    def __init__(self, traced: TracedModel) -> None:
        self.states = frozenset(traced.x)
        self._free: dict[sp.Basic, frozenset[sp.Basic]] = {}

    def of(self, term: Any, factors: tuple[Any, ...] = ()) -> Iterator[tuple[Any, tuple[Any, ...]]]:
        """A state and its ``factors`` for each linear term; nothing, and all factors, for others.

        Only the last factor of these holds states, if any does.
        """
        if term in self.states:
            yield term, factors
        elif not self.holds_states(term):
            yield None, (*factors, term)
        elif isinstance(term, sp.Add):
            for part in term.args:
                yield from self.of(part, factors)
        else:
            inner = [part for part in term.args if self.holds_states(part)]
            if isinstance(term, sp.Mul) and len(inner) == 1:
                others = (part for part in term.args if part is not inner[0])
                yield from self.of(inner[0], (*factors, *others))
            else:
                yield None, (*factors, term)

    def holds_states(self, term: sp.Basic) -> bool:
        """Whether a term contains a state."""
        return not self.free_symbols(term).isdisjoint(self.states)

    def free_symbols(self, term: sp.Basic) -> frozenset[sp.Basic]:
        """Those of a term, as ``term.free_symbols``."""
        if (known := self._free.get(term)) is None:
            parts = map(self.free_symbols, term.args)
            known = frozenset().union(*parts) if term.args else frozenset(term.free_symbols)
            self._free[term] = known
        return known
