"""Units of a formula's free parameters, from those of everything else in it.

Every term of a sum, and the result, must have one dimension; what a function is taken of has none.
Each such demand is a linear equation in the unknown exponents: with d(.) the vector of exponents,

    d(a b) = d(a) + d(b),   d(a^n) = n d(a),   d(a + b): d(a) = d(b).

They are solved exactly, in fractions.
"""

from __future__ import annotations

import ast
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache

from spiral.physics.formulas import syntax
from spiral.types.errors import ConfigError, InputError
from spiral.types.units import conversion, registry, short_form, spelled

Exponents = Mapping[str, Fraction]


@dataclass(frozen=True)
class Dimension:
    """A product of base dimensions and of unknown units: exponents of each."""

    known: Exponents = field(default_factory=dict)
    unknown: Exponents = field(default_factory=dict)

    def times(self, other: Dimension, power: Fraction = Fraction(1)) -> Dimension:
        """The product with another to a power."""
        return Dimension(
            _add_exponents(self.known, other.known, power),
            _add_exponents(self.unknown, other.unknown, power),
        )


def _add_exponents(first: Exponents, second: Exponents, power: Fraction) -> Exponents:
    keys = dict.fromkeys([*first, *second])
    total = {k: first.get(k, Fraction(0)) + power * second.get(k, Fraction(0)) for k in keys}
    return {k: v for k, v in total.items() if v}


NONE = Dimension()


@lru_cache(maxsize=256)
def dimension(unit: str) -> Dimension:
    """The dimension of a unit.

    Raises
    ------
    ConfigError : no unit that is known.
    """
    if not unit:
        return NONE
    try:
        dimensionality = registry().Quantity(1.0, spelled(unit)).dimensionality
    except Exception as error:  # pint's parser raises what Python's tokenizer does
        raise ConfigError(f"unit {unit!r}", "a unit such as 'N/m^3'") from error
    exponents = {k: Fraction(v).limit_denominator(24) for k, v in dimensionality.items()}
    return Dimension({k: v for k, v in exponents.items() if v})


class UnitEquations:
    """Linear equations in unknown exponents, each kept only while all can hold together."""

    def __init__(self, free: tuple[str, ...]) -> None:
        self.free = free
        self.rows: list[tuple[dict[str, Fraction], dict[str, Fraction]]] = []

    def demand_equal(self, first: Dimension, second: Dimension) -> bool:
        """Demand that both have one dimension; false where that contradicts earlier demands."""
        gap = first.times(second, Fraction(-1))
        left, right = dict(gap.unknown), {k: -v for k, v in gap.known.items()}
        for pivots, values in self.rows:
            pivot = next(iter(pivots))
            _eliminate(left, right, pivots, values, left.get(pivot, Fraction(0)))
        if not left:
            return not right
        pivot = next(iter(left))
        scale = 1 / left[pivot]
        row = ({k: v * scale for k, v in left.items()}, {k: v * scale for k, v in right.items()})
        for pivots, values in self.rows:
            _eliminate(pivots, values, *row, pivots.get(pivot, Fraction(0)))
        self.rows.append(row)
        return True

    def determined_dimensions(self) -> dict[str, Dimension]:
        """Unknown -> its dimension, for those that the demands fix."""
        return {
            next(iter(pivots)): Dimension(dict(values))
            for pivots, values in self.rows
            if len(pivots) == 1
        }


def _eliminate(
    left: dict[str, Fraction],
    right: dict[str, Fraction],
    pivots: Exponents,
    values: Exponents,
    times: Fraction,
) -> None:
    """Subtract a row so many times, in place."""
    if not times:
        return
    for into, what in ((left, pivots), (right, values)):
        total = dict(_add_exponents(into, what, -times))
        into.clear()
        into.update(total)


