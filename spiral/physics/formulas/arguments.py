"""What a parameter multiplies: a difference of variables that no port stands for.

M x'' = -B (x' - u')    B may follow x' - u', as a drag does
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from spiral.physics.formulas.definition import SystemDefinition
from spiral.physics.formulas.measured import formula_unit
from spiral.physics.formulas.rows import (
    FIRST,
    SECOND,
    EquationRow,
    restore_primes,
    row_units,
    symbol,
)
from spiral.physics.formulas.symbolic import formula_text
from spiral.types.errors import ConfigError
from spiral.types.parameter import State

_ENDING = "_argument"


@dataclass(frozen=True)
class Argument:
    """What a ``parameter`` multiplies: its name and unit, its formula, and as people write it."""

    value: State
    formula: str
    parameter: str
    words: str


def arguments_of(
    given: SystemDefinition, rows: Sequence[EquationRow], velocity: Mapping[str, str]
) -> tuple[Argument, ...]:
    """The argument of each parameter that has one.

    One and the same in all equations. What effects act at in any case is left out: sums of
    coordinates, differences of two states of first order, or of one and an input. ``velocity`` as
    in ``readings_of``.
    """
    arguments = []
    for name in (p.name for p in given.parameters):
        different = {_with_sign(a) for row in rows for a in _multiplied(row.value, symbol(name))}
        if len(different) != 1 or name + _ENDING in given.units:
            continue
        (argument,) = different
        if not _is_followed(given, argument, velocity):
            continue
        formula = formula_text(argument)
        try:
            unit = formula_unit(given, argument, row_units(given), formula)
        except ConfigError:  # said where an equation holds it
            continue
        words = restore_primes(formula)
        for given_input in given.inputs:
            words = re.sub(rf"\b{given_input.rate.name}\b", f"{given_input.name}'", words)
        arguments.append(Argument(State(name + _ENDING, unit), formula, name, words))
    return tuple(arguments)


def _multiplied(expression: Any, parameter: sp.Symbol) -> Iterator[Any]:
    """Sums that a parameter, or a power of it, is a factor of a product with; others as zero."""
    for product in sp.preorder_traversal(expression):
        factors = product.args if isinstance(product, sp.Mul) else ()
        if any(f.as_base_exp()[0] == parameter for f in factors):
            sums = [f for f in factors if isinstance(f, sp.Add) and not f.has(parameter)]
            yield sums[0] if len(sums) == 1 else sp.Integer(0)


def _with_sign(argument: Any) -> Any:
    """An argument or its negative: of both, always the same one, without a minus in front."""
    return min(argument, -argument, key=lambda a: (formula_text(a).startswith("-"), str(a)))


def _is_followed(given: SystemDefinition, argument: Any, velocity: Mapping[str, str]) -> bool:
    """Whether an argument is a plain sum of several variables that the equations do not solve for.

    One with a sum in it, or with a parameter that is to be found, is a balance of flows that a
    capacity divides.
    """
    if not isinstance(argument, sp.Add) or any(term.atoms(sp.Add) for term in argument.args):
        return False
    names = {str(s) for s in argument.free_symbols}
    first = {s.name for s in given.states if s.name not in {*velocity, *velocity.values()}}
    solved = {n for n in names if n.endswith(SECOND)} | ({n + FIRST for n in first} & names)
    if solved or names & {p.name for p in given.parameters if p.start is None}:
        return False
    moving = {*velocity, *velocity.values(), *(c + FIRST for c in velocity)} & names
    levels = (first | {i.name for i in given.inputs}) & names
    rates = {i.rate.name for i in given.inputs} & names
    few = 3 if names == levels else 2
    return bool(levels | rates) and len(moving | levels | rates) >= few
