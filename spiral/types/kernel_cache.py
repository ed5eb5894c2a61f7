"""Where compiled kernels are kept when neither the package nor the user's cache can be written.

Numba keeps them beside the source, else in the user's cache folder, and fails where it can write to
neither. They are programs: what another user could have written is never loaded.
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
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    usual = (package / "engine" / "__pycache__", home / "numba")
    if VARIABLE not in os.environ and not any(map(_is_writable, usual)):
        os.environ[VARIABLE] = str(private_folder(Path(tempfile.gettempdir())))


def private_folder(inside: Path) -> Path:
    """A folder of this user alone: that of earlier processes, else one removed at exit.

    The one that is there is taken only where it is a folder and no link, belongs to this user, and
    nobody else may read or write it.
    """
    if hasattr(os, "getuid"):
        kept = inside / f"spiral-kernels-{os.getuid()}"
        try:
            kept.mkdir(mode=0o700, exist_ok=True)
            status = kept.lstat()
        except OSError:
            status = None
        if (
            status is not None
            and stat.S_ISDIR(status.st_mode)
            and status.st_uid == os.getuid()
            and not stat.S_IMODE(status.st_mode) & 0o077
        ):
            return kept
    made = Path(tempfile.mkdtemp(prefix="spiral-kernels-", dir=inside))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def _is_writable(folder: Path) -> bool:
    """Whether a folder, or the first one above it that is there, takes files of this user."""
    there = next(p for p in (folder, *folder.parents) if p.exists())
    return os.access(there, os.W_OK | os.X_OK)
