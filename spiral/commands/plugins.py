"""The verbs ``plugins``, ``check`` and ``new``: list plugins, verify them, write a skeleton."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from spiral.commands.study import Tell
from spiral.io.request import BAD_INPUT, OK, Outcome, Request
from spiral.types.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from spiral.io.registry import Entry, Registry
    from spiral.io.testing import Check
    from spiral.types.system import System


def list_plugins(request: Request, registry: Registry) -> Outcome:
    """Every plugin, or those of the kinds and names asked for; the model that a file holds.

    A kind beside a name of that kind only says what the name is (``spiral plugins effect rub``).
    """
    from spiral.io.system_files import is_model_file

    known = {*registry.kinds, *(e.name for e in registry.entries)}
    files = [n for n in request.names if is_model_file(n)]
    for name in request.names:
        if name not in known and name not in files:
            raise ConfigError(
                f"plugin or kind {name!r}",
                f"a kind ({', '.join(registry.kinds)}), a plugin's name or a model's file",
                did_you_mean(name, known),
            )
    models = {f: _chosen_system((f"system={f}",), registry)[0] for f in files}
    asked = set(request.names)
    told = {e.kind for e in registry.entries if e.name in asked}
    wanted = asked - told
    entries = [e for e in registry.entries if not asked or e.name in asked or e.kind in wanted]
    result = {
        "plugins": [_plugin_dict(e) for e in entries],
        "failures": [
            {"name": f.name, "file": f.file, "message": f.message} for f in registry.failures
        ],
        "models": {f: [list(q) for q in s.quantities()] for f, s in models.items()},
    }
    parts = {"entries": entries, "failures": registry.failures, "asked": asked, "models": models}
    return Outcome(OK, result, parts)


def check_plugins(request: Request, registry: Registry, tell: Tell) -> Outcome:
    """Run the conformance suite on plugins, or on the model that is chosen; exit 2 at a failure.

    A model is a file (``model.yaml``), or what overrides choose (``system=NAME system.FIELD=1``).
    """
    from spiral.io.system_files import is_model_file
    from spiral.io.testing import check_plugin, failed

    if not request.names and not request.overrides:
        raise ConfigError("check", "spiral check NAME, or system=MODEL.yaml", "spiral plugins")
    systems = [n for n in request.names if is_model_file(n) or n in registry.names("system")]
    if request.overrides:  # of a system that is named, or that they choose
        models = [tuple(f"system={n}" for n in systems[:1]) + tuple(request.overrides)]
        plugins = [n for n in request.names if n not in systems[:1]]
    else:
        models = [(f"system={n}",) for n in systems if is_model_file(n)]
        plugins = [n for n in request.names if not is_model_file(n)]
    checked = [_check_model(overrides, registry, tell) for overrides in models]
    for entry in (e for name in plugins for e in registry.named(name)):
        tell(f"checking {entry.kind} {entry.name}")
        checked.append((entry, check_plugin(entry, registry)))
    result: dict[str, Any] = {
        "passed": not any(failed(checks) for _, checks in checked),
        "plugins": [
            {
                "kind": entry.kind,
                "name": entry.name,
                "file": entry.file,
                "passed": not failed(checks),
                "checks": [c.as_dict() for c in checks],
            }
            for entry, checks in checked
        ],
    }
    if not result["passed"]:
        result["error"] = _first_failure(checked)
    return Outcome(OK if result["passed"] else BAD_INPUT, result, {"checked": checked})


def _chosen_system(overrides: Sequence[str], registry: Registry) -> tuple[System, dict[str, Any]]:
    """The system that overrides choose, and the configuration."""
    from spiral.io.config import build_system, compose

    config = compose(overrides, registry)
    return build_system(config, registry), config


def _check_model(
    overrides: Sequence[str], registry: Registry, tell: Tell
) -> tuple[Entry, list[Check]]:
    """The system that overrides choose, its checks, under the name of its file if it is one.

    Records that they name are read, and what was understood of them is told.
    """
    from spiral.io.config import build_sources
    from spiral.io.programs import programs_named
    from spiral.io.system_files import is_python_file
    from spiral.io.testing import check_records, check_system

    system, config = _chosen_system(overrides, registry)
    chosen = config["system"]
    entry = registry.entry("system", chosen["name"])
    program = next(filter(is_python_file, programs_named(overrides)), "")
    file = str(chosen.get("path") or program)
    tell(f"checking {file or chosen['name']}")
    named = replace(entry, name=file, file=file) if file else entry
    checks = check_system(system)
    if file:  # the docstring is that of the plugin which reads files
        checks = [c for c in checks if c.name != "docstring"]
    if any(text.startswith(("record", "test")) for text in overrides):
        sources = zip(("record", "test"), build_sources(config, registry), strict=True)
        checks += [check_records(k, source, system) for k, source in sources if source is not None]
    return named, checks


def _first_failure(checked: Sequence[tuple[Entry, list[Check]]]) -> dict[str, str]:
    from spiral.io.testing import failed

    entry, failures = next((e, failed(checks)) for e, checks in checked if failed(checks))
    more = f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""
    kind = "model" if entry.name == entry.file else "plugin"
    passing = f"a {kind} that passes {failures[0].name!r}"
    given = f"{entry.kind} {failures[0].on}, in {entry.file}: {failures[0].seen}"
    if failures[0].name in ("record", "test"):
        passing, given = "records that this model can read", failures[0].seen
    return {
        "given": given,
        "expected": f"{passing}{more}",
        "try": failures[0].try_,
    }


def create_plugin(request: Request) -> Outcome:
    """Write a skeleton of a plugin and its test into the folder of local plugins."""
    import os
    from pathlib import Path

    from spiral.io.registry import DEFAULT_FOLDER, FOLDER_VARIABLE, NO_FOLDER, load_registry
    from spiral.io.scaffold import KINDS, new_plugin, similar_plugins

    _require_names_only(request, "spiral new KIND NAME", f"KIND is one of {', '.join(KINDS)}")
    if len(request.names) != 2:
        raise ConfigError(
            f"new {' '.join(request.names)}", "spiral new KIND NAME", "spiral new effect my_spring"
        )
    kind, name = request.names
    given = request.plugins or os.environ.get(FOLDER_VARIABLE) or DEFAULT_FOLDER
    folder = Path(given).expanduser()
    registry = load_registry(folder, local=folder.is_dir() and request.plugins != NO_FOLDER)
    files = new_plugin(kind, name, folder, registry)
    near = similar_plugins(name, registry)
    result = {"kind": kind, "name": name, "files": [str(f) for f in files], "similar": near}
    parts = {"files": files, "name": name, "similar": near, "plugins": request.plugins}
    return Outcome(OK, result, parts)


def _require_names_only(request: Request, expected: str, try_: str) -> None:
    if not request.names or request.overrides:
        words = " ".join([request.verb, *request.names, *request.overrides])
        raise ConfigError(words, expected, try_)


def _plugin_dict(entry: Any) -> dict[str, Any]:
    from spiral.types.fields import defaults_of, field_meanings

    fields = {k: v for k, v in defaults_of(entry.plugin).items() if k != "variant"}
    parameters = getattr(entry.plugin, "parameters", ())
    return {
        "kind": entry.kind,
        "name": entry.name,
        "meaning": entry.plugin.meaning(),
        "fields": fields,
        "field_meanings": field_meanings(entry.plugin),
        "parameters": {p.name: p.unit for p in parameters} if isinstance(parameters, tuple) else {},
        "origin": entry.origin,
        "version": entry.version,
        "file": entry.file,
    }
