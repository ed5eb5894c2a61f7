"""A right-hand side written in Python, traced once and written as equations."""

from __future__ import annotations

import ast
import inspect
import linecache
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from spiral.physics.formulas import syntax
from spiral.physics.formulas.definition import definition_of
from spiral.physics.formulas.dimensions import (
    BASE,
    NONE,
    Dimension,
    DimensionWalk,
    UnitEquations,
    dimension,
)
from spiral.physics.formulas.rows import symbol
from spiral.physics.formulas.symbolic import (
    CannotFollowError,
    Expression,
    expression_of,
    formula_text,
)
from spiral.types.errors import ConfigError, SpiralError, did_you_mean
from spiral.types.rates import per_second
from spiral.types.units import short_form

_LIBRARIES = ("numpy", "sympy", "spiral", "scipy")


class CannotTraceError(ConfigError):
    """A right-hand side that cannot be followed with expressions in place of numbers."""


class Values:
    """Named values in order: ``x.v``, ``x["v"]``, ``x[1]``, ``x, v = x``; an array where needed."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self.__dict__.update(values)

    def __getitem__(self, key: Any) -> Any:
        """By name, by number, or several by a slice."""
        return getattr(self, key) if isinstance(key, str) else np.asarray(self)[key]

    def __getattr__(self, name: str) -> NoReturn:
        """A name that is not declared."""
        if name.startswith("__"):
            raise AttributeError(name)
        raise CannotFollowError(f"{name!r}, which is not declared", did_you_mean(name, vars(self)))

    def __iter__(self) -> Iterator[Any]:
        """In order."""
        return iter(self.__dict__.values())

    def __len__(self) -> int:
        """How many."""
        return len(self.__dict__)

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        """An array of objects."""
        array = np.empty(len(self), dtype=object)
        array[:] = list(self)
        return array


def definition_from(rhs: Callable[..., Any], sections: Mapping[str, Any]) -> dict[str, Any]:
    """The definition of a system from its right-hand side ``rhs(t, x, u, p)``.

    Parameters
    ----------
    rhs : its value is the time derivative of each state: a list or an array in their order, or a
        mapping by name. Later arguments may be left out: ``rhs(t, x)``.
    sections : the other sections of a definition (``definition.SystemDefinition``).

    Raises
    ------
    ConfigError : what cannot be followed, with its line; units that do not fit.
    """
    declared = definition_of(dump_sections({**sections, "equations": ["0 = 0"]}))  # or refused
    names = [s.name for s in declared.states]

    def named_symbols(group: Sequence[Any]) -> Values:
        return Values({item.name: Expression(symbol(item.name)) for item in group})

    rates = {i.rate.name: i.rate.unit for i in declared.inputs}
    beside = {n: Expression(symbol(n)) for n in rates if n not in declared.units}
    inputs = type("Inputs", (Values,), beside)  # by name alone: u has as many values as inputs
    time = Expression(symbol("time"))
    given = (
        time, named_symbols(declared.states), inputs(vars(named_symbols(declared.inputs))),
        named_symbols(declared.parameters),
    )  # fmt: skip
    derivatives = _call_with_symbols(rhs, given, names)
    formulas = {n: formula_text(expression_of(v)) for n, v in derivatives.items()}
    units = {**rates, **declared.units, "time": "s"}
    due = {s.name: per_second(s.unit) for s in declared.states}
    formulas, constants = _name_constants(formulas, units, due)
    lines = [f"{name}' = {text}" for name, text in formulas.items()]
    if constants:
        sections = {**sections, "constants": {**(sections.get("constants") or {}), **constants}}
    return {"equations": lines, **sections}


def dump_sections(sections: Mapping[str, Any]) -> str:
    """Sections as text (YAML)."""
    import yaml

    plain = {k: _plain_data(v) for k, v in sections.items() if v is not None}
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=1000)


def _plain_data(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain_data(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain_data(value.tolist())
    return [_plain_data(v) for v in value] if isinstance(value, list | tuple) else value


def _call_with_symbols(
    rhs: Callable[..., Any], given: tuple[Any, ...], names: list[str]
) -> dict[str, Any]:
    try:
        count = sum(
            p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD) and p.default is p.empty
            for p in inspect.signature(rhs).parameters.values()
        )
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{rhs!r}", "a function rhs(t, x, u, p), or a file of equations") from (
            error
        )
    if not 2 <= count <= 4:
        raise ConfigError(
            f"a function of {count} arguments", "rhs(t, x), rhs(t, x, u) or rhs(t, x, u, p)"
        )
    try:
        result = rhs(*given[:count])
        rates = _rates_by_name(result, names)
        return {n: Expression(expression_of(rates[n])) for n in names}
    except SpiralError:
        raise
    except Exception as error:
        _raise_cannot_trace(rhs, error, names)


def _rates_by_name(result: Any, names: list[str]) -> Mapping[str, Any]:
    given = dict(result) if isinstance(result, Mapping) else list(result)
    wanted = set(given) == set(names) if isinstance(given, dict) else len(given) == len(names)
    if not wanted:
        told = ", ".join(map(str, given)) if isinstance(given, dict) else f"{len(given)} values"
        raise ConfigError(
            f"rates of the function: {told}",
            f"{len(names)}, one for each of {', '.join(names)}",
            "a list in the order of states, or a mapping by name",
        )
    return given if isinstance(given, dict) else dict(zip(names, given, strict=True))


def _raise_cannot_trace(rhs: Callable[..., Any], error: Exception, names: list[str]) -> NoReturn:
    place = _error_line(error)
    name = getattr(rhs, "__name__", "rhs")
    if isinstance(error, CannotFollowError):
        raise CannotTraceError(
            f"{name}(){place}: {error.given}",
            "arithmetic and functions of NumPy on the values given, from which derivatives follow",
            error.try_,
        ) from error
    raise CannotTraceError(
        f"{name}(){place}: {type(error).__name__}: {(str(error).splitlines() or [''])[0]}",
        f"the rates of {', '.join(names)}, as a list in this order or a mapping by name",
        "states, inputs and parameters by name, for instance x.x, u.F, p.m",
    ) from error


def _error_line(error: Exception) -> str:
    """Where in the caller's own code it happened."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        folders = Path(frame.filename).parts
        if frame.lineno and not any(lib in folders for lib in _LIBRARIES):
            text = linecache.getline(frame.filename, frame.lineno).strip()
            return f", line {frame.lineno}" + (f", `{text}`" if text else "")
    return ""


