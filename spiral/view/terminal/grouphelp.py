"""Help that names the plugins: ``spiral VERB --help`` and ``spiral VERB --help GROUP|NAME``.

Only this help loads the registry; a plugin that fails to import is a line of it.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from spiral.types.errors import ConfigError, SpiralError, did_you_mean

if TYPE_CHECKING:
    from spiral.io.registry import Entry, Registry

GROUPS = {"system": "system", "record": "source", "test": "source", "effect": "effect"}
"""Group as it is typed -> kind of plugin; other kinds are groups of their own name."""

_SETTINGS, _OTHERS = "settings", "others"
_SHIPPED = "spiral-po"


def groups_help(plugins: str | None, words: Sequence[str] = ()) -> str:
    """Every group with its options; for each of ``words`` the fields of a group or a plugin.

    Raises
    ------
    ConfigError : a word is neither.
    """
    from spiral.inference.problem import Settings
    from spiral.io.config import experiments
    from spiral.io.registry import load_registry
    from spiral.types.fields import defaults_of

    try:
        registry = load_registry(plugins)
    except SpiralError as error:
        return f"options of each group: not known, {error.given} (expected: {error.expected})"
    if words:
        return "\n\n".join(
            _group_or_plugin_help(word.partition("=")[2] or word, registry) for word in words
        )
    lines = ["options of each group (-m sweeps over them: system=a,b):"]
    for group, kind in _option_groups(registry).items():
        lines += _group_line(f"{group}=", _choices(kind, registry))
    lines += _group_line("experiment=", experiments())
    lines += _group_line(f"{_SETTINGS}.", list(defaults_of(Settings)))
    lines += _group_line(_OTHERS, list(_other_keys()))
    lines += _failure_lines(registry)
    return "\n".join([*lines, "", "--help GROUP or --help NAME tells meanings and fields"])


def _choices(kind: str, registry: Registry) -> list[str]:
    """Names of a kind that a command may choose; of systems also the ends of models' files."""
    from spiral.io.system_files import PLUGINS, PYTHON

    ends = sorted({*PLUGINS, PYTHON}) if kind == "system" else ()
    return [*registry.names(kind), *(f"FILE{end}" for end in ends)]


def _other_keys() -> dict[str, list[str]]:
    """Keys of the configuration that are no group -> their lines in ``conf/config.yaml``."""
    from spiral.io.config import PACKAGE

    text = files(PACKAGE).joinpath("config.yaml").read_text("utf-8")
    keys: dict[str, list[str]] = {}
    for line in text.splitlines():
        if (key := line.partition(":")[0]) and line[:1] not in ("#", " "):
            keys[key] = [line]
        elif keys and line.strip():
            keys[list(keys)[-1]].append(line)
    return {k: v for k, v in keys.items() if k not in ("defaults", "effect", "test", _SETTINGS)}


def _option_groups(registry: Registry) -> dict[str, str]:
    own = {kind: kind for kind in registry.kinds if kind not in GROUPS.values()}
    return {**{g: k for g, k in GROUPS.items() if k in registry.kinds}, **own}


def _group_or_plugin_help(word: str, registry: Registry) -> str:
    groups = _option_groups(registry)
    if word in groups:
        entries = [e for e in registry.entries if e.kind == groups[word]]
        width = max(len(e.name) for e in entries)
        listed = [line for e in entries for line in _plugin_lines(e, width)]
        return "\n".join([f"{word}=", *listed, *_failure_lines(registry)])
    if word == _SETTINGS:
        return "\n".join(_settings_help())
    keys = _other_keys()
    if lines := keys.get(word):
        return "\n".join(lines)
    if word == _OTHERS:
        return "\n".join(line for lines in keys.values() for line in lines)
    matches = [e for e in registry.entries if e.name == word]
    if not matches:
        known = [*groups, _SETTINGS, _OTHERS, *keys, *(e.name for e in registry.entries)]
        expected = f"a group ({', '.join((*groups, _SETTINGS, _OTHERS))}) or a plugin's name"
        raise ConfigError(f"--help {word}", expected, did_you_mean(word, known))
    by_kind = {kind: group for group, kind in reversed(groups.items())}
    return "\n".join(line for e in matches for line in _plugin_help(e, by_kind[e.kind]))


def _plugin_lines(entry: Entry, width: int) -> list[str]:
    """A plugin in a group: its meaning, and the names of its fields."""
    lines = _wrap_text(_meaning_and_origin(entry), f"  {entry.name:<{width}}  ")
    fields = ", ".join(_visible_fields(entry))
    return lines + (_wrap_text(f"fields: {fields}", " " * (width + 4)) if fields else [])


def _plugin_help(entry: Entry, group: str) -> list[str]:
    """A plugin by itself: its meaning, its fields with usual values, its parameters."""
    from spiral.types.fields import field_meanings

    lines = [f"{group}={entry.name}", *_wrap_text(_meaning_and_origin(entry), "  ")]
    key = f"effect.{entry.name}" if group == "effect" else group
    meanings, own = field_meanings(entry.plugin), " ".join(f"{s}=" for s in _sections_of(entry))
    for name, value in _visible_fields(entry).items():
        shown = "null" if value is None else repr(value)
        lines += _wrap_text(f"{key}.{name}={shown}", "    ")
        lines += _wrap_text(meanings[name], " " * 8) if name in meanings else []
    lines += _wrap_text(f"beside them: {own}", "    ") if own else []
    parameters = getattr(entry.plugin, "parameters", ())
    if parameters and isinstance(parameters, tuple):
        named = ", ".join(f"{p.name} ({p.unit or '1'})" for p in parameters)
        lines += _wrap_text(f"parameters: {named}", "    ")
    return lines


def _settings_help() -> list[str]:
    """The settings of a study with usual values and meanings, from their class."""
    from spiral.inference.problem import Settings
    from spiral.types.fields import defaults_of, field_meanings

    lines, meanings = [f"{_SETTINGS}.NAME=VALUE"], field_meanings(Settings)
    for name, value in defaults_of(Settings).items():
        shown = str(value).lower() if isinstance(value, bool) else repr(value)
        lines += _wrap_text(f"{_SETTINGS}.{name}={shown}", "    ")
        lines += _wrap_text(meanings[name], " " * 8)
    return lines


def _meaning_and_origin(entry: Entry) -> str:
    own = "" if entry.origin == _SHIPPED else f" [{entry.origin} {entry.version}]"
    return f"{entry.plugin.meaning()}{own}"


def _visible_fields(entry: Entry) -> dict[str, Any]:
    from spiral.types.fields import defaults_of

    hidden = {"variant", *_sections_of(entry)}
    return {k: v for k, v in defaults_of(entry.plugin).items() if k not in hidden}


def _sections_of(entry: Entry) -> tuple[str, ...]:
    """Fields that are options of their own: the plugins of a strategy."""
    from spiral.io.strategy_config import plugin_option_names

    return plugin_option_names(entry.plugin) if entry.kind == "strategy" else ()


def _failure_lines(registry: Registry) -> list[str]:
    return [
        line
        for f in registry.failures
        for line in _wrap_text(f"not usable: {f.name} in {f.file}: {f.message}", "  ")
    ]


def _group_line(key: str, names: Sequence[str]) -> list[str]:
    return _wrap_text(", ".join(names), f"  {key:<12}")


def _wrap_text(text: str, first: str) -> list[str]:
    width = max(40, min(shutil.get_terminal_size().columns, 110) - 2)
    return textwrap.wrap(
        text, width, initial_indent=first, subsequent_indent=" " * len(first),
        break_long_words=False, break_on_hyphens=False,
    ) or [first]  # fmt: skip
