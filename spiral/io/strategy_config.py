"""The strategy section of a configuration: its options, and refusal of those it does not use.

A strategy's own numbers are ``strategy.FIELD``. Its plugins are options of their own: ``gate``,
``derivative``, ``learner``, ``library``. ``NAME.FIELD`` (``paper.points``) is another spelling of
``strategy.FIELD`` for the strategy of that name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from spiral.inference.strategies.base import Strategy
from spiral.types.errors import ConfigError
from spiral.types.fields import by_name, defaults_of, field_names

if TYPE_CHECKING:
    from spiral.io.overrides import Assignment
    from spiral.io.registry import Registry
    from spiral.types.plugin import Plugin

Config = dict[str, Any]

PARTS = ("derivative", "learner", "library")
"""Options that choose one plugin of a strategy: groups of the configuration."""
SECTIONS = ("gate", *PARTS)
"""Fields of a strategy that are options of their own."""
FOR_IDENTIFY = ("share", "miss")
"""Settings that only ``identify`` looks at."""
SHARED = ("derivative",)
"""Options that a verb without a strategy (``identify``) uses too."""


def strategy_option_defaults(name: str, registry: Registry) -> dict[str, Any]:
    """``strategy.FIELD`` -> its usual value, of a strategy by name."""
    fields = defaults_of(registry.entry("strategy", name).plugin)
    return {k: v for k, v in fields.items() if k not in SECTIONS}


def default_strategy_section(name: str, registry: Registry) -> Config:
    """The configuration's ``strategy`` with the usual values of its options."""
    return {"name": name, **strategy_option_defaults(name, registry)}


def apply_strategy_choice(config: Config, items: Iterable[Assignment], registry: Registry) -> None:
    """Switch to the strategy that the overrides name, with that strategy's default plugins."""
    for item in items:
        name = str(item.value)
        if item.path != ("strategy",) or name == config["strategy"]["name"]:
            continue
        config["strategy"], config["gate"] = default_strategy_section(name, registry), None
        usual = defaults_of(registry.entry("strategy", name).plugin)
        config.update({part: usual[part] for part in PARTS if usual.get(part)})


def normalise_strategy_section(config: Config, registry: Registry) -> None:
    """Turn ``strategy: NAME`` (older saved runs) into a mapping; ``paper.*`` become its options."""
    given = config["strategy"]
    if isinstance(given, str):
        own = strategy_option_defaults(given, registry)
        former = {k: v for k, v in (config.get(given) or {}).items() if k in own}
        config["strategy"] = {"name": given, **own, **former}
    config.pop("paper", None)


def gate_fields(given: Any, config: Mapping[str, Any], registry: Registry) -> dict[str, Any]:
    """``[a, b]``, ``a`` or ``{a: {field: value}}`` -> name -> all its fields; null: the usual ones.

    Raises
    ------
    ConfigError : not a list of gates, or an unknown name.
    """
    if given is None:
        usual = defaults_of(_strategy_class(config, registry)).get("gate") or ()
        return {g["name"]: {k: v for k, v in g.items() if k != "name"} for g in usual}
    chain = by_name(given, "gate", "gate=[bonferroni_t,partial_f]")
    return {
        name: {**defaults_of(registry.entry("gate", name).plugin), **fields}
        for name, fields in chain.items()
    }


def rewrite_strategy_aliases(
    items: Iterable[Assignment], config: Mapping[str, Any], registry: Registry
) -> list[Assignment]:
    """Overrides with ``NAME.FIELD`` rewritten to ``strategy.FIELD``; unused options are refused.

    Raises
    ------
    ConfigError : an option of another strategy, whatever the verb.
    """
    rewritten = []
    for item in items:
        first = item.path[0]
        if first not in SHARED:
            refuse_unused_option(item, config, registry)
        if first == config["strategy"]["name"] and first not in config and len(item.path) > 1:
            item = replace(item, path=("strategy", *item.path[1:]))
        rewritten.append(item)
    return rewritten


def refuse_unused_option(item: Assignment, config: Mapping[str, Any], registry: Registry) -> None:
    """Refuse an option that the strategy of a configuration has no use for.

    Raises
    ------
    ConfigError : it would be dropped in silence.
    """
    first, name = item.path[0], config["strategy"]["name"]
    known = registry.names("strategy")
    what = first
    if first in SECTIONS:
        users = [s for s in known if first in field_names(registry.entry("strategy", s).plugin)]
    else:
        other = first in known and first not in config
        users, what = ([first], ".".join(item.path[1:])) if other else ([name], "")
    if name in users:
        return
    own = (
        *strategy_option_defaults(name, registry),
        *plugin_option_names(_strategy_class(config, registry)),
    )
    others = " or ".join(f"strategy={user} {item.text}" for user in users)
    raise ConfigError(
        f"{item.text}, not an option of strategy={name}",
        f"one of {', '.join(own) or 'none'}; {what} is one of {' and '.join(users)}",
        f"{others}, or leave it out" if others else "leave it out",
    )


def refuse_unused_setting(item: Assignment, config: Mapping[str, Any], registry: Registry) -> None:
    """Refuse a setting that the strategy of a configuration never looks at.

    Raises
    ------
    ConfigError : it would be dropped in silence.
    """
    plugin = _strategy_class(config, registry)
    assert issubclass(plugin, Strategy)
    if item.path[0] != "settings" or item.path[-1] not in (*plugin.ignores, *FOR_IDENTIFY):
        return
    unused = ", ".join((*plugin.ignores, *FOR_IDENTIFY))
    raise ConfigError(
        f"{item.text}, which strategy={plugin.plugin_name()} never looks at",
        f"settings other than {unused}",
        "leave it out; spiral plugins strategy tells the others",
    )


def build_strategy(config: Mapping[str, Any], registry: Registry) -> Strategy:
    """The strategy of a configuration, with its options and plugins.

    Raises
    ------
    ConfigError : a value out of range, or a gate that judges other evidence.
    """
    fields = {k: v for k, v in config["strategy"].items() if k != "name"}
    for part in plugin_option_names(_strategy_class(config, registry)):
        fields[part] = (
            _build_gates(config["gate"], registry)
            if part == "gate"
            else _build_strategy_part(part, config[part], registry)
        )
    made = registry.make("strategy", config["strategy"]["name"], fields, "strategy")
    assert isinstance(made, Strategy)
    return made


def _strategy_class(config: Mapping[str, Any], registry: Registry) -> type[Plugin]:
    return registry.entry("strategy", config["strategy"]["name"]).plugin


def plugin_option_names(plugin: type[Plugin]) -> tuple[str, ...]:
    """Fields of a strategy that are options of their own."""
    return tuple(s for s in SECTIONS if s in field_names(plugin))


def _build_gates(gates: Mapping[str, Any], registry: Registry) -> tuple[Any, ...]:
    pairs = gates.items()
    return tuple(registry.make("gate", name, fields, f"gate.{name}") for name, fields in pairs)


def _build_strategy_part(part: str, given: Mapping[str, Any], registry: Registry) -> Any:
    fields = {k: v for k, v in given.items() if k != "name"}
    return registry.make(part, given["name"], fields, part)
