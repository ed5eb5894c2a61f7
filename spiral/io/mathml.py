"""The model as MathML, which browsers draw without any font or script of their own."""

# ruff: noqa: N802  (SymPy's printers look methods up by class name)
from __future__ import annotations

from typing import Any

import sympy as sp
from sympy.printing.mathml import MathMLPresentationPrinter

from spiral.io.export.equation import equations
from spiral.types.model import Model

_LETTERS = {"alpha": "α", "beta": "β", "phase": "θ", "speed": "Ω"}  # noqa: RUF001
_DIGITS = 4


class _Printer(MathMLPresentationPrinter):
    """States with dots for their rates, numbers as m x 10^n with a few digits."""

    def _print_Symbol(self, sym: sp.Symbol, style: str = "plain") -> Any:
        return _dotted(self, sym.name)

    def _print_Float(self, e: Any) -> Any:  # type: ignore[override]
        digits, _, power = f"{float(e):.{_DIGITS}g}".partition("e")
        first = _leaf(self, "mn", digits)
        if not power:
            return first
        row = self.dom.createElement("mrow")
        ten = self.dom.createElement("msup")
        ten.appendChild(_leaf(self, "mn", "10"))
        ten.appendChild(_leaf(self, "mn", str(int(power)).replace("-", "−")))  # noqa: RUF001
        for part in (first, _leaf(self, "mo", "·"), ten):
            row.appendChild(part)
        return row


def _leaf(printer: MathMLPresentationPrinter, tag: str, text: str) -> Any:
    found = printer.dom.createElement(tag)
    found.appendChild(printer.dom.createTextNode(text))
    return found


def _dotted(printer: MathMLPresentationPrinter, name: str) -> Any:
    base, dots = name, 0
    while base.endswith("_rate"):
        base, dots = base.removesuffix("_rate"), dots + 1
    letter = _leaf(printer, "mi", _LETTERS.get(base, base))
    if not dots:
        return letter
    over = printer.dom.createElement("mover")
    over.setAttribute("accent", "true")
    over.appendChild(letter)
    over.appendChild(_leaf(printer, "mo", "˙" if dots == 1 else "¨"))
    return over


def mathml(model: Model) -> list[dict[str, Any]]:
    """One entry for each equation: ``left``, and ``terms`` of (owner, MathML) in order."""
    printer = _Printer()
    found = []
    for item in equations(model)[0]:
        rate = item.left.endswith("'")
        name = f"{item.left[:-1]}_rate" if rate else item.left
        left = _dotted(printer, name) if rate else _leaf(printer, "mtext", name)
        terms = [
            {"owner": term.owner or "system", "math": _term(printer, term.value)}
            for term in item.terms
        ]
        found.append({"left": left.toxml(), "terms": terms})
    return found


def _term(printer: _Printer, value: sp.Expr) -> str:
    """A term with its sign first; sums are multiplied out no further."""
    negative = value.could_extract_minus_sign() and not value.is_Add
    body: Any = printer._print(-value if negative else value)
    sign = "−" if negative else "+"  # noqa: RUF001
    return f"<mo>{sign}</mo>{body.toxml()}"
