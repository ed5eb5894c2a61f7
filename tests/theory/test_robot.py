"""Robots from MJCF and URDF: their equations against MuJoCo's, what is refused, hidden friction."""

import json

import numpy as np
import pytest

import spiral
from spiral.io.registry import NO_FOLDER, load_registry
from spiral.io.storage import model_data, rebuild_model
from spiral.io.testing import check_system, failed
from spiral.physics.compile import compile_model
from spiral.physics.robots.motion import BaseUnits, equations_of_motion
from spiral.physics.trace import trace
from spiral.types.errors import SpiralError
from spiral.types.model import seed_model

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

BAR = '<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>'


def arm(inner="", outer='damping="0.01"', more="", option=""):
    """Two links one below the other; attributes of both joints, what else there is."""
    return f"""<mujoco><option {option}/><worldbody><body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.02" {inner}/>{BAR}
      <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" {outer}/>{BAR}</body>
      </body></worldbody>{more}</mujoco>"""


def tree(rng, links):
    """Bodies at random places: a branch, slides among hinges, every axis and offset at random."""

    def numbers(count, size=1.0):
        return " ".join(f"{v:.6f}" for v in size * rng.normal(size=count))

    def body(k, rest):
        kind = "slide" if k % 3 == 2 else "hinge"
        return (
            f'<body pos="{numbers(3, 0.3)}" quat="{numbers(4)}">'
            f'<joint type="{kind}" axis="{numbers(3)}" pos="{numbers(3, 0.1)}" ref="{0.2 * k}" '
            f'armature="{0.01 * k}"/><inertial pos="{numbers(3, 0.1)}" quat="{numbers(4)}" '
            f'mass="{1 + k}" diaginertia="0.02 0.03 0.04"/>{rest}</body>'
        )

    half = links // 2
    first = "".join(body(k, "") for k in range(half, links))
    for k in reversed(range(half)):
        first = body(k, first)
    return f'<mujoco><compiler angle="radian"/><worldbody>{first}</worldbody></mujoco>'


def saved(path, text):
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("links", [1, 3, 7])
def test_mass_matrix_and_forces_are_those_of_mujoco(links, tmp_path):
    """M(q) and b(q, q') of random trees at random states, to 1e-9 of their size."""
    rng = np.random.default_rng(links)
    path = saved(tmp_path / "tree.xml", tree(rng, links))
    form = spiral.system(path, inputs=["joint_0"]).form
    model = mujoco.MjModel.from_xml_path(path)
    data, mass = mujoco.MjData(model), np.zeros((links, links))
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.normal(size=(2, links))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        own, bias = equations_of_motion(
            form, list(data.qpos), list(data.qvel), [b.mass for b in form.bodies],
            [1] * len(form.bodies), BaseUnits(),
        )  # fmt: skip
        own = np.array(own, float) + np.diag([j.armature for j in form.joints])
        assert own == pytest.approx(mass, abs=1e-9 * np.abs(mass).max())
        assert np.array(bias, float) == pytest.approx(data.qfrc_bias, abs=1e-9 * links * 100)


DRIVES = """<actuator><motor name="motor" joint="shoulder" gear="3"/>
<position name="servo" joint="elbow" kp="4" kv="0.3"/></actuator>"""


def test_accelerations_are_those_of_mujoco(tmp_path):
    """Traced and compiled: dampers, springs, armatures, a motor with gear, a servo; the units."""
    path = saved(
        tmp_path / "arm.xml", arm('stiffness="2" springref="10"', 'armature="0.01"', DRIVES)
    )
    system = spiral.system(path)
    assert not failed(check_system(system))
    assert {i.name: i.unit for i in system.inputs} == {"motor": "N*m", "servo": "rad"}
    traced = trace(system, ())
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.7, -0.4), (1.5, -2.0), (0.3, 0.2)
    mujoco.mj_forward(model, data)
    values = np.array([p.start for p in traced.parameters])
    inputs = np.array([{"motor": 0.3, "servo": 0.2}.get(n, 0.0) for n in traced.inputs])
    rate, by_x = np.zeros(4), np.zeros((4, 4))
    state = np.r_[data.qpos, data.qvel]
    compile_model(traced).rate(state, inputs, values, rate, by_x, np.zeros((4, len(values))))
    assert rate[2:] == pytest.approx(data.qacc, rel=1e-9)