def infer_dimensions(
    formulas: Mapping[str, tuple[str, str]], known: Mapping[str, str], free: tuple[str, ...]
) -> dict[str, Dimension]:
    """The dimension of every free parameter.

    Parameters
    ----------
    formulas : what it is (``force on x``) -> (formula, unit its value must have).
    known : name -> unit. free : names whose unit is asked for.

    Raises
    ------
    ConfigError : units that do not fit, or a parameter whose unit nothing fixes.
    """
    walk = DimensionWalk(
        UnitEquations(free), {**{k: dimension(v) for k, v in known.items()}}, known
    )
    for what, (text, unit) in formulas.items():
        if syntax.is_zero(syntax.read(text)):
            continue
        value_dimension = walk.of(syntax.read(text), text)
        if not walk.demands.demand_equal(value_dimension, dimension(unit)):
            raise ConfigError(
                f"{what} {text!r}, in {walk.words(value_dimension)}",
                f"a value in {short_form(unit) or 'no unit'}",
                "a free coefficient takes the unit that is missing: k*(...)",
            )
    solved = walk.demands.determined_dimensions()
    open_ = [name for name in free if name not in solved]
    if open_:
        raise ConfigError(
            f"{' and '.join(open_)}, whose unit the expression leaves open",
            "units of all but one of them",
            f"units='{{{open_[0]}: UNIT}}', for instance N/m",
        )
    return solved


@dataclass(frozen=True)
class DimensionWalk:
    """Dimensions of a formula's nodes, and the demands that they make of each other.

    ``known`` are dimensions by name, ``units`` the same as they are written.
    """

    demands: UnitEquations
    known: Mapping[str, Dimension]
    units: Mapping[str, str]

    def of(self, node: ast.expr, text: str) -> Dimension:
        """The dimension of a node."""
        if isinstance(node, ast.Constant):
            return NONE
        if isinstance(node, ast.Name):
            if node.id in syntax.CONSTANTS:
                return NONE
            return self.known.get(node.id, Dimension({}, {node.id: Fraction(1)}))
        if isinstance(node, ast.UnaryOp):
            return self.of(node.operand, text)
        if isinstance(node, ast.Call):
            return self._call_dimension(node, text)
        assert isinstance(node, ast.BinOp)
        if isinstance(node.op, ast.Add | ast.Sub):
            return self._common_dimension(node.left, node.right, text)
        first = self.of(node.left, text)
        if isinstance(node.op, ast.Pow):
            power = Fraction(syntax.exponent(node.right)).limit_denominator(24)
            return NONE.times(first, power)
        return first.times(self.of(node.right, text), Fraction(_exponent_sign(node.op)))

    def _common_dimension(self, left: ast.expr, right: ast.expr, text: str) -> Dimension:
        first, second = self.of(left, text), self.of(right, text)
        if syntax.is_zero(left):
            return second
        if not syntax.is_zero(right) and not self.demands.demand_equal(first, second):
            raise ConfigError(
                f"expression {text!r}: {ast.unparse(left)} in {self.words(first)} beside "
                f"{ast.unparse(right)} in {self.words(second)}",
                "terms of one unit",
                "give each term a coefficient of its own: a*x + b*x_rate",
            )
        return first

    def _call_dimension(self, node: ast.Call, text: str) -> Dimension:
        assert isinstance(node.func, ast.Name)
        name, given = node.func.id, node.args
        if name == "where":
            assert isinstance(given[0], ast.Compare)
            self._common_dimension(given[0].left, given[0].comparators[0], text)
            return self._common_dimension(given[1], given[2], text)
        if len(given) == 2:
            return self._common_dimension(given[0], given[1], text)
        inner = self.of(given[0], text)
        if name == "sqrt":
            return NONE.times(inner, Fraction(1, 2))
        if name in syntax.ELEMENTARY and not self.demands.demand_equal(inner, NONE):
            raise ConfigError(
                f"expression {text!r}: {name} of {ast.unparse(given[0])}, in {self.words(inner)}",
                f"{name} of a value without a unit",
                f"{name}({ast.unparse(given[0])}/w) with a width w",
            )
        return NONE if name in syntax.ELEMENTARY else inner

    def words(self, value_dimension: Dimension) -> str:
        """A dimension in words: a unit, and the unknown parameters in it."""
        unit = "*".join(f"{BASE.get(k, k)}^({v})" for k, v in value_dimension.known.items())
        parts = [short_form(unit)] if unit else []
        parts += [
            f"[{k}]" + ("" if v == 1 else f"^{v}") for k, v in value_dimension.unknown.items()
        ]
        return " ".join(parts) or "no unit"


