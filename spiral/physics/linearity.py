"""Whether the rates of a model are linear in its states, and what their coefficients hold."""

from __future__ import annotations

import sympy as sp

from spiral.physics.trace import TracedModel
from spiral.types.cache import kept


@kept(128)
def jacobian_names(traced: TracedModel) -> frozenset[str] | None:
    """Names of the parameters and inputs that d rate / d state depends on.

    Nothing where it depends on states. The form of the expressions decides: sums, and products of
    which one factor at most holds states. What is linear in another form (a fraction that would
    cancel) counts as one that depends on them.
    """
    gathered = _Coefficients(frozenset(traced.x))
    if not all(map(gathered.is_linear, traced.rate)):
        return None
    known = dict(zip(traced.p, traced.keys, strict=True))
    known |= dict(zip(traced.u, traced.inputs, strict=True))
    return frozenset(name for symbol, name in known.items() if symbol in gathered.symbols)


class _Coefficients:
    """Symbols of the coefficients of the states, gathered term by term.

    What a term contains is asked once for each term: the inverse of a mass matrix of six
    coordinates repeats the same ones all over.
    """

    def __init__(self, states: frozenset[sp.Basic]) -> None:
        self.states, self.symbols = states, set[sp.Basic]()
        self._free: dict[sp.Basic, frozenset[sp.Basic]] = {}

    def free_symbols(self, term: sp.Basic) -> frozenset[sp.Basic]:
        """Those of a term, as ``term.free_symbols``."""
        if (known := self._free.get(term)) is None:
            parts = map(self.free_symbols, term.args)
            known = frozenset().union(*parts) if term.args else frozenset(term.free_symbols)
            self._free[term] = known
        return known

    def is_linear(self, term: sp.Basic) -> bool:
        """Whether a term is linear in the states; the symbols of its coefficients are kept."""
        if term in self.states or self.free_symbols(term).isdisjoint(self.states):
            return True
        if isinstance(term, sp.Add):
            return all(map(self.is_linear, term.args))
        if not isinstance(term, sp.Mul):
            return False
        inner = [part for part in term.args if not self.free_symbols(part).isdisjoint(self.states)]
        for part in term.args:
            if part not in inner:
                self.symbols |= self.free_symbols(part)
        return len(inner) == 1 and self.is_linear(inner[0])
