"""Values that stand for expressions while a Python function is followed, and formulas of them.

A function written with arithmetic and NumPy is called once with such values in place of numbers;
what it returns are its equations:

    rhs(t, x, u, p)  ->  v' = (F - c*v - k*x)/m

What depends on a value that is not known yet (``if x > 0``, ``float(x)``) cannot be followed.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any, NoReturn

import numpy as np
import sympy as sp
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.str import StrPrinter

HYPOT, MAXIMUM, MINIMUM, WHERE = (
    sp.Function(n, real=True) for n in ("hypot", "maximum", "minimum", "where")
)
"""Functions that formulas have and whose smooth forms ``spiral.math`` chooses."""


class CannotFollowError(Exception):
    """What stands in a function and is no expression: ``given``, and what to ``try_``."""

    def __init__(self, given: str, try_: str) -> None:
        super().__init__(given)
        self.given, self.try_ = given, try_


class Expression(np.lib.mixins.NDArrayOperatorsMixin):
    """A value that stands for a SymPy expression; NumPy's arithmetic and functions act on it."""

    def __hash__(self) -> int:
        """As any object's: a value is itself alone."""
        return id(self)

    def __init__(self, expression: Any) -> None:
        self.expression = sp.sympify(expression)

    def __array_ufunc__(self, ufunc: Any, method: str, *values: Any, **options: Any) -> Any:
        """NumPy's function of expressions; of an array, of each of its entries."""
        name = ufunc.__name__
        if name in _STEPS:
            raise CannotFollowError(f"numpy.{name}, a step", "numpy.tanh(v/w) with a small width w")
        target = options.pop("out", (None,))[0]  # of ``+=`` and its like
        if method != "__call__" or options or name not in _FUNCTIONS:
            raise CannotFollowError(f"numpy.{name}", f"one of {', '.join(_NAMED)}")
        if isinstance(target, np.ndarray):
            return _fill_array(target, self.__array_ufunc__(ufunc, method, *values))
        values = tuple(np.array(v, object) if isinstance(v, list | tuple) else v for v in values)
        if any(isinstance(v, np.ndarray) and v.ndim for v in values):
            each = np.frompyfunc(lambda *v: self.__array_ufunc__(ufunc, method, *v), ufunc.nin, 1)
            boxed = (_wrap_in_array(v) if isinstance(v, Expression) else v for v in values)
            return each(*boxed)
        result = _FUNCTIONS[name](*(expression_of(v) for v in values))
        return Condition(result) if name in _COMPARED else Expression(result)

    def __array_function__(self, function: Any, types: Any, values: Any, options: Any) -> Any:
        """``numpy.where`` of a comparison and ``numpy.clip``; nothing else is known."""
        if function is np.where and len(values) == 3:
            return _trace_where(*values)
        if function is np.clip and len(values) == 3 and not options:
            return _trace_clip(*values)
        raise CannotFollowError(f"numpy.{function.__name__}", f"one of {', '.join(_NAMED)}")

    def __bool__(self) -> NoReturn:
        """A truth that depends on the values of a motion."""
        raise CannotFollowError(f"a decision by {self.expression}", _DECIDE)

    def __float__(self) -> NoReturn:
        """A number, as the functions of ``math`` ask for."""
        raise CannotFollowError(
            f"{self.expression}, taken for a number",
            "numpy.sin in place of math.sin; a list in place of an array that is filled",
        )

    __int__ = __index__ = __complex__ = __float__


class Condition(Expression):
    """A comparison of two expressions, for the first place of ``where``."""


def _wrap_in_array(value: Any) -> Any:
    box = np.empty((), dtype=object)
    box[()] = value
    return box


def expression_of(value: Any) -> Any:
    """What a value stands for; numbers stand for themselves."""
    if isinstance(value, Expression):
        return value.expression
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return expression_of(value.item())
    if isinstance(value, sp.Basic):
        return value
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        return sp.Integer(int(value))
    return sp.Float(float(value))


