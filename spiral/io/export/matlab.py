"""A model as a MATLAB function file (Octave reads it too): equations, Jacobians, estimates."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import sympy as sp
from sympy.printing.octave import OctaveCodePrinter

from spiral.io.export.names import sanitise_text
from spiral.io.export.program import (
    Program,
    assignments,
    header_lines,
    identifiers,
    items_in_expressions,
    jacobian_entries,
)
from spiral.io.writing import fill_template

_WORDS = (
    "break", "case", "catch", "classdef", "continue", "do", "else", "elseif", "end",
    "end_try_catch", "endfor", "endfunction", "endif", "endswitch", "endwhile", "for",
    "function", "global", "if", "otherwise", "parfor", "persistent", "return", "spmd", "switch",
    "try", "until", "unwind_protect", "while", "sin", "cos", "tan", "asin", "acos", "atan",
    "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "log", "sqrt", "abs",
    "sign", "floor", "ceil", "erf", "pi", "NaN", "nan", "Inf", "inf", "eps", "i", "j", "e",
    "zeros",
)  # fmt: skip
_RESERVED = (*_WORDS, "t", "x", "u", "p", "f", "y", "by_x", "by_p", "pick")
_FUNCTIONS = ("model", "rhs", "readings", "jacobian", "readings_jacobian", "step")


class _MatlabPrinter(OctaveCodePrinter):
    """Cases by a function of two values: a product with the condition makes NaN of 0 times Inf."""

    def _print_Float(self, expr: sp.Float) -> str:
        return repr(float(expr))

    def _print_Piecewise(self, expr: Any) -> str:
        text = "NaN"
        for value, condition in reversed(expr.args):
            if condition == sp.true:
                text = self._print(value)
            else:
                text = f"pick({self._print(condition)}, {self._print(value)}, {text})"
        return text


def matlab(program: Program) -> str:
    """The file's text."""
    fields = identifiers(program.parameters, _RESERVED)
    named = (*program.states, *program.inputs, *program.outputs, *program.parameters)
    values, errors = [], []
    for p in program.parameters:
        name, about = fields[p.symbol], sanitise_text(f"{p.name} [{p.unit or '1'}], {p.about}")
        error = "NaN" if p.error is None else repr(p.error)
        values.append(f"model.parameters.{name} = {p.value!r};  % {about}")
        errors.append(f"model.standard_errors.{name} = {error};")
    return fill_template(
        "export_matlab",
        name=f"{program.name}_" if program.name in (*_RESERVED, *_FUNCTIONS) else program.name,
        head="\n".join(f"% {line}".rstrip() for line in header_lines(program)),
        states=_cell_array(s.name for s in program.states),
        inputs=_cell_array(i.name for i in program.inputs),
        readings=_cell_array(o.name for o in program.outputs),
        units="\n".join(["{", *(f"    {_cell_array((i.name, i.unit))[1:-1]}" for i in named), "}"]),
        parameters="\n".join(values) or "model.parameters = struct();",
        errors="\n".join(errors) or "model.standard_errors = struct();",
        rhs=_value_lines(program, program.rate, "f"),
        output=_value_lines(program, program.output, "y"),
        rhs_slopes=_jacobian_lines(program, program.rate_x, program.rate_p),
        output_slopes=_jacobian_lines(program, program.output_x, program.output_p),
    )


def _cell_array(texts: Iterable[str]) -> str:
    return (
        "{" + ", ".join("'" + sanitise_text(text).replace("'", "''") + "'" for text in texts) + "}"
    )


def _value_lines(program: Program, values: Sequence[sp.Expr], array: str) -> str:
    lines, texts = _printed_expressions(program, values)
    lines.append(f"{array} = zeros({len(texts)}, 1);")
    return "\n".join([*lines, *(f"{array}({i}) = {t};" for i, t in enumerate(texts, 1))])


def _jacobian_lines(program: Program, by_x: list[list[sp.Expr]], by_p: list[list[sp.Expr]]) -> str:
    places = jacobian_entries(
        {"by_x": by_x, "by_p": by_p}, lambda name, i, j, _: f"{name}({i + 1}, {j + 1})"
    )
    lines, texts = _printed_expressions(program, list(places.values()))
    lines += [f"by_x = zeros({len(by_x)}, {len(program.states)});",
              f"by_p = zeros({len(by_p)}, {len(program.parameters)});"]  # fmt: skip
    lines += [f"{place} = {text};" for place, text in zip(places, texts, strict=True)]
    return "\n".join(lines)


def _printed_expressions(
    program: Program, values: Sequence[sp.Expr]
) -> tuple[list[str], list[str]]:
    """Lines that assign arguments and common subexpressions, and the texts of the values."""
    names = identifiers((*program.states, *program.inputs), _RESERVED)
    lines = [
        f"{names[i.symbol]} = {array}({items.index(i) + 1});"
        for array, items in (("x", program.states), ("u", program.inputs))
        for i in items_in_expressions(values, items)
    ]
    names |= {s: f"p.{name}" for s, name in identifiers(program.parameters, _RESERVED).items()}
    names[program.time] = "t"
    parts, texts = assignments(values, _MatlabPrinter({"strict": True}).doprint, names)
    return [*lines, *(f"{name} = {text};" for name, text, _ in parts)], texts
