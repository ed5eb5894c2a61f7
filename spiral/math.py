"""Functions for writing physics: one definition serves SymPy, pint and NumPy.

An effect's equation calls these instead of ``math`` or ``numpy``. On symbols they build
expressions, on quantities with units they check dimensions, on numbers they compute.
Heavy libraries are only looked at where one of their objects arrives.
"""

from __future__ import annotations

import sys
from functools import reduce
from typing import Any


def _is_symbolic(value: Any) -> bool:
    sympy = sys.modules.get("sympy")
    return sympy is not None and isinstance(value, sympy.Basic)


def _is_quantity(value: Any) -> bool:
    return hasattr(value, "dimensionality")


def _elementary_function(name: str) -> Any:
    def function(value: Any) -> Any:
        if _is_symbolic(value):
            return getattr(sys.modules["sympy"], name)(value)
        import numpy as np

        return getattr(np, name)(value.to("") if _is_quantity(value) else value)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = f"{name}(value) of a dimensionless value."
    return function


sin = _elementary_function("sin")
cos = _elementary_function("cos")
sinh = _elementary_function("sinh")
cosh = _elementary_function("cosh")
tanh = _elementary_function("tanh")
exp = _elementary_function("exp")
log = _elementary_function("log")


def sqrt(value: Any) -> Any:
    """Square root; units are halved."""
    if _is_symbolic(value):
        return sys.modules["sympy"].sqrt(value)
    return value**0.5


def maximum(first: Any, second: Any) -> Any:
    """The larger of two values of one unit; its derivative at the tie is that of the first."""
    return where(first >= second, first, second)


def ramp(value: Any, width: Any) -> Any:
    """The positive part (x)_+ with its corner rounded over +-w: exact outside, smooth inside.

    0 for x <= -w, (x + w)^2 / (4 w) for |x| < w, x for x >= w; continuous with its slope, off by
    w/4 at most (at x = 0). ``width`` 0 is the sharp corner; both of one unit.
    """
    inside = (value + width) * (value + width) / (4 * width) if _is_nonzero(width) else 0 * value
    return where(value >= width, value, where(value <= -width, 0 * value, inside))


def _is_traced(value: Any) -> bool:
    """Whether it stands for an expression, as ``spiral.physics.formulas.symbolic`` makes them."""
    return hasattr(value, "expression")


def _is_nonzero(width: Any) -> bool:
    return _is_symbolic(width) or _is_traced(width) or bool(getattr(width, "magnitude", width) != 0)


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """``if_true`` where the condition holds, else ``if_false``; both of one unit."""
    if _is_symbolic(condition):
        sympy = sys.modules["sympy"]
        return sympy.Piecewise((if_true, condition), (if_false, True))
    if _is_quantity(if_true) and _is_quantity(if_false):
        _ = if_true + if_false  # raises unless the units agree
    if isinstance(condition, bool):
        return if_true if condition else if_false
    import numpy as np

    return np.where(condition, if_true, if_false)


def length(values: Any) -> Any:
    """Euclidean length sqrt(sum v_i^2) that stays differentiable at rest.

    On symbols 1e-200 is added under the root, far below the square of any motion, so that
    v_i / |v| is 0 and not 0/0 at rest.
    """
    values = list(values)
    if any(map(_is_traced, values)):
        import numpy as np

        return reduce(np.hypot, values) if len(values) > 1 else np.abs(values[0])
    squares = sum(v * v for v in values)
    return sqrt(
        squares + sys.modules["sympy"].Float("1e-200") if _is_symbolic(squares) else squares
    )


def positive(value: Any) -> Any:
    """A dimensionless value d rounded above zero: (d + (d^2 + e^2)^(1/2)) / (1 + (1 + e^2)^(1/2)).

    With e = 0.01; one at d = 1.
    """
    return (value + length([value, 0.01])) / (1 + length([1, 0.01]))