def _trace_where(condition: Any, first: Any, second: Any) -> Any:
    if not isinstance(condition, Condition):
        raise CannotFollowError("numpy.where without a comparison", "numpy.where(x > g, a, b)")
    return Expression(WHERE(condition.expression, expression_of(first), expression_of(second)))


def _trace_clip(value: Any, low: Any, high: Any) -> Any:
    """min(max(x, low), high); a bound that is None is none."""
    raised = value if low is None else np.maximum(value, low)
    return raised if high is None else np.minimum(raised, high)


def _fill_array(target: Any, values: Any) -> Any:
    """An array that holds these values from now on, as ``+=`` asks for."""
    if target.dtype != object:
        raise CannotFollowError(
            "numbers in an array, to which an expression is added",
            "a list in place of an array that is filled",
        )
    target[...] = values
    return target


def _raise_power(base: Any, power: Any) -> Any:
    if not power.is_number:
        raise CannotFollowError(f"the power {base}**({power})", "a power that is a number")
    whole = sp.nsimplify(power)
    return base ** (whole if whole.q <= 2 else power)


def _sympy_function(name: str) -> Callable[[Any], Any]:
    return getattr(sp, name)


_NAMED_ALIKE = ("sin", "cos", "sinh", "cosh", "tanh", "exp", "log", "sqrt")  # here as in SymPy
_COMPARED = {"less": sp.Lt, "less_equal": sp.Le, "greater": sp.Gt, "greater_equal": sp.Ge}
_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "true_divide": operator.truediv,
    "negative": operator.neg,
    "positive": operator.pos,
    "power": _raise_power,
    "float_power": _raise_power,
    "square": lambda x: x**2,
    "reciprocal": lambda x: 1 / x,
    "tan": lambda x: sp.sin(x) / sp.cos(x),
    "absolute": sp.Abs,
    "fabs": sp.Abs,
    "hypot": HYPOT,
    "maximum": MAXIMUM,
    "minimum": MINIMUM,
    "fmax": MAXIMUM,
    "fmin": MINIMUM,
    **{name: _sympy_function(name) for name in _NAMED_ALIKE},
    **_COMPARED,
}
_STEPS = ("sign", "heaviside", "floor", "ceil", "rint", "trunc")
_NAMED = ("sin", "cos", "tan", "tanh", "sinh", "cosh", "exp", "log", "sqrt", "abs", "hypot",
          "maximum", "minimum", "clip", "where")  # fmt: skip
_DECIDE = "numpy.where(x > g, a, b) or spiral.math.where in place of if; numpy.maximum for max"


# --- as text -------------------------------------------------------------------------------------


def divisors(value: Any) -> list[Any]:
    """The factors of what an expression is divided by."""
    return list(sp.Mul.make_args(sp.fraction(sp.together(value))[1]))


def formula_text(expression: Any) -> str:
    """An expression as a formula (``spiral.physics.formulas.syntax``)."""
    return _Formula().doprint(expression)


class _Formula(StrPrinter):
    """SymPy's text, with numbers to the last digit and the functions that formulas have."""

    def _print_Float(self, expr: Any) -> str:  # noqa: N802
        return repr(float(expr))

    def _print_Abs(self, expr: Any) -> str:  # noqa: N802
        return f"abs({self._print(expr.args[0])})"

    def _print_Rational(self, expr: Any) -> str:  # noqa: N802
        return f"{expr.p}/{expr.q}"

    def _print_Pow(self, expr: Any, rational: bool = False) -> str:  # noqa: N802
        base, power = expr.base, expr.exp
        if power.is_Rational and power.q == 2:
            root = f"sqrt({self._print(base)})"
            if abs(power.p) > 1:
                root = f"{root}**{abs(power.p)}"
            return root if power > 0 else f"1/{root}"
        if power.is_Float or (power.is_Rational and power.q > 2):
            return f"{self.parenthesize(base, PRECEDENCE['Pow'])}**{float(power)!r}"
        return super()._print_Pow(expr, rational)
