"""Bare monomials of the paper's library (table CandidateLibrary): effects without a physical name.

They complete the named effects to the span of the paper's table, in which every basis function
has a coefficient of its own in every equation. Coefficients are signed as the term is written.
"""

from __future__ import annotations

from spiral.math import cos, sin
from spiral.types.effect import ForceEffect
from spiral.types.parameter import Parameter


class QuadraticCoupling(ForceEffect):
    """Quadratic in displacement: F_i = a_i x y + b_i q_j^2, j the other axis."""

    bare = True
    axes = 2
    parameters = (
        Parameter("product", "force/position^2", per_axis=True),
        Parameter("other", "force/position^2", per_axis=True),
    )

    def force(self, at, u, p):
        """(a_x x y + b_x y^2, a_y x y + b_y x^2)."""
        x, y = at.position
        return [
            p.product[0] * x * y + p.other[0] * y * y,
            p.product[1] * x * y + p.other[1] * x * x,
        ]


class PositionVelocity(ForceEffect):
    """Quadratic displacement-velocity: F_i = a_i x x' + b_i x y' + c_i y x' + d_i y y'."""

    bare = True
    axes = 2
    parameters = tuple(
        Parameter(name, "force/position/velocity", per_axis=True)
        for name in ("x_vx", "x_vy", "y_vx", "y_vy")
    )

    def force(self, at, u, p):
        """The four products, each with a coefficient per axis."""
        x, y = at.position
        vx, vy = at.velocity
        return [
            p.x_vx[i] * x * vx + p.x_vy[i] * x * vy + p.y_vx[i] * y * vx + p.y_vy[i] * y * vy
            for i in range(2)
        ]


class VelocityProducts(ForceEffect):
    """Quadratic velocity: F_i = a_i x'^2 + b_i x' y' + c_i y'^2."""

    bare = True
    axes = 2
    parameters = tuple(
        Parameter(name, "force/velocity^2", per_axis=True) for name in ("vx_vx", "vx_vy", "vy_vy")
    )

    def force(self, at, u, p):
        """The three products, each with a coefficient per axis."""
        vx, vy = at.velocity
        return [
            p.vx_vx[i] * vx * vx + p.vx_vy[i] * vx * vy + p.vy_vy[i] * vy * vy for i in range(2)
        ]


class SpeedCoupling(ForceEffect):
    """Speed coupling: F_i = W (a_i q_i + b_i q_j), j the other axis."""

    bare = True
    axes = 2
    inputs = ("speed",)
    parameters = (
        Parameter("own", "force/position*s", per_axis=True),
        Parameter("other", "force/position*s", per_axis=True),
    )

    def force(self, at, u, p):
        """W (a_x x + b_x y, a_y y + b_y x)."""
        x, y = at.position
        return [
            u.speed * (p.own[0] * x + p.other[0] * y),
            u.speed * (p.own[1] * y + p.other[1] * x),
        ]


class SpeedDamping(ForceEffect):
    """W q' that is not gyroscopic: F = W (a_x x' + s y', a_y y' + s x')."""

    bare = True
    axes = 2
    inputs = ("speed",)
    parameters = (
        Parameter("own", "force/velocity*s", per_axis=True),
        Parameter("symmetric", "force/velocity*s"),
    )

    def force(self, at, u, p):
        """W (a_x x' + s y', a_y y' + s x')."""
        vx, vy = at.velocity
        return [
            u.speed * (p.own[0] * vx + p.symmetric * vy),
            u.speed * (p.own[1] * vy + p.symmetric * vx),
        ]


class UnevenCubic(ForceEffect):
    """|q|^2 q that is not isotropic: F = |q|^2 (d x + c_x y, -d y + c_y x)."""

    bare = True
    axes = 2
    parameters = (
        Parameter("difference", "force/position^3"),
        Parameter("cross", "force/position^3", per_axis=True),
    )

    def force(self, at, u, p):
        """|q|^2 (d x + c_x y, -d y + c_y x)."""
        x, y = at.position
        r2 = x * x + y * y
        return [r2 * (p.difference * x + p.cross[0] * y), r2 * (p.cross[1] * x - p.difference * y)]


class UnevenDamping(ForceEffect):
    """|q|^2 v that is not isotropic: F = |q|^2 (d x' + c_x y', -d y' + c_y x')."""

    bare = True
    axes = 2
    parameters = (
        Parameter("difference", "force/velocity/position^2"),
        Parameter("cross", "force/velocity/position^2", per_axis=True),
    )

    def force(self, at, u, p):
        """|q|^2 (d x' + c_x y', -d y' + c_y x')."""
        x, y = at.position
        vx, vy = at.velocity
        r2 = x * x + y * y
        return [
            r2 * (p.difference * vx + p.cross[0] * vy),
            r2 * (p.cross[1] * vx - p.difference * vy),
        ]


class BackwardUnbalance(ForceEffect):
    """A synchronous force against the rotation: F = W^2 (a cos t + b sin t, b cos t - a sin t)."""

    bare = True
    axes = 2
    inputs = ("speed", "phase")
    parameters = (Parameter("cosine", "force*s^2"), Parameter("sine", "force*s^2"))

    def force(self, at, u, p):
        """W^2 (a cos t + b sin t, b cos t - a sin t), t the phase."""
        c, s = cos(u.phase), sin(u.phase)
        square = u.speed * u.speed
        return [square * (p.cosine * c + p.sine * s), square * (p.sine * c - p.cosine * s)]
