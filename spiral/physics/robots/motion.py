"""Equations of motion of a tree of rigid bodies, from velocities and accelerations of its parts.

    M(q) q'' + b(q, q') = Q,
    M = sum_i m_i Jv^T Jv + Jw^T I Jw,    b = sum_i m_i Jv^T (a_i - g) + Jw^T (I alpha_i + w x I w),

over the bodies i: Jv, Jw the slopes of a centre's velocity and of the angular velocity w by q', and
a_i, alpha_i the accelerations where q'' = 0 (R. Featherstone, Rigid Body Dynamics Algorithms, 2008,
ch. 2; T. R. Kane, D. A. Levinson, Dynamics, 1985). Written with arithmetic, sine and cosine alone,
so that numbers, quantities with units and expressions go through.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from spiral.math import cos, sin
from spiral.physics.robots.tree import Body, Joint, Robot

Values = Sequence[Any]
_ROUNDING = 1e-14  # what a direction is off by where it should be along an axis


@dataclass(frozen=True)
class BaseUnits:
    """A metre, a second and a kg m^2: 1, or quantities where states have units."""

    metre: Any = 1
    second: Any = 1
    inertia: Any = 1

    def zero(self, metres: int, seconds: int) -> list[Any]:
        """A vector of zeros of this unit."""
        return [0 * self.metre**metres * self.second**seconds] * 3


@dataclass(frozen=True)
class _Frame:
    """A moving frame: origin, rows of its rotation, w, alpha and the origin's acceleration.

    ``axes`` : of the joints below it, by number: axis in space, a place on it (of a hinge).
    """

    origin: Values
    turned: Sequence[Values]
    spin: Values
    spin_rate: Values
    push: Values
    axes: Mapping[int, tuple[Values, Values | None]]


def equations_of_motion(
    robot: Robot, q: Values, v: Values, masses: Values, factors: Values, sizes: BaseUnits
) -> tuple[list[list[Any]], list[Any]]:
    """M (n, n) and b (n,) without armature.

    Parameters
    ----------
    q, v : positions and velocities of the joints. masses, factors : of the bodies; a factor scales
        the tensor of inertia.
    """
    count = len(robot.joints)
    mass: list[list[Any]] = [[0] * count for _ in range(count)]
    bias: list[Any] = [0] * count
    pull = [_round_to_whole(g) * (sizes.metre * sizes.second**-2) for g in robot.gravity]
    frames = _body_frames(robot, q, v, sizes)
    for number, (body, frame) in enumerate(zip(robot.bodies, frames, strict=True)):
        centre = _add(frame.origin, _multiply_vector(frame.turned, _in_metres(body.centre, sizes)))
        arm = _subtract(centre, frame.origin)
        rate = _subtract(_add(frame.push, _rotational_acceleration(frame, arm)), pull)
        tensor = _inertia_tensor(body, frame, factors[number] * sizes.inertia)
        torque = _add(
            _multiply_vector(tensor, frame.spin_rate),
            _cross(frame.spin, _multiply_vector(tensor, frame.spin)),
        )
        force = [masses[number] * r for r in rate]
        moved = {k: _unit_rate_velocities(*axis, centre) for k, axis in frame.axes.items()}
        for k, (by_v, by_w) in moved.items():
            bias[k] = bias[k] + _dot(by_v, force) + _dot(by_w, torque)
            for j, (other_v, other_w) in moved.items():
                if j < k:
                    continue
                own = masses[number] * _dot(by_v, other_v) + _dot(
                    by_w, _multiply_vector(tensor, other_w)
                )
                mass[k][j] = mass[k][j] + own
    for k in range(count):
        for j in range(k):
            mass[k][j] = mass[j][k]
    return mass, bias


def _body_frames(robot: Robot, q: Values, v: Values, sizes: BaseUnits) -> list[_Frame]:
    """The frame of each body."""
    unit = [[int(i == j) for j in range(3)] for i in range(3)]
    still = (sizes.zero(0, -1), sizes.zero(0, -2), sizes.zero(1, -2))
    ground = _Frame(sizes.zero(1, 0), unit, *still, {})
    frames: list[_Frame] = []
    for number, body in enumerate(robot.bodies):
        frame = _fixed_body_frame(frames[body.parent] if body.parent >= 0 else ground, body, sizes)
        for k, joint in enumerate(robot.joints):
            if joint.body == number:
                frame = _frame_after_joint(frame, k, joint, q[k], v[k], sizes)
        frames.append(frame)
    return frames


def _fixed_body_frame(parent: _Frame, body: Body, sizes: BaseUnits) -> _Frame:
    """The frame of a body that does not move in its parent's."""
    arm = _multiply_vector(parent.turned, _in_metres(body.at, sizes))
    turned = [[_round_to_whole(x) for x in body.turned[3 * i : 3 * i + 3]] for i in range(3)]
    return replace(
        parent,
        origin=_add(parent.origin, arm),
        turned=_multiply_matrices(parent.turned, turned),
        push=_add(parent.push, _rotational_acceleration(parent, arm)),
    )


