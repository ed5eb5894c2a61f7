"""A study as a program to copy: records read, the model with what was added, what is missing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spiral.app.study import Study
from spiral.inference.problem import Settings
from spiral.io.config import GROUPS, Config, Options, defaults_of
from spiral.io.problem_setup import USUAL_STRATEGY
from spiral.io.registry import Registry

_CHOICES = ("candidates", "without", "values", "free", "fixed", "holdout", "holdout_blocks")
_FILES = ("file", "csv")


def non_default_options(config: Config, registry: Registry) -> dict[str, Any]:
    """Options that differ from the defaults: ``system``, ``record``, ``test``, ``choices``.

    Empty where the functions of Python cannot say one of them, as an effect given by a formula.
    """
    if config.get("expressions") or config["effect"] or config.get("seed") is not None:
        return {}
    usual = {k: v for k, v in vars(Options()).items() if k in _CHOICES}
    choices = {k: config[k] for k in _CHOICES if config[k] and config[k] != usual[k]}
    levels = _non_default_fields(config["settings"] or {}, defaults_of(Settings))
    strategy = _plugin_options("strategy", "strategy", config, registry)
    if strategy != {"name": USUAL_STRATEGY}:
        choices["strategy"] = strategy if len(strategy) > 1 else strategy["name"]
    return {
        "system": _plugin_options("system", GROUPS["system"], config, registry),
        "record": _plugin_options("record", GROUPS["record"], config, registry),
        "test": {k: v for k, v in config["test"].items() if v is not None},
        "choices": {**choices, **({"settings": levels} if levels else {})},
    }


def program_text(study: Study, out: Path) -> str:
    """Lines of Python for the step that is looked at; empty before its first fit."""
    turn = study.turn
    if turn is None:
        return ""
    if not study.program or study.own:
        if not turn.run_id:
            return ""
        return f"import spiral\n\nmodel = spiral.load({turn.run_id!r}, {str(out)!r})\nprint(model)"
    given = study.program
    record, test = dict(given["record"]), dict(given["test"])
    settle = {"settle": test.pop("settle")} if "settle" in test else {}
    lines = ["import spiral", "", f"system = {_system_argument(given['system'])}",
             f"record = {_read_call(record)}"]  # fmt: skip
    arguments = {"effects": list(study.added)} if study.added else {}
    arguments |= {**given["choices"], **settle}
    words = [f"{key}={_python_literal(value)}" for key, value in arguments.items()]
    if test:
        same = test.get("name") == record["name"]
        shared = {k: v for k, v in record.items() if k != "rows"} if same else {}
        lines.append(f"test = {_read_call({**shared, **test})}")
        words.insert(0, "test=test")
    wanted = _wrap_arguments(["record", "system", *words])
    return "\n".join([*lines, f"found = spiral.diagnose({wanted})", "print(found)"])


def _plugin_options(group: str, kind: str, config: Config, registry: Registry) -> dict[str, Any]:
    """A plugin's name and those of its fields that differ from their defaults."""
    section = {k: v for k, v in config[group].items() if k != "name"}
    name = config[group]["name"]
    return {
        "name": name,
        **_non_default_fields(section, defaults_of(registry.entry(kind, name).plugin)),
    }


def _non_default_fields(given: Mapping[str, Any], usual: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in given.items() if v != usual.get(k)}


def _system_argument(given: Mapping[str, Any]) -> str:
    """A file of equations by its path, a plugin by its name, or by name and fields."""
    if set(given) == {"name", "path"}:
        return _python_literal(given["path"])
    return _python_literal(given["name"] if len(given) == 1 else given)


def _read_call(fields: Mapping[str, Any]) -> str:
    """The call that reads records: of files, or of any other source by its name."""
    own = {k: v for k, v in fields.items() if k not in ("name", "path")}
    if fields["name"] not in _FILES:
        return f"spiral.read({_python_literal({'name': fields['name'], **own})}, system)"
    words = [f"{key}={_python_literal(value)}" for key, value in own.items()]
    return f"spiral.read({_wrap_arguments([_python_literal(fields['path']), 'system', *words])})"


def _wrap_arguments(arguments: list[str]) -> str:
    """Arguments on one line where they fit, else on lines of their own."""
    line = ", ".join(arguments)
    return line if len(line) < 78 else "".join(f"\n    {one}," for one in arguments) + "\n"


def _python_literal(value: Any) -> str:
    """A value as Python writes it."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{str(k)!r}: {_python_literal(v)}' for k, v in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_python_literal, value))}]"
    return repr(value)
