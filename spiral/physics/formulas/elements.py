"""Deflections of the elements in a balance of forces: what each parameter multiplies.

A spring between a rack and its pinion, k (x - r phi), one at the corner of a car, k (z - a theta),
or a gear's, k (N phi - psi), deflects by a combination of coordinates that is none of them and no
difference of two. With f the generalised forces, df_i/dk = c_i; of an element in line with its own
deflection e every c_i is a multiple of e (its virtual work is that of one force), so that e is told
by the gradient of any of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import pairwise

import sympy as sp

from spiral.physics.formulas import syntax
from spiral.physics.formulas.equations import StandardForm
from spiral.physics.formulas.symbolic import formula_text

Gradient = dict[sp.Symbol, sp.Expr]
"""Slopes of a deflection, or of a force by a parameter, by the coordinates that enter it."""


def element_deflections(form: StandardForm, known: Iterable[str]) -> Iterator[tuple[str, str]]:
    """(parameter, deflection as a formula) of elements on two or more coordinates, each once.

    A deflection is one coordinate and multiples of the others; of these formulas the one without
    fractions, or the shortest. A damper has that of its rates. What is no linear combination (a
    pendulum's weight), or depends on inputs (a wheel on a road), has none; those ``known``, or
    their negatives, are left out.
    """
    names = {n: sp.Symbol(n, real=True) for n in form.units}
    forces = [sp.sympify(syntax.compute(text, names)) for text in form.force]
    places = [names[c.name] for c in form.coordinates]
    rates = dict(zip((names[r] for r in form.rates), places, strict=True))
    others = (*form.others, *form.definition.inputs)
    moving = {*places, *rates, *(names[x.name] for x in others)}
    taken = {sp.expand(sp.sympify(syntax.compute(text, names))) for text in known}
    for parameter in form.definition.parameters:
        factor = names[parameter.name]
        rows = [sp.expand(sp.diff(f, factor)) for f in forces if f.has(factor)]
        gradient = _common_gradient(rows, rates, moving | {factor})
        if len(gradient) < 2:
            continue
        forms = [sp.expand(sum(sp.simplify(g / by) * q for q, g in gradient.items()))
                 for by in gradient.values()]  # fmt: skip
        text, deflection = min(
            ((formula_text(e), e) for e in forms),
            key=lambda pair: (pair[0].count("/"), len(pair[0]), pair[0]),
        )
        if not {deflection, sp.expand(-deflection)} & taken:
            taken.add(deflection)
            yield parameter.name, text


def _common_gradient(
    rows: list[sp.Expr], rates: dict[sp.Symbol, sp.Symbol], varying: set[sp.Symbol]
) -> Gradient:
    """The gradient of which those of all rows are multiples; empty where there is none."""
    gradients = [_gradient(row, rates, varying) for row in rows if row != 0]
    if not gradients or not all(_is_parallel(gradients[0], g) for g in gradients):
        return {}
    return gradients[0]


def _gradient(row: sp.Expr, rates: dict[sp.Symbol, sp.Symbol], varying: set[sp.Symbol]) -> Gradient:
    """Slopes of a row that is linear in coordinates, or in their rates, alone; else empty."""
    if row.free_symbols & {*rates} and row.free_symbols & {*rates.values()}:
        return {}
    still = row.subs(list(rates.items()))
    slopes = {q: sp.expand(sp.diff(still, q)) for q in rates.values() if still.has(q)}
    rest = sp.expand(still - sum(slope * q for q, slope in slopes.items()))
    constant = not any(slope.free_symbols & varying for slope in slopes.values())
    return slopes if rest == 0 and constant else {}


def _is_parallel(one: Gradient, other: Gradient) -> bool:
    """Whether two gradients have one direction."""
    return one.keys() == other.keys() and all(
        sp.expand(one[a] * other[b] - one[b] * other[a]) == 0 for a, b in pairwise(one)
    )
