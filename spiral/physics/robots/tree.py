"""Bodies, joints and actuators of a robot, as text for saved runs and other processes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

from spiral.types.errors import ConfigError

Vector = tuple[float, ...]
UNITS = {"hinge": ("rad", "N*m", "kg*m^2"), "slide": ("m", "N", "kg")}
"""Kind of a joint -> units of its position, its force, its inertia."""


@dataclass(frozen=True)
class Body:
    """A rigid body in the frame of its parent (-1 is the ground), all in SI.

    ``turned`` : rows of the rotation of its frame. ``inertia`` : rows of the tensor about its
    centre of mass ``centre``, along its frame.
    """

    name: str
    parent: int
    at: Vector
    turned: Vector
    mass: float
    centre: Vector
    inertia: Vector


@dataclass(frozen=True)
class Joint:
    """A hinge or a slide of a body, its axis and place in the body's frame, zero at ``zero``.

    -damping q' - stiffness (q - rest) - friction sign q', and ``armature`` on its inertia.
    """

    name: str
    body: int
    kind: str
    axis: Vector
    at: Vector
    zero: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0

    @property
    def units(self) -> tuple[str, str, str]:
        """Of position, force, inertia."""
        return UNITS[self.kind]


@dataclass(frozen=True)
class Actuator:
    """A force on a joint: gear (gain u - by_position gear q - by_velocity gear q').

    ``unit`` of its input u: a force, a position or a velocity of the joint.
    """

    name: str
    joint: str
    unit: str
    gear: float
    gain: float
    by_position: float = 0.0
    by_velocity: float = 0.0


@dataclass(frozen=True)
class Robot:
    """Bodies in an order in which a parent comes first."""

    title: str
    gravity: Vector
    bodies: tuple[Body, ...]
    joints: tuple[Joint, ...]
    actuators: tuple[Actuator, ...]

    @property
    def text(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self))

    def joint(self, name: str) -> Joint:
        """The joint of this name."""
        return next(j for j in self.joints if j.name == name)


@lru_cache(maxsize=16)
def robot_of(text: str) -> Robot:
    """A robot from its text.

    Raises
    ------
    ConfigError : a text that is not a robot's (``Robot.text``).
    """
    try:
        given = json.loads(text)
        kinds = {"bodies": Body, "joints": Joint, "actuators": Actuator}
        parts = {
            k: tuple(_construct_part(kind, item) for item in given[k]) for k, kind in kinds.items()
        }
        return Robot(str(given["title"]), _vector(given["gravity"]), **parts)
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"the text of a robot: {error}", "what spiral.system made") from error


def _construct_part(kind: Any, given: Mapping[str, Any]) -> Any:
    return kind(**{k: _vector(v) if isinstance(v, list) else v for k, v in given.items()})


def _vector(given: Any) -> Vector:
    return tuple(map(float, given))
