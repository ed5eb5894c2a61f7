"""Saved runs into MLflow: a parent for each study, a child for each round.

A run is logged once: ``tracked.json`` beside its ``run.json`` says where. One that was saved and
not logged (a locked database, a full disk, a process that was killed) is caught up by the next.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spiral.io.registry import LocalFile, Registry, error_summary, load_registry
from spiral.io.storage import FILE, SavedRun, read_run, run_ids
from spiral.io.tracking import content
from spiral.io.tracking.store import (
    Draw,
    Store,
    Tracking,
    open_store,
    skip_requirement_lookup,
    use_store,
)
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import ConfigError, InputError
from spiral.types.masking import without_passwords
from spiral.types.run import estimate_rows

MARK = "tracked.json"
BEFORE_ANY_FIT = ("identify", "plan")  # verbs whose model has no values to predict with
_BATCH = 100  # parameters or metrics in one call
_NO_PARAMETER = ("run", "out", "n_jobs", "tracking", "sweep")
_CAUGHT_UP = 50  # saved runs that one start logs after the fact, at most


@dataclass(frozen=True)
class TrackingResult:
    """The result of logging: MLflow's ids of the experiment and of every run, or why it failed."""

    runs: Mapping[str, str]
    uri: str = ""
    page: str = ""
    failure: str | None = None
    experiment: str = ""


@dataclass(frozen=True)
class FailedJob:
    """A job of a sweep that left no saved run: which, with what, and why."""

    sweep: str
    number: int
    overrides: tuple[str, ...]
    error: Mapping[str, Any]


def track(
    tracking: Tracking,
    out: str | os.PathLike[str],
    wanted: Sequence[str] = (),
    failed: Sequence[FailedJob] = (),
    catch_up: bool = True,
    draw: Draw | None = None,
    registry: Registry | None = None,
) -> TrackingResult:
    """Log saved runs, and those that an earlier start could not log.

    Parameters
    ----------
    tracking : how; nothing happens where it is not enabled.
    out : folder of saved runs. wanted : ids of runs to log.
    failed : jobs of a sweep that left no saved run.
    catch_up : whether to log saved runs that an earlier start could not log.
    draw : makes the report that is logged with a run; left out, none is.
    registry : the plugins of this command, of which models are built; left out, the installed ones.

    A failure of the store never raises: the saved runs stay, and the next start catches up.
    """
    if not tracking.enabled:
        return TrackingResult({})
    uri, page = without_passwords(tracking.resolve_uri(out)), tracking.page(out)
    folder, registry = Path(out).expanduser(), registry or load_registry(local=False)
    runs: dict[str, str] = {}
    experiment = ""
    try:
        with open_store(tracking, out, draw) as store:
            experiment = str(store.experiment)
            for run_id in wanted:
                runs[run_id] = _log_unless_done(store, tracking, folder / run_id, registry)
            for job in failed:
                _log_failure(store, job)
            if catch_up:
                _log_earlier_runs(store, tracking, folder, registry, max(wanted, default=""))
    except Exception as error:  # of whatever store: the result is saved and must not be lost
        return TrackingResult(runs, uri, page, without_passwords(error_summary(error)))
    return TrackingResult(runs, uri, page, experiment=experiment)


def _log_earlier_runs(
    store: Store, tracking: Tracking, folder: Path, registry: Registry, last: str
) -> None:
    """Log what an earlier start could not; a folder that holds no readable run is passed over.

    Runs behind ``last`` are of commands that may still be at work on them.
    """
    left = [i for i in run_ids(folder) if not (folder / i / MARK).is_file()]
    left = [i for i in left if not last or i <= last]
    for run_id in left[-_CAUGHT_UP:]:
        try:
            saved = read_run(folder / run_id / FILE)
        except InputError:
            continue
        if (saved.config.get("tracking") or {}).get("enabled"):
            _log_unless_done(store, tracking, folder / run_id, registry)


def _log_unless_done(store: Store, tracking: Tracking, folder: Path, registry: Registry) -> str:
    """Log a saved run unless it was; what a killed process logged of it is removed first."""
    mark = folder / MARK
    if mark.is_file():
        return str(json.loads(mark.read_text(encoding="utf-8"))["mlflow_run_id"])
    _remove_partial_runs(store, folder.name)
    saved = read_run(folder / FILE)
    number = _log_study(store, saved, registry if tracking.model else None)
    write_whole(mark, to_json({"mlflow_run_id": number, "uri": without_passwords(store.uri)}))
    return number


