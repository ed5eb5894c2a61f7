"""Saved runs: ``OUT/ID/run.json`` is written as a whole, and loaded to go on from it.

A saved run holds the composed configuration, the model (plugin names, fields, values, errors), the
hashes of its data, the plugins' versions, and the result as ``--json`` writes it. It may
come from anywhere: its id is its folder's name, a link that leads out of its folder is not
followed, and no path that it names is ever run.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.io.run_id import new_run_id
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import ConfigError, InputError, did_you_mean
from spiral.types.fields import plain
from spiral.types.label import make_label
from spiral.types.masking import without_passwords

if TYPE_CHECKING:
    from spiral.io.registry import LocalFile, Registry
    from spiral.types.model import Model
    from spiral.types.record import Record
    from spiral.types.run import Run

FORMAT = 1
FILE = "run.json"
LATEST = "latest"
MAKE_A_MODEL = ("discover", "add")  # verbs whose runs are meant by ``latest``
_MOST = 50 * 10**6  # bytes of text; what a study writes has less than one million
_ID = re.compile(r"\w[\w.-]{0,79}", re.ASCII)


@dataclass(frozen=True)
class SavedRun:
    """A run as it lies on disk."""

    run_id: str
    file: Path
    data: Mapping[str, Any]

    @property
    def verb(self) -> str:
        """The verb that saved it."""
        return str(self.data.get("verb", "discover"))

    @property
    def config(self) -> dict[str, Any]:
        """The configuration it was started with."""
        return dict(self.data["config"])

    @property
    def result(self) -> dict[str, Any]:
        """The result as ``--json`` writes it."""
        return dict(self.data["result"])

    def model(self, registry: Registry) -> Model:
        """Its final model, built again from plugins.

        Raises
        ------
        ConfigError : a plugin it used is not known here.
        """
        return rebuild_model(self.data["model"], registry)

    def local_files(self, registry: Registry) -> tuple[LocalFile, ...]:
        """Files of local plugins that its model is made of, as this command has run them.

        Raises
        ------
        ConfigError : a local plugin that is not loaded here, or whose file is not the one recorded.
        """
        model = self.data["model"]
        used = {
            f"system/{model['system']['name']}",
            *(f"effect/{e['name']}" for e in model["effects"]),
        }
        here, recorded = registry.local_plugins(), _recorded_hashes(self.data.get("local_plugins"))
        files = {}
        for key in sorted(used & {*here, *recorded}):
            file = here.get(key)
            if file is None or file.sha256 != recorded.get(key):
                raise ConfigError(
                    f"{key} of run {self.run_id}, " + ("not loaded here" if file is None else
                    f"which is not what {file.file} holds now"),
                    "the plugin file that the run recorded, by its SHA-256",
                    "--plugins DIR with that file",
                )  # fmt: skip
            files[file.file] = file
        return tuple(files.values())

    def as_config(self) -> dict[str, Any]:
        """A configuration whose model is this run's final one.

        Its effects become ``seed`` (those with fields of their own ``effect``), so that further
        effects are added to them; its values become start values.
        """
        saved = self.data["model"]
        config = self.config
        config["system"] = dict(saved["system"])  # with the text of the files that it was read from
        own = {_effect_label(e): _own_fields(e) for e in saved["effects"]}
        config["seed"] = [label for label, fields in own.items() if not fields]
        config["effect"] = {label: fields for label, fields in own.items() if fields}
        config["without"] = []
        config["values"] = _known_numbers(saved["values"])
        config["free"], config["fixed"] = list(saved["freed"]), list(saved["fixed"])
        defined = {**(config.get("expressions") or {}), **saved.get("expressions", {})}
        config["expressions"] = defined or None
        config["run"] = self.run_id
        return config


def save_run(
    run: Run,
    config: Mapping[str, Any],
    records: Mapping[str, Sequence[Record]],
    registry: Registry,
    folder: str | os.PathLike[str],
    verb: str = "discover",
) -> Run:
    """Write a run and return it with its id.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    named = replace(run, run_id=run.run_id or new_run_id(others=run_ids(folder)))
    save_result(verb, named.as_dict(), named.model, config, records, registry, folder)
    return named


