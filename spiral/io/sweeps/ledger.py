"""The folder of a sweep, ``OUT/sweeps/ID/``: its jobs, and a result row for each that ended.

``sweep.json`` holds verb, names, jobs and fingerprint; ``rows/00003.json`` a job's overrides, exit
code, result and seconds, written whole as it ends; ``rows/00003.told`` says that the hook of that
row (tracking) has run; ``summary.json`` holds every row, and says that the sweep is done.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spiral.io.run_id import new_run_id
from spiral.io.writing import to_json, write_whole
from spiral.types.errors import InputError

FOLDER = "sweeps"
_ASKED, _ROWS, _SUMMARY, _LOCK = "sweep.json", "rows", "summary.json", "lock"


@dataclass(frozen=True)
class Ledger:
    """A sweep's folder, held by this process; ``taken_up`` where an earlier start left it."""

    folder: Path
    lock: int | None
    taken_up: bool = False

    @property
    def sweep_id(self) -> str:
        """The name of the folder."""
        return self.folder.name

    def rows(self) -> dict[int, dict[str, Any]]:
        """Job's number -> its row; a file that does not read is no row."""
        by_number = {}
        for file in sorted((self.folder / _ROWS).glob("*.json")):
            row = _read_json(file)
            if row and file.stem.isdigit() and {"overrides", "exit", "result"} <= set(row):
                by_number[int(file.stem)] = row
        return by_number

    def write_row(self, index: int, row: Mapping[str, Any]) -> None:
        """Keep a row.

        Raises
        ------
        InputError : the folder cannot be written; rows that are there stay.
        """
        self._hook_mark(index).unlink(missing_ok=True)
        _write_json(self.folder / _ROWS / f"{index:05d}.json", row)

    def mark_hook_run(self, index: int) -> None:
        """Note that a row's hook has run."""
        _write_json(self._hook_mark(index), {})

    def has_hook_run(self, index: int) -> bool:
        """Whether a row's hook has run."""
        return self._hook_mark(index).exists()

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write the summary: the sweep is done."""
        _write_json(self.folder / _SUMMARY, summary)

    def discard(self) -> None:
        """Remove the folder of a sweep that could not begin."""
        if not self.taken_up:
            shutil.rmtree(self.folder, ignore_errors=True)

    def close(self) -> None:
        """Let others have the folder."""
        if self.lock is not None:
            os.close(self.lock)

    def _hook_mark(self, index: int) -> Path:
        return self.folder / _ROWS / f"{index:05d}.told"


def open_ledger(
    out: str | os.PathLike[str], asked: Mapping[str, Any], fingerprint: str, resume: bool
) -> Ledger:
    """The folder of the last sweep with this fingerprint, where it is not done; else a new one.

    Raises
    ------
    InputError : the folder cannot be written.
    """
    place = Path(out).expanduser() / FOLDER
    last = _last_sweep(place, fingerprint) if resume else None
    if last is not None and not (last / _SUMMARY).exists():
        held, lock = _lock_folder(last)
        if held:  # otherwise another process is at it
            return Ledger(last, lock, taken_up=True)
    try:
        return _create_ledger(place, {**asked, "fingerprint": fingerprint})
    except OSError as error:
        raise _unwritable_error(place, error) from error


def _create_ledger(place: Path, asked: Mapping[str, Any]) -> Ledger:
    place.mkdir(parents=True, exist_ok=True)
    while True:
        folder = place / new_run_id(others=(p.name for p in place.iterdir()))
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        break
    (folder / _ROWS).mkdir()
    _, lock = _lock_folder(folder)
    _write_json(folder / _ASKED, asked)
    return Ledger(folder, lock)


def _last_sweep(place: Path, fingerprint: str) -> Path | None:
    if not place.is_dir():
        return None
    for folder in sorted(place.iterdir(), reverse=True):
        if (_read_json(folder / _ASKED) or {}).get("fingerprint") == fingerprint:
            return folder
    return None


def _lock_folder(folder: Path) -> tuple[bool, int | None]:
    """Whether the folder is ours, until this process ends in whatever way."""
    try:
        import fcntl
    except ImportError:  # not on this system: two starts at once are not kept apart
        return True, None
    handle = os.open(folder / _LOCK, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return False, None
    except OSError:  # a file system without locks
        pass
    return True, handle


def _read_json(file: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def _write_json(file: Path, content: Mapping[str, Any]) -> None:
    try:
        write_whole(file, to_json(content) + "\n")
    except OSError as error:
        raise _unwritable_error(file, error) from error


def _unwritable_error(place: Path, error: OSError) -> InputError:
    return InputError(
        f"{place}: {error.strerror or error}",
        "a folder of sweeps that can be written",
        "free some space, or out=FOLDER; what is written stays",
    )
