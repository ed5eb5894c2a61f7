"""The capacity of each state of first order: what a flow into it is divided by.

    D(q, z, u) z' = sum of flows

A chamber whose volume a piston changes, a tank that widens: what leaks into it fills it the slower
the larger it is. D is what stands before z', or the divisor that all terms of z' share; effects
flow in over D / D0, with D0 that at rest, so that their amplitudes are rates of z there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp

from spiral.physics.formulas.definition import SystemDefinition
from spiral.physics.formulas.rows import symbol
from spiral.physics.formulas.symbolic import divisors, formula_text
from spiral.types.parameter import State


def flow_capacities(
    given: SystemDefinition, others: Sequence[State], matrix: Any, flows: Sequence[Any],
    rates: Sequence[str],
) -> tuple[tuple[str, str], ...]:  # fmt: skip
    """(name, D / D0 as a formula) of every state of first order whose D changes.

    Parameters
    ----------
    matrix : what stands before the rates of ``others``. flows : the rates themselves, solved.
    rates : names of coordinates' rates.
    """
    moving = {symbol(n) for n in (*(s.name for s in given.states), *rates)}
    moving |= {symbol(i.name) for i in given.inputs}
    rest = {symbol(s.name): s.start for s in given.states}
    rest = {s: rest.get(s, 0) for s in moving}
    changing = []
    for i, (state, flow) in enumerate(zip(others, flows, strict=True)):
        alone = all(matrix[i, j] == 0 for j in range(len(others)) if j != i)
        before = matrix[i, i]
        if alone and before.free_symbols & moving:
            capacity = before
        else:
            capacity = _shared_divisor(flow, moving, symbol(state.name)) if alone else sp.Integer(1)
        relative = _over_its_rest(capacity, rest)
        if relative != 1:
            changing.append((state.name, formula_text(relative)))
    return tuple(changing)


def _shared_divisor(flow: Any, moving: set[Any], own: Any) -> Any:
    """The divisor of moving quantities, not of the state itself, that all terms of a rate share.

    A product of such quantities over a divisor (S X / (K + S)) is one law of that form, and not
    several flows into one capacity.
    """
    apart = sp.Add.make_args(sp.expand_mul(flow, deep=False))
    terms = [set(divisors(term)) for term in apart]
    shared = [d for d in set.intersection(*terms)
              if d.free_symbols & moving and own not in d.free_symbols]  # fmt: skip
    if not shared:
        return sp.Integer(1)
    flows = sp.Add.make_args(sp.expand(sp.fraction(sp.together(flow))[0]))
    factors = [{*flow.as_powers_dict()} & moving for flow in flows]
    several = len(flows) > 1 and not set.intersection(*factors)
    return sp.Mul(*shared) if several else sp.Integer(1)


def _over_its_rest(capacity: Any, rest: dict[Any, float]) -> Any:
    """D / D0; 1 where D0 is none."""
    there = capacity.subs(rest)
    if there == 0 or there.has(sp.nan, sp.zoo, sp.oo):
        return sp.Integer(1)
    return capacity / there
