"""Logging to MLflow by a separate process, while the command has already returned.

The order goes through a pipe, so that no list of processes shows a password. The process belongs
to no terminal: Ctrl-C and a closed window do not reach it. Whatever becomes of it, the saved run
stays, and the next command logs what is missing; why the last logging failed is kept for that
command in ``OUT/.tracking.failure``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from spiral.io.storage import FILE, resolve_inside_folder
from spiral.io.tracking.store import Draw, tracking_options
from spiral.io.tracking.track import TrackingResult, track
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import InputError
from spiral.types.masking import without_passwords

WAIT_VARIABLE = "SPIRAL_TRACKING_WAIT"
FAILURE = ".tracking.failure"
_LONGEST = 500  # characters of a reason that are shown


@dataclass(frozen=True)
class LogRequest:
    """The runs that a background process is to log to MLflow, and how.

    Parameters
    ----------
    tracking : the section of this command's configuration.
    out : folder of saved runs. run_id : the run to log, beside those not logged before.
    plugins : the folder that the command line named, as ``load_registry`` takes it.
    """

    tracking: Mapping[str, Any]
    out: str
    run_id: str
    plugins: str | None


def is_foreground() -> bool:
    """Whether commands log to MLflow themselves, and return when that is done."""
    return os.environ.get(WAIT_VARIABLE, "") not in ("", "0")


def start_process(order: LogRequest, module: str) -> TrackingResult:
    """Hand an order to a new process, which runs ``module``, and do not wait for it.

    Returns where the run will be shown, or why no process could be started.
    """
    tracking = tracking_options({"tracking": order.tracking})
    uri, page = without_passwords(tracking.resolve_uri(order.out)), tracking.page(order.out)
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],  # -P: a file of the working folder is no module
            stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True,
        )  # fmt: skip
        assert process.stdin is not None
        with process.stdin as pipe:
            pipe.write(json.dumps(asdict(order)).encode())
    except OSError as error:
        return TrackingResult({}, uri, page, f"no process can be started: {error}")
    return TrackingResult({}, uri, page)


def execute_order(order: LogRequest, draw: Draw) -> None:
    """Log an order to MLflow; where that fails, leave the reason for the next command."""
    from spiral.io.registry import error_summary, load_registry

    tracking, folder = tracking_options({"tracking": order.tracking}), Path(order.out)
    if not (folder / order.run_id / FILE).is_file():  # taken away since
        return
    try:
        registry = load_registry(order.plugins)
        done = track(tracking, folder, (order.run_id,), draw=draw, registry=registry)
        failure = done.failure
    except Exception as error:  # for instance a plugin folder that is gone
        failure = error_summary(error)
    if failure is None:
        (folder / FAILURE).unlink(missing_ok=True)
    else:
        write_whole(folder / FAILURE, to_json({"failure": failure}))


def take_last_failure(out: str | os.PathLike[str]) -> str:
    """Why the last logging in the background failed, as one plain line; empty where it did not.

    Reading removes it. The folder may come from anywhere: no control characters, one line.
    """
    try:
        file = resolve_inside_folder(Path(out).expanduser(), FAILURE)
        if not file.is_file():
            return ""
        with file.open(encoding="utf-8") as lines:
            said = str(json.loads(lines.read(100 * _LONGEST))["failure"])
        file.unlink()
    except (OSError, ValueError, KeyError, TypeError, InputError):
        return ""
    return " ".join("".join(c if c.isprintable() else " " for c in said).split())[:_LONGEST]
