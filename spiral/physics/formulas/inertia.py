"""The inertia of each coordinate, so that effects act as forces, and the units of these forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import sympy as sp
from sympy.core.function import AppliedUndef

from spiral.physics.formulas import syntax
from spiral.physics.formulas.definition import SystemDefinition
from spiral.physics.formulas.dimensions import Dimension, DimensionWalk, UnitEquations, dimension
from spiral.physics.formulas.rows import TIME, formula_expression, is_negative, size_of, symbol
from spiral.physics.formulas.symbolic import divisors, formula_text
from spiral.types.errors import ConfigError
from spiral.types.parameter import State
from spiral.types.rates import per_second


def inertia_of(
    given: SystemDefinition,
    matrix: Any,
    rest: Sequence[Any],
    coordinates: Sequence[State],
    units: Mapping[str, str],
) -> tuple[Any, list[Any], tuple[str, ...]]:
    """Mass matrix, forces and their units; of equations solved for accelerations as well."""
    count = len(coordinates)
    solved = [i for i in range(count) if matrix[i, :] == sp.eye(count)[i, :]]
    if given.mass:
        stated = _stated_mass(given, coordinates)
        accelerations = matrix.LUsolve(sp.Matrix(rest)) if count else sp.Matrix([])
        matrix, force = stated, list(stated * accelerations)
    else:
        _check_uncoupled(rest, solved, coordinates, given)
        force, matrix = list(rest), matrix.copy()
        for i in solved:
            own = _own_inertia(rest[i], coordinates[i], given, units)
            above, below = sp.fraction(sp.together(rest[i]))
            matrix[i, i], force[i] = own, rest[i] if own == 1 else above * (own / below)
    force_units = [_force_unit(matrix[i, i], c, given, units) for i, c in enumerate(coordinates)]
    return matrix, force, tuple(force_units)


def _stated_mass(given: SystemDefinition, coordinates: Sequence[State]) -> Any:
    names = [c.name for c in coordinates]
    rows: list[list[str]] = [["0"] * len(names) for _ in names]
    if all(len(r) == 2 and r[0] in names for r in given.mass):
        for name, text in given.mass:  # type: ignore[misc]
            rows[names.index(name)][names.index(name)] = text
    else:
        rows = [list(r) for r in given.mass]
    matrix = sp.Matrix([[formula_expression(given, t) for t in row] for row in rows])
    if matrix.shape != (len(names), len(names)) or matrix != matrix.T or 0 in matrix.diagonal():
        raise ConfigError(
            f"mass {[list(r) for r in given.mass]}",
            f"an inertia for each of {', '.join(names)}, or {len(names)} rows, symmetric",
            f"mass: {{{', '.join(f'{n}: m_{n}' for n in names)}}}",
        )
    return matrix


def _check_uncoupled(
    rest: Sequence[Any],
    solved: Sequence[int],
    coordinates: Sequence[State],
    given: SystemDefinition,
) -> None:
    """Accelerations that share a divisor of states come from a mass matrix that is not diagonal."""
    states = {symbol(s.name) for s in given.states}
    seen: dict[Any, int] = {}
    for i in solved:
        for divisor in divisors(rest[i]):
            if divisor.free_symbols & states and seen.setdefault(divisor, i) != i:
                names = [c.name for c in coordinates]
                raise ConfigError(
                    f"accelerations of {names[seen[divisor]]} and {names[i]}, both divided by "
                    f"{divisor}: a force on one moves the other",
                    "the mass matrix, so that a force at a port acts on both",
                    f"mass=[[...], [...]] with its rows as text, in the order {', '.join(names)}",
                )


def _own_inertia(
    acceleration: Any, coordinate: State, given: SystemDefinition, units: Mapping[str, str]
) -> Any:
    """What an acceleration is divided by so that a force is left: a mass, a moment of inertia, 1.

    It is read off the divisors that parameters make, else off an input that is a force (which may
    act on a coordinate in part).
    """
    due = dimension("N" if coordinate.unit and dimension(coordinate.unit).known else "N*m")
    mechanical = dimension(coordinate.unit) in (dimension("m"), dimension(""))
    per = dimension(per_second(coordinate.unit, 2))
    states = {symbol(s.name) for s in given.states}
    named = [d for d in divisors(acceleration) if d.free_symbols and not d.free_symbols & states]
    divisor = sp.Mul(*named)
    divisor_dimension = _dimension_of(divisor, units)
    if mechanical and divisor_dimension is not None and divisor_dimension.times(per) == due:
        return divisor
    within = {s for f in acceleration.atoms(AppliedUndef) for s in f.free_symbols}
    for item in given.inputs:
        if symbol(item.name) in within:  # of ``where``, ``maximum``: it does not act in proportion
            continue
        slope: Any = sp.together(acceleration.diff(symbol(item.name)))
        plain = slope != 0 and not slope.free_symbols & {*states, *map(symbol, TIME)}
        if plain and not is_negative(slope) and (dimension(item.unit) == due or not mechanical):
            own = 1 / slope
            if _dimension_of(own, units) == dimension(item.unit).times(per, Fraction(-1)):
                return own
    return sp.Integer(1)


def _dimension_of(value: Any, units: Mapping[str, str]) -> Dimension | None:
    walk = DimensionWalk(UnitEquations(()), {n: dimension(u) for n, u in units.items()}, units)
    try:
        text = formula_text(value)
        return walk.of(syntax.read(text), text)
    except ConfigError:
        return None


def _force_unit(
    inertia: Any, coordinate: State, given: SystemDefinition, units: Mapping[str, str]
) -> str:
    """The unit of a row, that of M_ii q_i'': an input's or a usual one where it is of its size."""
    term = sp.Add.make_args(sp.expand(inertia))[0]
    powers = [(str(s), e) for s, e in term.as_powers_dict().items() if s.is_Symbol]
    parts = [f"({units[n] or '1'})^({e})" for n, e in powers]
    unit = "*".join([*parts, f"({coordinate.unit or '1'})", "s^(-2)"])
    usual = [i.unit for i in given.inputs if i.unit] + ["N", "N*m"]
    if not parts:
        usual = []
    for name in usual:
        if dimension(name) == dimension(unit) and abs(size_of(name) / size_of(unit) - 1) < 1e-9:
            return name
    return per_second(coordinate.unit, 2) if not parts else unit
