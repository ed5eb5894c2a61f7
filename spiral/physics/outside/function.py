"""A right-hand side in Python that cannot be traced, compiled by Numba; slopes by differences.

    df/da ~ (f(a + h) - f(a - h)) / 2h,    h = 1e-7 max(|a|, 1)

A step that suits motions down to some 1e-6 of their unit.
"""

from __future__ import annotations

import inspect
import re
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from spiral.physics.formulas.definition import definition_of, parse_sections
from spiral.physics.formulas.function import dump_sections
from spiral.physics.outside.program import CalledProgram
from spiral.physics.outside.wrapped import (
    WrappedProgram,
    kinematic_rates,
    rate_equations,
    rate_inputs,
)
from spiral.types.cache import kept
from spiral.types.errors import ConfigError

STEP = 1e-7
_GROUPS = ("x", "u", "p")


@kept(16)
def wrap_function(rhs: Callable[..., Any], text: str) -> WrappedProgram:
    """A compiled right-hand side and equations around it; ``text`` has all other sections.

    Raises
    ------
    ConfigError : a section or the function cannot be used.
    """
    sections = parse_sections(text)
    declared = definition_of(dump_sections({**sections, "equations": ["0 = 0"]}))
    states, inputs, parameters = (
        tuple(i.name for i in group)
        for group in (declared.states, declared.inputs, declared.parameters)
    )
    known = {q.name: q.start for q in declared.parameters if q.start is not None}
    start = {**dict.fromkeys(parameters, 1.0), **known, **dict(declared.values)}
    program = program_of(rhs, states, inputs, start)
    rates = kinematic_rates(
        program, len(states), [0.1] * (len(states) + len(inputs)) + [*start.values(), 0.1]
    )
    units = {s.name: s.unit for s in declared.states}
    around = {
        **sections,
        "equations": rate_equations(program, rates),
        "inputs": {**(sections.get("inputs") or {}), **rate_inputs(program, rates, units)},
    }
    sizes = (len(states), len(inputs), len(parameters))
    return WrappedProgram(program, sizes, dump_sections(around), inputs)


def program_of(
    rhs: Callable[..., Any],
    states: Sequence[str],
    inputs: Sequence[str],
    parameters: Mapping[str, float],
) -> CalledProgram:
    """The program of ``rhs(t, x, u, p)``, its arguments in this order, the time last.

    Parameters
    ----------
    parameters : name -> a value at which the function is tried once.

    Raises
    ------
    ConfigError : the function fails in Python, gives another number of rates, or does not compile.
    """
    groups = [
        _group_type(*g) for g in zip(_GROUPS, (states, inputs, tuple(parameters)), strict=True)
    ]
    name = getattr(rhs, "__name__", "rhs")
    count = _argument_count(rhs)
    _try_function(rhs, name, states, groups, list(parameters.values()), count)
    kernel = _compile_kernel(rhs, name, states, groups, count)
    arguments = (*states, *inputs, *parameters, "time")
    unused = np.zeros(1, dtype=np.int64), np.zeros(1)
    return CalledProgram(name, tuple(states), arguments, kernel.address, *unused, kernel)


def _group_type(letter: str, names: Sequence[str]) -> Any:
    return namedtuple(letter, names) if names else None  # type: ignore[misc]


def _argument_count(rhs: Callable[..., Any]) -> int:
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    given = inspect.signature(rhs).parameters.values()
    return sum(p.kind in kinds and p.default is p.empty for p in given)


