"""The model as MathML, which browsers draw without any font or script of their own."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

from typing import Any

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter
from sympy.printing.precedence import PRECEDENCE

from spiral.io.export.equation import case_list, model_equations
from spiral.types.model import Model

_LETTERS = {"alpha": "α", "beta": "β", "phase": "θ", "speed": "Ω"}  # noqa: RUF001
_DIGITS = 4
_INDEX = 2  # letters of an index, at most


class _MathmlPrinter(MathMLPresentationPrinter):
    """States with dots for their rates, numbers as m x 10^n with a few digits."""

    def element(self, value: Any) -> Any:
        """An expression as an element of the document."""
        return self._print(value)

    def _print_Symbol(self, sym: sp.Symbol, style: str = "plain") -> Any:
        return _dotted_symbol(self, sym.name)

    def _print_Float(self, e: Any) -> Any:  # type: ignore[override]
        digits, _, power = f"{float(e):.{_DIGITS}g}".partition("e")
        first = _text_element(self, "mn", digits)
        if not power:
            return first
        row = self.dom.createElement("mrow")
        ten = self.dom.createElement("msup")
        ten.appendChild(_text_element(self, "mn", "10"))
        ten.appendChild(_text_element(self, "mn", str(int(power)).replace("-", "−")))  # noqa: RUF001
        for part in (first, _text_element(self, "mo", "·"), ten):
            row.appendChild(part)
        return row

    def _print_Mul(self, expr: sp.Mul) -> Any:  # type: ignore[override]
        """Cases stand behind the other factors: in a fraction they would be small."""
        cases = [f for f in sp.Mul.make_args(expr) if isinstance(f, sp.Piecewise)]
        if not cases:
            return super()._print_Mul(expr)
        row = self.dom.createElement("mrow")
        rest = sp.Mul(*(f for f in sp.Mul.make_args(expr) if f not in cases))
        for factor in (rest, *cases):
            part: Any = self.parenthesize(factor, PRECEDENCE["Mul"], strict=True)
            row.appendChild(part)
        return row

    def _print_Add(self, expr: sp.Add, order: Any = None) -> Any:  # type: ignore[override]
        """Several cases of a sum stand one below the other."""
        if not _is_stacked(expr):
            return super()._print_Add(expr, order)
        terms = sp.Add.make_args(expr)
        return self._table([[self._with_sign(term)] for term in terms])

    def _print_Piecewise(self, expr: sp.Piecewise) -> Any:  # type: ignore[override]
        """A table in braces: a value and where it holds on each line."""
        row = self.dom.createElement("mrow")
        lines = []
        for value, condition in case_list(expr):
            where = self.dom.createElement("mrow")
            rest = condition == sp.true
            where.appendChild(_text_element(self, "mtext", "else" if rest else "where\xa0"))
            if not rest:
                where.appendChild(self.element(condition))
            lines.append([self.element(value), where])
        braces = (_text_element(self, "mo", brace) for brace in "{}")
        for part in (next(braces), self._table(lines), next(braces)):
            row.appendChild(part)
        return row

    def _with_sign(self, term: sp.Expr) -> Any:
        """A term of a sum behind its sign."""
        row = self.dom.createElement("mrow")
        negative = term.could_extract_minus_sign()
        row.appendChild(_text_element(self, "mo", "−" if negative else "+"))  # noqa: RUF001
        row.appendChild(self.element(-term if negative else term))
        return row

    def _table(self, lines: list[list[Any]]) -> Any:
        table = self.dom.createElement("mtable")
        for cells in lines:
            line = self.dom.createElement("mtr")
            for content in cells:
                cell = self.dom.createElement("mtd")
                cell.appendChild(content)
                line.appendChild(cell)
            table.appendChild(line)
        return table


def _is_stacked(value: sp.Expr) -> bool:
    """Whether an expression is a sum of several cases, too wide for a line."""
    return sum(term.has(sp.Piecewise) for term in sp.Add.make_args(value)) > 1


def _text_element(printer: MathMLPresentationPrinter, tag: str, text: str) -> Any:
    element = printer.dom.createElement(tag)
    element.appendChild(printer.dom.createTextNode(text))
    return element


def _dotted_symbol(printer: MathMLPresentationPrinter, name: str) -> Any:
    base, dots = name, 0
    while base.endswith("_rate"):
        base, dots = base.removesuffix("_rate"), dots + 1
    letter = _letter_with_index(printer, base)
    if not dots:
        return letter
    over = printer.dom.createElement("mover")
    over.setAttribute("accent", "true")
    over.appendChild(letter)
    over.appendChild(_text_element(printer, "mo", "˙" if dots == 1 else "¨"))
    return over


def _letter_with_index(printer: MathMLPresentationPrinter, name: str) -> Any:
    """A name; a short part after its last underscore as an index: ``k_x``, ``stiffness_x``."""
    stem, _, index = name.rpartition("_")
    if not stem or not index or len(index) > _INDEX:
        return _text_element(printer, "mi", _LETTERS.get(name, name))
    below = printer.dom.createElement("msub")
    below.appendChild(_text_element(printer, "mi", _LETTERS.get(stem, stem)))
    below.appendChild(_text_element(printer, "mn" if index.isdecimal() else "mi", index))
    return below


def mathml(model: Model) -> list[dict[str, Any]]:
    """One entry for each equation: ``left``, and ``terms`` of (owner, MathML) in order."""
    printer = _MathmlPrinter()
    entries = []
    for item in model_equations(model)[0]:
        rate = item.left.endswith("'")
        name = f"{item.left[:-1]}_rate" if rate else item.left
        left = _dotted_symbol(printer, name) if rate else _text_element(printer, "mtext", name)
        if item.inertia is not None:
            left = printer.element(item.inertia)
        terms = [
            {"owner": term.owner or "system", "math": _signed_term(printer, term.value)}
            for term in item.terms
        ]
        entries.append({"left": left.toxml(), "terms": terms})
    return entries


def _signed_term(printer: _MathmlPrinter, value: sp.Expr) -> str:
    """A term with its sign first; sums are multiplied out no further."""
    negative = value.could_extract_minus_sign() and not value.is_Add
    body = printer.element(-value if negative else value)
    if _is_stacked(value):
        return body.toxml()
    sign = "−" if negative else "+"  # noqa: RUF001
    return f"<mo>{sign}</mo>{body.toxml()}"
