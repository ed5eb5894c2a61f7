"""The time series that figures need, saved beside a run as ``OUT/ID/curves.npz``.

A report reads the saved run and these curves, and nothing else. Arrays keep every sample (32-bit
for values, time as start and step); they are thinned only where they are drawn. Models of one run
are named ``seed`` (before anything was added) and ``final``. ``compute_curves`` makes them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from spiral.io.readers.containers import npz_arrays
from spiral.io.storage import resolve_inside_folder
from spiral.types.errors import InputError
from spiral.types.record import Array

FILE = "curves.npz"
SEED, FINAL = "seed", "final"
INPUT = "input"  # before an input's name, which may be that of something else (``y``)


@dataclass(frozen=True)
class Curves:
    """Arrays by name, and what they mean.

    Names are ``RECORD.what``, ``RECORD.input.NAME`` or ``RECORD.MODEL.what``.
    """

    meta: Mapping[str, Any]
    arrays: Mapping[str, Array] = field(default_factory=dict)

    def get(self, *key: Any) -> Array | None:
        """One array in double precision, or nothing."""
        array = self.arrays.get(".".join(map(str, key)))
        return None if array is None else np.asarray(array, dtype=float)

    def get_input(self, record: int, name: str) -> Array | None:
        """An input of a record; files that were written before have it under its name alone."""
        array = self.get(record, INPUT, name)
        return self.get(record, name) if array is None and name != "y" else array

    @property
    def tested(self) -> int:
        """Number of the first test record; where there is none, of the first fitted one."""
        parts = [r["part"] for r in self.meta["records"]]
        return parts.index("test") if "test" in parts else 0

    def time(self, record: int) -> Array:
        """Time of a record, s."""
        about = self.meta["records"][record]
        return about["start"] + about["dt"] * np.arange(about["samples"])


def write_curves(curves: Curves, folder: Path) -> Path:
    """Write the file whole or not at all."""
    import os

    target, trial = folder / FILE, folder / f".{FILE}.tmp.npz"
    text = np.frombuffer(json.dumps(curves.meta).encode(), dtype=np.uint8)
    try:
        np.savez_compressed(trial, meta=text, **curves.arrays)  # type: ignore[arg-type]
        os.replace(trial, target)
    except BaseException:  # a full disk, a signal
        trial.unlink(missing_ok=True)
        raise
    return target


def read_curves(folder: Path) -> Curves | None:
    """The curves of a saved run; nothing where it kept none.

    Raises
    ------
    InputError : a file that is none of this program's, or a link out of the folder.
    """
    file = resolve_inside_folder(folder, FILE)
    if not file.is_file():
        return None
    try:
        arrays = npz_arrays(str(file), file)
        meta = json.loads(bytes(arrays.pop("meta")).decode())
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(f"{file}: {error}", "curves saved by this program") from error
    return Curves(meta, arrays)


def add_seed_curves(first: Curves, last: Curves) -> Curves:
    """Curves of a later model, with those of the study's first model added as ``seed``."""
    arrays = {k.replace(f".{FINAL}.", f".{SEED}."): v for k, v in first.arrays.items()
              if f".{FINAL}." in k}  # fmt: skip
    models = {SEED: first.meta["models"][FINAL], **last.meta["models"]}
    return Curves({**last.meta, "models": models}, {**arrays, **last.arrays})


def drop_seed_curves(curves: Curves) -> Curves:
    """Curves without those of ``seed``, the model that a study began with."""
    models = {k: v for k, v in curves.meta["models"].items() if k != SEED}
    return Curves({**curves.meta, "models": models}, curves.arrays)
