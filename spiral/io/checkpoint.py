"""Checkpoints of unfinished studies: saved after every round, so that the next start resumes.

``OUT/.unfinished/FINGERPRINT/checkpoint.json`` holds the rounds so far and where the study stands.
The fingerprint names everything that the result depends on, so that a study is taken up only by
the same study: same configuration, same data, same plugins, same version of the program.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spiral.inference.rounds import Checkpoint
from spiral.io.storage import model_data, rebuild_model, unwritable_folder_error
from spiral.io.writing import write_whole

if TYPE_CHECKING:
    from cattrs import Converter

    from spiral.inference.problem import Problem
    from spiral.io.registry import Registry

FOLDER = ".unfinished"
FILE = "checkpoint.json"
_YOUNG = 60.0  # s
_NO_INFLUENCE = ("out", "n_jobs", "run", "tracking", "sweep")  # on the result of a study


@dataclass(frozen=True)
class CheckpointStore:
    """Stores a study's checkpoints; ``folder`` is ``None`` while the same study runs elsewhere."""

    folder: Path | None
    registry: Registry

    def write(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint over the last one.

        Raises
        ------
        InputError : the folder cannot be written, for instance on a full disk.
        """
        if self.folder is None:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_checkpoint(checkpoint, self.folder / FILE, self.registry)
        except OSError as error:
            raise unwritable_folder_error(self.folder.parent.parent, error) from error

    def read_last(self) -> Checkpoint | None:
        """The checkpoint that an unfinished study left, or nothing."""
        if self.folder is None or not (self.folder / FILE).is_file():
            return None
        try:
            return read_checkpoint(self.folder / FILE, self.registry)
        except Exception:  # damaged, or written by another version: the study starts anew
            return None

    def remove(self) -> None:
        """Remove the checkpoint of a study that is now saved."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


def write_checkpoint(checkpoint: Checkpoint, file: Path, registry: Registry) -> None:
    """Write a checkpoint over the last one, whole or not at all."""
    plain = _json_converter(registry).unstructure(checkpoint)
    write_whole(file, json.dumps(plain, default=_to_python_number))


def read_checkpoint(file: Path, registry: Registry) -> Checkpoint:
    """A checkpoint from its file; whatever is wrong with it raises."""
    text = file.read_text(encoding="utf-8")
    return _json_converter(registry).structure(json.loads(text), Checkpoint)


@contextmanager
def checkpoint_keeper(
    config: Mapping[str, Any], problem: Problem, registry: Registry, out: str | os.PathLike[str]
) -> Iterator[CheckpointStore]:
    """The ``CheckpointStore`` of a study, locked against the same study in another process."""
    from filelock import FileLock, Timeout

    place = Path(out).expanduser() / FOLDER / study_fingerprint(config, problem, registry)
    lock = FileLock(f"{place}.lock", blocking=False)
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        yield CheckpointStore(None, registry)
        return
    except OSError as error:
        raise unwritable_folder_error(out, error) from error
    try:
        _remove_stale_locks(place.parent)
        yield CheckpointStore(place, registry)
    finally:
        lock.release()
        Path(f"{place}.lock").unlink(missing_ok=True)
        _remove_empty(place.parent)
        _remove_empty(place.parent.parent)  # made here, and nothing was saved


def _remove_stale_locks(folder: Path) -> None:
    """Remove the lock files that killed processes left: those of some age that nobody holds."""
    from filelock import FileLock, Timeout

    for file in folder.glob("*.lock"):
        try:
            if time.time() - file.stat().st_mtime < _YOUNG:  # a study that is about to hold it
                continue
            with FileLock(file, blocking=False):
                file.unlink(missing_ok=True)
        except (Timeout, OSError):
            continue


def study_fingerprint(config: Mapping[str, Any], problem: Problem, registry: Registry) -> str:
    """SHA-256 (20 digits) of everything that the result of a study depends on."""
    from spiral.version import __version__

    content = {
        "config": {k: v for k, v in config.items() if k not in _NO_INFLUENCE},
        "data": [r.sha256 for r in (*problem.records, *problem.test)],
        "model": model_data(problem.model),
        "plugins": registry.versions(),
        "version": __version__,
    }
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


def _to_python_number(value: Any) -> Any:
    """A number or array of NumPy's as Python's own."""
    return value.tolist()


def _remove_empty(folder: Path) -> None:
    try:
        folder.rmdir()
    except OSError:
        return  # another study is unfinished


def _json_converter(registry: Registry) -> Converter:
    """Frozen dataclasses to JSON and back; models by their plugins' names, arrays as lists."""
    import numpy as np
    from cattrs import Converter
    from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, override

    from spiral.types.model import Model
    from spiral.types.run import Comparison

    converter = Converter()
    converter.register_unstructure_hook(Model, model_data)
    converter.register_structure_hook(Model, lambda data, _: rebuild_model(data, registry))
    converter.register_unstructure_hook(np.ndarray, lambda a: a.tolist())
    converter.register_structure_hook(np.ndarray, lambda data, _: np.asarray(data, dtype=float))
    none = override(omit=True)
    converter.register_unstructure_hook(
        Comparison, make_dict_unstructure_fn(Comparison, converter, traces=none)
    )
    converter.register_structure_hook(
        Comparison, make_dict_structure_fn(Comparison, converter, traces=none)
    )
    return converter