def _try_function(
    rhs: Callable[..., Any],
    name: str,
    states: Sequence[str],
    groups: Sequence[Any],
    values: Sequence[float],
    count: int,
) -> None:
    """Call the function once in Python and check that it gives a rate for each state."""
    lengths = [len(g._fields) if g else 0 for g in groups]
    numbers = [[0.1] * lengths[0], [0.1] * lengths[1], list(values)]
    given = [g(*map(float, n)) if g else () for g, n in zip(groups, numbers, strict=True)]
    expected = f"the rates of {', '.join(states)}, as a list in this order"
    try:
        result = rhs(*(0.0, *given)[:count])
        told = "a mapping" if isinstance(result, Mapping) else f"{len(result)} values"
    except Exception as error:
        said = (str(error).splitlines() or [""])[0]
        raise ConfigError(
            f"{name}(): {type(error).__name__}: {said}",
            expected,
            "values by name (x.x, u.F, p.m) or number (x[0])",
        ) from error
    if told != f"{len(states)} values":
        raise ConfigError(f"{name}(), not traced but compiled, gives {told}", expected)


def _compile_kernel(
    rhs: Callable[..., Any],
    name: str,
    states: Sequence[str],
    groups: Sequence[Any],
    count: int,
) -> Any:
    """The kernel (``calls.KERNEL``)."""
    import numba as nb

    from spiral.physics.outside.calls import KERNEL, carray

    rates = _compile_rates(rhs, groups, count)
    rows, arguments = len(states), sum(len(g._fields) for g in groups if g) + 1

    def kernel(whole, numbers, given, columns, count, values, slopes):
        a, c = carray(given, arguments), carray(columns, count)
        rates(a, carray(values, rows))
        slope_rows = carray(slopes, (count, rows))
        low = np.empty(rows)
        for k in range(count):
            here = a[c[k]]
            step = STEP * max(abs(here), 1.0)
            a[c[k]] = here - step
            rates(a, low)
            a[c[k]] = here + step
            rates(a, slope_rows[k])
            a[c[k]] = here
            for i in range(rows):  # row by row took 2.5 s longer to compile
                slope_rows[k, i] = (slope_rows[k, i] - low[i]) / (2.0 * step)

    try:
        return nb.cfunc(KERNEL, error_model="numpy")(kernel)
    except Exception as error:  # typing, lowering or an internal error, each of a kind of its own
        raise ConfigError(
            f"{name}(), which Numba cannot compile: {_numba_reason(error)}",
            "numbers, arrays, loops, if, and functions of math and NumPy",
            "no objects, texts or calls of other libraries inside; tables as NumPy arrays",
        ) from error


def _compile_rates(rhs: Callable[..., Any], groups: Sequence[Any], count: int) -> Any:
    """rates(a, f): the function with its arguments from one array, the rates into another."""
    import numba as nb

    from spiral.physics.outside.calls import store

    states, inputs, parameters = _group_readers(groups)
    own = rhs if hasattr(rhs, "py_func") else nb.njit(rhs, error_model="numpy")

    @nb.njit
    def call_function(a):
        if count == 2:
            return own(a[-1], states(a))
        if count == 3:
            return own(a[-1], states(a), inputs(a))
        return own(a[-1], states(a), inputs(a), parameters(a))

    @nb.njit
    def rates(a, f):
        store(f, 0, call_function(a))

    return rates


def _group_readers(groups: Sequence[Any]) -> list[Any]:
    """For each group a function that takes its values by name out of one array."""
    import numba as nb
    from numba.np.unsafe import ndarray

    to_fixed_tuple: Any = ndarray.to_fixed_tuple

    def reader(group: Any, first: int, size: int) -> Any:
        if group is None:
            return nb.njit(lambda a: ())
        return nb.njit(lambda a: group(*to_fixed_tuple(a[first : first + size], size)))

    readers, first = [], 0
    for group in groups:
        size = len(group._fields) if group else 0
        readers.append(reader(group, first, size))
        first += size
    return readers


def _numba_reason(error: Exception) -> str:
    """The line of Numba's message that says what it met."""
    plain = re.sub(r"\x1b\[\d*m", "", str(error))  # of colours
    lines = [line.strip() for line in plain.splitlines() if line.strip()]
    passing = ("Failed in", "During:", "File ", "- Resolution", "<source")
    said = [line for line in lines if not line.startswith(passing)]
    return (said or lines or [type(error).__name__])[0][:200]