def _remove_partial_runs(store: Store, run_id: str) -> None:
    matches = store.client.search_runs([store.experiment], f"tags.`spiral.run_id` = '{run_id}'")
    for parent in matches:
        number = parent.info.run_id
        inner = f"tags.`mlflow.parentRunId` = '{number}'"
        for child in store.client.search_runs([store.experiment], inner):
            store.client.delete_run(child.info.run_id)
        store.client.delete_run(number)


def _log_study(store: Store, saved: SavedRun, registry: Registry | None) -> str:
    """One saved run as a parent with its rounds, its model by a registry; returns MLflow's id."""
    data = saved.data
    started, ended = _start_and_end(data)
    run = store.client.create_run(
        store.experiment, started, content.run_tags(data), content.run_name(data)
    )
    number = run.info.run_id
    config = {k: v for k, v in saved.config.items() if k not in _NO_PARAMETER}
    _log_batches(store, number, content.study_metrics(data), content.flat_parameters(config), ended)
    _log_datasets(store, number, data)
    _log_artifacts(store, number, saved)
    clock = started
    done = content.saved_rounds(data)
    for round_row in done:
        clock = _log_round(store, number, round_row, clock, len(done))
    if registry is not None:
        _log_model(store, number, saved, registry)
    store.client.set_terminated(number, "FINISHED", ended)
    return number


def _log_failure(store: Store, job: FailedJob) -> None:
    """A job as a failed run that says why; one logged before by the same sweep is replaced."""
    where = {"spiral.sweep": job.sweep, "spiral.job": str(job.number)}
    query = " and ".join(f"tags.`{k}` = '{v}'" for k, v in where.items())
    for before in store.client.search_runs([store.experiment], query):
        store.client.delete_run(before.info.run_id)
    message = "; ".join(f"{k}: {v}" for k, v in job.error.items() if v)
    tags = {**where, "spiral.error": message, "mlflow.note.content": message}
    name = f"failed: {' '.join(job.overrides)}"[:250]
    run = store.client.create_run(store.experiment, tags=tags, run_name=name)
    store.client.set_terminated(run.info.run_id, "FAILED")


def _log_round(
    store: Store, parent: str, round_row: Mapping[str, Any], clock: int, count: int
) -> int:
    """One round as a child; returns when it ended, ms."""
    tags = {
        "mlflow.parentRunId": parent,
        "spiral.round": str(round_row.get("round", 0)),
        "spiral.admitted": ", ".join(round_row.get("admitted", ())),
    }
    run = store.client.create_run(store.experiment, clock, tags, content.round_name(round_row))
    ended = clock + round(1000 * (round_row.get("seconds") or 0.0))
    _log_batches(store, run.info.run_id, content.round_metrics(round_row), {}, ended)
    if count > 1:  # a verb that fits once has all of it with the parent
        store.client.log_dict(run.info.run_id, dict(round_row), "round.json")
    store.client.set_terminated(run.info.run_id, "FINISHED", ended)
    return ended


def _log_batches(
    store: Store,
    number: str,
    metrics: Sequence[content.Metric],
    parameters: Mapping[str, str],
    moment: int,
) -> None:
    from mlflow.entities import Metric, Param

    figures = [Metric(k, v, moment, step) for k, v, step in metrics]
    given = [Param(k, v) for k, v in parameters.items()]
    for first in range(0, max(len(figures), len(given)), _BATCH):
        part = slice(first, first + _BATCH)
        store.client.log_batch(number, figures[part], given[part])


def _log_datasets(store: Store, number: str, data: Mapping[str, Any]) -> None:
    """Name, size and hash of every record, as MLflow lists them beside a run."""
    from mlflow.entities import Dataset, DatasetInput, InputTag

    inputs = [
        DatasetInput(
            Dataset(r["name"][-500:] or group, r["sha256"][:36], "local", str(r["name"]),
                    profile=json.dumps({"samples": r["samples"], "rate_hz": r["rate"]})),
            [InputTag("mlflow.data.context", group)],
        )
        for group, records in data["data"].items()
        for r in records
    ]  # fmt: skip
    if inputs:
        store.client.log_inputs(number, inputs)


