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
from typing import Any

import numpy as np
import sympy as sp

from spiral.physics.hidden import (
    BalanceRows,
    Poly,
    eliminate_hidden,
    multiply_matrix,
    plain_trig,
    rows_of,
)
from spiral.physics.trace import trace
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError
from spiral.types.system import MechanicalSystem


@dataclass(frozen=True)
class ProjectedCoefficient:
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
) -> tuple[ProjectedCoefficient, ...]:
    """Coefficients of a full system's motion in the effects of the study's system.

    Parameters
    ----------
    full, values : the whole machine with its seed, and its parameters by full name.
    order : time derivatives kept in the hidden states' dynamics, 0 to 3.
    study, effects : the observable system, and the effects in whose forces it is written; an
        amplitude that comes out as nothing is left out.

    Raises
    ------
    ConfigError : coordinates or inputs that do not match, no static hidden stiffness, a model of
        another form.
    """
    if not 0 <= order <= 3:
        raise ConfigError(f"library.order={order}", "0, 1, 2 or 3", "library.order=1")
    observed = [c.name for c in study.coordinates]
    names = [c.name for c in full.coordinates]
    driven = {i.name for i in study.inputs} <= {i.name for i in full.inputs}
    if not (set(observed) < set(names) and driven):
        raise ConfigError(
            f"a projection of {full.plugin_name()!r} onto {', '.join(observed)}",
            f"its inputs, and coordinates of it, some left to hide: {', '.join(names)}",
            "library.system=tilting_rotor with system=planar_rotor",
        )
    rows = rows_of(full, values, observed)
    keys, columns = _unit_accelerations(study, effects, rows)
    coefficients = _solve_coefficients(eliminate_hidden(rows, order), columns, rows)
    direct = _solve_coefficients(eliminate_hidden(rows, -1), columns, rows)
    return tuple(
        ProjectedCoefficient(
            key,
            _numeric_value(value, rows),
            _numeric_value(alone, rows),
            _coefficient_text(value, rows),
        )
        for key, value, alone in zip(keys, coefficients, direct, strict=True)
        if value != 0
    )


def _unit_accelerations(
    study: MechanicalSystem, effects: tuple[Effect, ...], rows: BalanceRows
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
        column = [sp.expand(plain_trig(sp.diff(e, symbol).xreplace(swap))) for e in own]
        known = {s for e in column for s in e.free_symbols}
        if {s.name for s in known} - set(rows.symbols):
            continue  # reads what the full system does not have
        keys.append(key)
        columns.append(tuple(rows.ring.from_expr(e) for e in column))
    return keys, columns


def _solve_coefficients(
    accelerations: tuple[Poly, ...], columns: list[tuple[Poly, ...]], rows: BalanceRows
) -> list[Poly]:
    """Coefficients c with sum_k c_k column_k = acceleration, monomial by monomial."""
    wanted = _monomials(accelerations, rows)
    tables = [_monomials(c, rows) for c in columns]
    coefficients: list[Poly] = [rows.ring.zero] * len(columns)
    for group in _column_groups(tables):
        places = sorted({m for k in group for m in tables[k]})
        matrix = sp.Matrix(
            [[tables[k].get(m, rows.ring.zero).as_expr() for k in group] for m in places]
        )
        map_ = (matrix.T * matrix).inv() * matrix.T
        target = [wanted.get(m, rows.ring.zero) for m in places]
        for k, value in zip(group, multiply_matrix(rows, map_, target), strict=True):
            coefficients[k] = value
    return coefficients


def _monomials(values: tuple[Poly, ...], rows: BalanceRows) -> dict[tuple[int, ...], Poly]:
    """(equation, exponents of the motion) -> coefficient, a polynomial in the parameters."""
    names = [str(g) for g in rows.ring.symbols]
    parameters = [i for i, n in enumerate(names) if n in rows.known]
    table: dict[tuple[int, ...], Poly] = {}
    for equation, value in enumerate(values):
        for monomial, number in value.terms():
            motion = tuple(0 if i in parameters else e for i, e in enumerate(monomial))
            inner = tuple(e if i in parameters else 0 for i, e in enumerate(monomial))
            key = (equation, *motion)
            table[key] = table.get(key, rows.ring.zero) + rows.ring.from_dict({inner: number})
    return table


def _column_groups(tables: list[dict[tuple[int, ...], Any]]) -> list[list[int]]:
    """Columns that share monomials, directly or through others."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    shared = [[int(bool(set(a) & set(b))) for b in tables] for a in tables]
    count, labels = connected_components(csr_array(np.array(shared)), directed=False)
    return [[k for k in range(len(tables)) if labels[k] == g] for g in range(count)]


def _numeric_value(value: Poly, rows: BalanceRows) -> float:
    return float(value.as_expr().subs({sp.Symbol(k): v for k, v in rows.known.items()}))


def _coefficient_text(value: Poly, rows: BalanceRows) -> str:
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
