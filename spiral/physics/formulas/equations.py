"""Equations of motion from text, brought to one form.

    M(q, p) q'' = f(q, q', z, u, p)        z' = g(q, q', z, u, p)

q are coordinates with their rates, z the states of first order beside them, of which each has a
capacity: what effects let flow into it is divided by that. A state with ``x''`` is
a coordinate, and so is a state whose rate is another state (``x' = v``).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import sympy as sp

from spiral.physics.formulas import syntax
from spiral.physics.formulas.arguments import Argument, arguments_of
from spiral.physics.formulas.capacity import flow_capacities
from spiral.physics.formulas.definition import SystemDefinition, definition_of
from spiral.physics.formulas.dimensions import DimensionWalk, UnitEquations, dimension
from spiral.physics.formulas.inertia import inertia_of
from spiral.physics.formulas.measured import auxiliaries_of, readings_of
from spiral.physics.formulas.rows import (
    FIRST,
    SECOND,
    TIME,
    EquationRow,
    check_row_units,
    is_negative,
    read_row,
    restore_primes,
    symbol,
)
from spiral.physics.formulas.symbolic import formula_text
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.parameter import State
from spiral.types.rates import per_second

_PERMUTED = 6  # coordinates up to which every order of their equations is tried


@dataclass(frozen=True)
class StandardForm:
    """The form that a system takes its physics from; formulas are text.

    ``rates`` are the names of the coordinates' rates, ``capacities`` those of states that have a
    changing one, with its formula, ``force_units`` the units of the rows,
    ``readings`` what is measured that is no state, ``named`` what ``let`` names, ``arguments`` what
    parameters multiply.
    """

    definition: SystemDefinition
    coordinates: tuple[State, ...]
    rates: tuple[str, ...]
    others: tuple[State, ...]
    mass: tuple[tuple[str, ...], ...]
    force: tuple[str, ...]
    flow: tuple[str, ...]
    capacities: tuple[tuple[str, str], ...]
    force_units: tuple[str, ...]
    readings: tuple[tuple[State, str], ...]
    named: tuple[tuple[State, str], ...]
    arguments: tuple[Argument, ...]

    @property
    def auxiliaries(self) -> tuple[tuple[State, str], ...]:
        """What ``let`` names, or a parameter multiplies, and its formula."""
        return (*self.named, *((a.value, a.formula) for a in self.arguments))

    @property
    def units(self) -> dict[str, str]:
        """Name -> unit of all that the formulas may name."""
        pairs = zip(self.rates, self.coordinates, strict=True)
        return {
            **self.definition.units,
            **{rate: per_second(c.unit) for rate, c in pairs},
            **dict.fromkeys(TIME, "s"),
        }


@lru_cache(maxsize=64)
def equations_of(text: str) -> StandardForm:
    """The equations of a definition.

    Raises
    ------
    ConfigError : what is no formula, units that do not fit, a state without its equation.
    """
    given = definition_of(text)
    rows = [read_row(given, i) for i in range(len(given.equations))]
    return _arrange_equations(given, rows)


def _arrange_equations(given: SystemDefinition, rows: Sequence[EquationRow]) -> StandardForm:
    second = {s.name for s in given.states if any(_has_symbol(r, s.name + SECOND) for r in rows)}
    pairs = _rate_pairs(given, rows, second)
    taken = {row.place for _, row in pairs.values()}
    coordinates = [s for s in given.states if s.name in second or s.name in pairs]
    velocity = {c.name: pairs[c.name][0] if c.name in pairs else f"{c.name}_rate"
                for c in coordinates}  # fmt: skip
    others = [s for s in given.states if s.name not in {*velocity, *velocity.values()}]
    unknown = [*_accelerations(coordinates, second, velocity),
               *(symbol(s.name + FIRST) for s in others)]  # fmt: skip
    left = [r for r in rows if r.place not in taken]
    kinematic = {symbol(c + FIRST): symbol(v) for c, v in velocity.items()}
    values = [r.value.subs(kinematic) for r in left]
    if len(left) != len(unknown):
        due = [restore_primes(str(s)) for s in (*(symbol(c + FIRST) for c in pairs), *unknown)]
        raise ConfigError(
            f"{len(rows)} equations for the states {', '.join(s.name for s in given.states)}",
            f"{len(unknown) + len(taken)}, one for each of {', '.join(due)}",
        )
    count, places = len(coordinates), [r.place for r in left]
    order, signs, matrix = _match_equations(values, unknown, places, count)
    units = check_row_units(given, rows, velocity)
    _check_separate_rates(matrix, count, [places[i] for i in order])
    known = dict.fromkeys(unknown, 0)
    rest = [-s * values[i].subs(known) for i, s in zip(order, signs, strict=True)]
    inertia, force, force_units = inertia_of(
        given, matrix[:count, :count], rest[:count], coordinates, units
    )
    before = matrix[count:, count:]
    flow = list(before.LUsolve(sp.Matrix(rest[count:]))) if others else []
    capacities = flow_capacities(given, others, before, flow, tuple(velocity.values()))
    return StandardForm(
        given, tuple(coordinates), tuple(velocity.values()), tuple(others),
        tuple(tuple(formula_text(inertia[i, j]) for j in range(count)) for i in range(count)),
        tuple(map(formula_text, force)), tuple(map(formula_text, flow)), capacities, force_units,
        readings_of(given, velocity), auxiliaries_of(given, velocity),
        arguments_of(given, rows, velocity),
    )  # fmt: skip


def _accelerations(
    coordinates: Iterable[State], second: set[str], velocity: Mapping[str, str]
) -> list[sp.Symbol]:
    """What stands for each: x'' or the rate of the state that is its rate."""
    return [
        symbol(c.name + SECOND if c.name in second else velocity[c.name] + FIRST)
        for c in coordinates
    ]


def _has_symbol(row: EquationRow, name: str) -> bool:
    return symbol(name) in row.value.free_symbols


def _rate_pairs(
    given: SystemDefinition, rows: Sequence[EquationRow], second: set[str]
) -> dict[str, tuple[str, EquationRow]]:
    """Coordinate -> its rate and the equation that says so, of equations ``x' = v``."""
    pairs: dict[str, tuple[str, EquationRow]] = {}
    names = [s.name for s in given.states if s.name not in second]
    for row in rows:
        for name in names:
            if not _has_symbol(row, name + FIRST):
                continue
            for other in names:
                gap = symbol(name + FIRST) - symbol(other)
                if other != name and sp.expand(row.value - gap) * sp.expand(row.value + gap) == 0:
                    pairs.setdefault(name, (other, row))
    rates = [v for v, _ in pairs.values()]
    chained = {n for n in pairs if n in rates}  # a rate that has a rate in turn: first order
    return {n: p for n, p in pairs.items() if n not in chained and rates.count(p[0]) == 1}