def _log_artifacts(store: Store, number: str, saved: SavedRun) -> None:
    import pandas as pd
    import yaml

    tables = {
        "terms": estimate_rows(saved.result),
        "suggestions": content.suggestion_rows(saved.data),
    }
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for name, rows in tables.items():
            if rows:
                (folder / f"{name}.json").write_text(to_json(rows), encoding="utf-8")
                pd.DataFrame(content.rows_to_columns(rows)).to_parquet(folder / f"{name}.parquet")
        (folder / "plugins.json").write_text(to_json(saved.data["plugins"]), encoding="utf-8")
        text = yaml.safe_dump(json.loads(to_json(saved.config)), sort_keys=False)
        (folder / "config.yaml").write_text(text, encoding="utf-8")
        (folder / FILE).write_text(to_json(saved.data), encoding="utf-8")
        html = store.draw(saved) if store.draw is not None else None
        if html is not None:
            (folder / "report.html").write_text(html, encoding="utf-8")
        store.client.log_artifacts(number, str(folder))


def _log_model(store: Store, number: str, saved: SavedRun, registry: Registry) -> None:
    """The final model, with the run it is built from and the local plugins it needs.

    A run may come from anywhere: its model is built of this command's plugins alone, and only where
    they are those that it recorded. Where they are not, the tag ``spiral.model`` says so.
    """
    import mlflow

    from spiral.version import __version__

    if saved.verb in BEFORE_ANY_FIT or not saved.data["model"]["values"]:
        return
    try:
        files = saved.local_files(registry)
        signature = _model_signature(saved.model(registry).system)
    except ConfigError as error:
        store.client.set_tag(number, "spiral.model", f"not logged: {error.given}")
        return
    with (
        tempfile.TemporaryDirectory() as place,
        use_store(store),
        skip_requirement_lookup(),
        mlflow.start_run(run_id=number),
    ):
        mlflow.pyfunc.log_model(
            name="model",
            python_model=str(Path(__file__).with_name("served.py")),
            artifacts=_model_artifacts(Path(place), saved, files),
            signature=signature,
            pip_requirements=[f"spiral-po=={__version__}"],
        )


def _model_artifacts(place: Path, saved: SavedRun, files: Sequence[LocalFile]) -> dict[str, str]:
    """Copies of the saved run and of the plugins' files: the very text that was hashed."""
    run = place / FILE
    run.write_text(to_json(saved.data), encoding="utf-8")
    artifacts = {content.RUN: str(run)}
    for index, file in enumerate(files):
        text = Path(file.file).read_bytes()
        if hashlib.sha256(text).hexdigest() != file.sha256:
            raise InputError(
                f"{file.file}, changed since it was loaded", "the file that was loaded"
            )
        target = place / content.PLUGINS / str(index) / Path(file.file).name
        target.parent.mkdir(parents=True)
        target.write_bytes(text)
        artifacts[content.PLUGINS] = str(place / content.PLUGINS)
    return artifacts


def _start_and_end(data: Mapping[str, Any]) -> tuple[int, int]:
    """Start and end of a study in ms since 1970; the end is when it was saved."""
    from datetime import datetime

    ended = round(1000 * datetime.fromisoformat(data["created"]).timestamp())
    taken = sum(r.get("seconds") or 0.0 for r in content.saved_rounds(data))
    taken = taken or data["result"].get("seconds") or 0.0
    return ended - round(1000 * taken), ended


def _model_signature(system: Any) -> Any:
    """Names and types of what the served model takes and gives."""
    from mlflow.models import ModelSignature
    from mlflow.types import ColSpec, ParamSchema, ParamSpec, Schema

    measured: list[Any] = [ColSpec("double", c) for c in (content.TIME, *system.observed)]
    known: list[Any] = [
        ColSpec("double", i.name, required=i.derived_from is None) for i in system.inputs
    ]
    settle = ParamSpec("settle", "double", float("nan"))
    return ModelSignature(Schema([*measured, *known]), Schema(measured), ParamSchema([settle]))
