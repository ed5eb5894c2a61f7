"""A model as a Python file of CasADi functions, for optimisation and control."""

from __future__ import annotations

import keyword
from collections.abc import Sequence

import sympy as sp

from spiral.io.export.program import (
    Program,
    assignments,
    header_lines,
    identifiers,
    items_in_expressions,
)
from spiral.io.export.python import ArrayLibrary, PythonPrinter, indent_lines, template_literals
from spiral.io.writing import fill_template

_CASADI = ArrayLibrary(
    "ca", "if_else", "logic_and", "logic_or", "logic_not", renamed={"abs": "fabs"}
)
_RESERVED = (*keyword.kwlist, "t", "x", "u", "p", "ca")


def casadi(program: Program) -> str:
    """The file's text."""
    return fill_template(
        "export_casadi",
        head="\n".join(header_lines(program)),
        **template_literals(program),
        rhs=_function_body(program, program.rate),
        output=_function_body(program, program.output),
    )


def _function_body(program: Program, values: Sequence[sp.Expr]) -> str:
    names = identifiers((*program.states, *program.inputs, *program.parameters), _RESERVED)
    names[program.time] = "t"
    lines = []
    for array, items in (("x", program.states), ("u", program.inputs), ("p", program.parameters)):
        lines += [
            f"{names[i.symbol]} = {array}[{items.index(i)}]"
            for i in items_in_expressions(values, items)
        ]
    parts, texts = assignments(values, PythonPrinter(_CASADI).doprint, names)
    lines += [f"{name} = {text}" for name, text, _ in parts]
    return indent_lines([*lines, f"return ca.vertcat({', '.join(texts)})"])