def save_result(
    verb: str,
    result: Mapping[str, Any],
    model: Model,
    config: Mapping[str, Any],
    records: Mapping[str, Sequence[Record]],
    registry: Registry,
    folder: str | os.PathLike[str],
    overrides: Sequence[str] = (),
) -> str:
    """Write what a verb found, with its model and all that it came from; returns the run's id.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    run_id = str(result.get("run_id") or new_run_id(others=run_ids(folder)))
    named = {**result, "run_id": run_id}
    content = saved_run_content(verb, named, model, config, records, registry, overrides)
    target = Path(folder).expanduser() / run_id / FILE
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, to_json(content))
    except OSError as error:
        raise unwritable_folder_error(folder, error) from error
    return run_id


def saved_run_content(
    verb: str,
    result: Mapping[str, Any],
    model: Model,
    config: Mapping[str, Any],
    records: Mapping[str, Sequence[Record]],
    registry: Registry,
    overrides: Sequence[str] = (),
) -> dict[str, Any]:
    """All that is saved of a run, as plain data."""
    run_id = str(result.get("run_id") or new_run_id())
    return {
        "format": FORMAT,
        "run_id": run_id,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "verb": verb,
        "overrides": [without_passwords(o) for o in overrides],
        "config": _mask_tracking_password(config),
        "plugins": registry.versions(),
        "local_plugins": _local_hashes(model, registry),
        "data": {k: [_record_summary(r) for r in group] for k, group in records.items()},
        "model": model_data(model),
        "result": {**result, "run_id": run_id},
    }


def _mask_tracking_password(config: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration whose address of MLflow holds no password."""
    tracking = config.get("tracking") or {}
    uri = tracking.get("uri")
    masked = {**tracking, "uri": without_passwords(uri)} if isinstance(uri, str) else tracking
    return {**config, "tracking": masked} if "tracking" in config else dict(config)


def unwritable_folder_error(folder: str | os.PathLike[str], error: OSError) -> InputError:
    """The error for a folder of runs that cannot be written (no permission, a full disk)."""
    return InputError(
        f"folder of runs {str(folder)!r}: {error.strerror or error}",
        "a folder that can be written",
        "out=FOLDER, or free some space; what was written before is kept",
    )


def model_data(model: Model) -> dict[str, Any]:
    """Enough to build a model again: plugin names, fields, values, errors, formulas."""
    from spiral.physics.formulas.expression import definitions_of

    return {
        "system": plain(model.system),
        "effects": [plain(e) for e in model.effects],
        "values": dict(model.values),
        "errors": dict(model.errors),
        "correlations": {k: dict(row) for k, row in model.correlations.items()},
        "freed": list(model.freed),
        "fixed": list(model.fixed),
        "expressions": definitions_of(model.effects),
    }


def rebuild_model(saved: Mapping[str, Any], registry: Registry) -> Model:
    """A model built again from what ``model_data`` gave.

    Raises
    ------
    ConfigError : a plugin it used is not known here.
    """
    from spiral.io.custom import registry_with_expressions
    from spiral.types.model import Model

    fields = {k: v for k, v in saved["system"].items() if k != "name"}
    system = registry.make("system", saved["system"]["name"], fields)
    registry = registry_with_expressions(registry, saved.get("expressions", {}), system)
    effects = tuple(
        registry.effect_from_label(e["name"], {k: v for k, v in e.items() if k != "name"})
        for e in saved["effects"]
    )
    return Model(
        system,
        effects,
        values=_known_numbers(saved["values"]),
        freed=tuple(saved["freed"]),
        fixed=tuple(saved["fixed"]),
        errors=_known_numbers(saved["errors"]),
        correlations={k: _known_numbers(row) for k, row in saved.get("correlations", {}).items()},
    )


def load_run(name: str, folder: str | os.PathLike[str]) -> SavedRun:
    """A saved run by ``latest``, its id, or the start of its id.

    Raises
    ------
    ConfigError : no such run, or several that start so.
    InputError : a file that is not a saved run.
    """
    known = run_ids(folder)
    if not known:
        raise ConfigError(
            f"run={name}", f"a saved run in {str(folder)!r}",
            "run discover first; what Python made is not saved there (pickle keeps it)",
        )  # fmt: skip
    matches = [_latest_run_id(known, folder)] if name == LATEST else [i for i in known if i == name]
    matches = matches or [i for i in known if i.startswith(name)]
    if len(matches) > 1:
        raise ConfigError(
            f"run={name}, which {len(matches)} runs start with",
            "one run",
            f"type more of it: {', '.join(matches[:4])}",
        )
    if not matches:
        raise ConfigError(
            f"run={name}",
            f"latest, or one of the {len(known)} runs in {str(folder)!r}",
            did_you_mean(name, known) if len(known) < 6 else f"the last is {known[-1]}",
        )
    return read_run(Path(folder).expanduser() / matches[0] / FILE)


