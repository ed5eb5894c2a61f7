"""A robot's description (MJCF, URDF), read by MuJoCo; elements without equations are refused."""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from spiral.physics.robots.tree import UNITS, Actuator, Body, Joint, Robot
from spiral.types.errors import ConfigError, InputError
from spiral.types.identifier import identifier

_KINDS = {3: "hinge", 2: "slide"}
"""MuJoCo's numbers of the joints that are read; 0 is a free one, 1 a ball."""
_NO_GRAVITY, _NO_CONTACT = 1 << 7, 1 << 4  # of MuJoCo's flags
_NO_FORCES = 1 << 0 | 1 << 2 | 1 << 5 | 1 << 6 | 1 << 11
"""Constraints, friction, springs, dampers, actuation disabled."""
_LEFT_OUT = (
    ("ntendon", "tendons"), ("neq", "equality constraints"), ("nflex", "flexible bodies"),
    ("npair", "pairs of geoms in contact"), ("nplugin", "plugins"), ("na", "actuators with states"),
)  # fmt: skip
_CURVED = ("dof_dampingpoly", "jnt_stiffnesspoly", "jnt_springyield", "body_gravcomp",
           "actuator_damping", "actuator_armature", "actuator_delay")  # fmt: skip


def read_robot(path: str, untouched: bool = False) -> str:
    """The text of a robot (``physics.robots.tree``) from its file.

    Parameters
    ----------
    path : MJCF (``.xml``) or URDF (``.urdf``); meshes and included files lie where it says.
    untouched : leave out contacts between its parts, which the record does not have.

    Raises
    ------
    InputError : no such file, one that MuJoCo does not read, or a robot that has more than hinges,
        slides and rigid bodies. ConfigError : MuJoCo is not there.
    """
    mujoco = _import_mujoco(path)
    place = Path(path).expanduser()
    if not place.is_file():
        raise InputError(f"robot {path!r}: no such file", "an MJCF or a URDF file")
    try:
        model = mujoco.MjModel.from_xml_path(str(place))
    except ValueError as error:
        said = " ".join(str(error).split())
        raise InputError(f"robot {path!r}: {said}", "an MJCF or a URDF file") from error
    _check_robot(path, model, untouched)
    return _convert_robot(place.stem, model).text


def _import_mujoco(path: str) -> Any:
    """The module ``mujoco``, an optional dependency."""
    try:
        return importlib.import_module("mujoco")
    except ImportError as error:
        raise ConfigError(
            f"the robot {path!r}, and no MuJoCo to read it",
            "the extra robots",
            "pip install 'spiral[robots]'",
        ) from error


def _check_robot(path: str, model: Any, untouched: bool) -> None:
    """Refuse what is more than rigid bodies on hinges and slides without contact."""
    names = _element_names(model, "body")
    for count, what in _LEFT_OUT:
        if getattr(model, count, 0):
            raise _unsupported_error(path, what, f"leave the {what} out of the file")
    for number, kind in enumerate(model.jnt_type):
        if int(kind) not in _KINDS:
            body = names[int(model.jnt_bodyid[number])]
            what = "a free joint" if int(kind) == 0 else "a ball joint"
            hint = "fix the base to the ground" if int(kind) == 0 else "three hinges in its place"
            raise _unsupported_error(path, f"{what} (body {body!r})", hint)
    if not model.njnt:
        raise _unsupported_error(path, "no joint", "a URDF needs joints that are not fixed")
    for name in _CURVED:
        if np.any(getattr(model, name, 0)):
            raise _unsupported_error(path, f"{name} that is not zero", "leave it out of the file")
    if model.opt.density or model.opt.viscosity:
        raise _unsupported_error(path, "a fluid around it", "density and viscosity zero")
    if int(model.opt.disableflags) & _NO_FORCES:
        raise _unsupported_error(
            path, "forces of its joints disabled", "leave that flag out of the file"
        )
    untouched = untouched or bool(int(model.opt.disableflags) & _NO_CONTACT)
    if not untouched and (pair := next(_touching_bodies(model), None)):
        raise _unsupported_error(
            path, f"bodies that may touch: {names[pair[0]]!r} and {names[pair[1]]!r}",
            "system.untouched=true where nothing touches in the record, or contype=\"0\" "
            "conaffinity=\"0\" of their geoms",
        )  # fmt: skip


def _unsupported_error(path: str, what: str, hint: str) -> InputError:
    expected = "rigid bodies on hinges and slides, nothing in contact"
    return InputError(f"robot {path!r} with {what}", expected, hint)


