"""Deflections of the elements in a balance of forces: what each parameter multiplies.

A spring between a rack and its pinion, k (x - r phi), one at the corner of a car, k (z - a theta),
or a gear's, k (N phi - psi), deflects by a combination of coordinates that is none of them and no
difference of two. With f the generalised forces, df_i/dk = c_i; of an element in line with its own
deflection e every c_i is a multiple of e (its virtual work is that of one force), so that e is told
by the gradient of any of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import sympy as sp

from spiral.physics.formulas import syntax
from spiral.physics.formulas.equations import StandardForm
from spiral.physics.formulas.symbolic import formula_text


@lru_cache(maxsize=64)
def element_deflections(form: StandardForm) -> tuple[tuple[str, str], ...]:
    """(parameter, deflection as a formula) of elements on two or more coordinates, each once.

    A deflection is one coordinate and multiples of the others; of these formulas the one without
    fractions, or the shortest. A damper has that of its rates. What is no linear combination (a
    pendulum's weight), or depends on inputs (a wheel on a road), has none.
    """
    known = {n: sp.Symbol(n, real=True) for n in form.units}
    forces = [sp.sympify(syntax.compute(text, known)) for text in form.force]
    places = [known[c.name] for c in form.coordinates]
    rates = dict(zip((known[r] for r in form.rates), places, strict=True))
    moving = {*places, *rates, *(known[s.name] for s in form.others)}
    given = {known[i.name] for i in form.definition.inputs}
    found: dict[str, tuple[str, str]] = {}
    for parameter in form.definition.parameters:
        rows = [sp.expand(sp.diff(f, known[parameter.name])) for f in forces]
        gradients = list(_gradients(rows, places, rates, moving | given | {known[parameter.name]}))
        if not gradients or len(gradients) != sum(row != 0 for row in rows):
            continue
        first, *more = gradients
        acting = [i for i, g in enumerate(first) if g != 0]
        if len(acting) < 2 or not all(_is_parallel(first, other) for other in more):
            continue
        forms = [sum(sp.simplify(first[i] / first[j]) * places[i] for i in acting) for j in acting]
        texts = (formula_text(e) for e in forms)
        text = min(texts, key=lambda t: (t.count("/"), len(t), t))
        found.setdefault(text, (parameter.name, text))
    return tuple(found.values())


def same_deflection(form: StandardForm, one: str, other: str) -> bool:
    """Whether two formulas of coordinates are the same, or each the other's negative."""
    known = {n: sp.Symbol(n, real=True) for n in form.units}
    a, b = (sp.sympify(syntax.compute(text, known)) for text in (one, other))
    return sp.expand(a - b) == 0 or sp.expand(a + b) == 0


def _gradients(
    rows: list[sp.Expr], places: list[sp.Symbol], rates: dict[sp.Symbol, sp.Symbol],
    varying: set[sp.Symbol],
) -> Iterator[list[sp.Expr]]:  # fmt: skip
    """Slopes by the coordinates of rows that are linear in these, or in their rates, alone."""
    for row in rows:
        still = row.subs(list(rates.items()))
        slopes = [sp.expand(sp.diff(still, place)) for place in places]
        linear = sp.expand(still - sum(s * q for s, q in zip(slopes, places, strict=True))) == 0
        mixed = row.free_symbols & {*rates} and row.free_symbols & {*places}
        constant = not any(s.free_symbols & varying for s in slopes)
        if row != 0 and linear and constant and not mixed:
            yield slopes


def _is_parallel(one: list[sp.Expr], other: list[sp.Expr]) -> bool:
    """Whether two gradients have one direction."""
    return all(
        sp.expand(one[i] * other[j] - one[j] * other[i]) == 0
        for i in range(len(one)) for j in range(i)
    )  # fmt: skip
