"""Elimination of hidden coordinates from a traced balance, in exact polynomials.

See ``spiral.physics.projection`` for the equations. Polynomials carry two marks: the order in time
derivatives and the size of the motion, by which they are cut.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import sympy as sp
from sympy.polys.rings import ring

from spiral.physics.trace import TracedModel, trace
from spiral.types.errors import ConfigError
from spiral.types.system import MechanicalSystem

_ORDER, _SIZE = sp.symbols("order_ size_")
_DEGREE = 3

Poly: TypeAlias = Any
"""An element of SymPy's sparse polynomial ring over the rationals."""


@dataclass(frozen=True)
class BalanceRows:
    """The balance of a full system as polynomials in one ring.

    ``symbols`` are the ring's generators by name; ``known`` the values of the parameters that are
    generators; ``mass`` that of the observed rows, and ``mass_name`` where it is one parameter.
    """

    ring: Any
    symbols: Mapping[str, Any]
    observed: tuple[Poly, ...]
    hidden: tuple[Poly, ...]
    pairs: tuple[tuple[str, bool], ...]
    known: Mapping[str, Any]
    mass: sp.Matrix
    mass_name: str

    def at(self, name: str) -> Poly:
        """A generator by name."""
        return self.symbols[name]

    def names(self, hidden: bool, suffix: str = "") -> list[str]:
        """Generators of the observed or hidden coordinates."""
        return [f"{n}{suffix}" for n, h in self.pairs if h is hidden]


def rows_of(
    full: MechanicalSystem, values: Mapping[str, float], observed: list[str]
) -> BalanceRows:
    """The balance of a full system with its seed, at these values, split by what is observed."""
    balance, symbolic = _named_balance(full, values)
    names = [c.name for c in full.coordinates]
    mass = sp.Matrix(balance).jacobian([sp.Symbol(f"{n}_a") for n in names])
    seen = [names.index(n) for n in observed]
    others = [i for i in range(len(names)) if i not in seen]
    if any(mass[i, j] != 0 for i in seen for j in others):
        raise ConfigError("inertia that couples observed and hidden", "a mass matrix in blocks")
    own = mass.extract(seen, seen)
    gens = {s.name for e in balance for s in e.free_symbols} | {f"{n}_rate" for n in names}
    gens |= {*names, "speed", "speed_rate", _ORDER.name, _SIZE.name, *(f"{n}_a" for n in names)}
    gens |= {f"{n}_j" for n in names}
    chosen = sorted(gens)
    ring_, *elements = ring(chosen, sp.QQ)
    single = own[0, 0].name if own[0, 0].is_Symbol and own == own[0, 0] * sp.eye(len(seen)) else ""
    return BalanceRows(
        ring_,
        dict(zip(chosen, elements, strict=True)),
        tuple(ring_.from_expr(sp.expand(balance[i])) for i in seen),
        tuple(ring_.from_expr(sp.expand(balance[i])) for i in others),
        tuple((n, n not in observed) for n in names),
        symbolic,
        own.subs({sp.Symbol(k): v for k, v in symbolic.items()}),
        single,
    )


def _named_balance(
    full: MechanicalSystem, values: Mapping[str, float]
) -> tuple[list[Any], dict[str, Any]]:
    """The traced balance in named symbols, numbers exact; and parameters that stay symbols."""
    traced = trace(full, full.seed)
    known = {k: p.start for k, p in zip(traced.keys, traced.parameters, strict=True)}
    known.update(values)
    known["system.phase_origin"] = 0.0
    lacking = [k for k, v in known.items() if v is None]
    if lacking:
        raise ConfigError(f"no value for {', '.join(lacking)}", "a value for each parameter")
    exact = {k: sp.Rational(str(float(v))) for k, v in known.items() if v is not None}
    kept = _dynamic_parameters(traced, full)
    names = [f"{c.name}_a" for c in full.coordinates]
    swap: dict[Any, Any] = {
        s: sp.Symbol(k) if k in kept else exact[k]
        for k, s in zip(traced.keys, traced.p, strict=True)
    }
    for name, symbol in zip(
        (*traced.states, *traced.inputs, *names),
        (*traced.x, *traced.u, *traced.acceleration),
        strict=True,
    ):
        swap[symbol] = sp.Symbol(name)
    return [plain_trig(e.xreplace(swap)) for e in traced.balance], {k: exact[k] for k in kept}