def _touching_bodies(model: Any) -> Iterator[tuple[int, int]]:
    """Bodies whose geoms may touch: not joined rigidly, nor parent and child, as MuJoCo has it."""
    weld, own = model.body_weldid, model.geom_bodyid
    parent = [int(weld[model.body_parentid[int(weld[b])]]) for b in range(model.nbody)]
    excluded = {int(s) for s in model.exclude_signature}
    for a, b in itertools.combinations(range(model.ngeom), 2):
        kinds = (model.geom_contype, model.geom_conaffinity)
        meets = kinds[0][a] & kinds[1][b] or kinds[0][b] & kinds[1][a]
        first, second = sorted((int(own[a]), int(own[b])))
        one, other = int(weld[first]), int(weld[second])
        joined = one == other or (
            one and other and (parent[first] == other or parent[second] == one)
        )
        if meets and not joined and (first << 16) + second not in excluded:
            yield first, second


# --- what is taken -------------------------------------------------------------------------------


def _convert_robot(title: str, model: Any) -> Robot:
    joints = _joints(model)
    gravity = np.zeros(3) if int(model.opt.disableflags) & _NO_GRAVITY else model.opt.gravity
    return Robot(
        title,
        tuple(map(float, gravity)),
        tuple(_body(model, number, name) for number, name in _bodies(model)),
        joints,
        tuple(_actuators(title, model, joints)),
    )


def _bodies(model: Any) -> list[tuple[int, str]]:
    return list(enumerate(_element_names(model, "body")))[1:]


def _body(model: Any, number: int, name: str) -> Body:
    turned, along = (
        _rotation_matrix(model.body_quat[number]),
        _rotation_matrix(model.body_iquat[number]),
    )
    tensor = along @ np.diag(model.body_inertia[number]) @ along.T
    return Body(
        name,
        int(model.body_parentid[number]) - 1,
        _float_tuple(model.body_pos[number]),
        _float_tuple(turned),
        float(model.body_mass[number]),
        _float_tuple(model.body_ipos[number]),
        _float_tuple(0.5 * (tensor + tensor.T)),
    )


def _joints(model: Any) -> tuple[Joint, ...]:
    joints = []
    for number, name in enumerate(_element_names(model, "joint")):
        dof, at = int(model.jnt_dofadr[number]), int(model.jnt_qposadr[number])
        joints.append(Joint(
            name, int(model.jnt_bodyid[number]) - 1, _KINDS[int(model.jnt_type[number])],
            _float_tuple(model.jnt_axis[number]), _float_tuple(model.jnt_pos[number]),
            float(model.qpos0[at]), float(model.dof_damping[dof]),
            float(model.dof_frictionloss[dof]), float(model.dof_armature[dof]),
            float(np.ravel(model.jnt_stiffness[number])[0]), float(model.qpos_spring[at]),
        ))  # fmt: skip
    return tuple(joints)


def _actuators(title: str, model: Any, joints: tuple[Joint, ...]) -> Iterator[Actuator]:
    """Motors, and servos of position and of velocity, each on a joint."""
    for number, name in enumerate(_element_names(model, "actuator")):
        gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
        plain = not gain[1:].any() and not bias[3:].any() and not bias[0]
        on_joint = int(model.actuator_trntype[number]) == 0
        kinds = (int(model.actuator_gaintype[number]), int(model.actuator_biastype[number]))
        if not (plain and on_joint and kinds in ((0, 0), (0, 1))):
            raise _unsupported_error(title, f"the actuator {name!r}",
                           "motor, position or velocity, each on a joint")  # fmt: skip
        joint = joints[int(model.actuator_trnid[number][0])]
        own, force = joint.units[0], UNITS[joint.kind][1]
        servo = kinds[1] == 1
        unit = force if not servo else own if bias[1] else f"{own}/s"
        yield Actuator(
            name, joint.name, unit, float(model.actuator_gear[number][0]), float(gain[0]),
            *(-float(b) if servo else 0.0 for b in bias[1:3]),
        )  # fmt: skip


def _element_names(model: Any, kind: str) -> list[str]:
    """Names as Python identifiers; an element without a name is called by its number."""
    count = {"body": model.nbody, "joint": model.njnt, "actuator": model.nactuator}[kind]
    names: list[str] = []
    for number in range(count):
        told = getattr(model, kind)(number).name or f"{kind}_{number}"
        names.append(identifier(told, set(names)))
    return names


def _rotation_matrix(quaternion: Any) -> np.ndarray:
    """The rotation of a quaternion (w, x, y, z)."""
    w, *v = np.asarray(quaternion, dtype=float) / np.linalg.norm(quaternion)
    x, y, z = v
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * across + 2 * across @ across


def _float_tuple(given: Any) -> tuple[float, ...]:
    return tuple(map(float, np.ravel(given)))
