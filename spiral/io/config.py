"""The configuration of a study: composed by Hydra, checked by the registry, built into a Problem.

Hydra composes ``conf/config.yaml`` and a preset of ``conf/experiment``; groups and values given on
the command line are parsed by its grammar and applied here, so that every name is checked against
the registry and mappings are replaced rather than merged. A composed configuration is plain data.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from spiral.inference.plan_options import PlanOptions
from spiral.inference.problem import Problem, Settings
from spiral.io import custom, problem_setup, strategy_config
from spiral.io.overrides import Assignment, parse_overrides, set_value
from spiral.io.python_model import system_section
from spiral.io.registry import Registry
from spiral.io.strategy_config import build_strategy, gate_fields
from spiral.io.system_files import is_python_file, plugin_of_file
from spiral.types.cache import kept
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.fields import by_name, construct, defaults_of, field_names, is_open, plain
from spiral.types.label import name_of, owner_of, split_port

Config = dict[str, Any]

GROUPS = {
    "system": "system",
    "record": "source",
    "test": "source",
    "derivative": "derivative",
    "observer": "observer",
    "learner": "learner",
    "library": "library",
}
_ANY_FILE = "file"  # the source that reads files of every kind
# Default plugin of each group that configurations of older saved runs lack.
USUAL = {
    "derivative": "total_variation", "learner": "tanh_network", "library": "paper",
    "observer": "ekf",
}  # fmt: skip
PACKAGE = "spiral_conf"
_TEST_SEED_FIELDS = ("name", "settle")


@dataclass(frozen=True)
class Options:
    """The top-level values of a configuration, typed."""

    effect: Any = None
    seed: tuple[str, ...] | None = None
    without: tuple[str, ...] = ()
    candidates: tuple[str, ...] | None = None
    values: Mapping[str, float] | None = None
    free: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    calibrate: bool | None = None
    uncertain: Any = None
    holdout: float | None = None
    holdout_blocks: int = 1
    settings: Any = field(default_factory=dict)
    run: str | None = None
    out: str = "runs"
    curves: bool = True
    n_jobs: int = -1
    tracking: Any = field(default_factory=dict)


def experiments() -> tuple[str, ...]:
    """Names of the presets."""
    from importlib.resources import files

    folder = files(PACKAGE) / "experiment"
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".yaml")))


def register_with_hydra(registry: Registry) -> None:
    """Tell Hydra about the plugins, so that presets can choose them."""
    from hydra.core.config_store import ConfigStore

    store = ConfigStore.instance()
    for name in registry.names("strategy"):
        store.store(
            name=name,
            group="strategy",
            node=strategy_config.default_strategy_section(name, registry),
        )
    for group, kind in GROUPS.items():
        for name in registry.names(kind):
            store.store(name=name, group=group, node=_default_plugin_section(group, name, registry))


def compose(overrides: Sequence[str], registry: Registry, base: Config | None = None) -> Config:
    """The configuration that overrides ask for, on top of ``base`` or the usual values.

    Raises
    ------
    ConfigError : an unknown key, name or field, with near misses; a value that does not parse.
    """
    items = parse_overrides(overrides)
    config = (
        copy.deepcopy(base) if base is not None else _compose_preset(_preset_name(items), registry)
    )
    if base is not None and _preset_name(items):
        raise ConfigError(
            f"experiment={_preset_name(items)} together with run=", "one of them", "leave one out"
        )
    items, registry = custom.route_expression_overrides(config, items, registry)
    strategy_config.normalise_strategy_section(config, registry)
    strategy_config.apply_strategy_choice(config, items, registry)
    _normalise_sections(config, registry)
    taken = (("experiment",), ("strategy",))
    rest = strategy_config.rewrite_strategy_aliases(
        (i for i in items if i.path not in taken), config, registry
    )
    for item in [i for i in rest if len(i.path) == 1]:
        _apply_override(config, item, registry)
    for item in [i for i in rest if len(i.path) > 1]:
        _apply_override(config, item, registry)
    top_level_options(config)
    build_strategy(config, registry)  # refused before anything is read
    return config


def top_level_options(config: Config) -> Options:
    """The top-level values, checked."""
    given = {k: config[k] for k in field_names(Options) if k in config}
    checked = construct(Options, given, "")
    problem_setup.check_holdout(checked.holdout, checked.holdout_blocks)
    return checked


def statistics_settings(config: Config) -> Settings:
    """Levels and sizes of the statistics."""
    checked = construct(Settings, config["settings"], "settings")
    for name in ("level", "alias_level", "whiteness_level", "share", "miss"):
        if not 0 < getattr(checked, name) < 1:
            raise ConfigError(
                f"settings.{name}={getattr(checked, name):g}", "a probability between 0 and 1"
            )
    return checked


def build_system(config: Config, registry: Registry) -> Any:
    """The system of a configuration."""
    return _make_group_plugin("system", config, registry)


def build_derivative(config: Config, registry: Registry) -> Any:
    """The estimator of derivatives of a configuration."""
    return _make_group_plugin("derivative", config, registry)


def build_observer(config: Config, registry: Registry) -> Any:
    """The state estimator of a configuration."""
    return _make_group_plugin("observer", config, registry)


def build_sources(config: Config, registry: Registry) -> tuple[Any, Any | None]:
    """Where the record comes from, and the test record where one is named.

    A field of the test that is left out is as in the record where both have one source.
    """
    registry = custom.registry_for_config(config, registry)
    record = _make_group_plugin("record", config, registry)
    section = config["test"]
    if not section.get("name"):
        return record, None
    given = {k: v for k, v in section.items() if k not in _TEST_SEED_FIELDS and v is not None}
    if section["name"] == config["record"]["name"]:
        given = {**plain(record.as_test()), **given}
        given.pop("name", None)
    return record, registry.make("source", section["name"], given, "test")


def build_effects(config: Config, registry: Registry, system: Any) -> tuple[Any, ...]:
    """The effects of the model: its seed and those added, less those left out."""
    registry = custom.registry_for_config(config, registry)
    chosen = top_level_options(config)
    if chosen.seed is None:
        effects = list(system.seed)
    else:
        effects = [registry.effect_from_label(label) for label in chosen.seed]
    effects += [registry.effect_from_label(k, v) for k, v in config["effect"].items()]
    labels = [e.label for e in effects]
    for label in chosen.without:
        if label not in labels:
            raise ConfigError(
                f"without={label}",
                f"an effect of the model: {', '.join(labels)}",
                did_you_mean(label, labels),
            )
    return tuple(e for e in effects if e.label not in chosen.without)


def build_model(config: Config, registry: Registry) -> Any:
    """The model of a configuration; a system's nominal values are start values."""
    from spiral.inference.simulate import with_defaults
    from spiral.types.model import Model

    registry = custom.registry_for_config(config, registry)
    system = build_system(config, registry)
    chosen = top_level_options(config)
    effects = build_effects(config, registry, system)
    values = dict(chosen.values or {})
    free, fixed = chosen.free, chosen.fixed
    if chosen.run:  # values of effects that are no longer in the model are dropped
        gone = set(registry.names("effect"))

        def is_present(key: str) -> bool:
            owner = owner_of(key)
            return owner in {e.label for e in effects} or name_of(owner) not in gone

        values = {k: v for k, v in values.items() if is_present(k)}
        free, fixed = tuple(filter(is_present, free)), tuple(filter(is_present, fixed))
    return with_defaults(Model(system, effects, values=values, freed=free, fixed=fixed))