def _dynamic_parameters(traced: TracedModel, full: MechanicalSystem) -> list[str]:
    """The system's own parameters that do not move the static equilibrium."""
    still = dict.fromkeys((*traced.acceleration, *traced.u), sp.Integer(0))
    still.update(dict.fromkeys(traced.x[len(full.coordinates) :], sp.Integer(0)))
    static = {s for e in traced.balance for s in e.xreplace(still).free_symbols}
    return [
        k
        for k, s in zip(traced.keys, traced.p, strict=True)
        if k.startswith("system.") and k != "system.phase_origin" and s not in static
    ]


def plain_trig(value: Any) -> Any:
    """cos and sin of an input as symbols."""
    swap = {f: sp.Symbol(f"{f.func.__name__}_{f.args[0]}") for f in value.atoms(sp.sin, sp.cos)}
    return value.xreplace(swap)


def eliminate_hidden(rows: BalanceRows, order: int) -> tuple[Poly, ...]:
    """Observed accelerations; ``order`` -1 leaves the hidden states at rest."""
    series = _hidden_series(rows, order) if order >= 0 else [rows.ring.zero] * len(rows.hidden)
    keep = max(order, 1)
    swap = _hidden_motion(rows, series, keep)
    force = [
        -_truncate_order(rows, _substitute_motion(rows, row, swap, False), keep)
        for row in rows.observed
    ]
    accelerations = multiply_matrix(rows, rows.mass.inv(), force)
    static = [_truncate_order(rows, f, 0) for f in accelerations]
    places = [
        (rows.at(f"{n}_j"), _acceleration_rate(rows, f)) for n, f in _pair_with_names(rows, static)
    ]
    places += [
        (rows.at(f"{n}_a"), _truncate_order(rows, f, min(order, 1)))
        for n, f in _pair_with_names(rows, accelerations)
    ]
    reduced = [
        _truncate_order(rows, _remove_size_marks(rows, f).compose(places), keep)
        for f in accelerations
    ]
    one = [(rows.at(_ORDER.name), rows.ring.one), (rows.at(_SIZE.name), rows.ring.one)]
    return tuple(f.compose(one) for f in reduced)


def _pair_with_names(rows: BalanceRows, values: list[Poly]) -> list[tuple[str, Poly]]:
    return list(zip(rows.names(False), values, strict=True))


def _acceleration_rate(rows: BalanceRows, f: Poly) -> Poly:
    """d/dt of an acceleration that depends on o, speed and phase, without a mark of order."""
    total = rows.ring.zero
    for n in rows.names(False):
        total += f.diff(rows.at(n)) * rows.at(f"{n}_rate")
    total += f.diff(rows.at("speed")) * rows.at("speed_rate")
    if "cos_phase" in rows.symbols and "sin_phase" in rows.symbols:
        cosine, sine = rows.at("cos_phase"), rows.at("sin_phase")
        total += (f.diff(sine) * cosine - f.diff(cosine) * sine) * rows.at("speed")
    return total


def multiply_matrix(rows: BalanceRows, matrix: Any, values: list[Poly]) -> list[Poly]:
    """A matrix of numbers times a vector of polynomials."""
    products = []
    for i in range(matrix.rows):
        total: Poly = rows.ring.zero
        for j, value in enumerate(values):
            total += rows.ring.from_expr(matrix[i, j]) * value
        products.append(total)
    return products


def _remove_size_marks(rows: BalanceRows, f: Poly) -> Poly:
    """Higher derivatives without their mark of size: what replaces them brings its own."""
    names = [str(g) for g in rows.ring.symbols]
    size = names.index(_SIZE.name)
    at = [names.index(n) for suffix in ("_a", "_j") for n in rows.names(False, suffix)]
    terms = {}
    for monomial, number in f.terms():
        less = sum(monomial[i] for i in at)
        terms[(*monomial[:size], monomial[size] - less, *monomial[size + 1 :])] = number
    return rows.ring.from_dict(terms)