def _frame_after_joint(
    frame: _Frame, number: int, joint: Joint, q: Any, v: Any, sizes: BaseUnits
) -> _Frame:
    """The frame after a joint."""
    own = [_round_to_whole(x) for x in joint.axis]
    axis = _multiply_vector(frame.turned, own)
    if joint.kind == "slide":
        gone = q - joint.zero * sizes.metre if joint.zero else q
        arm = [a * gone for a in axis]
        coriolis = [2 * x for x in _cross(frame.spin, [a * v for a in axis])]
        push = _add(_add(frame.push, _rotational_acceleration(frame, arm)), coriolis)
        axes = {**frame.axes, number: (axis, None)}
        return replace(frame, origin=_add(frame.origin, arm), push=push, axes=axes)
    at = _in_metres(joint.at, sizes)
    arm = _multiply_vector(frame.turned, at)
    place = _add(frame.origin, arm)
    turning = [a * v for a in axis]
    turned = _multiply_matrices(
        frame.turned, _axis_rotation(own, q - joint.zero if joint.zero else q)
    )
    after = _Frame(
        place,
        turned,
        _add(frame.spin, turning),
        _add(frame.spin_rate, _cross(frame.spin, turning)),
        _add(frame.push, _rotational_acceleration(frame, arm)),
        {**frame.axes, number: (axis, place)},
    )
    back = [-x for x in _multiply_vector(turned, at)]
    return replace(
        after,
        origin=_add(place, back),
        push=_add(after.push, _rotational_acceleration(after, back)),
    )


def _rotational_acceleration(frame: _Frame, arm: Values) -> list[Any]:
    """alpha x r + w x (w x r)."""
    return _add(_cross(frame.spin_rate, arm), _cross(frame.spin, _cross(frame.spin, arm)))


def _unit_rate_velocities(
    axis: Values, place: Values | None, centre: Values
) -> tuple[Values, Values]:
    """The velocities of a centre and of its body for a unit rate of a joint."""
    if place is None:
        return axis, [0] * 3
    return _cross(axis, _subtract(centre, place)), axis


def _axis_rotation(axis: Values, angle: Any) -> list[list[Any]]:
    """Rodrigues: cos a I + sin a [e]x + (1 - cos a) e e^T."""
    c, s = cos(angle), sin(angle)
    x, y, z = axis
    across = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return [
        [(c if i == j else 0) + s * across[i][j] + (1 - c) * (axis[i] * axis[j]) for j in range(3)]
        for i in range(3)
    ]


def _inertia_tensor(body: Body, frame: _Frame, factor: Any) -> list[list[Any]]:
    """R I R^T."""
    rows = [[_round_to_whole(x, 0.0) for x in body.inertia[3 * i : 3 * i + 3]] for i in range(3)]
    across = [list(column) for column in zip(*frame.turned, strict=True)]
    turned = _multiply_matrices(_multiply_matrices(frame.turned, rows), across)
    return [[x * factor for x in row] for row in turned]


def _in_metres(vector: Values, sizes: BaseUnits) -> list[Any]:
    return [_round_to_whole(x, 0.0) * sizes.metre for x in vector]


def _round_to_whole(value: float, rounding: float = _ROUNDING) -> Any:
    """A number; a whole one as such, so that products with 0 and 1 vanish from expressions."""
    near = round(value)
    return near if abs(value - near) <= rounding else value


def _add(a: Values, b: Values) -> list[Any]:
    return [x + y for x, y in zip(a, b, strict=True)]


def _subtract(a: Values, b: Values) -> list[Any]:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: Values, b: Values) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Values, b: Values) -> list[Any]:
    return [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]


def _multiply_vector(rows: Sequence[Values], vector: Values) -> list[Any]:
    return [_dot(row, vector) for row in rows]


def _multiply_matrices(a: Sequence[Values], b: Sequence[Values]) -> list[list[Any]]:
    columns = [list(column) for column in zip(*b, strict=True)]
    return [[_dot(row, column) for column in columns] for row in a]
