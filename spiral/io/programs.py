"""Files that are programs (FMUs, Python): run only where a command or a call names them.

A saved run, a study's folder and the page name files as well, and may come from anywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from spiral.io.system_files import PROGRAMS, is_python_file, plugin_of_file
from spiral.types.errors import ConfigError
from spiral.types.plugin import Plugin


def refuse_program(
    plugin: type[Plugin], fields: Mapping[str, Any], programs: frozenset[str]
) -> None:
    """Refuse to make what would run a file that the user did not name.

    Raises
    ------
    ConfigError : such a file.
    """
    file = str(fields.get(plugin.program) or "") if plugin.program else ""
    if file:
        refuse_unnamed(file, programs, f"{plugin.kind}.{plugin.program}={file}")


def refuse_unnamed(file: str, programs: frozenset[str], named: str) -> None:
    """Refuse to run a file that the user did not name; ``named`` : how a command names it.

    Raises
    ------
    ConfigError : such a file.
    """
    if file not in programs:
        raise ConfigError(
            f"the program {file!r}, which would run as a system",
            "a file that the command itself names: it runs with your rights",
            f"{named} beside the rest, or spiral.system in Python",
        )


def programs_named(overrides: Sequence[str], names: Sequence[str] = ()) -> frozenset[str]:
    """The programs that a command line names: FILE, ``system=FILE`` and ``system.path=FILE``."""
    from spiral.io.overrides import parse_overrides

    given = [(i.path, str(i.value)) for i in parse_overrides(overrides) if not i.delete]
    systems = {*names, *(v for path, v in given if path == ("system",))}
    named = {v for v in systems if plugin_of_file(v) in PROGRAMS or is_python_file(v)}
    return frozenset(named | {v for path, v in given if path == ("system", "path")})
