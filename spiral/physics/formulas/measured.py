"""Readings and named formulas that are no state: their units, with names for rates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import sympy as sp

from spiral.physics.formulas import syntax
from spiral.physics.formulas.definition import SystemDefinition
from spiral.physics.formulas.dimensions import DimensionWalk, UnitEquations, dimension
from spiral.physics.formulas.rows import (
    SECOND,
    formula_expression,
    replace_primes,
    restore_primes,
    row_units,
    size_of,
    symbol,
)
from spiral.types.errors import ConfigError
from spiral.types.parameter import State
from spiral.types.units import short_form


def readings_of(
    given: SystemDefinition, velocity: Mapping[str, str]
) -> tuple[tuple[State, str], ...]:
    """Each reading that is no state with its unit, and its formula with names for rates.

    Parameters
    ----------
    velocity : coordinate -> the name of its rate.

    Raises
    ------
    ConfigError : what is no formula, a name or a rate that is not there, units that do not fit.
    """
    readings = []
    for name, text in given.readings:
        place = f"observed: {name} = {text}"
        formula = replace_primes(text, {i.name: i.rate.name for i in given.inputs})
        try:
            value = formula_expression(given, formula)
            for state in (s.name for s in given.states if s.name not in velocity):
                if symbol(state + SECOND) in value.free_symbols:
                    expected = f"of a coordinate: {', '.join(velocity) or 'there is none'}"
                    raise ConfigError(f"{state}''", expected)
            unit = formula_unit(given, value, row_units(given), formula)
        except ConfigError as error:
            said = restore_primes(error.given)
            raise ConfigError(f"{place}: {said}", error.expected, error.try_) from error
        readings.append((State(name, unit), formula))
    return tuple(readings)


def auxiliaries_of(
    given: SystemDefinition, velocity: Mapping[str, str]
) -> tuple[tuple[State, str], ...]:
    """What ``let`` names of two states or inputs, or more, with its unit and its formula.

    What is a function of one alone says no more than that one. Those of accelerations, of the rates
    of states of first order, or of a unit that is not plain are left out. ``velocity`` as in
    ``readings_of``.
    """
    auxiliaries = []
    variables = {i.name for i in (*given.states, *given.inputs)} | {*velocity.values()}
    variables |= {i.rate.name for i in given.inputs}
    for name, text in given.named:
        formula = replace_primes(text, {i.name: i.rate.name for i in given.inputs})
        try:
            value = formula_expression(given, formula)
            unit = formula_unit(given, value, row_units(given), formula)
        except ConfigError:  # said where an equation holds it
            continue
        used = {restore_primes(str(s)) for s in value.free_symbols}
        rates = {n for n in used if n.endswith("'")}
        if rates <= {f"{c}'" for c in velocity} and len((used & variables) | rates) > 1:
            auxiliaries.append((State(name, unit), formula))
    return tuple(auxiliaries)


def formula_unit(
    given: SystemDefinition, value: sp.Expr, units: Mapping[str, str], text: str
) -> str:
    """The unit of a formula: one that is used already where it is of its size, else a product."""
    walk = DimensionWalk(UnitEquations(()), {n: dimension(u) for n, u in units.items()}, units)
    wanted = walk.of(syntax.read(text), text)
    if not wanted.known:
        return ""
    usual = [u for u in ("N", "N*m", *given.units.values()) if u and dimension(u) == wanted]
    powers = [(name, e) for name, e in _powers_of_names(sp.expand(value)).items() if e != 0]
    unit = "*".join(f"({units[n] or '1'})^({e})" for n, e in powers)
    if [e for _, e in powers] == [1]:
        unit = units[powers[0][0]]
    if unit and dimension(unit) == wanted:
        same = [u for u in usual if abs(size_of(u) / size_of(unit) - 1) < 1e-9]
        return same[0] if same else short_form(unit)
    if usual and all(size_of(u) == 1.0 for u in units.values()):  # |x - z|: all is SI
        return usual[0]
    raise ConfigError(
        f"{text!r}, whose unit is not plain", "a product, or a sum of products, or units of SI"
    )


def _powers_of_names(value: sp.Expr) -> Counter[str]:
    """Name -> its power in a formula's unit: of the first term of a sum, also under a quotient."""
    powers: Counter[str] = Counter()
    for base, exponent in sp.Add.make_args(value)[0].as_powers_dict().items():
        inner = base.args[0] if isinstance(base, sp.Abs) else base
        if base.is_Symbol:
            powers[str(base)] += exponent
        elif inner.is_Symbol or inner.is_Add:
            powers.update({n: e * exponent for n, e in _powers_of_names(inner).items()})
    return powers
