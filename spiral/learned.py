"""Learned effects: a force of unknown form, as a curve over one state.

    F = B(s / S) g,    B(z) = sum_k c_k b((z - z_k) / h),    z_k = k h, k = -9 .. 9, h = 1/8

with cubic B-splines b, which make every cubic spline with knots h apart on |z| <= 1; S is the
largest |s| that the records show, g a factor without unknowns (1, a velocity, its direction).
Such an effect is linear in its coefficients c_k, so it is scored, fitted and judged like any other;
outside |z| <= 1.375 it is zero. It is no candidate unless it is asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from spiral.effect import ForceEffect
from spiral.math import length
from spiral.parameter import Parameter

SPACING = 0.125
COUNT = 19
Follows = Literal["position", "velocity"]


class LearnedForce(ForceEffect):
    """A curve over a state, its coefficients named ``c0`` to ``c18`` and its extent ``span``.

    ``follows`` is the kind of state; ``times`` what the curve is multiplied by, in words (nothing
    where it is the force itself).
    """

    bare: ClassVar[bool] = True
    follows: ClassVar[Follows] = "position"
    times: ClassVar[str] = ""


def coefficients(unit: str, of: Follows) -> tuple[Parameter, ...]:
    """Parameters of a curve: its coefficients in ``unit``, per axis, and its extent."""
    span = Parameter("span", of, lower=0.0, role="shape", start=1.0, grid=(0.8,))
    return (*(Parameter(f"c{k}", unit, per_axis=True) for k in range(COUNT)), span)


def curve(z: Any, values: Sequence[Any]) -> Any:
    """B(z) for a dimensionless z and the coefficients of one axis."""
    return sum(c * b for c, b in zip(values, basis(z), strict=True))


def basis(z: Any) -> list[Any]:
    """The cubic B-splines at z: symbols, numbers and arrays alike.

    b(u) = (|u+2|^3 - 4 |u+1|^3 + 6 |u|^3 - 4 |u-1|^3 + |u-2|^3) / 12, which needs no cases.
    """
    middle = COUNT // 2
    u = z / SPACING
    cubes = [_cube(u - (k - middle)) for k in range(-2, COUNT + 2)]
    weights = (1, -4, 6, -4, 1)
    return [
        sum(w * cubes[k + i] for i, w in enumerate(weights)) / 12 for k in range(COUNT)
    ]  # cubes[j] belongs to the knot j - 2


def _cube(u: Any) -> Any:
    return u * u * length([u])
