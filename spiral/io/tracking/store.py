"""Where runs are tracked: SQLite beside the saved runs, or as `MLFLOW_TRACKING_URI` says."""

from __future__ import annotations

import contextlib
import logging
import os
import secrets
import socket
import sqlite3
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from spiral.io.storage import SavedRun
from spiral.types.errors import InputError
from spiral.types.fields import construct
from spiral.types.masking import without_passwords

if TYPE_CHECKING:
    from mlflow import MlflowClient

URI_VARIABLE = "MLFLOW_TRACKING_URI"
DATABASE, ARTIFACTS, LOCK = "mlflow.db", "artifacts", ".tracking.lock"
_PATIENCE = 120.0  # s to wait for another process that writes to the same store
_REACH = 3.0  # s to wait for a server's first answer
_TRIES = {"MLFLOW_HTTP_REQUEST_MAX_RETRIES": "2", "MLFLOW_HTTP_REQUEST_TIMEOUT": "20"}


@dataclass(frozen=True)
class Tracking:
    """How runs are tracked.

    Parameters
    ----------
    enabled : whether runs are logged to MLflow at all.
    uri : MLflow's tracking URI; left out, ``MLFLOW_TRACKING_URI``, else SQLite in ``out``.
    experiment : MLflow's experiment.
    model : whether the final model is logged, ready to predict.
    """

    enabled: bool = True
    uri: str | None = None
    experiment: str = "spiral"
    model: bool = True

    def resolve_uri(self, out: str | os.PathLike[str]) -> str:
        """The tracking URI in force."""
        own = Path(out).expanduser().resolve() / DATABASE
        return self.uri or os.environ.get(URI_VARIABLE) or f"sqlite:///{own}"

    def page(self, out: str | os.PathLike[str]) -> str:
        """What opens MLflow's page on this store: a command, or the server's own address."""
        uri = self.resolve_uri(out)
        if not uri.startswith("sqlite:"):
            shown = without_passwords(uri)
            return shown if uri.startswith("http") else f"mlflow ui --backend-store-uri {shown}"
        file = Path(uri.removeprefix("sqlite:///"))
        with contextlib.suppress(ValueError):
            file = file.relative_to(Path.cwd())
        return f"mlflow ui --backend-store-uri sqlite:///{file}"


def tracking_options(config: Mapping[str, Any]) -> Tracking:
    """The tracking that a composed configuration asks for.

    Raises
    ------
    ConfigError : an unknown field, or a value of another type.
    """
    return construct(Tracking, config.get("tracking") or {}, "tracking")


Draw = Callable[[SavedRun], str | None]
"""Makes the HTML report of a saved run; nothing where the run kept no curves."""


@dataclass(frozen=True)
class Store:
    """An open store; ``draw`` makes the report of a saved run, where it can have one."""

    client: MlflowClient
    experiment: str
    uri: str
    draw: Draw | None = None


@contextlib.contextmanager
def open_store(
    tracking: Tracking, out: str | os.PathLike[str], draw: Draw | None = None
) -> Iterator[Store]:
    """The store, created and migrated where it is new; other processes wait meanwhile.

    Artifacts of a database go into a folder beside the saved runs; a server decides for itself.
    """
    from filelock import FileLock

    folder = Path(out).expanduser().resolve()
    folder.mkdir(parents=True, exist_ok=True)
    uri = tracking.resolve_uri(out)
    if uri.startswith("http"):
        _check_server(uri)
    with (
        FileLock(folder / LOCK, timeout=_PATIENCE),
        _silence_mlflow(),
    ):  # who waits has not imported MLflow
        from mlflow import MlflowClient

        if uri == f"sqlite:///{folder / DATABASE}" and not (folder / DATABASE).is_file():
            _create_database(folder / DATABASE)
        client = MlflowClient(tracking_uri=uri)
        known = client.get_experiment_by_name(tracking.experiment)
        if known is not None:
            number = known.experiment_id
        else:
            served = uri.startswith("http")
            place = None if served else (folder / ARTIFACTS).as_uri()
            number = client.create_experiment(tracking.experiment, artifact_location=place)
        yield Store(client, number, uri, draw)


def _create_database(file: Path) -> None:
    """MLflow's database, whole or not at all: one whose tables are half made can never be opened.

    The copy by SQLite holds all that is written, whatever connections MLflow keeps to the first.
    """
    from mlflow import MlflowClient

    for left in file.parent.glob(f".{file.name}.*"):  # of a process that was killed
        left.unlink(missing_ok=True)
    trial = file.with_name(f".{file.name}.{secrets.token_hex(4)}.tmp")
    copy = trial.with_suffix(".copy.tmp")
    try:
        MlflowClient(tracking_uri=f"sqlite:///{trial}").search_experiments(max_results=1)
        with (
            contextlib.closing(sqlite3.connect(trial)) as made,
            contextlib.closing(sqlite3.connect(copy)) as whole,
        ):
            made.backup(whole)
        os.replace(copy, file)
    finally:
        for left in file.parent.glob(f"{trial.stem}*"):
            left.unlink(missing_ok=True)


def _check_server(uri: str) -> None:
    """One short try to reach a server, where MLflow's own client would try for minutes.

    Raises
    ------
    InputError : nobody answers.
    """
    parts = urlsplit(uri)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    try:
        socket.create_connection((parts.hostname or "", port), timeout=_REACH).close()
    except OSError as error:
        raise InputError(
            f"no answer from {without_passwords(uri)} ({error.strerror or error})",
            "a tracking server that runs",
        ) from error


def import_mlflow() -> None:
    """Import MLflow, which takes a second or two, without its reports to its makers."""
    for name, value in _TRIES.items():  # a server that dies in the middle is left within a minute
        os.environ.setdefault(name, value)
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
    os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")  # where JSON may go
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")
    import mlflow  # noqa: F401


@contextlib.contextmanager
def use_store(store: Store) -> Iterator[None]:
    """The store as MLflow's own default, for the calls that take no client.

    MLflow exports a default URI to the environment; what was there before comes back.
    """
    import mlflow

    before = os.environ.get(URI_VARIABLE)
    mlflow.set_tracking_uri(store.uri)
    try:
        yield
    finally:
        mlflow.set_tracking_uri(before or "")
        if before is None:
            os.environ.pop(URI_VARIABLE, None)


@contextlib.contextmanager
def skip_requirement_lookup() -> Iterator[None]:
    """Model requirements are logged as they are given.

    MLflow lists every file of every installed package (2 s) to find the module of each requirement,
    only to warn where another version is installed; here they name this very version.
    """
    from mlflow.utils import requirements_utils as found

    before = getattr(found, "_MODULES_TO_PACKAGES", None)
    found._MODULES_TO_PACKAGES = before or {}
    try:
        yield
    finally:
        found._MODULES_TO_PACKAGES = before


@contextlib.contextmanager
def _silence_mlflow() -> Iterator[None]:
    """MLflow, imported, without its remarks and those of its migrations on a new database."""
    names = ("mlflow", "alembic", "psycopg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        import_mlflow()  # which sets the levels of its own
        levels = [logging.getLogger(n).level for n in names]
        for name in names:
            logging.getLogger(name).setLevel(logging.ERROR)
        try:
            yield
        finally:
            for name, level in zip(names, levels, strict=True):
                logging.getLogger(name).setLevel(level)