def build_problem(config: Config, registry: Registry) -> Problem:
    """The ``Problem`` of a study: its model, with the records loaded and the test kept apart."""
    chosen, levels = top_level_options(config), statistics_settings(config)
    model = build_model(config, registry)
    record, test_source = build_sources(config, registry)
    records = record.load(model.system)
    test = None if test_source is None else test_source.load(model.system)
    return problem_setup.pose_problem(
        custom.registry_for_config(config, registry), model, records, test,
        holdout=chosen.holdout, holdout_blocks=chosen.holdout_blocks,
        settle=config["test"].get("settle"), candidates=chosen.candidates,
        settings=levels, strategy=build_strategy(config, registry),
    )  # fmt: skip


def _preset_name(items: Iterable[Assignment]) -> str | None:
    name = None
    for item in items:
        if item.path == ("experiment",):
            name = item.value
    known = experiments()
    if name is not None and name not in known:
        raise ConfigError(
            f"experiment={name}",
            f"one of {', '.join(known)}",
            did_you_mean(str(name), known),
        )
    return name


def _compose_preset(preset: str | None, registry: Registry) -> Config:
    """``config.yaml`` with a preset, as plain data of the caller's own."""
    return copy.deepcopy(_compose_with_hydra(preset, registry))


@kept(16)
def _compose_with_hydra(preset: str | None, registry: Registry) -> Config:
    """The composition by Hydra, cached: jobs of a sweep and requests of the page repeat it."""
    import hydra
    from hydra.core.global_hydra import GlobalHydra
    from omegaconf import OmegaConf

    register_with_hydra(registry)
    given = [f"experiment={preset}"] if preset else []
    shared = GlobalHydra.instance()
    outer, shared.hydra = shared.hydra, None  # a Hydra application may be running around us
    try:
        with hydra.initialize_config_module(PACKAGE, version_base="1.3"):
            composed = hydra.compose("config", overrides=given)
    finally:
        shared.hydra = outer
    config = OmegaConf.to_container(composed, resolve=True)
    assert isinstance(config, dict)
    return {"experiment": preset, "system": None, "record": None, **config}  # type: ignore[dict-item]


