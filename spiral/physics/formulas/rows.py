"""Equations as text: read, their names resolved, the units of their terms checked."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from random import Random
from typing import Any

import sympy as sp

from spiral.physics.formulas import syntax
from spiral.physics.formulas.definition import SystemDefinition
from spiral.physics.formulas.dimensions import DimensionWalk, UnitEquations, dimension
from spiral.physics.formulas.symbolic import CannotFollowError, Expression, expression_of
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.rates import per_second
from spiral.types.units import factor, short_form

TIME = ("t", "time")
FIRST, SECOND = "_prime", "_prime_prime"
"""Ends of the names that stand for ``x'`` and ``x''`` in a formula."""
_PRIMED = re.compile(r"\b([A-Za-z_]\w*)('{1,2})(?!')")


class UnitSizeError(ConfigError):
    """Units of the right kind whose sizes do not go together."""


@dataclass(frozen=True)
class EquationRow:
    """One equation: its place, its text, left minus right as a formula and as an expression."""

    place: str
    formula: str
    value: Any


def read_row(given: SystemDefinition, number: int) -> EquationRow:
    """The equation of this number.

    Raises
    ------
    ConfigError : no formula on each side of one =, or a name that is not declared.
    """
    text = given.equations[number]
    place = f"equation {number + 1}, {text!r}"
    if text.count("=") != 1:
        raise ConfigError(place, "one = with a formula on each side", "m*x'' + c*x' + k*x = F")
    names = [s.name for s in given.states]
    rates = {i.name: i.rate.name for i in given.inputs}
    for match in _PRIMED.finditer(text):
        name, order = match[1], len(match[2])
        if name in rates and order > 1:
            raise ConfigError(f"{place}: {match[0]}", f"of an input its first rate: {name}'")
        if name not in names and name not in rates:
            raise ConfigError(
                f"{place}: the rate of {name!r}",
                f"of a state or an input: {', '.join((*names, *rates))}",
                did_you_mean(name, (*names, *rates)),
            )
    left, right = (replace_primes(side, rates).strip() for side in text.split("="))
    formula = left if right == "0" else f"({left}) - ({right})"
    try:
        value = formula_expression(given, formula)
    except ConfigError as error:
        raise ConfigError(
            f"{place}: {restore_primes(error.given)}", error.expected, error.try_
        ) from error
    return EquationRow(place, formula, value)


def replace_primes(text: str, rates: Mapping[str, str]) -> str:
    """A formula with names in place of ``x'`` and ``x''``; ``rates`` are those of inputs."""
    ends = {1: FIRST, 2: SECOND}
    return _PRIMED.sub(lambda m: rates.get(m[1]) or m[1] + ends[len(m[2])], text)


def restore_primes(text: str) -> str:
    """A formula with ``x'`` and ``x''``, as people write them, in place of names for them."""
    return re.sub(rf"(\w+?)({SECOND}|{FIRST})\b", lambda m: m[1] + "'" * m[2].count("_prime"), text)


def formula_expression(given: SystemDefinition, formula: str) -> Any:
    """A formula as an expression.

    Raises
    ------
    ConfigError : what is no formula, or a name that is not declared.
    """
    known = [*given.units, *TIME]
    known += [f"{s.name}{e}" for s in given.states for e in (FIRST, SECOND)]
    for name in syntax.names(formula):
        if name not in known:
            plain = [n for n in known if not n.endswith(FIRST)]
            raise ConfigError(
                f"{name!r}, which is not declared",
                f"states, inputs, parameters or constants: {', '.join(plain)}",
                did_you_mean(name, plain) + f"; or add it: parameters: {{{name}: UNIT}}",
            )
    try:
        return expression_of(syntax.compute(formula, {n: Expression(symbol(n)) for n in known}))
    except CannotFollowError as error:
        raise ConfigError(error.given, "a formula", error.try_) from error


def symbol(name: str) -> sp.Symbol:
    """What stands for a state, an input or a parameter; both words for time are one."""
    return sp.Symbol("time" if name == "t" else name, real=True)


