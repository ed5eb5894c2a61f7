"""Conversion from a file's units to a system's, some of which are fields of the system."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import fields, replace

import numpy as np

from spiral.types.errors import InputError
from spiral.types.record import Array
from spiral.types.system import System
from spiral.types.units import base_form, conversion

_TURN = 2 * np.pi
_COLD, _COLDEST = -90.0, 150.0  # of numbers that are degrees Celsius, sooner than kelvins
_NEAR_ZERO = 0.05  # of what a series covers
_BEFORE = re.compile(r".*[\W_]")  # what stands before a name's last word: speed_rpm, angle-deg
_BEFORE_TIME = re.compile(r".*(?:[\W_]|[a-z](?=[A-Z]))")  # and timeMs
_SAID = re.compile(
    "[num\u00b5chkMG](m|g|s|A|V|W|N|Pa|Hz|J|K|bar|rad|l|L|F|H|T|Ohm|mol)"
    "|Pa|Hz|bar|rad|deg|rpm|rps|psi|degC|degF|mol"
)
"""Endings of names that are units; ``in``, ``min`` or ``pc`` are words or indices sooner."""
_UNIT_OF_TIME = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("us", "microseconds", "micros"), "us"),
    **dict.fromkeys(("ms", "msec", "milliseconds", "millis"), "ms"),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), "min"),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), "h"),
    "days": "day",
}
"""Last words of a time column's name that say a unit."""
_ANY = "cd"  # candela, which no system uses: a series that takes it has its unit set by the field


def conversion_to_system(given: str, system: System, name: str) -> tuple[float, float]:
    """Factor and zero that take values of a series in ``given`` to the system's unit.

    ``name`` is a channel, an input, or ``time``, which is in s.

    Raises
    ------
    InputError : an unknown unit, or one of another dimension; the message names the field of the
        system that sets its own unit, where it has one.
    """
    if name == "time":
        return conversion(given, "s", name)
    try:
        return conversion(given, system.unit_of(name), name)
    except InputError as error:
        field = unit_field(system, name)
        if not field or base_form(given) is None:
            raise
        own = f"; where {given!r} is what the machine works in, system.{field}='{given}'"
        raise InputError(error.given, error.expected, f"{error.try_}{own}") from error


def unit_at_end(column: str, system: System, name: str) -> str:
    """The unit that a column's name ends with (``speed_rpm``); empty where it names none.

    It counts where it has the dimension of the series. A single letter is an index as often, and
    counts where it is the series' own unit.
    """
    if name == "time":
        return _UNIT_OF_TIME.get(_BEFORE_TIME.sub("", column.strip()).lower(), "")
    said, own = _BEFORE.sub("", column.strip()), system.unit_of(name)
    if said == own or not _SAID.fullmatch(said):
        return said if said == own else ""
    try:
        conversion(said, own, name)
    except InputError:
        return ""
    return said


def unit_doubts(
    system: System, series: Mapping[str, Array], said: Collection[str]
) -> dict[str, str]:
    """A question for each series whose numbers are unusual in the system's unit, which no one said.

    An angle that swings by more than a turn to and fro, a temperature (one that is never zero, as a
    rise of it is) below the coldest places on earth: these are more often in degrees.
    """
    doubts = {}
    for name, values in series.items():
        seen = values[np.isfinite(values)]
        if name in said or len(seen) < 2:
            continue
        unit, low, high = system.unit_of(name), float(seen.min()), float(seen.max())
        is_rise = np.abs(seen).min() <= _NEAR_ZERO * (high - low)
        swings = high - low > _TURN and abs(seen[-1] - seen[0]) < (high - low) / 2
        likely = {
            "deg": unit == "rad" and swings,
            "degC": unit == "K" and low > _COLD and high < _COLDEST and not is_rise,
        }
        for other in (u for u, is_likely in likely.items() if is_likely):
            doubts[name] = (
                f"values of {name} run from {low:.3g} to {high:.3g} {unit}, and nobody said that "
                f"they are in {unit}: if they are in {other}, record.units='{{{name}: {other}}}'"
            )
    return doubts


def unit_field(system: System, name: str) -> str:
    """The field that sets a state's or input's unit, as ``force_unit``; empty where none does."""
    for field in fields(system):
        if not field.name.endswith("_unit"):
            continue
        try:
            if replace(system, **{field.name: _ANY}).unit_of(name) == _ANY:
                return field.name
        except Exception:  # a plugin's own check of its fields may raise anything
            continue
    return ""