# --- numbers that have units ---------------------------------------------------------------------


def _name_constants(
    formulas: Mapping[str, str], units: Mapping[str, str], due: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Formulas whose numbers with a unit are constants by name, and these constants.

    A plain function says ``9.81`` and means m/s^2: what unit each number has follows from the
    units of everything else.
    """
    named = {k: _Numbers(units) for k in formulas}
    trees = {}
    for i, (state, text) in enumerate(formulas.items()):
        named[state].prefix = f"number_{i}"
        trees[state] = named[state].visit(ast.parse(text, mode="eval").body)
    numbers = {n: v for one in named.values() for n, v in one.values.items()}
    demands = UnitEquations(tuple(numbers))
    walk = DimensionWalk(demands, {n: dimension(u) for n, u in units.items()}, units)
    for state, tree in trees.items():
        _demand_rate_unit(walk, demands, state, tree, formulas[state], due[state])
    for name in numbers:
        demands.demand_equal(Dimension({}, {name: Fraction(1)}), NONE)
    solved = demands.determined_dimensions()
    kept = {n: solved[n] for n in numbers if solved.get(n, NONE).known}
    names = {n: f"constant_{i + 1}" for i, n in enumerate(kept)}
    constants = {names[n]: f"{numbers[n]!r} {short_form(_unit_text(d))}" for n, d in kept.items()}
    back = {n: ast.Constant(v) for n, v in numbers.items() if n not in kept}
    back |= {n: ast.Name(names[n]) for n in kept}
    return {k: ast.unparse(_Back(back).visit(t)) for k, t in trees.items()}, constants


_HINT = (
    "check the units given; a number that has one is written even where it is 1: numpy.sin(1.0*x)"
)


def _demand_rate_unit(
    walk: DimensionWalk, demands: UnitEquations, state: str, tree: ast.expr, text: str, unit: str
) -> None:
    if syntax.is_zero(tree):
        return
    try:
        rate_dimension = walk.of(tree, text)
        fits = demands.demand_equal(rate_dimension, dimension(unit))
    except ConfigError as error:
        said = error.given.partition("': ")[2] or error.given
        raise ConfigError(f"the rate of {state}, {text}: {said}", error.expected, _HINT) from error
    if not fits:
        raise ConfigError(
            f"the rate of {state}, {text}, in {walk.words(rate_dimension)}",
            f"a value in {short_form(unit)}",
            _HINT,
        )


def _unit_text(value_dimension: Dimension) -> str:
    return "*".join(f"{BASE.get(k, k)}^({v})" for k, v in value_dimension.known.items())


class _Numbers(ast.NodeTransformer):
    """Replaces every number but exponents and zeros by a name."""

    def __init__(self, taken: Mapping[str, str]) -> None:
        self.prefix, self.taken = "", taken
        self.values: dict[str, float] = {}

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        """A power keeps its exponent, a ratio of whole numbers is one number."""
        if isinstance(node.op, ast.Pow):
            return ast.BinOp(self.visit(node.left), node.op, node.right)
        both = isinstance(node.left, ast.Constant) and isinstance(node.right, ast.Constant)
        if both and isinstance(node.op, ast.Div):
            return self._replace_number(node.left.value / node.right.value)  # type: ignore[attr-defined]
        return self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        """A number, zero apart, which has any unit."""
        return node if node.value == 0 else self._replace_number(node.value)

    def _replace_number(self, value: Any) -> ast.AST:
        name = f"{self.prefix}_{len(self.values)}"
        self.values[name] = value
        return ast.Name(name)


class _Back(ast.NodeTransformer):
    """Replaces names by what stands for them."""

    def __init__(self, by: Mapping[str, ast.expr]) -> None:
        self.by = by

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """The name itself where nothing stands for it."""
        return self.by.get(node.id, node)