def _exponent_sign(operation: ast.operator) -> int:
    return -1 if isinstance(operation, ast.Div) else 1


BASE = {
    "[length]": "m", "[mass]": "kg", "[time]": "s", "[current]": "A", "[temperature]": "K",
    "[substance]": "mol", "[luminosity]": "cd",
}  # fmt: skip


# --- a dimension in the words of a place ---------------------------------------------------------


def unit_for(wanted: Dimension, words: Mapping[str, str]) -> str | None:
    """A unit of that dimension as a product of a few given ones, by their words.

    Parameters
    ----------
    wanted : without unknowns.
    words : word -> unit, in order of preference (``force`` -> N, ``position`` -> m, ``s`` -> s).

    Returns
    -------
    For instance ``force/position^3``; the first factor is taken once or not at all. ``None`` where
    no product fits.
    """
    if not wanted.known:
        return ""
    first = next(iter(words))
    for count in range(1, 4):
        for chosen in itertools.combinations(words, count):
            for powers in _exponent_solutions(wanted, [dimension(words[w]) for w in chosen]):
                if first not in chosen or powers[0] == 1:
                    return _product_text(chosen, powers)
    return None


def _exponent_solutions(
    wanted: Dimension, given: list[Dimension]
) -> Iterator[tuple[Fraction, ...]]:
    """Exponents, none zero, whose product has the dimension wanted."""
    unknown = tuple(str(i) for i in range(len(given)))
    bases = dict.fromkeys([*wanted.known, *(k for g in given for k in g.known)])
    demands = UnitEquations(unknown)
    for base in bases:
        left = {u: g.known[base] for u, g in zip(unknown, given, strict=True) if base in g.known}
        right = wanted.known.get(base, Fraction(0))
        target = Dimension({"1": right} if right else {})
        if not demands.demand_equal(Dimension({}, left), target):
            return
    solved = demands.determined_dimensions()
    powers = tuple(solved[u].known.get("1", Fraction(0)) if u in solved else None for u in unknown)
    if all(p is not None and p != 0 for p in powers):
        yield tuple(p for p in powers if p is not None)


def _product_text(chosen: tuple[str, ...], powers: tuple[Fraction, ...]) -> str:
    """``force/position^3`` from words and their powers; position/s is a velocity."""
    powers_by_word = dict(zip(chosen, powers, strict=True))
    if powers_by_word == {"position": 1, "s": -1}:
        return "velocity"
    above = [_power_text(w, p) for w, p in powers_by_word.items() if p > 0]
    below = [_power_text(w, -p) for w, p in powers_by_word.items() if p < 0]
    return "/".join(["*".join(above) or "1", *below])


def _power_text(word: str, power: Fraction) -> str:
    return word if power == 1 else f"{word}^{float(power):g}"


def check_unit_agrees(name: str, given: str, coherent: str) -> None:
    """Refuse a unit that is not the one the numbers are in.

    Raises
    ------
    ConfigError : another dimension, or another size of unit.
    """
    try:
        way = conversion(given, coherent, f"parameter {name!r}")
    except InputError as error:
        raise ConfigError(
            error.given, error.expected, f"units='{{{name}: {short_form(coherent)}}}'"
        ) from error
    if abs(way[0] - 1.0) > 1e-9 or way[1]:
        raise ConfigError(
            f"unit {given!r} of parameter {name!r}",
            f"the unit its numbers are in here: {short_form(coherent)}",
            f"units='{{{name}: {short_form(coherent)}}}'",
        )
