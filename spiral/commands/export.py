"""The verb ``export``: the model of a saved run as a program or a text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from spiral.commands.study import Tell
from spiral.io.request import OK, Outcome, Request
from spiral.types.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from spiral.io.registry import Registry

_KEYS = ("run", "out", "system.path")


def export(request: Request, registry: Registry, tell: Tell) -> Outcome:
    """One file, by default in the folder of the run and named after its system.

    Raises
    ------
    ConfigError : an option it has not, no such run or kind, a model that cannot be written so, or
        a local plugin that is not the one that the run recorded.
    InputError : a file that cannot be written.
    """
    from spiral.io.export.kinds import KINDS, export_kind
    from spiral.io.export.kinds import export as written
    from spiral.io.overrides import parse_overrides
    from spiral.io.storage import load_run

    given = {".".join(i.path): i.value for i in parse_overrides(request.overrides)}
    usage = "spiral export RUN --to KIND [--out FILE] [out=FOLDER]"
    for key in given:
        if key not in _KEYS:
            raise ConfigError(f"export {key}=", usage, did_you_mean(key, _KEYS))
    runs = (*request.names, *([str(given["run"])] if given.get("run") else []))
    if len(runs) > 1:
        raise ConfigError(f"export of {', '.join(runs)}", "one run", usage)
    if request.to is None:
        raise ConfigError("export without a kind", f"--to one of {', '.join(KINDS)}", usage)
    kind = export_kind(request.to)
    saved = load_run(runs[0] if runs else "latest", str(given.get("out") or "runs"))
    saved.local_files(registry)  # refused where a plugin is not the one that the run recorded
    model = saved.model(registry)
    beside = saved.file.with_name(f"{model.system.plugin_name()}{kind.suffix}")
    origin = f"run {saved.run_id}"
    tell(f"writing {kind.label}")
    target = written(model, request.to, request.out or beside, origin)
    result = {"run": saved.run_id, "to": request.to, "meaning": kind.meaning, "file": str(target),
              "bytes": target.stat().st_size}  # fmt: skip
    return Outcome(OK, result, {"request": request})