def _hidden_series(rows: BalanceRows, order: int) -> list[Poly]:
    """Hidden coordinates in terms of the observed motion."""
    names = rows.names(True)
    zero = {n: 0 for n in rows.symbols if n not in names}
    stiffness = sp.Matrix(
        [
            [
                row.diff(rows.at(n)).as_expr().subs({**zero, **dict.fromkeys(names, 0)})
                for n in names
            ]
            for row in rows.hidden
        ]
    )
    if stiffness.det() == 0:
        raise ConfigError(
            "hidden coordinates without a stiffness of their own",
            "a static equilibrium for given observed ones",
        )
    inverse = stiffness.inv()
    series: list[Poly] = [rows.ring.zero] * len(names)
    for _ in range(order + 3):
        swap = _hidden_motion(rows, series, order)
        off = [
            _truncate_order(rows, _substitute_motion(rows, row, swap, True), order)
            for row in rows.hidden
        ]
        steps = multiply_matrix(rows, inverse, off)
        series = [f - step for f, step in zip(series, steps, strict=True)]
    return series


def _hidden_motion(rows: BalanceRows, series: list[Poly], order: int) -> list[tuple[Poly, Poly]]:
    """Hidden coordinates, rates and accelerations as functions of the observed motion."""
    first = [_truncate_order(rows, _motion_derivative(rows, f), order) for f in series]
    second = [_truncate_order(rows, _motion_derivative(rows, f), order) for f in first]
    substitutions = []
    for suffix, values in (("", series), ("_rate", first), ("_a", second)):
        substitutions += [
            (rows.at(n), f) for n, f in zip(rows.names(True, suffix), values, strict=True)
        ]
    return substitutions


def _substitute_motion(
    rows: BalanceRows, row: Poly, hidden: list[tuple[Poly, Poly]], with_acceleration: bool
) -> Poly:
    """A row with the hidden motion put in and the observed one marked by size and order.

    An observed acceleration of its own row stands on the left-hand side, so it is left out.
    """
    size, step = rows.at(_SIZE.name), rows.at(_ORDER.name)
    swap = [(rows.at(n), size * rows.at(n)) for n in rows.names(False)]
    swap += [(rows.at(n), size * step * rows.at(n)) for n in rows.names(False, "_rate")]
    for n in rows.names(False, "_a"):
        put = size * step**2 * rows.at(n) if with_acceleration else rows.ring.zero
        swap.append((rows.at(n), put))
    slow = [(place, _truncate_order(rows, value, 0)) for place, value in hidden]
    linear, rest = _split_linear(rows, row)
    return linear.compose([*hidden, *swap]) + rest.compose([*slow, *swap])


def _split_linear(rows: BalanceRows, row: Poly) -> tuple[Poly, Poly]:
    """Terms linear in the motion (or free of it), and the others."""
    names = [str(g) for g in rows.ring.symbols]
    moving = {f"{n}{suffix}" for n, _ in rows.pairs for suffix in ("", "_rate", "_a")}
    at = [i for i, n in enumerate(names) if n in moving]
    linear = {m: c for m, c in row.terms() if sum(m[i] for i in at) <= 1}
    rest = {m: c for m, c in row.terms() if m not in linear}
    return rows.ring.from_dict(linear), rows.ring.from_dict(rest)


def _motion_derivative(rows: BalanceRows, f: Poly) -> Poly:
    """d/dt of a function of the observed motion and speed; one order more.

    ``f`` carries its marks already: o' as size order o'.
    """
    total = rows.ring.zero
    for n in rows.names(False):
        total += f.diff(rows.at(n)) * rows.at(f"{n}_rate")
        total += f.diff(rows.at(f"{n}_rate")) * rows.at(f"{n}_a")
        total += f.diff(rows.at(f"{n}_a")) * rows.at(f"{n}_j")
    total += f.diff(rows.at("speed")) * rows.at("speed_rate")
    return total * rows.at(_ORDER.name)


def _truncate_order(rows: BalanceRows, value: Poly, order: int, degree: int = _DEGREE) -> Poly:
    """Terms up to an order in time derivatives and a degree in amplitude."""
    names = [str(g) for g in rows.ring.symbols]
    i, j = names.index(_ORDER.name), names.index(_SIZE.name)
    return rows.ring.from_dict({m: c for m, c in value.terms() if m[i] <= order and m[j] <= degree})
