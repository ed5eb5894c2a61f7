"""A request of the command line, the configuration that it composes, and its outcome."""

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
    """The answer to a request: exit code, JSON result, objects to draw.

    ``result`` is what ``--json`` writes; ``parts`` are the objects that the terminal prints.
    """

    exit: int
    result: dict[str, Any]
    parts: dict[str, Any] = field(default_factory=dict)


def compose_request(request: Request, registry: Registry) -> Config:
    """The composed configuration, on top of a saved run where ``run=`` names one.

    The folder of runs and the tracking address are this command's own: those of a saved run, which
    may come from anywhere, are ignored.
    """
    from spiral.io.config import Options, compose
    from spiral.io.overrides import parse_overrides
    from spiral.io.storage import load_run
    from spiral.io.tracking.store import Tracking, tracking_options
    from spiral.types.fields import defaults_of

    given = {".".join(i.path): i.value for i in parse_overrides(request.overrides)}
    if not given.get("run"):
        config = compose(request.overrides, registry)
        tracking_options(config)  # refused before anything is computed
        _refuse_unused(request, config, registry)
        return config
    saved = load_run(str(given["run"]), str(given.get("out") or "runs"))
    base = saved.as_config()
    if request.verb == "simulate":
        base = _simulation_of_run(base, registry)
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
    from spiral.io.overrides import parse_overrides
    from spiral.io.strategy_config import SHARED, refuse_unused_option, refuse_unused_setting

    if request.verb not in ASK_A_STRATEGY:
        return
    for item in parse_overrides(request.overrides):
        refuse_unused_setting(item, config, registry)
        if item.path[0] in SHARED:
            refuse_unused_option(item, config, registry)


def _simulation_of_run(base: Config, registry: Registry) -> Config:
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