def _latest_run_id(known: Sequence[str], folder: str | os.PathLike[str]) -> str:
    """The last run that made a model; where none did, the last of all."""
    for name in reversed(known):
        if read_run(Path(folder).expanduser() / name / FILE).verb in MAKE_A_MODEL:
            return name
    return known[-1]


def read_run(file: Path) -> SavedRun:
    """A saved run from its file; the name of its folder is its id.

    Raises
    ------
    InputError : a file that is not a saved run, or lies elsewhere.
    """
    try:
        data = json.loads(read_text_inside(file.parent, file.name))
        if data["format"] > FORMAT:
            raise InputError(
                f"{file}: format {data['format']}", f"at most {FORMAT}", "update this program"
            )
        run_id = file.absolute().parent.name
        return SavedRun(run_id, file, {**data, "run_id": run_id})
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{file}: {error}", "a run saved by this program") from error


def resolve_inside_folder(folder: Path, name: str) -> Path:
    """A file of a folder, links resolved.

    Raises
    ------
    InputError : a link leads out of the folder.
    """
    place, target = folder.resolve(), (folder / name).resolve()
    if not target.is_relative_to(place):
        raise InputError(
            f"{folder / name}, a link out of its folder",
            f"a file in {folder}",
            "copy the file there",
        )
    return target


def read_text_inside(folder: Path, name: str) -> str:
    """The text of a file of a folder.

    Raises
    ------
    InputError : a link leads out of the folder, or more than any study writes. OSError : no file.
    """
    file = resolve_inside_folder(folder, name)
    if file.stat().st_size > _MOST:
        raise InputError(
            f"{file}: {file.stat().st_size / 1e6:.3g} MB of text",
            f"at most {_MOST / 1e6:.3g} MB", "a folder that this program wrote",
        )  # fmt: skip
    return file.read_text(encoding="utf-8")


def run_folder(folder: str | os.PathLike[str], run_id: str) -> Path:
    """The folder of a run.

    Raises
    ------
    ConfigError : no name that a run may have.
    """
    if not _ID.fullmatch(run_id):
        raise ConfigError(
            f"run {run_id[:60]!r}", "the id of a saved run", "choose one from the list"
        )
    return Path(folder).expanduser() / run_id


def run_ids(folder: str | os.PathLike[str]) -> list[str]:
    """Ids of the saved runs, oldest first."""
    place = Path(folder).expanduser()
    if not place.is_dir():
        return []
    return sorted(p.name for p in place.iterdir() if _ID.fullmatch(p.name) and (p / FILE).is_file())


def _record_summary(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "samples": record.samples,
        "rate": 1.0 / record.dt,
        "sha256": record.sha256,
        "notes": list(record.remarks),
    }


def _local_hashes(model: Model, registry: Registry) -> dict[str, str]:
    """``kind/name`` -> SHA-256 of the file, of the local plugins that a model is made of."""
    used = {f"{p.kind}/{p.plugin_name()}" for p in (model.system, *model.effects)}
    return {k: f.sha256 for k, f in registry.local_plugins().items() if k in used}


def _recorded_hashes(recorded: Any) -> dict[str, str]:
    """Hashes as a run recorded them; runs of earlier versions recorded paths, which say nothing."""
    return dict(recorded) if isinstance(recorded, Mapping) else {}


def _effect_label(effect: Mapping[str, Any]) -> str:
    return make_label(effect["name"], effect.get("port") or "")


def _own_fields(effect: Mapping[str, Any]) -> dict[str, Any]:
    """Fields beyond its place."""
    return {k: v for k, v in effect.items() if k not in ("name", "port", "variant")}


def _known_numbers(values: Mapping[str, float | None]) -> dict[str, float]:
    return {k: float(v) for k, v in values.items() if v is not None}
