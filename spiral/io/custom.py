"""Effects by expression in a configuration: ``effect.NAME.expression=FORMULA`` makes a plugin.

A definition lives in the configuration under ``expressions`` as NAME -> fields. Such an effect is a
candidate like any plugin, and part of the model where ``effect``, ``seed`` or a saved run names it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from spiral.io.overrides import Assignment
from spiral.io.registry import Entry, Registry
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError

if TYPE_CHECKING:
    from spiral.types.system import System

Config = dict[str, Any]

KEY = "expressions"
ORIGIN = "expression"
FORMULA = "expression"
_OPEN = ("expression", "units", "shape", "grid", "lower")


def route_expression_overrides(
    config: Config, items: tuple[Assignment, ...], registry: Registry
) -> tuple[tuple[Assignment, ...], Registry]:
    """Overrides of expression effects routed to ``expressions``, and a registry with their names.

    ``config`` gets a definition with every field for each name, in place.

    Raises
    ------
    ConfigError : a name that a plugin has.
    """
    known = registry.names("effect")
    kept = _collect_definitions(config)
    asked = [i.path[1] for i in items if i.path[0] == "effect" and i.path[2:3] == (FORMULA,)]
    names = dict.fromkeys([*kept, *asked, *(i.path[1] for i in items if _is_definition_key(i))])
    for name in names:
        if name in known:
            raise ConfigError(
                f"effect.{name}.expression",
                f"a name that no plugin has; {name} is one",
                f"effect.my_{name}.expression=...",
            )
    config[KEY] = {name: {**_default_definition(), **(kept.get(name) or {})} for name in names}
    turned = tuple(
        replace(i, path=(KEY, *i.path[1:])) if _is_expression_field(i, names) else i for i in items
    )
    made = [Entry("effect", name, Effect, "", ORIGIN, "") for name in names]
    return turned, _add_entries(registry, made)


def open_expression_keys(config: Config) -> list[str]:
    """Fields of definitions that take a mapping."""
    return [f"{KEY}.{name}.{field}" for name in config.get(KEY) or {} for field in _OPEN]


def registry_for_config(config: Mapping[str, Any], registry: Registry) -> Registry:
    """The registry with the effects by expression of a configuration.

    Raises
    ------
    ConfigError : a formula that is not allowed, or whose units do not fit the system.
    """
    definitions, section = config.get(KEY), config.get("system")
    if not definitions or not section:
        return registry
    fields = {k: v for k, v in section.items() if k != "name"}
    return registry_with_expressions(
        registry, definitions, registry.make("system", section["name"], fields)
    )


def registry_with_expressions(
    registry: Registry, definitions: Mapping[str, Mapping[str, Any]], system: System
) -> Registry:
    """The registry with effects by expression for a system.

    Raises
    ------
    ConfigError : a formula that is not allowed, or whose units do not fit the system.
    """
    from spiral.physics.formulas.expression import class_of

    made = []
    for name, given in definitions.items():
        text = json.dumps(given, sort_keys=True, default=str)
        version = hashlib.sha256(text.encode()).hexdigest()[:12]
        effect_class = class_of(name, given, system)
        made.append(Entry("effect", name, effect_class, f"effect.{name}", ORIGIN, version))
    return _add_entries(registry, made)


def _add_entries(registry: Registry, made: Iterable[Entry]) -> Registry:
    made = tuple(made)
    names = {e.name for e in made}
    kept = tuple(e for e in registry.entries if e.kind != "effect" or e.name not in names)
    entries = sorted((*kept, *made), key=lambda e: (e.kind, e.name))
    return replace(registry, entries=tuple(entries))


def _collect_definitions(config: Config) -> dict[str, Any]:
    """Definitions under ``expressions``; those that a preset has under ``effect`` move there."""
    definitions = dict(config.get(KEY) or {})
    effects = config.get("effect")
    if isinstance(effects, Mapping):
        inside = {k: v for k, v in effects.items() if isinstance(v, Mapping) and FORMULA in v}
        definitions |= {str(k): dict(v) for k, v in inside.items()}
        config["effect"] = {k: {} if k in inside else v for k, v in effects.items()}
    return definitions


def _is_definition_key(item: Assignment) -> bool:
    return item.path[0] == KEY and len(item.path) > 1


def _is_expression_field(item: Assignment, names: Iterable[str]) -> bool:
    """Whether an override sets a field of a definition; ``~effect.NAME`` leaves it defined."""
    return item.path[0] == "effect" and len(item.path) > 2 and item.path[1] in names


def _default_definition() -> dict[str, Any]:
    from spiral.physics.formulas.expression import Definition
    from spiral.types.fields import defaults_of

    return defaults_of(Definition)
