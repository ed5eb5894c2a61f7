"""A program (an FMU, a compiled function) as f(a) in expressions, evaluated by a kernel.

In an expression each value stands as a function of SymPy, whose derivative is another one; the
emitter calls the kernel once for all of them (``spiral.physics.emit``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import sympy as sp

from spiral.types.errors import ConfigError

Array = np.ndarray


@dataclass(frozen=True, eq=False)
class CalledProgram:
    """values = f(arguments), behind the address of a kernel (``calls.KERNEL``).

    ``rows`` name the values, ``arguments`` what they depend on. ``whole`` and ``numbers`` are the
    kernel's own; ``owner`` keeps alive what it needs.
    """

    name: str
    rows: tuple[str, ...]
    arguments: tuple[str, ...]
    address: int | None
    whole: Array
    numbers: Array
    owner: Any

    @cached_property
    def functions(self) -> tuple[type[ProgramValue], ...]:
        """A function of SymPy for each value."""
        return tuple(_value_function_class(self, row, None) for row in range(len(self.rows)))

    def slope(self, row: int, column: int) -> type[ProgramValue]:
        """The derivative of a value by an argument."""
        return self._slopes[row][column]

    @cached_property
    def _slopes(self) -> tuple[tuple[type[ProgramValue], ...], ...]:
        columns = range(len(self.arguments))
        return tuple(
            tuple(_value_function_class(self, row, c) for c in columns)
            for row in range(len(self.rows))
        )

    def values(self, given: Sequence[Any]) -> list[Any]:
        """Expressions of the values, at expressions of the arguments."""
        return [function(*map(sp.sympify, given)) for function in self.functions]

    def values_and_slopes(self, given: Any, columns: Sequence[int] = ()) -> tuple[Array, Array]:
        """Values (points, rows) and slopes (points, columns, rows) at (points, arguments)."""
        from spiral.physics.outside.calls import evaluate_along

        points = np.ascontiguousarray(np.atleast_2d(np.asarray(given, dtype=float)))
        wanted = np.array(columns, dtype=np.int64)
        values = np.full((len(points), len(self.rows)), np.nan)
        slopes = np.full((len(points), len(wanted), len(self.rows)), np.nan)
        evaluate_along(self.address, self.whole, self.numbers, points, wanted, values, slopes)
        return values, slopes


class ProgramValue(sp.Function):
    """One value of a program, or its slope by one argument."""

    program: ClassVar[CalledProgram]
    row: ClassVar[int]
    column: ClassVar[int | None]

    def fdiff(self, argindex: int = 1) -> Any:
        """The slope by an argument, counted from one.

        Raises
        ------
        ConfigError : a second derivative, which no program tells.
        """
        if self.column is not None:
            raise ConfigError(
                f"a second derivative of {self.program.name}", "first derivatives alone"
            )
        return self.program.slope(self.row, argindex - 1)(*self.args)

    def _eval_is_real(self) -> bool:
        return True


def _value_function_class(
    program: CalledProgram, row: int, column: int | None
) -> type[ProgramValue]:
    """SymPy's function of a value or a slope; ``lambdify`` calls its ``_imp_`` with arrays."""
    of = "" if column is None else f"_by_{program.arguments[column]}"

    def numeric_values(*given: Any) -> Any:
        parts = np.broadcast_arrays(*(np.asarray(g, dtype=float) for g in given))
        points = np.stack([p.ravel() for p in parts], axis=1)
        values, slopes = program.values_and_slopes(points, () if column is None else (column,))
        flat = values[:, row] if column is None else slopes[:, 0, row]
        return flat.reshape(parts[0].shape)

    own = {"program": program, "row": row, "column": column, "_imp_": staticmethod(numeric_values),
           "nargs": len(program.arguments)}  # fmt: skip
    return type(f"{program.rows[row]}{of}", (ProgramValue,), own)
