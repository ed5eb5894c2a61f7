"""The model as MathML, which browsers draw without any font or script of their own."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

from typing import Any

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

from spiral.io.export.equation import model_equations
from spiral.types.model import Model

_LETTERS = {"alpha": "α", "beta": "β", "phase": "θ", "speed": "Ω"}  # noqa: RUF001
_DIGITS = 4


class _MathmlPrinter(MathMLPresentationPrinter):
    """States with dots for their rates, numbers as m x 10^n with a few digits."""

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


def _text_element(printer: MathMLPresentationPrinter, tag: str, text: str) -> Any:
    element = printer.dom.createElement(tag)
    element.appendChild(printer.dom.createTextNode(text))
    return element


def _dotted_symbol(printer: MathMLPresentationPrinter, name: str) -> Any:
    base, dots = name, 0
    while base.endswith("_rate"):
        base, dots = base.removesuffix("_rate"), dots + 1
    letter = _text_element(printer, "mi", _LETTERS.get(base, base))
    if not dots:
        return letter
    over = printer.dom.createElement("mover")
    over.setAttribute("accent", "true")
    over.appendChild(letter)
    over.appendChild(_text_element(printer, "mo", "˙" if dots == 1 else "¨"))
    return over


def mathml(model: Model) -> list[dict[str, Any]]:
    """One entry for each equation: ``left``, and ``terms`` of (owner, MathML) in order."""
    printer = _MathmlPrinter()
    entries = []
    for item in model_equations(model)[0]:
        rate = item.left.endswith("'")
        name = f"{item.left[:-1]}_rate" if rate else item.left
        left = _dotted_symbol(printer, name) if rate else _text_element(printer, "mtext", name)
        if item.inertia is not None:
            left = printer._print(item.inertia)
        terms = [
            {"owner": term.owner or "system", "math": _signed_term(printer, term.value)}
            for term in item.terms
        ]
        entries.append({"left": left.toxml(), "terms": terms})
    return entries


def _signed_term(printer: _MathmlPrinter, value: sp.Expr) -> str:
    """A term with its sign first; sums are multiplied out no further."""
    negative = value.could_extract_minus_sign() and not value.is_Add
    body: Any = printer._print(-value if negative else value)
    sign = "−" if negative else "+"  # noqa: RUF001
    return f"<mo>{sign}</mo>{body.toxml()}"
