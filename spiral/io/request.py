"""What was asked on the command line, the configuration that it composes, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spiral.io.config import Config
    from spiral.io.registry import Registry

ASK_A_STRATEGY = ("discover", "diagnose", "compare", "add")

OK, BAD_INPUT, REFUSED = 0, 2, 3
"""Exit codes: an answer, a question that cannot be asked, an honest refusal."""


@dataclass(frozen=True)
class Request:
    """What was asked: a verb, names (effects, kinds), overrides, and where plugins lie.

    ``out`` is the file to write, ``to`` the kind of an export.
    """

    verb: str
    names: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    plugins: str | None = None
    out: str | None = None
    to: str | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    ``result`` is the JSON contract's; ``parts`` are the objects that the terminal draws, by name.
    """

    exit: int
    result: dict[str, Any]
    parts: dict[str, Any] = field(default_factory=dict)


def configured(request: Request, registry: Registry) -> Config:
    """The composed configuration, on top of a saved run where ``run=`` names one.

    Where runs are kept and told to is this command's affair: a saved run, which may come from
    anywhere, has no say in it.
    """
    from spiral.io.config import Options, compose
    from spiral.io.overrides import parse
    from spiral.io.storage import load_run
    from spiral.io.tracking.store import Tracking, tracking_of
    from spiral.types.fields import defaults_of

    given = {".".join(i.path): i.value for i in parse(request.overrides)}
    if not given.get("run"):
        config = compose(request.overrides, registry)
        tracking_of(config)  # refused before anything is computed
        _refuse_unused(request, config, registry)
        return config
    saved = load_run(str(given["run"]), str(given.get("out") or "runs"))
    base = saved.as_config()
    if request.verb == "simulate":
        base = _as_truth(base, registry)
    base |= {"out": Options.out, "tracking": defaults_of(Tracking)}
    base["sweep"] = {**(base.get("sweep") or {}), "id": None, "address": None}
    kept = tuple(o for o in request.overrides if not o.startswith("run="))
    config = {**compose(kept, registry, base), "run": saved.run_id}
    _refuse_unused(request, config, registry)
    return config


def _refuse_unused(request: Request, config: Config, registry: Registry) -> None:
    """Refuse what another verb may look at, where this one's strategy does not.

    Raises
    ------
    ConfigError : an option that nobody would look at.
    """
    from spiral.io.overrides import parse
    from spiral.io.strategy_config import SHARED, check_settings, check_used

    if request.verb not in ASK_A_STRATEGY:
        return
    for item in parse(request.overrides):
        check_settings(item, config, registry)
        if item.path[0] in SHARED:
            check_used(item, config, registry)


def _as_truth(base: Config, registry: Registry) -> Config:
    """A saved run's model as what ``record=simulation`` integrates."""
    from spiral.types.fields import defaults_of

    fields = defaults_of(registry.entry("source", "simulation").plugin)
    seeded = [e.label for e in registry.make("system", base["system"]["name"]).seed]
    labels = [*base["seed"], *base["effect"]]
    record = {
        "name": "simulation",
        **fields,
        "effects": [
            {"name": label, **base["effect"].get(label, {})}
            for label in labels
            if label not in seeded
        ],
        "without": [label for label in seeded if label not in labels],
        "values": dict(base["values"]),
    }
    return {**base, "record": record, "test": {"name": None, "settle": None}}