def _default_plugin_section(group: str, name: str, registry: Registry) -> Config:
    """A plugin's fields with their defaults; a test's are empty, to be as in the record."""
    fields = defaults_of(registry.entry(GROUPS[group], name).plugin)
    if group == "test":
        fields = dict.fromkeys(fields)
    return {"name": name, **fields}


def _normalise_sections(config: Config, registry: Registry) -> None:
    """Bring sections to one form: ``test`` with all its fields, ``effect`` as label -> fields."""
    for group, name in USUAL.items():
        if not config.get(group):
            config[group] = _default_plugin_section(group, name, registry)
    test = config["test"] or {}
    extra = [k for k in test if k not in _TEST_SEED_FIELDS]
    if extra and not test.get("name"):
        test = _test_like_record(config, registry, test)
    config["test"] = {"name": None, "settle": None, **test}
    config["effect"] = _effect_fields(config["effect"], registry)
    config["gate"] = gate_fields(config.get("gate"), config, registry)
    config["plan"] = {**defaults_of(PlanOptions), **(config.get("plan") or {})}


def _test_like_record(config: Config, registry: Registry, test: Config) -> Config:
    if not config["record"]:
        raise ConfigError("a test without a record", "record=NAME", "record=csv record.path=FILE")
    name = config["record"]["name"]
    return {**_default_plugin_section("test", name, registry), **test, "name": name}


def _effect_fields(given: Any, registry: Registry) -> Config:
    """``[a, b@PORT]``, ``a`` or ``{a: {field: value}}`` -> label -> all its fields."""
    sections = {}
    for label, fields in by_name(given, "effect", "effect=[cubic_stiffness]").items():
        name, port = split_port(label)
        defaults = defaults_of(registry.entry("effect", name).plugin)
        for hidden in ("variant", *(["port"] if port else [])):
            defaults.pop(hidden)
        sections[label] = {**defaults, **fields}
    return sections


def _apply_override(config: Config, item: Assignment, registry: Registry) -> None:
    first = item.path[0]
    if len(item.path) == 1 and first in GROUPS:
        _choose_group_plugin(config, first, None if item.delete else item.value, registry)
        return
    if item.path == ("effect",):
        config["effect"] = _effect_fields(None if item.delete else item.value, registry)
        return
    if item.path == ("gate",):
        given = [] if item.delete else item.value
        config["gate"] = gate_fields(given, config, registry)
        return
    if first == "test" and item.path[1:] != ("settle",) and not config["test"]["name"]:
        config["test"] = {"settle": None, **_test_like_record(config, registry, config["test"])}
    if first == "record" and not config["record"] and _is_field_of_file(item, registry):
        _choose_group_plugin(config, "record", _ANY_FILE, registry)
    if item.path[-1] == "name" and first in (*GROUPS, "strategy"):
        raise ConfigError(f"{item.text!r}", f"{first}=NAME", f"{first}={item.value}")
    if first in ("effect", "gate") and len(item.path) == 2 and item.delete:
        config[first].pop(item.path[-1], None)
        return
    set_value(config, item, _open_keys(config, registry))


def _is_field_of_file(item: Assignment, registry: Registry) -> bool:
    """Whether an override gives a field of the source that reads files of any kind."""
    known = defaults_of(registry.entry("source", _ANY_FILE).plugin)
    return not item.delete and len(item.path) > 1 and item.path[1] in known


def _choose_group_plugin(config: Config, group: str, name: Any, registry: Registry) -> None:
    """Choose a group's plugin; one that is chosen already keeps the fields that a preset set."""
    if name is None:
        settle = (config["test"] or {}).get("settle")
        config[group] = {"name": None, "settle": settle} if group == "test" else None
        return
    if group == "system" and is_python_file(str(name)):
        config[group] = system_section(str(name), registry.programs)
        return
    file = str(name) if group == "system" and plugin_of_file(str(name)) else ""
    if config[group] and config[group].get("name") == name:
        return
    chosen = _default_plugin_section(group, plugin_of_file(file) or str(name), registry)
    if file:
        chosen["path"] = file
    if group == "test":
        chosen["settle"] = config["test"].get("settle")
    config[group] = chosen


def _open_keys(config: Config, registry: Registry) -> tuple[str, ...]:
    keys = ["values", *custom.open_expression_keys(config)]
    for group, kind in GROUPS.items():
        if config[group] and config[group].get("name"):
            plugin = registry.entry(kind, config[group]["name"]).plugin
            keys += [f"{group}.{f}" for f in field_names(plugin) if is_open(plugin, f)]
    return tuple(keys)


def _make_group_plugin(group: str, config: Config, registry: Registry) -> Any:
    kind = GROUPS[group]
    section = config[group]
    if not section:
        names = registry.names(kind)
        raise ConfigError(
            f"no {group}",
            f"{group}=NAME with one of {', '.join(names)}",
            f"or a preset: experiment={' | '.join(experiments())}",
        )
    fields = {k: v for k, v in section.items() if k != "name"}
    return registry.make(kind, section["name"], fields, group)
