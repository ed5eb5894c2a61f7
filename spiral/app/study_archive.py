"""A whole study as one ZIP file: its steps as saved runs, its command, its uploaded files."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path

from spiral.app.frame import shell_command
from spiral.app.study import FILE, FOLDER, UPLOADS, Study, study_folder
from spiral.io.storage import run_folder

ARCHIVE = "study.zip"
_READ_ME = """\
{title}
{note}
study.json    the steps with their figures, candidates and verdicts
runs/         each step as a saved run: unpack, then spiral report run=ID out=runs
records/      files that were uploaded for it
command.txt   the last step from a terminal; paths in it are those of the machine it ran on
"""


def write_archive(out: Path, study: Study) -> Path:
    """Write the ZIP file of a study into its folder.

    Raises
    ------
    ConfigError : no such study.
    """
    folder = study_folder(out, study.ident)
    target = folder / ARCHIVE
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("README.txt", _READ_ME.format(title=study.title, note=study.note))
        archive.writestr("command.txt", shell_command(study) + "\n")
        archive.write(folder / FILE, FILE)
        for name, file in _archive_entries(out, study):
            archive.write(file, name)
    return target


def _archive_entries(out: Path, study: Study) -> Iterator[tuple[str, Path]]:
    """Names in the archive and files: those of its runs, and those uploaded for it; no links."""
    for turn in study.turns:
        if not turn.run_id:
            continue
        folder = run_folder(out, turn.run_id)
        yield from ((f"runs/{turn.run_id}/{f.name}", f) for f in _regular_files(folder))
    given = "\n".join(study.overrides)
    for folder in sorted((out / FOLDER / UPLOADS).glob("*")):
        if str(folder) in given:
            yield from ((f"records/{f.name}", f) for f in _regular_files(folder) if str(f) in given)


def _regular_files(folder: Path) -> list[Path]:
    inside = sorted(folder.iterdir()) if folder.is_dir() else []  # a run may be deleted since
    return [f for f in inside if f.is_file() and not f.is_symlink()]
