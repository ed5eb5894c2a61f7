"""A model as one C file: equations, Jacobians, estimates in a struct, a Runge-Kutta step."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy as sp
from sympy.printing.c import C99CodePrinter, reserved_words, reserved_words_c99

from spiral.io.export.names import sanitise_text
from spiral.io.export.program import (
    Constant,
    Program,
    assignments,
    header_lines,
    identifiers,
    items_in_expressions,
    jacobian_entries,
)
from spiral.io.writing import fill_template

_MATHEMATICS = (
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign",
    "cos", "cosh", "erf", "erfc", "exp", "exp2", "expm1", "fabs", "fdim", "floor", "fma",
    "fmax", "fmin", "fmod", "frexp", "hypot", "ilogb", "isfinite", "isinf", "isnan", "j0", "j1",
    "jn", "ldexp", "lgamma", "log", "log10", "log1p", "log2", "logb", "lrint", "lround", "modf",
    "nan", "nearbyint", "pow", "remainder", "remquo", "rint", "round", "scalbln", "scalbn",
    "signbit", "sin", "sinh", "sqrt", "tan", "tanh", "tgamma", "trunc", "y0", "y1", "yn",
)  # fmt: skip
_RESERVED = (
    *reserved_words, *reserved_words_c99, *_MATHEMATICS, "linux", "unix", "bool", "true", "false",
    "NAN", "INFINITY", "HUGE_VAL", "NULL", "errno",
    "t", "x", "u", "p", "f", "y", "by_x", "by_p", "rates", "outputs",
)  # fmt: skip


class _CPrinter(C99CodePrinter):
    """C99 with cases as conditional expressions."""

    def _print_Piecewise(self, expr: Any) -> str:
        text = "NAN"
        for value, condition in reversed(expr.args):
            if condition == sp.true:
                text = self._print(value)
            else:
                text = f"({self._print(condition)} ? {self._print(value)} : {text})"
        return f"({text})"


def c(program: Program) -> str:
    """The file's text."""
    fields = identifiers(program.parameters, _RESERVED)
    rows = [(fields[p.symbol], p) for p in program.parameters]
    return fill_template(
        "export_c",
        name=program.name,
        head="\n".join(f" * {line}".rstrip() for line in header_lines(program)),
        states=str(len(program.states)),
        inputs=str(len(program.inputs)),
        readings=str(len(program.outputs)),
        parameters=str(len(program.parameters)),
        fields="\n".join(f"    double {n}; /* {_parameter_comment(p)} */" for n, p in rows)
        or "    char none;",
        estimates=_struct_initialiser((n, repr(p.value)) for n, p in rows),
        errors=_struct_initialiser(
            (n, "NAN" if p.error is None else repr(p.error)) for n, p in rows
        ),
        rhs=_value_lines(program, program.rate, "f"),
        output=_value_lines(program, program.output, "y"),
        rhs_slopes=_jacobian_lines(program, by_x=program.rate_x, by_p=program.rate_p),
        output_slopes=_jacobian_lines(program, by_x=program.output_x, by_p=program.output_p),
        input_slopes=_jacobian_lines(program, rates=program.rate_u, outputs=program.output_u),
    )


def _parameter_comment(parameter: Constant) -> str:
    return sanitise_text(f"{parameter.name} [{parameter.unit or '1'}], {parameter.about}")


def _struct_initialiser(values: Any) -> str:
    return "\n".join(f"    .{name} = {value}," for name, value in values) or "    0"


def _value_lines(program: Program, values: Sequence[sp.Expr], array: str) -> str:
    places = {f"{array}[{i}]": value for i, value in enumerate(values)}
    return _function_body(program, places)


def _jacobian_lines(program: Program, **matrices: list[list[sp.Expr]]) -> str:
    """Matrices by the names of their arrays, entry by entry, zeros too."""
    places = jacobian_entries(
        matrices, lambda name, i, j, width: f"{name}[{i * width + j}]", zeros=True
    )
    return _function_body(
        program, places, [name for name, rows in matrices.items() if not any(rows)]
    )


def _function_body(
    program: Program, places: Mapping[str, sp.Expr], unused: Sequence[str] = ()
) -> str:
    """A C function's body: arguments, common subexpressions, entries, unused arguments as void."""
    values = list(places.values())
    names = identifiers((*program.states, *program.inputs), _RESERVED)
    given = []
    for array, items in (("x", program.states), ("u", program.inputs)):
        some = items_in_expressions(values, items)
        given += [f"const double {names[i.symbol]} = {array}[{items.index(i)}];" for i in some]
        unused = unused if some else [*unused, array]
    fields = identifiers(program.parameters, _RESERVED)
    names |= {s: f"p->{name}" for s, name in fields.items()} | {program.time: "t"}
    free = set().union(*(v.free_symbols for v in values))
    unused = [*unused, *(["p"] if free.isdisjoint(fields) else [])]
    unused = [*unused, *([] if program.time in free else ["t"])]
    parts, texts = assignments(values, _CPrinter({"strict": True}).doprint, names)
    lines = [*given, *(f"const double {name} = {text};" for name, text, _ in parts)]
    lines += [f"{place} = {text};" for place, text in zip(places, texts, strict=True)]
    return "\n".join(f"    {line}" for line in [*(f"(void){name};" for name in unused), *lines])
