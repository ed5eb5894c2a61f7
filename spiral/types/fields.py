"""From a configuration's plain values to the typed fields of a frozen dataclass, and back."""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

from spiral.types.cache import kept
from spiral.types.errors import ConfigError, SpiralError, did_you_mean
from spiral.types.plugin import Plugin

_SECTION = "Fields\n------\n"
Resolve = Callable[[type, Any, str], Any]
"""(kind of plugin, its name or label or mapping, where it was given) -> the plugin."""


def field_names(cls: type) -> tuple[str, ...]:
    """Names of the fields in order."""
    return tuple(f.name for f in dataclasses.fields(cls))


def field_meanings(cls: type) -> dict[str, str]:
    """Field -> its text under ``Fields`` in the docstring of the class or of a base class."""
    meanings: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        _, _, section = inspect.cleandoc(base.__dict__.get("__doc__") or "").partition(_SECTION)
        names: list[str] = []
        for line in section.split("\n\n")[0].splitlines():
            start = re.match(r"(\w+(?:, \w+)*) : (.*)", line)
            if start:
                names = start[1].split(", ")
                meanings.update(dict.fromkeys(names, start[2]))
            elif names:
                meanings.update({n: f"{meanings[n]} {line.strip()}" for n in names})
    return {n: meanings[n].replace("``", "") for n in field_names(cls) if n in meanings}


@kept(1024)
def is_open(cls: type, name: str) -> bool:
    """Whether a field takes a mapping with keys of the user's choice."""
    hint = typing.get_type_hints(cls)[name]
    return any(h is Any or _type_origin(h) is Mapping for h in (hint, *typing.get_args(hint)))


def defaults_of(cls: type) -> dict[str, Any]:
    """Field -> default as plain data (lists, mappings, numbers, text); ``None`` without one."""
    defaults = {}
    for item in dataclasses.fields(cls):
        value = None
        if item.default is not dataclasses.MISSING:
            value = item.default
        elif item.default_factory is not dataclasses.MISSING:
            value = item.default_factory()
        defaults[item.name] = plain(value)
    return defaults


def plain(value: Any) -> Any:
    """A field's value as plain data; a plugin becomes its label or ``{name, fields}``."""
    if isinstance(value, Plugin):
        given = {k: plain(getattr(value, k)) for k in field_names(type(value))}
        return {"name": value.plugin_name(), **given}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [plain(v) for v in value]
    if callable(value):  # a function: its name, from which it cannot be rebuilt
        return f"{value.__module__}.{value.__qualname__}"
    return value


def by_name(given: Any, what: str, example: str) -> dict[str, dict[str, Any]]:
    """``[a, b]``, ``a``, ``{a: {field: value}}`` or nothing -> name -> the fields given with it.

    Raises
    ------
    ConfigError : none of these.
    """
    if given is None:
        return {}
    if isinstance(given, str):
        given = [given]
    if isinstance(given, list):
        given = dict.fromkeys(map(str, given))
    if not isinstance(given, Mapping):
        raise ConfigError(f"{what}={given!r}", f"a list of {what}s", example)
    return {str(name): dict(fields or {}) for name, fields in given.items()}


def construct(
    cls: type, given: Mapping[str, Any], where: str, resolve: Resolve | None = None
) -> Any:
    """An instance from plain values.

    Parameters
    ----------
    cls : a frozen dataclass.
    given : field -> plain value.
    where : its name in messages, e.g. ``record``.
    resolve : finds a plugin by name for fields that hold one.

    Raises
    ------
    ConfigError : an unknown field (near misses are named) or a value of another type.
    """
    known = field_names(cls)
    hints = typing.get_type_hints(cls)
    values = {}
    for name, value in given.items():
        if name not in known:
            raise unknown_field(where, str(name), known)
        values[name] = convert(value, hints[name], f"{where}.{name}".lstrip("."), resolve)
    try:
        return cls(**values)
    except SpiralError:
        raise
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where} with {dict(given)}", "fields that fit", str(error)) from error


def unknown_field(where: str, name: str, known: tuple[str, ...]) -> ConfigError:
    """The error for a field that the class does not have."""
    expected = (
        f"a field of {where}: {', '.join(known)}" if known else f"no fields: {where} has none"
    )
    return ConfigError(f"{where}.{name}", expected, did_you_mean(name, known))


def convert(value: Any, hint: Any, where: str, resolve: Resolve | None = None) -> Any:
    """A plain value as the type a field declares."""
    if hint is Any:
        return value
    origin, arguments = _type_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _convert_union(value, arguments, where, resolve)
    if origin is typing.Literal:
        if value in arguments:
            return value
        names = [str(a) for a in arguments]
        raise _wrong_value_error(
            where, value, f"one of {', '.join(names)}", did_you_mean(str(value), names)
        )
    if origin is tuple:
        return _convert_tuple(value, arguments, where, resolve)
    if origin is Mapping:
        of = arguments[1] if len(arguments) > 1 else Any
        if of is str and isinstance(value, list | tuple) and all(isinstance(n, str) for n in value):
            value = {name: name for name in value}  # a list of names: each is called as it is
        if not isinstance(value, Mapping):
            raise _wrong_value_error(where, value, "a mapping", f"{where}='{{name: value}}'")
        return {str(k): convert(v, of, f"{where}.{k}", resolve) for k, v in value.items()}
    if isinstance(hint, type) and issubclass(hint, Plugin):
        if isinstance(value, hint) or resolve is None:
            return value
        return resolve(hint, value, where)
    return _convert_scalar(value, hint, where)


def _type_origin(hint: Any) -> Any:
    origin = typing.get_origin(hint) or hint
    return Mapping if isinstance(origin, type) and issubclass(origin, Mapping) else origin


def _wrong_value_error(where: str, value: Any, expected: str, try_: str = "") -> ConfigError:
    return ConfigError(f"{where}={value!r}", expected, try_)


def _convert_union(
    value: Any, members: tuple[Any, ...], where: str, resolve: Resolve | None
) -> Any:
    if value is None and type(None) in members:
        return None
    errors = []
    for member in members:
        if member is type(None):
            continue
        try:
            return convert(value, member, where, resolve)
        except ConfigError as error:
            errors.append(error)
    raise errors[-1]


def _convert_tuple(
    value: Any, members: tuple[Any, ...], where: str, resolve: Resolve | None
) -> Any:
    item = members[0] if members else Any
    if isinstance(value, str) or (not members and not isinstance(value, list | tuple)):
        value = [value]
    if not isinstance(value, list | tuple):
        raise _wrong_value_error(where, value, "a list", f"{where}='[...]'")
    if members and members[-1] is not Ellipsis and len(value) != len(members):
        raise _wrong_value_error(where, value, f"a list of {len(members)} values")
    return tuple(convert(v, item, f"{where}[{i}]", resolve) for i, v in enumerate(value))


def _convert_scalar(value: Any, hint: Any, where: str) -> Any:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if hint is bool and isinstance(value, bool):
        return value
    if hint is int and number and float(value).is_integer():
        return int(value)
    if hint is float and number:
        return float(value)
    if hint is str and (isinstance(value, str) or number):
        return str(value)
    words = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
    raise _wrong_value_error(where, value, words.get(hint, f"a value of type {hint}"))
