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
    states, symbols = frozenset[sp.Basic](traced.x), set[sp.Basic]()
    if not all(_gather_coefficients(rate, states, symbols) for rate in traced.rate):
        return None
    known = dict(zip(traced.p, traced.keys, strict=True))
    known |= dict(zip(traced.u, traced.inputs, strict=True))
    return frozenset(name for symbol, name in known.items() if symbol in symbols)


def _gather_coefficients(
    term: sp.Basic, states: frozenset[sp.Basic], symbols: set[sp.Basic]
) -> bool:
    """Whether a term is linear in the states; the symbols of its coefficients are added."""
    if term in states or term.free_symbols.isdisjoint(states):
        return True
    if isinstance(term, sp.Add):
        return all(_gather_coefficients(part, states, symbols) for part in term.args)
    if not isinstance(term, sp.Mul):
        return False
    inner = [part for part in term.args if not part.free_symbols.isdisjoint(states)]
    for part in term.args:
        if part not in inner:
            symbols |= part.free_symbols
    return len(inner) == 1 and _gather_coefficients(inner[0], states, symbols)
