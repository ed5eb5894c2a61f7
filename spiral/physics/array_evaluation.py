"""Traced expressions evaluated with an array library: NumPy's, or that of a device (JAX).

The same rules as those of the machine code (``emit``): powers of small integers are products,
negative powers quotients, and of a piecewise expression the first piece whose condition holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sympy as sp

from spiral.physics.emit import MOST_FACTORS
from spiral.physics.outside.program import ProgramValue
from spiral.types.errors import PluginError

_NAMES = {
    sp.sin: "sin", sp.cos: "cos", sp.exp: "exp", sp.log: "log", sp.tan: "tan", sp.tanh: "tanh",
    sp.sinh: "sinh", sp.cosh: "cosh", sp.asin: "arcsin", sp.acos: "arccos", sp.atan: "arctan",
    sp.asinh: "arcsinh", sp.acosh: "arccosh", sp.atanh: "arctanh", sp.floor: "floor",
    sp.ceiling: "ceil", sp.Abs: "abs", sp.sign: "sign",
}  # fmt: skip
_ORDERED = {
    sp.Gt: "greater", sp.Ge: "greater_equal", sp.Lt: "less", sp.Le: "less_equal", sp.Eq: "equal",
    sp.Ne: "not_equal",
}  # fmt: skip


class ArrayEvaluator:
    """Values of expressions at arrays that broadcast; every node is computed once.

    Parameters
    ----------
    library : ``numpy``, or a module with its functions (``jax.numpy``).
    erf : the error function of that library.
    symbols : the value of every symbol.
    """

    def __init__(self, library: Any, erf: Any, symbols: Mapping[sp.Symbol, Any]) -> None:
        self._library, self._erf = library, erf
        self._values: dict[Any, Any] = dict(symbols)

    def value(self, expression: Any) -> Any:
        """The value of an expression, a condition among them.

        Raises
        ------
        PluginError : a function or a program that array libraries lack.
        """
        known = self._values.get(expression)
        if known is None:
            known = self._values[expression] = self._evaluate(expression)
        return known

    def _evaluate(self, e: Any) -> Any:
        if e.is_Number or e.is_NumberSymbol:
            return float(e)
        if e in (sp.true, sp.false):
            return e == sp.true
        if e.is_Add:
            return _fold(lambda a, b: a + b, map(self.value, e.args))
        if e.is_Mul:
            return _fold(lambda a, b: a * b, map(self.value, e.args))
        if e.is_Pow:
            return self._power(*e.args)
        if isinstance(e, sp.Piecewise):
            return self._piecewise(e.args)
        if isinstance(e, sp.Max | sp.Min):
            return self._extreme(e)
        if type(e) in _ORDERED:
            return getattr(self._library, _ORDERED[type(e)])(*map(self.value, e.args))
        return self._call(e)

    def _power(self, base: Any, exponent: Any) -> Any:
        if exponent.is_Integer and int(exponent) < 0:
            return 1.0 / self.value(base ** (-exponent))
        if exponent.is_Integer and int(exponent) <= MOST_FACTORS:
            return _fold(lambda a, b: a * b, [self.value(base)] * int(exponent))
        if exponent == sp.S.Half:
            return self._library.sqrt(self.value(base))
        if base == sp.E:
            return self._library.exp(self.value(exponent))
        return self._library.power(self.value(base), self.value(exponent))

    def _piecewise(self, pieces: Sequence[Any]) -> Any:
        """The first piece whose condition holds, of all that are there; NaN where none does."""
        selected: Any = float("nan")
        for expression, condition in reversed(pieces):
            value = self.value(expression)
            holds = condition == sp.true
            selected = (
                value if holds else self._library.where(self.value(condition), value, selected)
            )
        return selected

    def _extreme(self, e: Any) -> Any:
        """The largest or smallest; where two are equal the slope is the former's."""
        before = "greater_equal" if isinstance(e, sp.Max) else "less_equal"
        compare = getattr(self._library, before)
        return _fold(lambda a, b: self._library.where(compare(a, b), a, b), map(self.value, e.args))

    def _call(self, e: Any) -> Any:
        library = self._library
        if isinstance(e, ProgramValue):
            raise _program_error(e)
        if isinstance(e, sp.Not):
            return library.logical_not(self.value(e.args[0]))
        if isinstance(e, sp.And | sp.Or):
            join = library.logical_and if isinstance(e, sp.And) else library.logical_or
            return _fold(join, map(self.value, e.args))
        if isinstance(e, sp.ITE):
            return library.where(*map(self.value, e.args))
        if isinstance(e, sp.atan2):
            return library.arctan2(*map(self.value, e.args))
        if isinstance(e, sp.erf):
            return self._erf(self.value(e.args[0]))
        if e.func in _NAMES and len(e.args) == 1:
            return getattr(library, _NAMES[e.func])(self.value(e.args[0]))
        raise _no_array_function_error(e)


def _fold(join: Any, values: Iterable[Any]) -> Any:
    """The values joined from the first on, in their order."""
    first, *others = values
    for other in others:
        first = join(first, other)
    return first


def _program_error(e: ProgramValue) -> PluginError:
    return PluginError(
        f"{e.program.name} in a batch: a program that is called, not equations",
        "a model whose equations are known as expressions",
        "simulate one record after the other with spiral.simulate",
    )


def _no_array_function_error(e: Any) -> PluginError:
    name = str(e) if isinstance(e, sp.Symbol) else getattr(e.func, "__name__", str(e.func))
    known = sorted({f.__name__ for f in _NAMES} | {"atan2", "erf", "Piecewise", "Max", "Min"})
    return PluginError(
        f"{name} in an equation, which array libraries lack",
        f"numbers, the symbols given, + - * / **, {', '.join(known)}",
        "write it with the functions of spiral.math, or simulate one record after the other",
    )