def row_units(given: SystemDefinition) -> dict[str, str]:
    """Name -> unit of all that equations may name, ``x'`` and ``x''`` by their own names."""
    units = {**given.units, **dict.fromkeys(TIME, "s")}
    for s in given.states:
        units[s.name + FIRST] = per_second(s.unit)
        units[s.name + SECOND] = per_second(s.unit, 2)
    return units


def check_row_units(
    given: SystemDefinition, rows: Sequence[EquationRow], velocity: Mapping[str, str]
) -> dict[str, str]:
    """Check that the terms of every equation have one unit and one size; name -> unit."""
    states = {s.name: s.unit for s in given.states}
    for name, rate in velocity.items():
        if rate in states:
            _check_rate_unit(rate, states[rate], per_second(states[name]))
    units = row_units(given)
    walk = DimensionWalk(UnitEquations(()), {n: dimension(u) for n, u in units.items()}, units)
    sizes = {n: size_of(u) for n, u in units.items()}
    coherent = all(size == 1.0 for size in sizes.values())
    for row in rows:
        try:
            walk.of(syntax.read(row.formula), row.formula)
        except ConfigError as error:
            raise ConfigError(
                f"{row.place}: {restore_primes(error.given.partition(': ')[2] or error.given)}",
                error.expected,
                "check the units; a number that has one goes to constants: {g: 9.81 m/s^2}",
            ) from error
        if not coherent:
            _check_unit_sizes(row, units, sizes)
    return units


def _check_rate_unit(rate: str, unit: str, due: str) -> None:
    if dimension(unit) != dimension(due) or abs(factor(unit or "1", due, rate) - 1) > 1e-9:
        raise ConfigError(f"unit {unit!r} of {rate}", f"{short_form(due)}, for it is a rate")


@lru_cache(maxsize=512)
def size_of(unit: str) -> float:
    """How many SI units a difference of one of these is."""
    from spiral.types.units import base_form, registry, spelled

    if not unit:
        return 1.0
    if (known := base_form(unit)) is not None:
        return known[0]
    try:
        return float(registry().Quantity(1.0, spelled(unit)).to_base_units().magnitude)
    except Exception as error:
        raise ConfigError(f"unit {unit!r}", "one that converts to SI") from error


def _check_unit_sizes(
    row: EquationRow, units: Mapping[str, str], sizes: Mapping[str, float]
) -> None:
    """Terms of one size: in SI units the whole equation is the same but for a factor."""
    names = sorted(map(str, row.value.free_symbols))
    function = sp.lambdify([symbol(n) for n in names], row.value, _PLAIN)
    ratios, random = [], Random(0)
    for _ in range(6):  # at values of no pattern: equal ones cancel, and leave a rounding error
        values = [random.uniform(1.0, 3.0) for _ in names]
        scaled = [v * sizes[n] for v, n in zip(values, names, strict=True)]
        with contextlib.suppress(ArithmeticError, ValueError):  # a root or a logarithm below zero
            ratios.append(function(*scaled) / function(*values))
    if not ratios or max(ratios) - min(ratios) > 1e-9 * abs(ratios[0]):
        uneven = [
            f"{restore_primes(n)} in {short_form(units[n])}" for n in names if sizes[n] != 1.0
        ]
        raise UnitSizeError(
            f"{row.place}, with {', '.join(uneven)}: numbers of terms that cannot be added",
            "units that go together, for instance all SI; time is in s, and x' is per second",
            "numbers without a unit that convert (1440, 0.001), and temperatures with a zero of "
            "their own, keep units from being converted: leave these out, or write SI units",
        )


_PLAIN = [
    {"hypot": lambda a, b: (a * a + b * b) ** 0.5, "maximum": max, "minimum": min,
     "where": lambda c, a, b: a if c else b},
    "math",
]  # fmt: skip


def is_negative(value: Any) -> bool:
    """Whether a factor is below zero, with all that it is made of above."""
    positive = {s: sp.Symbol(str(s), positive=True) for s in value.free_symbols}
    substituted = value.subs(positive)
    return bool(substituted.is_negative) or (
        substituted.is_negative is None and substituted.could_extract_minus_sign()
    )
