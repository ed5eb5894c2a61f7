"""Where compiled kernels are kept, and the machine code of models.

Numba keeps kernels beside the source, else in the user's cache folder, and fails where it can write
to neither. What is kept is a program: what another user could have written is never loaded.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def provide(package: Path) -> None:
    """Set ``NUMBA_CACHE_DIR`` to a private folder where Numba could not write its kernels.

    Worker processes inherit it.

    Parameters
    ----------
    package : folder of the package whose kernels are compiled.
    """
    usual = (package / "engine" / "__pycache__", _user_cache() / "numba")
    if VARIABLE not in os.environ and not any(map(_is_writable, usual)):
        os.environ[VARIABLE] = str(private_folder(Path(tempfile.gettempdir())))


def private_folder(inside: Path) -> Path:
    """A folder of this user alone: that of earlier processes, else one removed at exit.

    The one that is there is taken only where it is a folder and no link, belongs to this user, and
    nobody else may read or write it.
    """
    if hasattr(os, "getuid"):
        kept = inside / f"spiral-kernels-{os.getuid()}"
        if _is_private(kept):
            return kept
    made = Path(tempfile.mkdtemp(prefix="spiral-kernels-", dir=inside))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def models_folder() -> Path | None:
    """Where machine code of models is kept: a folder of this user alone, or none.

    In ``NUMBA_CACHE_DIR`` where that is set, else in the user's cache folder.
    """
    given = os.environ.get(VARIABLE)
    folder = (Path(given) if given else _user_cache() / "spiral") / "models"
    return folder if hasattr(os, "getuid") and _is_private(folder) else None


def _user_cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())


def _is_private(folder: Path) -> bool:
    """Whether a folder, made where it is missing, is this user's and nobody else may use it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return False
    own = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid()
    return own and not stat.S_IMODE(status.st_mode) & 0o077 and os.access(folder, os.W_OK)


def _is_writable(folder: Path) -> bool:
    """Whether a folder, or the first one above it that is there, takes files of this user."""
    there = next(p for p in (folder, *folder.parents) if p.exists())
    return os.access(there, os.W_OK | os.X_OK)
