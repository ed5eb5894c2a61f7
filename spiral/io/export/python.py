"""A model as one Python module: equations, readings, Jacobians, names, units, a free run."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

import inspect
import keyword
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import sympy as sp
from sympy.printing.numpy import NumPyPrinter

from spiral.engine import series
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
from spiral.types.noise import estimate_noise
from spiral.types.parameter import HELD

_RESERVED = (*keyword.kwlist, "t", "x", "u", "p", "np", "found", "by_x", "by_p")


@dataclass(frozen=True)
class ArrayLibrary:
    """How a Python library that computes with arrays or symbols is called.

    ``cases`` is its choice between two values, ``renamed`` are functions that it calls differently
    from NumPy.
    """

    name: str
    cases: str
    both: str
    either: str
    neither: str
    renamed: Mapping[str, str] = field(default_factory=dict)


_NUMPY = ArrayLibrary("np", "where", "logical_and", "logical_or", "logical_not")


class PythonPrinter(NumPyPrinter):
    """Expressions by functions of a library, cases by its choice, comparisons by operators."""

    def __init__(self, library: ArrayLibrary) -> None:
        super().__init__({"strict": True})
        self._library = library

    def _module_format(self, fqn: str, register: bool = True) -> str:
        name = fqn.rsplit(".", 1)[-1]
        return f"{self._library.name}.{self._library.renamed.get(name, name)}"

    def _print_Float(self, expr: Any) -> str:
        return repr(float(expr))

    def _print_Piecewise(self, expr: Any) -> str:
        cases = self._module_format(self._library.cases)
        text = self._module_format("nan")
        for value, condition in reversed(expr.args):
            if condition == sp.true:
                text = self._print(value)
            else:
                text = f"{cases}({self._print(condition)}, {self._print(value)}, {text})"
        return text

    def _print_Relational(self, expr: Any) -> str:
        return f"({self._print(expr.lhs)} {expr.rel_op} {self._print(expr.rhs)})"

    def _nest_calls(self, function: str, expr: Any) -> str:
        first, *others = map(self._print, expr.args)
        for other in others:
            first = f"{self._module_format(function)}({first}, {other})"
        return first

    def _print_And(self, expr: Any) -> str:
        return self._nest_calls(self._library.both, expr)

    def _print_Or(self, expr: Any) -> str:
        return self._nest_calls(self._library.either, expr)

    def _print_Not(self, expr: Any) -> str:
        return f"{self._module_format(self._library.neither)}({self._print(expr.args[0])})"


def python(program: Program) -> str:
    """The module's text."""
    between = (
        series.interpolate_input, series.without_white_noise, series.rows_at_stages, estimate_noise,
        series.rate_per_sample, series.rates_per_sample,
    )  # fmt: skip
    given = [i for i in program.inputs if i.name not in program.rates]
    return fill_template(
        "export_python",
        head="\n".join(header_lines(program)),
        inputs_example=", ".join(f"{sanitise_text(i.name)!r}: samples" for i in given),
        start_example=f"{sanitise_text(program.states[0].name)!r}: 0.0",
        **template_literals(program),
        between=python_literal(dict(program.between)),
        rates=python_literal(dict(program.rates)),
        rhs=_value_lines(program, program.rate),
        output=_value_lines(program, program.output),
        rhs_slopes=_jacobian_lines(program, program.rate_x, program.rate_p),
        output_slopes=_jacobian_lines(program, program.output_x, program.output_p),
        held=repr(HELD),
        knots=str(series.SPEED_RATE_KNOTS),
        interpolation="\n\n".join(inspect.getsource(f) for f in between).rstrip(),
    )


def template_literals(program: Program) -> dict[str, str]:
    """Names, units, estimates and standard errors as literals, by their places in a template."""
    named = (*program.states, *program.inputs, *program.outputs, *program.parameters)
    return {
        "states": python_literal(tuple(s.name for s in program.states)),
        "inputs": python_literal(tuple(i.name for i in program.inputs)),
        "readings": python_literal(tuple(o.name for o in program.outputs)),
        "units": python_literal({i.name: i.unit for i in named}),
        "parameters": python_literal({p.name: p.value for p in program.parameters}),
        "errors": python_literal({p.name: p.error for p in program.parameters}),
    }


def python_literal(value: Any) -> str:
    """A tuple in one line, a mapping with a line for each entry; texts as ``repr`` writes them."""
    if not isinstance(value, dict):
        return repr(value)
    rows = [f"    {key!r}: {entry!r}," for key, entry in value.items()]
    return "\n".join(["{", *rows, "}"]) if rows else "{}"


def _value_lines(program: Program, values: Sequence[sp.Expr]) -> str:
    lines, texts = _printed_expressions(program, values)
    lines.append(f"found = np.empty(({len(texts)}, *x.shape[1:]))")
    lines += [f"found[{i}] = {text}" for i, text in enumerate(texts)]
    return indent_lines([*lines, "return found"])


def _jacobian_lines(program: Program, by_x: list[list[sp.Expr]], by_p: list[list[sp.Expr]]) -> str:
    places = jacobian_entries(
        {"by_x": by_x, "by_p": by_p}, lambda name, i, j, _: f"{name}[{i}, {j}]"
    )
    lines, texts = _printed_expressions(program, list(places.values()))
    lines.append(f"by_x = np.zeros(({len(by_x)}, {len(program.states)}, *x.shape[1:]))")
    lines.append(f"by_p = np.zeros(({len(by_p)}, {len(program.parameters)}, *x.shape[1:]))")
    lines += [f"{place} = {text}" for place, text in zip(places, texts, strict=True)]
    return indent_lines([*lines, "return by_x, by_p"])


def _printed_expressions(
    program: Program, values: Sequence[sp.Expr]
) -> tuple[list[str], list[str]]:
    """Lines that assign arguments and common subexpressions, and the texts of the values."""
    names = identifiers((*program.states, *program.inputs, *program.parameters), _RESERVED)
    names[program.time] = "t"
    lines = ["x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)"]
    for array, items in (("x", program.states), ("u", program.inputs)):
        lines += [
            f"{names[i.symbol]} = {array}[{items.index(i)}]"
            for i in items_in_expressions(values, items)
        ]
    for item in items_in_expressions(values, program.parameters):
        lines.append(f"{names[item.symbol]} = np.float64(p[{item.name!r}])")
    parts, texts = assignments(values, PythonPrinter(_NUMPY).doprint, names)
    return [*lines, *(f"{name} = {text}" for name, text, _ in parts)], texts


def indent_lines(lines: Sequence[str]) -> str:
    """Lines of a function's body."""
    return "\n".join(f"    {line}" for line in lines)
