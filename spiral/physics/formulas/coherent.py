"""A definition whose units have other sizes than SI's, with every number in SI.

    x' = a x,   a = 0.85 1/d   ->   a = 9.84e-6 1/s

Equations add numbers, so their units must go together; a book's rates per day and a data sheet's
kJ/K do not. Values with their units say what they are: they are converted, and so are states and
inputs, whose records are converted as they are read. A number without a unit says nothing: where an
equation holds one that may be a conversion by hand (1440, 0.001), nothing is converted.
"""

from __future__ import annotations

import ast
import contextlib
import re
from collections.abc import Mapping
from math import isclose
from typing import Any

from spiral.physics.formulas import syntax
from spiral.physics.formulas.definition import parse_sections, value_and_unit
from spiral.physics.formulas.equations import equations_of
from spiral.physics.formulas.function import dump_sections
from spiral.physics.formulas.let import write_out
from spiral.physics.formulas.rows import UnitSizeError, replace_primes, size_of
from spiral.types.units import registry, short_form, spelled

CONVERTED = "converted"
_NUMBERS = ("value", "lower", "upper", "start")
_LARGEST = 12  # a number of an equation up to this, or a quarter of it, is no conversion
_FOUND = re.compile(r"constant_\d+")  # a number of a Python function, in the units of its author


def text_in_units_that_fit(text: str) -> str:
    """A definition's text, or the same in SI units where those that it has do not go together.

    Raises
    ------
    ConfigError : what ``equations_of`` refuses, also in SI units, or where nothing is converted.
    """
    try:
        equations_of(text)
        return text
    except UnitSizeError as error:
        reason = error
    for time_alone in (True, False):
        sections = coherent_sections(text, time_alone)
        with contextlib.suppress(UnitSizeError):
            if sections is not None:
                equations_of(converted := dump_sections(sections))
                return converted
    raise reason


def coherent_sections(text: str, time_alone: bool) -> dict[str, Any] | None:
    """The sections of a definition in SI units; nothing where numbers may hold conversions.

    ``time_alone`` : minutes, hours and days become seconds, all else stays (mg/l/d -> mg/l/s).
    The section ``converted`` says of each name what it was: its value and unit, or its unit.
    """
    given = parse_sections(text)
    if _may_hold_conversions(given):
        return None
    whole, was = dict(given), {}
    for section in ("states", "inputs", "parameters", "constants"):
        entries = given.get(section)
        if not isinstance(entries, Mapping):
            continue
        made = {}
        for name, entry in entries.items():
            unit = _unit_of(str(name), entry, section)
            coherent = coherent_unit(unit, time_alone)
            if coherent is None:
                return None
            if coherent != (unit, 1.0):
                was[str(name)] = _words_of(str(name), entry, section)
                entry = _converted(str(name), entry, section, *coherent)
            made[name] = entry
        whole[section] = made
    return {**whole, CONVERTED: was} if was else None


def coherent_unit(unit: str, time_alone: bool = False) -> tuple[str, float] | None:
    """The unit of SI in place of one, and how many of it that is; nothing for one with a zero."""
    size = size_of(unit)
    if isclose(size, 1.0):
        return unit, 1.0
    units = registry()
    product = units.dimensionless
    for name, power in units.Quantity(1.0, spelled(unit)).unit_items():
        quantity = units.Quantity(1.0, name)
        if not quantity._is_multiplicative:
            return None
        stays = time_alone and not quantity.check("[time]")
        product = product * (units.Unit(name) if stays else _plain_unit(units, name)) ** power
    plain = short_form(f"{product:~C}")
    ratio = size / size_of(plain)
    return (unit, 1.0) if isclose(ratio, 1.0) else (plain, ratio)


def _plain_unit(units: Any, name: str) -> Any:
    """The unit itself, without its prefix, or what it is in base units: the first of size one."""
    for plain in (name, units.parse_unit_name(name)[0][1]):
        if isclose(float(units.Quantity(1.0, plain).to_base_units().magnitude), 1.0):
            return units.Unit(plain)
    return units.Quantity(1.0, name).to_base_units().units


def _unit_of(name: str, entry: Any, section: str) -> str:
    if isinstance(entry, Mapping):
        return str(entry.get("unit") or "")
    if section in ("states", "inputs"):
        return str(entry or "")
    return value_and_unit(name, entry)[1]


def _words_of(name: str, entry: Any, section: str) -> str:
    """What an entry was: ``0.85 1/d``, or ``cm``."""
    if section in ("states", "inputs"):
        return _unit_of(name, entry, section)
    value = entry.get("value") if isinstance(entry, Mapping) else value_and_unit(name, entry)[0]
    unit = _unit_of(name, entry, section)
    return unit if value is None else f"{float(value):g} {unit}"


def _converted(name: str, entry: Any, section: str, unit: str, size: float) -> Any:
    """An entry in another unit, of which one was ``size``."""
    if isinstance(entry, Mapping):
        numbers = {k: float(entry[k]) * size for k in _NUMBERS if entry.get(k) is not None}
        return {**entry, **numbers, "unit": unit}
    if section in ("states", "inputs"):
        return unit
    value, _ = value_and_unit(name, entry)
    return unit if value is None else [value * size, unit]


def _may_hold_conversions(given: Mapping[str, Any]) -> bool:
    """Whether an equation holds a number that is none of a law, or one of a Python function."""
    constants = given.get("constants")
    if isinstance(constants, Mapping) and any(_FOUND.fullmatch(str(n)) for n in constants):
        return True
    equations = write_out(given).get("equations") or ()
    sides = (side for e in equations for side in str(e).split("="))
    return any(not _is_of_a_law(n) for side in sides for n in _numbers_in(side))


def _numbers_in(side: str) -> list[float]:
    tree = syntax.read(replace_primes(side, {}))
    found = (n.value for n in ast.walk(tree) if isinstance(n, ast.Constant))
    return [float(v) for v in found if isinstance(v, int | float)]


def _is_of_a_law(number: float) -> bool:
    """Whether a number is a small whole one, a half or a quarter."""
    return abs(number) <= _LARGEST and float(4 * number).is_integer()
