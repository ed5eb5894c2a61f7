"""What a model can be exported to: one entry for each kind.

A new kind is a writer (a function of a model and of words that say where it comes from) and its
entry in ``KINDS``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from spiral.types.errors import ConfigError, InputError, did_you_mean

if TYPE_CHECKING:
    from spiral.types.model import Model

Writer = Callable[["Model", str], str | bytes]


@dataclass(frozen=True)
class Kind:
    """What is written, with which suffix, by which function."""

    meaning: str
    suffix: str
    write: Writer


def _text(model: Model, origin: str) -> str:
    from spiral.io.export.equation import equation

    return equation(model)


def _latex(model: Model, origin: str) -> str:
    from spiral.io.export.equation import latex

    return latex(model)


def _printed(name: str) -> Writer:
    """The function ``spiral.io.export.NAME.NAME`` of a ``Program``, imported when it is asked."""

    def write(model: Model, origin: str) -> str | bytes:
        from importlib import import_module

        from spiral.io.export.program import program

        printer = getattr(import_module(f"spiral.io.export.{name}"), name)
        return printer(program(model, origin))

    return write


KINDS = {
    "text": Kind("the equation in plain Unicode", ".txt", _text),
    "latex": Kind("the equation as a LaTeX align environment", ".tex", _latex),
    "python": Kind("one Python module: NumPy, Jacobians, a free run", ".py", _printed("python")),
    "c": Kind("one C99 file: libm, Jacobians, a Runge-Kutta step", ".c", _printed("c")),
    "matlab": Kind(
        "a MATLAB function file: Jacobians, a Runge-Kutta step", ".m", _printed("matlab")
    ),
    "modelica": Kind("a Modelica model", ".mo", _printed("modelica")),
    "casadi": Kind("a Python file of CasADi functions", ".py", _printed("casadi")),
    "fmu": Kind("an FMU (FMI 2.0): source, and a binary of this machine", ".fmu", _printed("fmu")),
}


def exported_text(model: Model, to: str, origin: str = "") -> str:
    """A model in one of the ``KINDS`` that are text; ``origin`` says where it comes from.

    Raises
    ------
    ConfigError : an unknown kind, an archive, or a model that cannot be written so.
    """
    content = kind_of(to).write(model, origin)
    if isinstance(content, str):
        return content
    raise ConfigError(
        f"export to {to} as a text", "a file for it", f"path='model{KINDS[to].suffix}'"
    )


def write_export(model: Model, to: str, path: str | Path, origin: str = "") -> Path:
    """A model in one of ``KINDS`` as a file, written whole or not at all; returns its path.

    Raises
    ------
    ConfigError : an unknown kind, or a model that cannot be written so. InputError : a file that
        cannot be written.
    """
    from spiral.io.writing import write_whole

    target, content = Path(path).expanduser(), kind_of(to).write(model, origin)
    if isinstance(content, str):
        content = content.rstrip("\n") + "\n"
    try:
        write_whole(target, content)
    except OSError as error:
        raise InputError(
            f"{target}: {error.strerror or error}", "a file that can be written"
        ) from error
    return target


def kind_of(to: str) -> Kind:
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
