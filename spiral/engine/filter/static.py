"""The static map: hidden coordinates that follow the measured ones without inertia.

With rates, accelerations and inputs at zero, the hidden rows of the balance of forces read
K_hh q_h + K_ho q_o = 0, so

    q_h = -K_hh^-1 K_ho q_o,

K being the Jacobian of the balance (traced, not written again) at rest. It needs no filter and
knows no dynamics: the baseline that every observer is printed beside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import sympy as sp

from spiral.physics.trace import TracedModel
from spiral.types.record import Array

_RANK = 1e-10


@dataclass(frozen=True)
class StaticMap:
    """``matrix`` (hidden, observed) with q_h = matrix @ q_o."""

    hidden: tuple[str, ...]
    observed: tuple[str, ...]
    matrix: Array


def static_map(traced: TracedModel, values: Array) -> StaticMap | None:
    """The map at given parameter values.

    Returns nothing where there is none: a first-order system, no hidden coordinate, or a hidden
    stiffness that is singular.
    """
    names = tuple(n for n in traced.states if traced.rate_name(n) in traced.states)
    hidden = tuple(n for n in names if n not in traced.channels)
    observed = tuple(n for n in names if n in traced.channels)
    if not traced.forces or not hidden or not observed:
        return None
    stiffness = _stiffness(traced, names, values)
    rows = [names.index(n) for n in hidden]
    own = stiffness[np.ix_(rows, rows)]
    other = stiffness[np.ix_(rows, [names.index(n) for n in observed])]
    if not np.all(np.isfinite(stiffness)) or np.linalg.cond(own) > 1 / _RANK:
        return None
    return StaticMap(hidden, observed, -np.linalg.solve(own, other))


def _stiffness(traced: TracedModel, names: tuple[str, ...], values: Array) -> Array:
    """d balance / d q at rest, with all rates, accelerations and inputs at zero."""
    with np.errstate(all="ignore"):
        at_rest = _stiffness_function(traced, names)(*np.zeros(len(traced.x)), *values)
    return np.array(at_rest, dtype=float)


@lru_cache(maxsize=32)
def _stiffness_function(traced: TracedModel, names: tuple[str, ...]) -> Callable[..., Any]:
    coordinates = [traced.x[traced.states.index(n)] for n in names]
    moving = [x for x in traced.x if x not in coordinates]
    still = dict.fromkeys((*traced.u, *traced.acceleration, *moving), sp.Integer(0))
    rows: list[Any] = [row.xreplace(still) for row in traced.forces]
    jacobian = sp.Matrix([[row.diff(q) for q in coordinates] for row in rows])
    return sp.lambdify([*traced.x, *traced.p], jacobian, "numpy")
