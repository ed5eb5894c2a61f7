"""Hidden coordinates projected onto observed ones, by elimination to an order of their dynamics.

With coordinates split into observed o and hidden h, the hidden rows of M q'' = F are solved for h
as a series in time derivatives (each d/dt counts one order e; forces that are nonlinear in the
motion are taken quasi-statically, at order 0) and to third degree in amplitude,

    h = h_0(o) + e h_1(o, o') + e^2 h_2(o, o', o'') + ...,

by the fixed point h <- h - K_hh^-1 B_h(o, h, e h', e^2 h''), B_h being the traced balance of those
rows. Put into the observed rows this gives o'' = P(o, o', speed, phase), whose monomials are then
written in the forces of named effects. To leading order, with T = K_hh^-1 K_ho, the stiffness is
(K_oo - K_oh T)/m and the gyroscopic matrix W T^T G T/m. All arithmetic is exact (rational numbers).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from sympy.polys.rings import ring

from spiral.effect import Effect
from spiral.errors import ConfigError
from spiral.system import MechanicalSystem
from spiral.trace import Traced, trace

_ORDER, _SIZE = sp.symbols("order_ size_")
_DEGREE = 3

Poly: TypeAlias = Any
"""An element of SymPy's sparse polynomial ring over the rationals."""


@dataclass(frozen=True)
class Projected:
    """One coefficient of the observable equations.

    ``value`` in the study's units; ``direct`` what it would be if the hidden states stood still;
    ``formula`` in the system's parameters that the static map of hidden states does not contain.
    """

    key: str
    value: float
    direct: float
    formula: str


def project(
    full: MechanicalSystem,
    values: Mapping[str, float],
    order: int,
    study: MechanicalSystem,
    effects: tuple[Effect, ...],
) -> tuple[Projected, ...]:
    """Coefficients of a full system's motion in the effects of the study's system.

    Parameters
    ----------
    full, values : the whole machine with its seed, and its parameters by full name.
    order : time derivatives kept in the hidden states' dynamics, 0 to 2.
    study, effects : the observable system, and the effects in whose forces it is written; an
        amplitude that comes out as nothing is left out.

    Raises
    ------
    ConfigError : coordinates or inputs that do not match, no static hidden stiffness, a model of
        another form.
    """
    if not 0 <= order <= 2:
        raise ConfigError(f"library.order={order}", "0, 1 or 2", "library.order=1")
    observed = [c.name for c in study.coordinates]
    names = [c.name for c in full.coordinates]
    if not set(observed) < set(names):
        raise ConfigError(
            f"a projection of {full.plugin_name()!r} onto {', '.join(observed)}",
            f"coordinates of it, some left to hide: {', '.join(names)}",
            "library.system=tilting_rotor with system=planar_rotor",
        )
    rows = _rows(full, values, observed)
    keys, columns = _columns(study, effects, rows)
    found = _matched(_eliminated(rows, order), columns, rows)
    direct = _matched(_eliminated(rows, -1), columns, rows)
    return tuple(
        Projected(key, _number(value, rows), _number(alone, rows), _text(value, rows))
        for key, value, alone in zip(keys, found, direct, strict=True)
        if value != 0
    )


@dataclass(frozen=True)
class _Rows:
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


def _rows(full: MechanicalSystem, values: Mapping[str, float], observed: list[str]) -> _Rows:
    balance, symbolic = _balance(full, values)
    names = [c.name for c in full.coordinates]
    mass = sp.Matrix(balance).jacobian([sp.Symbol(f"{n}_a") for n in names])
    seen = [names.index(n) for n in observed]
    others = [i for i in range(len(names)) if i not in seen]
    if any(mass[i, j] != 0 for i in seen for j in others):
        raise ConfigError("inertia that couples observed and hidden", "a mass matrix in blocks")
    own = mass.extract(seen, seen)
    gens = {s.name for e in balance for s in e.free_symbols} | {f"{n}_rate" for n in names}
    gens |= {*names, "speed", "speed_rate", _ORDER.name, _SIZE.name, *(f"{n}_a" for n in names)}
    chosen = sorted(gens)
    ring_, *elements = ring(chosen, sp.QQ)
    single = own[0, 0].name if own[0, 0].is_Symbol and own == own[0, 0] * sp.eye(len(seen)) else ""
    return _Rows(
        ring_,
        dict(zip(chosen, elements, strict=True)),
        tuple(ring_.from_expr(sp.expand(balance[i])) for i in seen),
        tuple(ring_.from_expr(sp.expand(balance[i])) for i in others),
        tuple((n, n not in observed) for n in names),
        symbolic,
        own.subs({sp.Symbol(k): v for k, v in symbolic.items()}),
        single,
    )