def _match_equations(
    values: Sequence[Any], unknown: Sequence[sp.Symbol], places: Sequence[str], count: int
) -> tuple[list[int], list[int], Any]:
    """The equations in the order of their unknown rates, their signs, the matrix of these rates.

    The first ``count`` rates are accelerations.
    """
    for value, place in zip(values, places, strict=True):
        for one in unknown:
            slope = value.diff(one)
            if slope.free_symbols & {*unknown} or slope.has(sp.Derivative, sp.Subs):
                raise ConfigError(
                    f"{place}, not linear in {restore_primes(str(one))}",
                    "rates of highest order as plain factors",
                )
    matrix = sp.Matrix([[sp.expand(v.diff(one)) for one in unknown] for v in values])
    rows = {j: [i for i in range(len(values)) if matrix[i, j] != 0] for j in range(len(unknown))}
    order = _assign_rows(rows, len(unknown))
    if order is None:
        lacking = [str(unknown[j]) for j, matches in rows.items() if not matches]
        raise ConfigError(
            f"equations without {', '.join(map(restore_primes, lacking)) or 'a unique solution'}",
            "one equation for the highest rate of each state",
        )
    others = itertools.permutations(order[:count]) if count <= _PERMUTED else ()
    orders = ([*some, *order[count:]] for some in (order[:count], *others))
    trials = ((some, *_order_equations(matrix, some)) for some in orders)
    return next(
        (t for t in trials if _is_valid_order(t[2], count)),
        (order, *_order_equations(matrix, order)),
    )


