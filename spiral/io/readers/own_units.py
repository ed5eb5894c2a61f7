"""Conversion from a file's units to a system's, some of which are fields of the system."""

from __future__ import annotations

from dataclasses import fields, replace

from spiral.types.errors import InputError
from spiral.types.system import System
from spiral.types.units import base_form, conversion

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