def _balance(
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
    kept = _kept_symbolic(traced, full)
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
    return [_plain_trig(e.xreplace(swap)) for e in traced.balance], {k: exact[k] for k in kept}


def _kept_symbolic(traced: Traced, full: MechanicalSystem) -> list[str]:
    """The system's own parameters that do not move the static equilibrium."""
    still = dict.fromkeys((*traced.acceleration, *traced.u), sp.Integer(0))
    still.update(dict.fromkeys(traced.x[len(full.coordinates) :], sp.Integer(0)))
    static = {s for e in traced.balance for s in e.xreplace(still).free_symbols}
    return [
        k
        for k, s in zip(traced.keys, traced.p, strict=True)
        if k.startswith("system.") and k != "system.phase_origin" and s not in static
    ]


def _plain_trig(value: Any) -> Any:
    """cos and sin of an input as symbols."""
    swap = {f: sp.Symbol(f"{f.func.__name__}_{f.args[0]}") for f in value.atoms(sp.sin, sp.cos)}
    return value.xreplace(swap)


def _eliminated(rows: _Rows, order: int) -> tuple[Poly, ...]:
    """Observed accelerations; ``order`` -1 leaves the hidden states at rest."""
    series = _series(rows, order) if order >= 0 else [rows.ring.zero] * len(rows.hidden)
    keep = max(order, 1)
    swap = _hidden_motion(rows, series, keep)
    force = [-_cut(rows, _motion(rows, row, swap, False), keep) for row in rows.observed]
    found = _times(rows, rows.mass.inv(), force)
    leading = [_cut(rows, f, 0) for f in found]
    places = [(rows.at(n), f) for n, f in zip(rows.names(False, "_a"), leading, strict=True)]
    reduced = [_cut(rows, _unmarked(rows, f).compose(places), keep) for f in found]
    one = [(rows.at(_ORDER.name), rows.ring.one), (rows.at(_SIZE.name), rows.ring.one)]
    return tuple(f.compose(one) for f in reduced)


def _times(rows: _Rows, matrix: Any, values: list[Poly]) -> list[Poly]:
    """A matrix of numbers times a vector of polynomials."""
    found = []
    for i in range(matrix.rows):
        total: Poly = rows.ring.zero
        for j, value in enumerate(values):
            total += rows.ring.from_expr(matrix[i, j]) * value
        found.append(total)
    return found


def _unmarked(rows: _Rows, f: Poly) -> Poly:
    """Accelerations without their mark of size, which what replaces them brings itself."""
    names = [str(g) for g in rows.ring.symbols]
    size = names.index(_SIZE.name)
    at = [names.index(n) for n in rows.names(False, "_a")]
    terms = {}
    for monomial, number in f.terms():
        less = sum(monomial[i] for i in at)
        terms[(*monomial[:size], monomial[size] - less, *monomial[size + 1 :])] = number
    return rows.ring.from_dict(terms)


def _series(rows: _Rows, order: int) -> list[Poly]:
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
    found: list[Poly] = [rows.ring.zero] * len(names)
    for _ in range(order + 3):
        swap = _hidden_motion(rows, found, order)
        off = [_cut(rows, _motion(rows, row, swap, True), order) for row in rows.hidden]
        steps = _times(rows, inverse, off)
        found = [f - step for f, step in zip(found, steps, strict=True)]
    return found


def _hidden_motion(rows: _Rows, series: list[Poly], order: int) -> list[tuple[Poly, Poly]]:
    """Hidden coordinates, rates and accelerations as functions of the observed motion."""
    first = [_cut(rows, _derivative(rows, f), order) for f in series]
    second = [_cut(rows, _derivative(rows, f), order) for f in first]
    found = []
    for suffix, values in (("", series), ("_rate", first), ("_a", second)):
        found += [(rows.at(n), f) for n, f in zip(rows.names(True, suffix), values, strict=True)]
    return found


def _motion(
    rows: _Rows, row: Poly, hidden: list[tuple[Poly, Poly]], with_acceleration: bool
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
    slow = [(place, _cut(rows, value, 0)) for place, value in hidden]
    linear, rest = _split(rows, row)
    return linear.compose([*hidden, *swap]) + rest.compose([*slow, *swap])


def _split(rows: _Rows, row: Poly) -> tuple[Poly, Poly]:
    """Terms linear in the motion (or free of it), and the others."""
    names = [str(g) for g in rows.ring.symbols]
    moving = {f"{n}{suffix}" for n, _ in rows.pairs for suffix in ("", "_rate", "_a")}
    at = [i for i, n in enumerate(names) if n in moving]
    linear = {m: c for m, c in row.terms() if sum(m[i] for i in at) <= 1}
    rest = {m: c for m, c in row.terms() if m not in linear}
    return rows.ring.from_dict(linear), rows.ring.from_dict(rest)


def _derivative(rows: _Rows, f: Poly) -> Poly:
    """d/dt of a function of o, o', o'' and speed; one order more.

    ``f`` carries its marks already: o' as size order o'.
    """
    total = rows.ring.zero
    for n in rows.names(False):
        total += f.diff(rows.at(n)) * rows.at(f"{n}_rate")
        total += f.diff(rows.at(f"{n}_rate")) * rows.at(f"{n}_a")
    total += f.diff(rows.at("speed")) * rows.at("speed_rate")
    return total * rows.at(_ORDER.name)


def _cut(rows: _Rows, value: Poly, order: int, degree: int = _DEGREE) -> Poly:
    """Terms up to an order in time derivatives and a degree in amplitude."""
    names = [str(g) for g in rows.ring.symbols]
    i, j = names.index(_ORDER.name), names.index(_SIZE.name)
    return rows.ring.from_dict({m: c for m, c in value.terms() if m[i] <= order and m[j] <= degree})


# --- writing accelerations in effects ------------------------------------------------------------


def _columns(
    study: MechanicalSystem, effects: tuple[Effect, ...], rows: _Rows
) -> tuple[list[str], list[tuple[Poly, ...]]]:
    """Accelerations of the study's system for every amplitude set to one, in the same ring."""
    traced = trace(study, effects)
    swap: dict[Any, Any] = {
        s: sp.Symbol(n)
        for n, s in zip((*traced.states, *traced.inputs), (*traced.x, *traced.u), strict=True)
    }
    if "system.phase_origin" in traced.keys:
        swap[traced.p[traced.keys.index("system.phase_origin")]] = sp.Integer(0)
    keys, columns = [], []
    for key, parameter, symbol in zip(traced.keys, traced.parameters, traced.p, strict=True):
        if key.startswith("system.") or parameter.role != "amplitude":
            continue
        own = [traced.rate[traced.states.index(f"{c.name}_rate")] for c in study.coordinates]
        column = [sp.expand(_plain_trig(sp.diff(e, symbol).xreplace(swap))) for e in own]
        known = {s for e in column for s in e.free_symbols}
        if {s.name for s in known} - set(rows.symbols):
            continue  # reads what the full system does not have
        keys.append(key)
        columns.append(tuple(rows.ring.from_expr(e) for e in column))
    return keys, columns


def _matched(
    accelerations: tuple[Poly, ...], columns: list[tuple[Poly, ...]], rows: _Rows
) -> list[Poly]:
    """Coefficients c with sum_k c_k column_k = acceleration, monomial by monomial."""
    wanted = _monomials(accelerations, rows)
    tables = [_monomials(c, rows) for c in columns]
    found: list[Poly] = [rows.ring.zero] * len(columns)
    for group in _groups(tables):
        places = sorted({m for k in group for m in tables[k]})
        matrix = sp.Matrix(
            [[tables[k].get(m, rows.ring.zero).as_expr() for k in group] for m in places]
        )
        map_ = (matrix.T * matrix).inv() * matrix.T
        target = [wanted.get(m, rows.ring.zero) for m in places]
        for k, value in zip(group, _times(rows, map_, target), strict=True):
            found[k] = value
    return found


def _monomials(values: tuple[Poly, ...], rows: _Rows) -> dict[tuple[int, ...], Poly]:
    """(equation, exponents of the motion) -> coefficient, a polynomial in the parameters."""
    names = [str(g) for g in rows.ring.symbols]
    parameters = [i for i, n in enumerate(names) if n in rows.known]
    found: dict[tuple[int, ...], Poly] = {}
    for equation, value in enumerate(values):
        for monomial, number in value.terms():
            motion = tuple(0 if i in parameters else e for i, e in enumerate(monomial))
            inner = tuple(e if i in parameters else 0 for i, e in enumerate(monomial))
            key = (equation, *motion)
            found[key] = found.get(key, rows.ring.zero) + rows.ring.from_dict({inner: number})
    return found


def _groups(tables: list[dict[tuple[int, ...], Any]]) -> list[list[int]]:
    """Columns that share monomials, directly or through others."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    shared = [[int(bool(set(a) & set(b))) for b in tables] for a in tables]
    count, labels = connected_components(csr_array(np.array(shared)), directed=False)
    return [[k for k in range(len(tables)) if labels[k] == g] for g in range(count)]


def _number(value: Poly, rows: _Rows) -> float:
    return float(value.as_expr().subs({sp.Symbol(k): v for k, v in rows.known.items()}))


def _text(value: Poly, rows: _Rows) -> str:
    """The formula with four digits: a polynomial over the mass, parameters by short names."""
    expression = value.as_expr()
    if rows.mass_name:
        expression = expression * rows.mass[0, 0]
    swap = {sp.Symbol(k): sp.Symbol(k.removeprefix("system.")) for k in rows.known}
    text = str(sp.N(expression, 4).xreplace(swap))
    if not rows.mass_name:
        return text
    below = rows.mass_name.removeprefix("system.")
    return f"({text})/{below}" if " " in text else f"{text}/{below}"