URDF = """<robot name="two"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 -0.15"/><mass value="0.5"/>
<inertia ixx="0.004" iyy="0.004" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 -0.1" rpy="0 0.3 0"/><mass value="0.3"/>
<inertia ixx="0.002" iyy="0.002" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="5" velocity="9"/>
<dynamics damping="0.1"/></joint>
<joint name="elbow-joint" type="continuous"><parent link="upper"/><child link="lower"/>
<origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/></joint></robot>"""


def test_a_urdf_is_a_system_with_named_inputs_sensors_places_and_free_numbers(tmp_path):
    """And a saved run of it needs no file."""
    path = saved(tmp_path / "two.urdf", URDF)
    system = spiral.system(
        path, inputs=["shoulder"], observed=["shoulder", "elbow_joint'"],
        free=["elbow_joint_damping", "lower_mass"], ports={"belt": "elbow_joint - shoulder"},
    )  # fmt: skip
    assert not failed(check_system(system))
    assert [i.name for i in system.inputs] == ["shoulder_torque"]
    assert system.observed == ("shoulder", "elbow_joint_rate")
    assert [p.name for p in system.ports] == ["shoulder", "elbow_joint", "belt"]
    assert system.defaults == {"system.lower_mass": 0.3}
    start = {p.name: p.start for p in system.parameters}
    assert start["elbow_joint_damping"] is None
    assert start["shoulder_damping"] == 0.1
    again = json.loads(json.dumps(model_data(seed_model(system))))
    (tmp_path / "two.urdf").unlink()
    assert rebuild_model(again, load_registry(NO_FOLDER)).system == system


BALL = arm().replace('name="elbow" axis="0 1 0" damping="0.01"', 'name="elbow" type="ball"')
FREE = arm().replace('name="shoulder" axis="0 1 0" damping="0.02"', 'type="free"')
FLOOR = arm().replace("<worldbody>", '<worldbody><geom name="floor" type="plane" size="1 1 1"/>')
TENDON = '<tendon><fixed name="t"><joint joint="elbow" coef="1"/></fixed></tendon>'
EQUAL = '<equality><joint joint1="elbow" joint2="shoulder"/></equality>'
MUSCLE = '<actuator><general name="m" joint="elbow" dyntype="integrator"/></actuator>'


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        (BALL, {}, ["a ball joint (body 'lower')", "three hinges"]),
        (FREE, {}, ["a free joint (body 'upper')", "fix the base"]),
        (FLOOR, {}, ["may touch: 'world' and 'upper'", "untouched=true"]),
        (arm(more=TENDON), {}, ["tendons"]),
        (arm(more=EQUAL), {}, ["equality constraints"]),
        (arm(more=MUSCLE), {}, ["actuators with states"]),
        (arm(option='density="1.2"'), {}, ["a fluid"]),
        (arm(more="<option><flag damper='disable'/></option>"), {}, ["joints disabled"]),
        ("<mujoco><worldbody/></mujoco>", {}, ["no joint"]),
        ("<mujoco><nonsense/></mujoco>", {}, ["an MJCF or a URDF file"]),
        (arm(), {"free": ["elbow_dampng"]}, ["did you mean 'elbow_damping'"]),
        (arm(), {"observed": ["elbo"]}, ["measured 'elbo'", "did you mean 'elbow'"]),
        (arm(), {"inputs": ["wrist"]}, ["recorded 'wrist'"]),
        (arm(), {"ports": {"belt": "elbow - wrist"}}, ["wrist"]),
        (arm(), {"mass": {"elbow": "m"}}, ["the file, ports, inputs, observed, free"]),
    ],
)
def test_what_equations_do_not_hold_is_refused(text, options, said, tmp_path):
    path = saved(tmp_path / "arm.xml", text)
    with pytest.raises(SpiralError) as caught:
        spiral.system(path, **options)
    for words in said:
        assert words in str(caught.value)


def test_contacts_are_left_out_where_the_user_says_so(tmp_path):
    path = saved(tmp_path / "arm.xml", FLOOR)
    system = load_registry(NO_FOLDER).make("system", "robot", {"path": path, "untouched": True})
    assert [c.name for c in system.coordinates] == ["shoulder", "elbow"]
