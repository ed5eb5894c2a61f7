"""Overrides of a configuration, parsed by Hydra's grammar and applied to plain data.

A key is checked against what is there: top-level keys, the fields of the chosen plugins, the
fields of chosen effects. Fields that take a mapping accept any key below them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from spiral.types.errors import ConfigError, did_you_mean

_LONGEST, _DEEPEST = 20_000, 50  # letters, and brackets in one another
_NAME = re.compile(r"[\w./\\%°-][\w ./\\%°^*:'()\[\]{}-]*")  # of a column or a file, units too
_BARE = re.compile(r"(:\s*)([^\s,:{}\[\"'][^,:{}\"']*?)(?=\s*[,}])")  # a mapping's value, no quotes
_PRIMED = re.compile(r"(?<=[{,\s])([A-Za-z_]\w*)('{1,2})(?=\s*:)")  # a mapping's key, x' or x''
_PLAIN_VALUE = re.compile(r"[+-]?[\d.]+([eE][+-]?\d+)?|true|false|null", re.IGNORECASE)


@dataclass(frozen=True)
class Assignment:
    """One override: where, what, and whether the key is taken away (``~key``)."""

    path: tuple[str, ...]
    value: Any
    text: str
    delete: bool = False


def parse_overrides(texts: Sequence[str]) -> tuple[Assignment, ...]:
    """Overrides without sweeps.

    Raises
    ------
    ConfigError : what Hydra's grammar does not read, or a sweep.
    """
    assignments = []
    for text, override in zip(texts, _parse_with_hydra(texts), strict=True):
        if override.is_sweep_override():
            raise ConfigError(
                f"{text!r}, several values",
                "one value, or a sweep over them",
                "add -m to run once for each value, or write a list as [a,b]",
            )
        path = tuple(_full_key(override).split("."))
        assignments.append(Assignment(path, override.value(), text, override.is_delete()))
    return tuple(assignments)


def expand_sweep(texts: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """The jobs of a sweep in order: every combination of the values given."""
    from hydra._internal.core_plugins.basic_sweeper import BasicSweeper

    batches = BasicSweeper.split_arguments(_parse_with_hydra(texts), max_batch_size=None)
    return tuple(tuple(job) for batch in batches for job in batch)


def _parse_with_hydra(texts: Sequence[str]) -> list[Any]:
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    parser = OverridesParser.create()
    parsed = []
    for text in texts:
        if len(text) > _LONGEST or _bracket_depth(text) > _DEEPEST:
            raise ConfigError(
                f"an override of {len(text)} letters, {text[:40]}...",
                f"at most {_LONGEST} letters, and {_DEEPEST} brackets in one another",
                "a preset: a file in experiment/",
            )
        try:
            parsed.append(_parse_one(parser, _quote_formula(text)))
        except (HydraException, ValueError) as error:  # a number of thousands of digits
            raise ConfigError(
                f"{text[:200]!r}: {str(error).splitlines()[0]}",
                "KEY=VALUE, KEY=[a,b] or KEY='{a: b}'",
                "quote values with special characters: KEY='\"...\"'",
            ) from error
    return parsed


def _parse_one(parser: Any, text: str) -> Any:
    """An override; a name with brackets, which the grammar does not read, is a plain text.

    So ``record.time=t [s]`` and ``record.path=run (2).csv`` mean what they say, and so do the
    values of a mapping, ``record.units={X: g/m^3}``; its key ``x''`` is ``x_acceleration``.
    """
    from hydra.errors import HydraException

    try:
        return parser.parse_override(text)
    except HydraException:
        key, _, value = text.partition("=")
        if _NAME.fullmatch(value):
            return parser.parse_override(f'{key}="{value}"')
        if not value.startswith("{"):
            raise
        named = _PRIMED.sub(lambda m: m[1] + ("_rate", "_acceleration")[len(m[2]) - 1], value)
        return parser.parse_override(f"{key}={_BARE.sub(_quote_text, named)}")


def _quote_text(pair: re.Match[str]) -> str:
    """A mapping's value in quotes, unless it is a number or a word of the grammar."""
    return pair[0] if _PLAIN_VALUE.fullmatch(pair[2]) else f'{pair[1]}"{pair[2]}"'


