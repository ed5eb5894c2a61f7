"""A model as a Python file of CasADi functions, for optimisation and control."""

from __future__ import annotations

import keyword
from collections.abc import Sequence

import sympy as sp

from spiral.io.export.program import Program, assignments, described, identifiers, used
from spiral.io.export.python import ArrayLibrary, PythonPrinter, indented, tables
from spiral.io.writing import filled

_CASADI = ArrayLibrary(
    "ca", "if_else", "logic_and", "logic_or", "logic_not", renamed={"abs": "fabs"}
)
_RESERVED = (*keyword.kwlist, "t", "x", "u", "p", "ca")


def casadi(found: Program) -> str:
    """The file's text."""
    return filled(
        "export_casadi",
        head="\n".join(described(found)),
        **tables(found),
        rhs=_values(found, found.rate),
        output=_values(found, found.output),
    )


def _values(found: Program, values: Sequence[sp.Expr]) -> str:
    names = identifiers((*found.states, *found.inputs, *found.parameters), _RESERVED)
    names[found.time] = "t"
    lines = []
    for array, items in (("x", found.states), ("u", found.inputs), ("p", found.parameters)):
        lines += [f"{names[i.symbol]} = {array}[{items.index(i)}]" for i in used(values, items)]
    parts, texts = assignments(values, PythonPrinter(_CASADI).doprint, names)
    lines += [f"{name} = {text}" for name, text, _ in parts]
    return indented([*lines, f"return ca.vertcat({', '.join(texts)})"])
