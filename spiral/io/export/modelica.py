"""A model as a Modelica model: states, equations, readings, parameters with their estimates."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

import functools
import re
from typing import Any

import sympy as sp
from sympy.printing.codeprinter import PrintMethodNotImplementedError
from sympy.printing.str import StrPrinter

from spiral.io.export.names import sanitise_text
from spiral.io.export.program import (
    Program,
    ProgramVariable,
    assignments,
    header_lines,
    identifiers,
)
from spiral.io.writing import fill_template

_FUNCTIONS = {
    "sin": "sin", "cos": "cos", "tan": "tan", "asin": "asin", "acos": "acos", "atan": "atan",
    "atan2": "atan2", "sinh": "sinh", "cosh": "cosh", "tanh": "tanh", "exp": "exp", "log": "log",
    "Abs": "abs", "sign": "sign", "floor": "floor", "ceiling": "ceil",
}  # fmt: skip
_RESERVED = (
    "algorithm", "and", "annotation", "assert", "block", "break", "class", "connect", "connector",
    "constant", "constrainedby", "der", "discrete", "each", "else", "elseif", "elsewhen",
    "encapsulated", "end", "enumeration", "equation", "expandable", "extends", "external", "false",
    "final", "flow", "for", "function", "if", "import", "impure", "in", "initial", "inner", "input",
    "loop", "model", "noEvent", "not", "operator", "or", "outer", "output", "package", "parameter",
    "partial", "protected", "public", "pure", "record", "redeclare", "replaceable", "return",
    "stream", "then", "time", "true", "type", "when", "while", "within", "sqrt", "Real", "Boolean",
    *_FUNCTIONS.values(),
)  # fmt: skip


class _ModelicaPrinter(StrPrinter):
    """Modelica's operators; cases without events, as the motion was fitted."""

    def _print_Float(self, expr: sp.Float) -> str:
        return repr(float(expr))

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
        return super()._print_Pow(expr, rational).replace("**", "^")

    def _print_Function(self, expr: Any) -> str:
        name = _FUNCTIONS.get(expr.func.__name__)
        if name is None:
            raise PrintMethodNotImplementedError(f"{expr.func.__name__}")
        return f"{name}({', '.join(map(self._print, expr.args))})"

    def _print_Abs(self, expr: Any) -> str:
        return self._print_Function(expr)

    def _print_Piecewise(self, expr: Any) -> str:
        text = "0.0"
        for value, condition in reversed(expr.args):
            if condition == sp.true:
                text = self._print(value)
            else:
                text = f"(if {self._print(condition)} then {self._print(value)} else {text})"
        return f"noEvent{text}" if text.startswith("(") else text

    def _print_Relational(self, expr: Any) -> str:
        sign = {"!=": "<>"}.get(expr.rel_op, expr.rel_op)
        return f"({self._print(expr.lhs)} {sign} {self._print(expr.rhs)})"

    def _print_And(self, expr: Any) -> str:
        return f"({' and '.join(map(self._print, expr.args))})"

    def _print_Or(self, expr: Any) -> str:
        return f"({' or '.join(map(self._print, expr.args))})"

    def _print_Not(self, expr: Any) -> str:
        return f"(not {self._print(expr.args[0])})"


_paired = functools.partial(zip, strict=True)


def modelica(program: Program) -> str:
    """The file's text."""
    readings = _readings(program)
    items = (*program.states, *program.inputs, *readings, *program.parameters)
    names = identifiers(items, (*_RESERVED, _class_name(program)))
    values = [*program.rate, *program.output]
    parts, texts = assignments(values, _ModelicaPrinter().doprint, {**names, program.time: "time"})
    rates, outputs = texts[: len(program.rate)], texts[len(program.rate) :]
    return fill_template(
        "export_modelica",
        name=_class_name(program),
        head="\n".join(f" * {line}".rstrip() for line in header_lines(program)),
        title=sanitise_text(program.title),
        parameters=_declaration_lines(
            f"parameter Real {names[p.symbol]}{_unit_modifier(p)} = {p.value!r} {_item_comment(p)};"
            for p in program.parameters
        ),
        inputs=_declaration_lines(
            f"input Real {names[i.symbol]}{_unit_modifier(i)} {_item_comment(i)};"
            for i in program.inputs
        ),
        outputs=_declaration_lines(
            f"output Real {names[o.symbol]}{_unit_modifier(o)} {_item_comment(o)};"
            for o in readings
        ),
        states=_declaration_lines(
            f"Real {names[s.symbol]}({_modifier_list(s, 'start = 0.0, fixed = true')}) "
            f"{_item_comment(s)};"
            for s in program.states
        ),
        parts=_declaration_lines(f"{'Boolean' if p.logical else 'Real'} {p.name};" for p in parts),
        equations=_declaration_lines(
            [
                *(f"{p.name} = {p.text};" for p in parts),
                *(f"der({names[s.symbol]}) = {t};" for s, t in _paired(program.states, rates)),
                *(f"{names[o.symbol]} = {t};" for o, t in _paired(readings, outputs)),
            ]
        ),
    )


def _readings(program: Program) -> list[ProgramVariable]:
    """The outputs, under names that no state has."""
    return [
        ProgramVariable(f"reading_{o.name}", o.unit, o.symbol, "reading") for o in program.outputs
    ]


def _class_name(program: Program) -> str:
    return "".join(part.capitalize() for part in program.name.split("_"))


def _declaration_lines(texts: Any) -> str:
    return "\n".join(f"  {text}" for text in texts)


def _item_comment(item: ProgramVariable) -> str:
    return f'"{sanitise_text(", ".join(filter(None, (item.name, item.about))))}"'


def _unit_modifier(item: ProgramVariable) -> str:
    return f"({_modifier_list(item)})" if _modifier_list(item) else ""


def _modifier_list(item: ProgramVariable, more: str = "") -> str:
    """The unit in Modelica's notation, ``kg*m^2`` as ``kg.m2``, where it can be written so."""
    text = item.unit.replace("*", ".").replace("^", "")
    known = re.fullmatch(r"[A-Za-z0-9./()-]+", text) and text.count("/") < 2
    return ", ".join(filter(None, [f'unit = "{text}"' if known else "", more]))
