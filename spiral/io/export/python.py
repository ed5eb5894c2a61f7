"""A model as one Python module: equations, readings, Jacobians, names, units, a free run."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

import inspect
import keyword
from collections.abc import Sequence
from typing import Any

import sympy as sp
from sympy.printing.numpy import NumPyPrinter

from spiral.engine import series
from spiral.io.export.program import (
    Program,
    assignments,
    described,
    identifiers,
    plain,
    used,
)
from spiral.io.writing import filled

_RESERVED = (*keyword.kwlist, "t", "x", "u", "p", "np", "found", "by_x", "by_p")


class _Printer(NumPyPrinter):
    """NumPy as ``np``; cases by ``np.where``, comparisons by operators."""

    _and, _or = "&", "|"

    def _module_format(self, fqn: str, register: bool = True) -> str:
        return f"np.{fqn.rsplit('.', 1)[-1]}"

    def _print_Piecewise(self, expr: Any) -> str:
        text = "np.nan"
        for value, condition in reversed(expr.args):
            if condition == sp.true:
                text = self._print(value)
            else:
                text = f"np.where({self._print(condition)}, {self._print(value)}, {text})"
        return text

    def _print_Relational(self, expr: Any) -> str:
        return f"({self._print(expr.lhs)} {expr.rel_op} {self._print(expr.rhs)})"

    def _print_And(self, expr: Any) -> str:
        return f"({' & '.join(map(self._print, expr.args))})"

    def _print_Or(self, expr: Any) -> str:
        return f"({' | '.join(map(self._print, expr.args))})"

    def _print_Not(self, expr: Any) -> str:
        return f"(~{self._print(expr.args[0])})"


def python(found: Program) -> str:
    """The module's text."""
    between = (series.between_samples, series.held_values, series.rate_per_sample)
    given = [i for i in found.inputs if i.name not in found.rates]
    named = (*found.states, *found.inputs, *found.outputs, *found.parameters)
    return filled(
        "export_python",
        head="\n".join(described(found)),
        inputs_example=", ".join(f"{plain(i.name)!r}: samples" for i in given),
        start_example=f"{plain(found.states[0].name)!r}: 0.0",
        states=_literal(tuple(s.name for s in found.states)),
        inputs=_literal(tuple(i.name for i in found.inputs)),
        readings=_literal(tuple(o.name for o in found.outputs)),
        units=_literal({i.name: i.unit for i in named}),
        parameters=_literal({p.name: p.value for p in found.parameters}),
        errors=_literal({p.name: p.error for p in found.parameters}),
        between=_literal(dict(found.between)),
        rates=_literal(dict(found.rates)),
        rhs=_values(found, found.rate),
        output=_values(found, found.output),
        rhs_slopes=_slopes(found, found.rate_x, found.rate_p),
        output_slopes=_slopes(found, found.output_x, found.output_p),
        knots=str(series.SPEED_RATE_KNOTS),
        interpolation="\n\n".join(inspect.getsource(f) for f in between).rstrip(),
    )


def _literal(value: Any) -> str:
    """A tuple in one line, a mapping with a line for each entry; texts as ``repr`` writes them."""
    if not isinstance(value, dict):
        return repr(value)
    rows = [f"    {key!r}: {entry!r}," for key, entry in value.items()]
    return "\n".join(["{", *rows, "}"]) if rows else "{}"


def _values(found: Program, values: Sequence[sp.Expr]) -> str:
    lines, texts = _computed(found, values)
    lines.append(f"found = np.empty(({len(texts)}, *x.shape[1:]))")
    lines += [f"found[{i}] = {text}" for i, text in enumerate(texts)]
    return _indented([*lines, "return found"])


def _slopes(found: Program, by_x: list[list[sp.Expr]], by_p: list[list[sp.Expr]]) -> str:
    entries = {
        f"{name}[{i}, {j}]": entry
        for name, rows in (("by_x", by_x), ("by_p", by_p))
        for i, row in enumerate(rows)
        for j, entry in enumerate(row)
        if entry != 0
    }
    lines, texts = _computed(found, list(entries.values()))
    lines.append(f"by_x = np.zeros(({len(by_x)}, {len(found.states)}, *x.shape[1:]))")
    lines.append(f"by_p = np.zeros(({len(by_p)}, {len(found.parameters)}, *x.shape[1:]))")
    lines += [f"{place} = {text}" for place, text in zip(entries, texts, strict=True)]
    return _indented([*lines, "return by_x, by_p"])


def _computed(found: Program, values: Sequence[sp.Expr]) -> tuple[list[str], list[str]]:
    """Lines that name what is given and what is common, and the texts of the values."""
    names = identifiers((*found.states, *found.inputs, *found.parameters), _RESERVED)
    names[found.time] = "t"
    lines = ["x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)"]
    for array, items in (("x", found.states), ("u", found.inputs)):
        lines += [f"{names[i.symbol]} = {array}[{items.index(i)}]" for i in used(values, items)]
    for item in used(values, found.parameters):
        lines.append(f"{names[item.symbol]} = np.float64(p[{item.name!r}])")
    parts, texts = assignments(values, _Printer({"strict": True}).doprint, names)
    return [*lines, *(f"{name} = {text}" for name, text in parts)], texts


def _indented(lines: Sequence[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