def _bracket_depth(text: str) -> int:
    """How deep brackets of any kind lie in one another, at most."""
    steps = ((letter in "[{(") - (letter in "]})") for letter in text)
    return max(accumulate(steps), default=0)


def _quote_formula(text: str) -> str:
    """A formula in quotes, so that its brackets are not the grammar's: effect.NAME.expression=f(x).

    Commas outside brackets still part the values of a sweep.
    """
    key, equals, value = text.partition("=")
    if not equals or "expression" not in key.split(".")[2:] or value[:1] in ("", *"'\"[{"):
        return text
    parts, depth = [""], 0
    for letter in value:
        depth += {"(": 1, ")": -1}.get(letter, 0)
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    quoted = ['"' + p.strip().replace('"', '\\"') + '"' for p in parts]
    return f"{key}={','.join(quoted)}"


def _full_key(override: Any) -> str:
    """The key as typed: Hydra takes ``effect.NAME@PORT.field`` for a group and its package."""
    package = f"@{override.package}" if override.package else ""
    return f"{override.key_or_group}{package}"


def set_value(tree: dict[str, Any], item: Assignment, is_open: tuple[str, ...]) -> None:
    """Put one value into nested plain data, in place.

    ``is_open`` are dotted keys of fields that take a mapping with keys of the user's choice.
    """
    node: Any = tree
    for depth, word in enumerate(item.path):
        here = ".".join(item.path[:depth])
        last = depth == len(item.path) - 1
        if here in is_open:
            _set_open(node, item, depth)
            return
        if node is None:
            raise ConfigError(f"{item.text!r}, but no {here} is chosen", f"{here}=NAME before it")
        if not isinstance(node, dict):
            raise ConfigError(f"{item.text!r}", f"{here}=VALUE, which has no fields")
        if word not in node:
            raise _unknown_key_error(item, here, tuple(node))
        if last:
            _assign_value(node, word, item, ".".join(item.path) in is_open)
            return
        if node[word] is None and ".".join(item.path[: depth + 1]) in is_open:
            node[word] = {}
        node = node[word]


_SWITCHES = {"True": True, "False": False, "on": True, "off": False, "yes": True, "no": False,
             "none": False, "None": False}  # fmt: skip


def _assign_value(node: dict[str, Any], word: str, item: Assignment, mapping: bool) -> None:
    plugin = len(item.path) > 1 and isinstance(node[word], dict) and "name" in node[word]
    if item.delete:
        node[word] = {} if isinstance(node[word], dict) else None
    elif isinstance(node[word], dict) and "enabled" in node[word] and str(item.value) in _SWITCHES:
        node[word]["enabled"] = _SWITCHES[str(item.value)]
    elif isinstance(node[word], dict) and not mapping and not plugin:
        raise ConfigError(
            f"{item.text!r}",
            f"a field of {word}: {', '.join(node[word])}",
            f"{'.'.join(item.path)}.FIELD=VALUE",
        )
    else:
        node[word] = item.value


def _set_open(node: dict[str, Any], item: Assignment, depth: int) -> None:
    """Below an open field the rest of the path is one key: ``values.cubic_stiffness.stiffness``."""
    key = ".".join(item.path[depth:])
    first, *rest = item.path[depth:]
    if isinstance(node.get(first), dict) and rest:
        node[first] = dict(node[first])
        node[first][".".join(rest)] = item.value
        return
    if item.delete:
        node.pop(key, None)
    else:
        node[key] = item.value


def _unknown_key_error(item: Assignment, here: str, known: tuple[str, ...]) -> ConfigError:
    names = tuple(k for k in known if k != "name")
    word = item.path[len(here.split(".")) if here else 0]
    what = f"a field of {here}" if here else "a key of the configuration"
    expected = f"{what}: {', '.join(names)}" if names else f"nothing here: {here} has no fields"
    hint = did_you_mean(word, names)
    if not here and word == "effects":  # what Python calls them
        hint = "seed=[NAME, ...] begins with these effects"
    if here in ("system", "effect"):
        hint += f"; the first value of a parameter is values.{'.'.join(item.path)}={item.value}"
    return ConfigError(f"{'.'.join(item.path)!r}", expected, hint)
