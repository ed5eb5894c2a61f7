"""A model as a Modelica model: states, equations, readings, parameters with their estimates."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

import re
from typing import Any

import sympy as sp
from sympy.printing.codeprinter import PrintMethodNotImplementedError
from sympy.printing.str import StrPrinter

from spiral.io.export.names import plain
from spiral.io.export.program import Item, Program, assignments, described, identifiers
from spiral.io.writing import filled

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


class _Printer(StrPrinter):
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


def modelica(found: Program) -> str:
    """The file's text."""
    readings = [Item(f"reading_{o.name}", o.unit, o.symbol, "reading") for o in found.outputs]
    items = (*found.states, *found.inputs, *readings, *found.parameters)
    names = identifiers(items, (*_RESERVED, _class(found)))
    values = [*found.rate, *found.output]
    parts, texts = assignments(values, _Printer().doprint, {**names, found.time: "time"})
    rates, outputs = texts[: len(found.rate)], texts[len(found.rate) :]
    return filled(
        "export_modelica",
        name=_class(found),
        head="\n".join(f" * {line}".rstrip() for line in described(found)),
        title=plain(found.title),
        parameters=_lines(
            f"parameter Real {names[p.symbol]}{_unit(p)} = {p.value!r} {_about(p)};"
            for p in found.parameters
        ),
        inputs=_lines(f"input Real {names[i.symbol]}{_unit(i)} {_about(i)};" for i in found.inputs),
        outputs=_lines(f"output Real {names[o.symbol]}{_unit(o)} {_about(o)};" for o in readings),
        states=_lines(
            f"Real {names[s.symbol]}({_modified(s, 'start = 0.0, fixed = true')}) {_about(s)};"
            for s in found.states
        ),
        parts=_lines(f"{'Boolean' if p.logical else 'Real'} {p.name};" for p in parts),
        equations=_lines(
            [
                *(f"{p.name} = {p.text};" for p in parts),
                *(
                    f"der({names[s.symbol]}) = {t};"
                    for s, t in zip(found.states, rates, strict=True)
                ),
                *(f"{names[o.symbol]} = {t};" for o, t in zip(readings, outputs, strict=True)),
            ]
        ),
    )


def _class(found: Program) -> str:
    return "".join(part.capitalize() for part in found.name.split("_"))


def _lines(texts: Any) -> str:
    return "\n".join(f"  {text}" for text in texts)


def _about(item: Item) -> str:
    return f'"{plain(", ".join(filter(None, (item.name, item.about))))}"'


def _unit(item: Item) -> str:
    return f"({_modified(item)})" if _modified(item) else ""


def _modified(item: Item, more: str = "") -> str:
    """The unit in Modelica's notation, ``kg*m^2`` as ``kg.m2``, where it can be written so."""
    text = item.unit.replace("*", ".").replace("^", "")
    known = re.fullmatch(r"[A-Za-z0-9./()-]+", text) and text.count("/") < 2
    return ", ".join(filter(None, [f'unit = "{text}"' if known else "", more]))
