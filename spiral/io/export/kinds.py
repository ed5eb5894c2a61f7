"""What a model can be exported to: one entry for each kind.

A new kind is a writer (a function of a model and of words that say where it comes from) and its
entry in ``KINDS``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, overload

from spiral.types.errors import ConfigError, InputError, did_you_mean

if TYPE_CHECKING:
    from spiral.types.model import Model
    from spiral.types.run import Run

Writer = Callable[["Model", str], str | bytes]


@dataclass(frozen=True)
class Kind:
    """What is written, under which name and suffix, by which function; ``archive`` is no text."""

    label: str
    meaning: str
    suffix: str
    write: Writer
    archive: bool = False


def _write_text(model: Model, origin: str) -> str:
    from spiral.io.export.equation import equation_text

    return equation_text(model)


def _write_latex(model: Model, origin: str) -> str:
    from spiral.io.export.equation import equation_latex

    return equation_latex(model)


def _program_writer(name: str, module: str = "") -> Writer:
    """A writer that prints a ``Program`` by the function NAME; its module is imported on use."""

    def write(model: Model, origin: str) -> str | bytes:
        from importlib import import_module

        from spiral.io.export.program import build_program

        printer = getattr(import_module(f"spiral.io.export.{module or name}"), name)
        return printer(build_program(model, origin))

    return write


KINDS = {
    "text": Kind("Equation", "the equation in plain Unicode", ".txt", _write_text),
    "latex": Kind("LaTeX", "the equation as a LaTeX align environment", ".tex", _write_latex),
    "python": Kind(
        "Python",
        "one Python module: NumPy, Jacobians, a free run",
        ".py",
        _program_writer("python"),
    ),
    "c": Kind("C", "one C99 file: libm, Jacobians, a Runge-Kutta step", ".c", _program_writer("c")),
    "fmu": Kind(
        "FMU", "FMI 2.0: source, and a binary of this machine", ".fmu", _program_writer("fmu"), True
    ),
    "fmu3": Kind(
        "FMU, FMI 3.0", "the same for FMI 3.0", "_3.fmu", _program_writer("fmu3", "fmu"), True
    ),
    "matlab": Kind(
        "MATLAB", "a function file: Jacobians, a Runge-Kutta step", ".m", _program_writer("matlab")
    ),
    "modelica": Kind("Modelica", "a Modelica model", ".mo", _program_writer("modelica")),
    "casadi": Kind(
        "CasADi", "a Python file of CasADi functions", "_casadi.py", _program_writer("casadi")
    ),
}


@overload
def export(model: Model | Run, to: str = "text", path: None = None, origin: str = "") -> str: ...
@overload
def export(model: Model | Run, to: str, path: str | Path, origin: str = "") -> Path: ...
def export(
    model: Model | Run, to: str = "text", path: str | Path | None = None, origin: str = ""
) -> str | Path:
    """A model as an equation, or as a program that needs nothing of this one.

    Parameters
    ----------
    to : ``text`` (plain Unicode), ``latex``, ``python``, ``c``, ``matlab``, ``modelica``,
        ``casadi``, ``fmu`` and ``fmu3``.
    path : the file to write, whole or not at all; its path is returned. Without it the text is.
    origin : where the model comes from, in words; of a saved run its id.

    Raises
    ------
    ConfigError : an unknown kind, an archive without a path, or a model that cannot be written so.
    InputError : a file that cannot be written.
    """
    from spiral.types.model import Model
    from spiral.types.run import Run

    kind = export_kind(to)
    if path is None and kind.archive:
        raise ConfigError(
            f"export to {to} as a text", "a file for it", f"path='model{kind.suffix}'"
        )
    if isinstance(model, Run):
        origin = origin or (f"run {model.run_id}" if model.run_id else "")
        model = model.model
    if not isinstance(model, Model):
        raise ConfigError(
            f"a {type(model).__name__} to export", "a run, or a model with its values",
            "spiral.compare(record, system).model has them",
        )  # fmt: skip
    content = kind.write(model, origin)
    if path is None:
        return str(content)
    if isinstance(content, str):
        content = content.rstrip("\n") + "\n"
    return _write_file(Path(path).expanduser(), content)


def _write_file(target: Path, content: str | bytes) -> Path:
    from spiral.io.writing import write_whole

    try:
        write_whole(target, content)
    except OSError as error:
        raise InputError(
            f"{target}: {error.strerror or error}", "a file that can be written"
        ) from error
    return target


def export_kind(to: str) -> Kind:
    """A kind by name.

    Raises
    ------
    ConfigError : an unknown one.
    """
    if to not in KINDS:
        raise ConfigError(
            f"export to {to!r}", f"one of {', '.join(KINDS)}", did_you_mean(to, KINDS)
        )
    return KINDS[to]