def _order_equations(matrix: Any, order: Sequence[int]) -> tuple[list[int], Any]:
    """The equations' signs, by which each own rate is positive, and the matrix in this order."""
    ordered = matrix.extract(list(order), list(range(len(order))))
    signs = [-1 if is_negative(ordered[i, i]) else 1 for i in range(len(order))]
    return signs, sp.diag(*signs) * ordered


def _is_valid_order(matrix: Any, count: int) -> bool:
    """Whether every coordinate's own acceleration is there, and the mass matrix symmetric.

    Of m (x'' - z'') = f and m (z'' - x'') + M z'' = g each equation has both accelerations, and one
    order alone is right.
    """
    inertia = matrix[:count, :count]
    return all(inertia[i, i] != 0 for i in range(count)) and _is_symmetric(inertia)


def _is_symmetric(inertia: Any) -> bool:
    return (inertia - inertia.T).expand() == sp.zeros(*inertia.shape)


def _assign_rows(rows: Mapping[int, Sequence[int]], count: int) -> list[int] | None:
    """A row for each column, by augmenting paths; columns with one row first."""
    owner: dict[int, int] = {}

    def assign_column(column: int, seen: set[int]) -> bool:
        for row in rows[column]:
            if row not in seen:
                seen.add(row)
                if row not in owner or assign_column(owner[row], seen):
                    owner[row] = column
                    return True
        return False

    if not all(assign_column(j, set()) for j in sorted(rows, key=lambda j: len(rows[j]))):
        return None
    back = {column: row for row, column in owner.items()}
    return [back[j] for j in range(count)]


def _check_separate_rates(matrix: Any, count: int, places: Sequence[str]) -> None:
    size = matrix.shape[0]
    for i in range(size):
        for j in range(size):
            if (i < count) != (j < count) and matrix[i, j] != 0:
                raise ConfigError(
                    f"{places[i]}, with an acceleration and the rate of another state",
                    "accelerations and rates of first order in equations of their own",
                    "put the rate's own equation in its place",
                )
    inertia = matrix[:count, :count]
    if not _is_symmetric(inertia):
        raise ConfigError(
            f"equations with a mass matrix that is not symmetric: {inertia.tolist()}",
            "M = M^T, as Lagrange's equations give it, so that a force at a port has its work",
            "the equation of each coordinate as it is, not divided by a mass",
        )


# --- ports ---------------------------------------------------------------------------------------


def port_unit(equations: StandardForm, texts: Iterable[str], name: str) -> tuple[str, str]:
    """(unit of position, unit of force) at a port, all its axes alike.

    Raises
    ------
    ConfigError : a position that is no formula of coordinates, or axes of several units.
    """
    units, known = equations.units, {c.name: i for i, c in enumerate(equations.coordinates)}
    walk = DimensionWalk(UnitEquations(()), {n: dimension(u) for n, u in units.items()}, units)
    axis_units, given = set(), equations.definition
    driven = {name for i in given.inputs for name in (i.name, i.rate.name)}
    for text in texts:
        names = [n for n in syntax.names(text) if n in known]
        for other in syntax.names(text):
            if other in driven or other not in {*known, *given.units}:
                raise ConfigError(
                    f"port {name}: {other!r}",
                    f"coordinates: {', '.join(known)}",
                    did_you_mean(other, known),
                )
        if not names:
            raise ConfigError(f"port {name}: {text!r}", f"a formula of {', '.join(known)}")
        position = walk.of(syntax.read(text), text)
        own = next((n for n in names if dimension(units[n]) == position), names[0])
        axis_units.add((units[own], equations.force_units[known[own]]))
        if dimension(units[own]) != position:
            raise ConfigError(f"port {name}: {text!r}", f"a position in {units[own] or 'rad'}")
    if len(axis_units) > 1:
        raise ConfigError(
            f"port {name} with axes in {axis_units}", "axes of one unit and one force"
        )
    return axis_units.pop()
