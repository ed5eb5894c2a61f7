"""Learned effects: a force, a flow or a change of a parameter of unknown form, as a curve.

    F = B(z) g,    B(z) = sum_k c_k b_k(z),    k = 0 .. 20

with natural cubic splines b_k: every cubic spline on the knots z_j = 9/8 sinh(3j/20) / sinh(3/2),
j = -10 .. 10 (closer in the middle, where a motion is most of its time), that is straight outside
them, so that a motion larger than any seen goes on along the last slope. Over a state of both signs
(or a radius) z = s / S, with S 0.8 of the largest |s| that the records show; over a level
z = 2 s / S - 1. The factor g holds no unknowns (1, a velocity, its direction, a displacement). Such
an effect is linear in its coefficients c_k, so it is scored, fitted and judged like any other. It
is no candidate unless it is asked for.

The value of a parameter that varies is p (1 + B(z) - B(0)), p its own where the variable is zero:
without the last function, which is a constant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from spiral.math import length
from spiral.types.effect import FlowEffect, ForceEffect, ParameterEffect, StateFlow
from spiral.types.parameter import Parameter

COUNT = 21
_LAST = COUNT // 2
_UNEVEN = 1.5
_REACH = 1.125
KNOTS = tuple(
    _REACH * math.sinh(_UNEVEN * j / _LAST) / math.sinh(_UNEVEN) for j in range(-_LAST, _LAST + 1)
)
_COARSE = ((0, 5, 10), (0, 2, 5, 7, 10), tuple(range(_LAST + 1)))
"""Knots of the middle and of one side, for the coarsest to the finest curve."""


def _hats() -> tuple[tuple[tuple[int, int, int], ...], ...]:
    """(first, middle, last) knot of each hat, the finest level first, from the outside inwards."""
    levels, known = [], set()
    for knots in _COARSE:
        inner = [(knots[i - 1] if i else -knots[1], knots[i], knots[i + 1])
                 for i in range(len(knots) - 1) if knots[i] not in known]  # fmt: skip
        levels.append(tuple(reversed(inner)))
        known |= set(knots)
    return tuple(reversed(levels))


_HATS = _hats()


def _levels() -> dict[str, int]:
    fine, middle, _ = (sum(1 + bool(hat[1]) for hat in level) for level in _HATS)
    return {f"c{k}": (k < fine) + (k < fine + middle) for k in range(COUNT)}


LEVELS = _levels()
"""By name of a coefficient: 0 of a curve on the fewest knots (5 functions), 1 (9), 2 (all 21)."""
Follows = Literal["position", "velocity", "radius"]


class LearnedForce(ForceEffect):
    """A curve over a state, its coefficients named ``c0`` to ``c20`` and its extent ``span``.

    ``follows`` is the kind of state; ``times`` what the curve is multiplied by, in words (nothing
    where it is the force itself).
    """

    bare: ClassVar[bool] = True
    follows: ClassVar[Follows] = "position"
    times: ClassVar[str] = ""


class LearnedFlow(FlowEffect):
    """A flow that follows the level of one state by a curve: ``c0`` to ``c20`` and ``span``.

    ``state`` is the level that it follows, ``into`` the channel whose flow the curve gives.
    """

    bare: ClassVar[bool] = True
    state: ClassVar[str] = ""
    into: ClassVar[str] = ""
    times: ClassVar[str] = ""


class LearnedStateFlow(StateFlow):
    """A flow into a state of first order, or between two, by a curve: ``c0`` to ``c20``, ``span``.

    It follows that state, or the difference of the two.
    """

    bare: ClassVar[bool] = True
    follows: ClassVar[Follows] = "position"
    times: ClassVar[str] = ""


class LearnedParameterChange(ParameterEffect):
    """A parameter that follows a variable by a curve: ``c0`` to ``c19`` and ``span``."""

    bare: ClassVar[bool] = True
    times: ClassVar[str] = ""


Learned = LearnedForce | LearnedFlow | LearnedStateFlow | LearnedParameterChange


def coefficients(
    unit: str, of: str, per_axis: bool = True, extent: float = 0.8, count: int = COUNT
) -> tuple[Parameter, ...]:
    """Parameters of a curve: its coefficients in ``unit``, and its extent, a share of the largest.

    ``of`` : the unit of the state, ``position`` or ``velocity``.
    """
    span = Parameter("span", of, lower=0.0, role="shape", start=1.0, grid=(extent,))
    parts = (Parameter(f"c{k}", unit, per_axis=per_axis, loose=True) for k in range(count))
    return (*parts, span)


def curve(z: Any, values: Sequence[Any]) -> Any:
    """B(z) for a dimensionless z and the coefficients of one axis."""
    return sum(c * b for c, b in zip(values, basis(z), strict=True))


def spacing(z: float) -> float:
    """Distance of knots around z."""
    steep = z * math.sinh(_UNEVEN) / _REACH
    return _REACH * _UNEVEN / _LAST / math.sinh(_UNEVEN) * math.hypot(1.0, steep)


def basis(z: Any) -> list[Any]:
    """The natural cubic splines at z: symbols, numbers and arrays alike.

    By their curvature: a function for each knot but the outermost two, whose second derivative is
    a hat over its knot and which is zero towards the middle; then z and 1. Hats are hierarchical:
    those of fine knots come first, then wider ones over every second or third knot, then the widest
    (``LEVELS``), so that with the others at zero the last few are splines on fewer knots. Where no
    motion reaches a hat, its coefficient says nothing (its column is exactly zero), and at zero the
    curve goes on straight. Each is in units of the middle spacing.
    """
    unit = spacing(0.0)
    knots = {j: KNOTS[_LAST + j] / unit for j in range(-_LAST, _LAST + 1)}
    cubes = {side: {j: _cube(side * z / unit - k) for j, k in knots.items()} for side in (1, -1)}
    functions = [
        _hat([knots[j] for j in hat], [cubes[side][j] for j in hat])
        for level in _HATS
        for hat in level
        for side in ((1, -1) if hat[1] else (1,))
    ]
    return [*functions, z / unit, z * 0 + 1]


def _hat(knots: list[float], cubes: list[Any]) -> Any:
    """The function whose second derivative is 1 at the middle knot and 0 at the others."""
    before, after = knots[1] - knots[0], knots[2] - knots[1]
    weights = (1 / before, -1 / before - 1 / after, 1 / after)
    return sum(w * c for w, c in zip(weights, cubes, strict=True)) / 6


def _cube(u: Any) -> Any:
    """(u)_+^3 without cases."""
    positive = (u + length([u])) / 2
    return positive * positive * positive
