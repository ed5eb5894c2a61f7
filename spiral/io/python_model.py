"""Models that a file of Python defines: ``system=machine.py`` runs it and takes its system.

A right-hand side that can be traced becomes equations, which a run holds as text: the file is not
needed again, neither in other processes nor where a saved run is read.
"""

from __future__ import annotations

import contextlib
import os
import runpy
import sys
import traceback
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from spiral.io.programs import refuse_unnamed
from spiral.types.errors import ConfigError
from spiral.types.fields import plain
from spiral.types.system import System

_EXPECTED = "a file that ends with system = spiral.system(rhs, states=..., ...)"
_SCRIPT = "python {file}, which reads the records and calls spiral.discover(record, system)"


def system_section(file: str, programs: frozenset[str]) -> dict[str, Any]:
    """Name and fields of the system that a file of Python defines.

    Parameters
    ----------
    programs : files that the command itself names; no other is run.

    Raises
    ------
    ConfigError : a file that the command does not name, that fails, or that holds no system, or one
        that a run cannot hold.
    """
    refuse_unnamed(file, programs, f"system={file}")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        system = system_of_file(file)
    if callable(getattr(system, "function", None)):
        why = next((str(w.message) for w in said), "its function cannot be traced")
        raise ConfigError(
            f"{file}: {why}",
            "a right-hand side that becomes equations, which a run can hold",
            f"write it with spiral.math, or {_SCRIPT.format(file=file)}",
        )
    if not type(system).is_shipped():
        raise ConfigError(
            f"{file}: system is a {type(system).__name__}, a class of its own",
            "what spiral.system(...) or spiral.structure(...) returns",
            f"a class of systems is a plugin: put the file into ./plugins, and "
            f"system={system.plugin_name()}",
        )
    return plain(system)


def system_of_file(file: str) -> System:
    """The system that a file of Python defines, which is run: ``system``, else its only one.

    Raises
    ------
    ConfigError : a file that fails, or that holds no system.
    """
    return _system_of(file, _run_model_file(file))


def _run_model_file(file: str) -> dict[str, Any]:
    """The names that a file of Python defines; what it prints goes where messages go."""
    if not Path(file).is_file():
        raise ConfigError(
            f"system={file}", "a file that is there", f"it was looked for in {Path.cwd()}"
        )
    try:
        with _imports_beside(file), contextlib.redirect_stdout(sys.stderr):
            return runpy.run_path(file, run_name="spiral_model")
    except ConfigError as error:
        raise ConfigError(f"{file}: {error.given}", error.expected, error.try_) from error
    except (Exception, SystemExit) as error:
        words = error.msg if isinstance(error, SyntaxError) else error
        message = f"{type(error).__name__}: {words}".removesuffix(": ")
        raise ConfigError(f"{file}{_line_of(error, file)}: {message}", _EXPECTED) from error


@contextlib.contextmanager
def _imports_beside(file: str) -> Iterator[None]:
    """Files beside this one can be imported, as where it is run as a script."""
    folder = str(Path(file).resolve().parent)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            sys.path.remove(folder)


def _line_of(error: BaseException, file: str) -> str:
    """``, line 3``: where a file failed; empty where it was not read so far."""
    if isinstance(error, SyntaxError) and error.lineno:
        return f", line {error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    at = [f.lineno for f in frames if os.path.realpath(f.filename) == os.path.realpath(file)]
    return f", line {at[-1]}" if at else ""


def _system_of(file: str, names: dict[str, Any]) -> System:
    """The system called ``system``, else the only one."""
    known = {k: v for k, v in names.items() if isinstance(v, System)}
    if "system" in known:
        return known["system"]
    if len({id(v) for v in known.values()}) == 1:
        return next(iter(known.values()))
    told = f"{file}: {len(known)} systems ({', '.join(known)})" if known else f"{file}: no system"
    given = names.get("system")
    told += f", system is a {type(given).__name__}" if given is not None else ""
    raise ConfigError(told, _EXPECTED, "system = spiral.system(rhs, states={...}, observed=[...])")
