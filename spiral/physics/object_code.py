"""Machine code of models, kept on disk: what one process has compiled others load.

A study compiles some fifty models, an eighth of its time, and the next study of the same machine
compiles most of them again. A file's name is a hash of the intermediate code and of all that its
translation depends on; it begins with a hash of the code that follows. It is a program: only files
of a folder that nobody else may write are loaded.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from spiral.types.kernel_cache import models_folder

_MOST = 200_000_000  # bytes that are kept; beyond them the half that was not used for longest goes
_SUFFIX = ".o"


def kept_code(text: str, settings: tuple[str, ...], translate: Callable[[], bytes]) -> bytes:
    """The machine code of a module: that of an earlier process, else ``translate()``.

    Parameters
    ----------
    text : the module's intermediate code. settings : what else its translation depends on.
    """
    folder = _folder()
    if folder is None:
        return translate()
    name = hashlib.sha256("\0".join((*settings, text)).encode()).hexdigest()
    path = folder / f"{name}{_SUFFIX}"
    if (code := _load(path)) is not None:
        return code
    code = translate()
    _save(path, code)
    return code


@cache
def _folder() -> Path | None:
    """Where machine code is kept, with no more in it than is kept."""
    folder = models_folder()
    if folder is not None:
        _remove_oldest(folder, _MOST)
    return folder


def _load(path: Path) -> bytes | None:
    """The code in a file, marked as used; nothing where it is missing or not what was written."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    told, code = data[:32], data[32:]
    if hashlib.sha256(code).digest() != told:
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    return code


def _save(path: Path, code: bytes) -> None:
    """Write the file as a whole or not at all; a full disk leaves it out."""
    with contextlib.suppress(OSError):
        handle, made = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(code).digest() + code)
            Path(made).replace(path)
        except OSError:
            Path(made).unlink(missing_ok=True)


def _remove_oldest(folder: Path, most: int) -> None:
    """Where there is more than ``most`` bytes, remove the half that was not used for longest."""
    files = []
    for path in folder.iterdir():
        with contextlib.suppress(OSError):
            status = path.stat()
            files.append((status.st_mtime, status.st_size, path))
    total = sum(size for _, size, _ in files)
    if total <= most:
        return
    for _, size, path in sorted(files):
        path.unlink(missing_ok=True)
        total -= size
        if total <= most / 2:
            return
