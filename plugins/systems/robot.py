"""A robot by its description: rigid bodies on hinges and slides."""

from __future__ import annotations

from typing import Any

from spiral.math import tanh
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.system import MechanicalSystem
from spiral.types.units import quantity

WIDTH = 0.01
"""Of a joint's velocity, over which its friction changes sign: rad/s, m/s."""
_JOINT = (("damping", "({1})*s/({0})"), ("friction", "{1}"), ("armature", "{2}"),
          ("stiffness", "({1})/({0})"))  # fmt: skip


class Robot(MechanicalSystem):
    """M(q) q'' + b(q, q') + d q' + f tanh(q'/w) + k (q - q_r) = Q, for joints that turn or slide.

    b holds centrifugal, Coriolis and gravity forces; Q those of actuators and joints.

    Fields
    ------
    path : MJCF (.xml) or URDF (.urdf) file, which MuJoCo reads (extra robots).
    recorded : actuators whose inputs, joints whose forces a record has; left out, all actuators.
    measured : joints whose positions, and JOINT' of whose velocities are measured; left out, all
        positions.
    places : port -> a position where effects act, as a formula of the joints, beside each joint.
    free : parameters that the fit moves: BODY_mass, BODY_inertia (a factor), JOINT_damping,
        JOINT_friction, JOINT_armature, JOINT_stiffness.
    untouched : parts that may touch do not in the record.
    text : the robot as it was read, which needs no file; with neither, two links that swing.
    """

    path: str = ""
    recorded: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    places: Any = ()
    free: tuple[str, ...] = ()
    untouched: bool = False
    text: str = ""

    def __post_init__(self):
        """Read the file, so that what is wrong is said at once."""
        pairs = self.places.items() if hasattr(self.places, "items") else self.places or ()
        object.__setattr__(self, "places", tuple((str(a), str(b)) for a, b in pairs))
        for name in ("recorded", "measured", "free"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if not self.text:
            from spiral.io.readers.robot import read_robot

            text = read_robot(self.path, self.untouched) if self.path else _two_link_example().text
            object.__setattr__(self, "text", text)
        joints = [j.name for j in self.form.joints]
        drives = [a.name for a in self.form.actuators]
        _refuse_unknown_names("recorded", self.recorded, [*drives, *joints])
        _refuse_unknown_names("measured", self.measured, [*joints, *(f"{j}'" for j in joints)])
        _refuse_unknown_names("free", self.free, [name for name, *_ in _all_parameters(self.form)])
        _ = self.ports

    @property
    def form(self):
        """Bodies, joints and actuators."""
        from spiral.physics.robots.tree import robot_of

        return robot_of(self.text)

    @property
    def coordinates(self):
        """The joints' positions."""
        return tuple(State(j.name, j.units[0]) for j in self.form.joints)

    @property
    def injections(self):
        """A force or a torque on each joint."""
        return tuple(State(j.name, j.units[1]) for j in self.form.joints)

    @property
    def observed(self):
        """What is measured."""
        names = self.measured or [j.name for j in self.form.joints]
        return tuple(self.rate_name(n[:-1]) if n.endswith("'") else n for n in names)

    @property
    def inputs(self):
        """Commands of actuators by their names, forces on joints as JOINT_torque or JOINT_force."""
        inputs = [Input(a.name, a.unit, "zero_order") for a in self._recorded_actuators()]
        inputs += [Input(_force_name(j), j.units[1], "smooth") for j in self._forced_joints()]
        return tuple(inputs)

    @property
    def parameters(self):
        """Masses, factors of inertias, and what acts in the joints; known unless they are free."""
        return tuple(
            Parameter(name, unit, lower=0.0, start=None if name in self.free else value)
            for name, unit, value in _all_parameters(self.form)
            if value or name in self.free
        )

    @property
    def defaults(self):
        """First values of what is free."""
        known = {name: value for name, _, value in _all_parameters(self.form)}
        return {f"system.{name}": known[name] for name in self.free if known[name]}

    @property
    def ports(self):
        """Each joint, then the places that were named."""
        joints = self.form.joints
        own = tuple(Port(j.name, (j.name,), _joint_position(j.name), *j.units[:2]) for j in joints)
        return (*own, *(_place_port(self.form, name, text) for name, text in self.places))

    @property
    def seed(self):
        """The description is the whole model; effects come on top."""
        return ()

    def mass(self, q, p):
        """M(q), armatures included."""
        return self._mass_and_bias(q, q, p, still=True)[0]

    def force(self, q, v, u, p):
        """Q - b(q, q') - d q' - f tanh(q'/w) - k (q - q_r)."""
        _, bias = self._mass_and_bias(q, v, p)
        forces = []
        for joint, b in zip(self.form.joints, bias, strict=True):
            at, speed = getattr(q, joint.name), getattr(v, joint.name)
            total = -b
            for name, pull in (
                ("damping", lambda s=speed: s),
                (
                    "friction",
                    lambda s=speed, j=joint: tanh(s / _with_unit_like(WIDTH, f"{j.units[0]}/s", s)),
                ),
                ("stiffness", lambda a=at, j=joint: a - _with_unit_like(j.rest, j.units[0], a)),
            ):
                value = getattr(p, f"{joint.name}_{name}", None)
                total = total if value is None else total - value * pull()
            forces.append(total + self._drive_force(joint, at, speed, u))
        return forces

    def _mass_and_bias(self, q, v, p, still=False):
        from spiral.physics.robots.motion import BaseUnits, equations_of_motion

        form = self.form
        at, speeds = ([getattr(x, j.name) for j in form.joints] for x in (q, v))
        units = _has_units(at[0])
        one = [quantity(unit, 1.0) for unit in ("m", "s", "kg*m**2")]
        sizes = BaseUnits(*one) if units else BaseUnits()
        if still:
            speeds = [_with_unit_like(0, f"{j.units[0]}/s", at[0]) for j in form.joints]
        masses = [
            getattr(p, f"{b.name}_mass", _with_unit_like(0, "kg", at[0])) for b in form.bodies
        ]
        factors = [getattr(p, f"{b.name}_inertia", 0) for b in form.bodies]
        mass, bias = equations_of_motion(form, at, speeds, masses, factors, sizes)
        for i, joint in enumerate(form.joints):
            mass[i][i] = mass[i][i] + getattr(p, f"{joint.name}_armature", 0)
        return mass, bias

    def _drive_force(self, joint, at, speed, u):
        """What actuators and a recorded force do at a joint."""
        total = 0
        for a in self._recorded_actuators():
            if a.joint != joint.name:
                continue
            own, force, _ = joint.units
            terms = ((a.gain, getattr(u, a.name), a.unit), (-a.by_position, at, own),
                     (-a.by_velocity, speed, f"{own}/s"))  # fmt: skip
            for factor, value, unit in terms:
                if factor:
                    total = (
                        total
                        + _with_unit_like(a.gear * factor, f"({force})/({unit})", value) * value
                    )
        return total + getattr(u, _force_name(joint)) if joint in self._forced_joints() else total

    def _recorded_actuators(self):
        return [a for a in self.form.actuators if not self.recorded or a.name in self.recorded]

    def _forced_joints(self):
        drives = {a.name for a in self.form.actuators}
        return [j for j in self.form.joints if j.name in self.recorded and j.name not in drives]


def _all_parameters(form):
    """Name, unit and value of every number that may be free."""
    for body in form.bodies:
        yield f"{body.name}_mass", "kg", body.mass
        yield f"{body.name}_inertia", "", float(any(body.inertia))
    for joint in form.joints:
        for name, unit in _JOINT:
            yield f"{joint.name}_{name}", unit.format(*joint.units), getattr(joint, name)


def _refuse_unknown_names(what, names, known):
    for name in names:
        if name not in known:
            raise ConfigError(
                f"{what} {name!r} of a robot", f"of {', '.join(known)}", did_you_mean(name, known)
            )


def _force_name(joint):
    return f"{joint.name}_{'torque' if joint.kind == 'hinge' else 'force'}"


def _joint_position(name):
    return lambda q, p: [getattr(q, name)]


def _place_port(form, name, text):
    """A port at a formula of the joints, which are of one unit."""
    from spiral.physics.formulas import syntax

    used = syntax.names(text)
    _refuse_unknown_names(f"place {name!r}:", used, [j.name for j in form.joints])
    units = {form.joint(n).units[:2] for n in used}
    if len(units) != 1:
        raise ConfigError(f"place {name!r}: {text}", "joints that all turn or all slide")
    return Port(name, (name,), lambda q, p: [syntax.compute(text, vars(q))], *units.pop())


def _has_units(value):
    return hasattr(value, "dimensionality")


def _with_unit_like(value, unit, beside):
    """A number, with its unit where what it stands beside has one."""
    return quantity(unit, value) if _has_units(beside) else value


def _two_link_example():
    """Links of 0.3 and 0.25 m, one below the other, that swing about y."""
    from spiral.physics.robots.tree import Body, Joint, Robot

    unit, zero = (1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (0.0, 0.0, 0.0)
    bodies = (
        Body("upper", -1, zero, unit, 0.5, (0.0, 0.0, -0.15), (4e-3, 0, 0, 0, 4e-3, 0, 0, 0, 1e-4)),
        Body("lower", 0, (0.0, 0.0, -0.3), unit, 0.3, (0.0, 0.0, -0.12),
             (2e-3, 0, 0, 0, 2e-3, 0, 0, 0, 1e-4)),
    )  # fmt: skip
    joints = (
        Joint("shoulder", 0, "hinge", (0.0, 1.0, 0.0), zero, damping=0.02),
        Joint("elbow", 1, "hinge", (0.0, 1.0, 0.0), zero, damping=0.01),
    )
    return Robot("two links", (0.0, 0.0, -9.81), bodies, joints, ())
