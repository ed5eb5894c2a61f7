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
from spiral.io.export.names import plain
from spiral.io.export.program import (
    Program,
    assignments,
    described,
    entries,
    identifiers,
    used,
)
from spiral.io.writing import filled
from spiral.types.noise import estimate_noise

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

    def _joined(self, function: str, expr: Any) -> str:
        first, *others = map(self._print, expr.args)
        for other in others:
            first = f"{self._module_format(function)}({first}, {other})"
        return first

    def _print_And(self, expr: Any) -> str:
        return self._joined(self._library.both, expr)

    def _print_Or(self, expr: Any) -> str:
        return self._joined(self._library.either, expr)

    def _print_Not(self, expr: Any) -> str:
        return f"{self._module_format(self._library.neither)}({self._print(expr.args[0])})"


def python(found: Program) -> str:
    """The module's text."""
    between = (
        series.between_samples, series.held_values, estimate_noise, series.rate_per_sample,
    )  # fmt: skip
    given = [i for i in found.inputs if i.name not in found.rates]
    return filled(
        "export_python",
        head="\n".join(described(found)),
        inputs_example=", ".join(f"{plain(i.name)!r}: samples" for i in given),
        start_example=f"{plain(found.states[0].name)!r}: 0.0",
        **tables(found),
        between=literal(dict(found.between)),
        rates=literal(dict(found.rates)),
        rhs=_values(found, found.rate),
        output=_values(found, found.output),
        rhs_slopes=_slopes(found, found.rate_x, found.rate_p),
        output_slopes=_slopes(found, found.output_x, found.output_p),
        knots=str(series.SPEED_RATE_KNOTS),
        interpolation="\n\n".join(inspect.getsource(f) for f in between).rstrip(),
    )


def tables(found: Program) -> dict[str, str]:
    """Names, units, estimates and standard errors as literals, by their places in a template."""
    named = (*found.states, *found.inputs, *found.outputs, *found.parameters)
    return {
        "states": literal(tuple(s.name for s in found.states)),
        "inputs": literal(tuple(i.name for i in found.inputs)),
        "readings": literal(tuple(o.name for o in found.outputs)),
        "units": literal({i.name: i.unit for i in named}),
        "parameters": literal({p.name: p.value for p in found.parameters}),
        "errors": literal({p.name: p.error for p in found.parameters}),
    }


def literal(value: Any) -> str:
    """A tuple in one line, a mapping with a line for each entry; texts as ``repr`` writes them."""
    if not isinstance(value, dict):
        return repr(value)
    rows = [f"    {key!r}: {entry!r}," for key, entry in value.items()]
    return "\n".join(["{", *rows, "}"]) if rows else "{}"


def _values(found: Program, values: Sequence[sp.Expr]) -> str:
    lines, texts = _computed(found, values)
    lines.append(f"found = np.empty(({len(texts)}, *x.shape[1:]))")
    lines += [f"found[{i}] = {text}" for i, text in enumerate(texts)]
    return indented([*lines, "return found"])


def _slopes(found: Program, by_x: list[list[sp.Expr]], by_p: list[list[sp.Expr]]) -> str:
    places = entries({"by_x": by_x, "by_p": by_p}, lambda name, i, j, _: f"{name}[{i}, {j}]")
    lines, texts = _computed(found, list(places.values()))
    lines.append(f"by_x = np.zeros(({len(by_x)}, {len(found.states)}, *x.shape[1:]))")
    lines.append(f"by_p = np.zeros(({len(by_p)}, {len(found.parameters)}, *x.shape[1:]))")
    lines += [f"{place} = {text}" for place, text in zip(places, texts, strict=True)]
    return indented([*lines, "return by_x, by_p"])


def _computed(found: Program, values: Sequence[sp.Expr]) -> tuple[list[str], list[str]]:
    """Lines that name what is given and what is common, and the texts of the values."""
    names = identifiers((*found.states, *found.inputs, *found.parameters), _RESERVED)
    names[found.time] = "t"
    lines = ["x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)"]
    for array, items in (("x", found.states), ("u", found.inputs)):
        lines += [f"{names[i.symbol]} = {array}[{items.index(i)}]" for i in used(values, items)]
    for item in used(values, found.parameters):
        lines.append(f"{names[item.symbol]} = np.float64(p[{item.name!r}])")
    parts, texts = assignments(values, PythonPrinter(_NUMPY).doprint, names)
    return [*lines, *(f"{name} = {text}" for name, text, _ in parts)], texts


def indented(lines: Sequence[str]) -> str:
    """Lines of a function's body."""
    return "\n".join(f"    {line}" for line in lines)
