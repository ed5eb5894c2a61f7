"""A model as a MATLAB function file (Octave reads it too): equations, Jacobians, estimates."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import sympy as sp
from sympy.printing.octave import OctaveCodePrinter

from spiral.io.export.names import plain
from spiral.io.export.program import Program, assignments, described, entries, identifiers, used
from spiral.io.writing import filled

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


class _Printer(OctaveCodePrinter):
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


def matlab(found: Program) -> str:
    """The file's text."""
    fields = identifiers(found.parameters, _RESERVED)
    named = (*found.states, *found.inputs, *found.outputs, *found.parameters)
    values, errors = [], []
    for p in found.parameters:
        name, about = fields[p.symbol], plain(f"{p.name} [{p.unit or '1'}], {p.about}")
        error = "NaN" if p.error is None else repr(p.error)
        values.append(f"model.parameters.{name} = {p.value!r};  % {about}")
        errors.append(f"model.standard_errors.{name} = {error};")
    return filled(
        "export_matlab",
        name=f"{found.name}_" if found.name in (*_RESERVED, *_FUNCTIONS) else found.name,
        head="\n".join(f"% {line}".rstrip() for line in described(found)),
        states=_cell(s.name for s in found.states),
        inputs=_cell(i.name for i in found.inputs),
        readings=_cell(o.name for o in found.outputs),
        units="\n".join(["{", *(f"    {_cell((i.name, i.unit))[1:-1]}" for i in named), "}"]),
        parameters="\n".join(values) or "model.parameters = struct();",
        errors="\n".join(errors) or "model.standard_errors = struct();",
        rhs=_values(found, found.rate, "f"),
        output=_values(found, found.output, "y"),
        rhs_slopes=_slopes(found, found.rate_x, found.rate_p),
        output_slopes=_slopes(found, found.output_x, found.output_p),
    )


def _cell(texts: Iterable[str]) -> str:
    return "{" + ", ".join("'" + plain(text).replace("'", "''") + "'" for text in texts) + "}"


def _values(found: Program, values: Sequence[sp.Expr], array: str) -> str:
    lines, texts = _computed(found, values)
    lines.append(f"{array} = zeros({len(texts)}, 1);")
    return "\n".join([*lines, *(f"{array}({i}) = {t};" for i, t in enumerate(texts, 1))])


def _slopes(found: Program, by_x: list[list[sp.Expr]], by_p: list[list[sp.Expr]]) -> str:
    places = entries(
        {"by_x": by_x, "by_p": by_p}, lambda name, i, j, _: f"{name}({i + 1}, {j + 1})"
    )
    lines, texts = _computed(found, list(places.values()))
    lines += [f"by_x = zeros({len(by_x)}, {len(found.states)});",
              f"by_p = zeros({len(by_p)}, {len(found.parameters)});"]  # fmt: skip
    lines += [f"{place} = {text};" for place, text in zip(places, texts, strict=True)]
    return "\n".join(lines)


def _computed(found: Program, values: Sequence[sp.Expr]) -> tuple[list[str], list[str]]:
    """Lines that name what is given and what is common, and the texts of the values."""
    names = identifiers((*found.states, *found.inputs), _RESERVED)
    lines = [
        f"{names[i.symbol]} = {array}({items.index(i) + 1});"
        for array, items in (("x", found.states), ("u", found.inputs))
        for i in used(values, items)
    ]
    names |= {s: f"p.{name}" for s, name in identifiers(found.parameters, _RESERVED).items()}
    names[found.time] = "t"
    parts, texts = assignments(values, _Printer({"strict": True}).doprint, names)
    return [*lines, *(f"{name} = {text};" for name, text, _ in parts)], texts
