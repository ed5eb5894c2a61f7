"""What couples with what, read off the equations, and its picture, which is text too."""

from dataclasses import asdict
from xml.etree import ElementTree

import pytest
from spiral_plugins.effects.dissipative import Gyroscopic
from spiral_plugins.effects.flows import Overflow
from spiral_plugins.effects.inputs import ActuatorLag
from spiral_plugins.effects.restoring import CubicStiffness
from spiral_plugins.effects.sensors import Delay
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.equations import Equations
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.tilting_rotor import TiltingRotor

import spiral
from spiral.physics.couplings import Feed, Link, couplings_of
from spiral.types.model import seed_model
from spiral.view.report.sketch import describe_sketch, sketch, sketch_figure
from tests.scenes import registry


def graph(system, *effects):
    return couplings_of(seed_model(system, effects))


def places(found):
    return {(p.kind, p.name): (p.touches, [e.label for e in p.effects]) for p in found.places}


def chain(tmp_path, masses):
    """Masses in a row on springs, the first to ground and driven, each second one measured."""
    names = range(1, masses + 1)
    lines = ["states: {" + ", ".join(f"q{i}: m" for i in names) + "}", "inputs: {F: N}",
             "parameters: {m: 1 kg, k: 100 N/m}",
             f"observed: [{', '.join(f'q{i}' for i in names if i % 2)}]", "equations:"]  # fmt: skip
    for i in names:
        left = f"k*(q{i} - q{i - 1})" if i > 1 else "k*q1"
        right = f" + k*(q{i} - q{i + 1})" if i < masses else ""
        lines.append(f"  - m*q{i}'' + {left}{right} = {'F' if i == 1 else '0'}")
    (tmp_path / "chain.yaml").write_text("\n".join(lines))
    return Equations(path=str(tmp_path / "chain.yaml"))


def test_a_rotor_has_its_gyroscopic_coupling_and_its_ports():
    found = graph(TiltingRotor(), Gyroscopic())
    assert [(n.name, n.measured) for n in found.nodes] == [
        ("x", True), ("y", True), ("alpha", False), ("beta", False)
    ]  # fmt: skip
    assert found.links == (Link("alpha", "beta", True),)  # W I_p: each moment by the other's rate
    assert found.inputs[0] == Feed("speed", "rad/s", ("alpha", "beta"))
    assert places(found)["port", "bearing_1"][0] == ("x", "y", "alpha", "beta")
    touched, effects = places(found)["port", "disk"]
    assert (touched, effects) == (("x", "y"), ["unbalance", "gyroscopic"])
    disk = next(p for p in found.places if p.name == "disk")
    assert [e.added for e in disk.effects] == [False, True]


def test_neighbours_of_a_chain_are_coupled_and_no_others(tmp_path):
    found = graph(chain(tmp_path, 5), CubicStiffness(port="q2-q3"))
    pairs = [(k.source, k.target) for k in found.links]
    assert pairs == [(f"q{i}", f"q{i + 1}") for i in range(1, 5)]
    assert all(k.mutual for k in found.links)
    assert found.inputs == (Feed("F", "N", ("q1",)),)
    assert places(found)["port", "q2-q3"] == (("q2", "q3"), ["cubic_stiffness@q2-q3"])


def test_a_tank_flows_into_the_next_and_not_back():
    found = graph(CascadedTanks(), Overflow())
    assert [(n.name, n.coordinate, n.measured) for n in found.nodes] == [
        ("upper", False, False), ("lower", False, True)
    ]  # fmt: skip
    assert places(found) == {
        ("flow", "upper"): (("upper",), ["pump"]),
        ("flow", "upper, lower"): (("upper", "lower"), ["outlets", "overflow"]),
    }


def test_sensors_that_report_no_state_have_boxes_of_their_own():
    text = """
equations: ["m*x'' + k*x + q*(x - z) = F", "n*z'' + q*(z - x) = 0"]
states: {x: m, z: m}
inputs: {F: N}
parameters: {m: 2 kg, n: 1 kg, k: 2000 N/m, q: 1500 N/m}
observed: ["x''", "mount = q*(x - z)"]
"""
    plain = graph(Equations(text=text))
    assert [(n.name, n.measured) for n in plain.nodes] == [("x", False), ("z", False)]
    assert [(r.name, r.touches) for r in plain.readings] == [
        ("x_acceleration", ("x",)), ("mount", ("x", "z"))
    ]  # fmt: skip
    said = " ".join(describe_sketch(asdict(plain)))
    assert "The sensor mount tells of x and z." in said
    assert "Hidden" not in said
    drawn = sketch(asdict(plain))
    assert drawn.count(">mount (N)<") == drawn.count(">x acceleration (m/s²)<") == 1
    late = graph(Equations(text=text), Delay(port="mount"))
    assert places(late)["sensor", "sensors mount"][0] == ("x", "z")
    assert sketch(asdict(late)).count(">sensor mount") == 1


def test_a_state_that_another_follows_is_told_one_way(tmp_path):
    (tmp_path / "rc.yaml").write_text(
        "states: {u: V, w: V}\ninputs: {e: V}\nparameters: {a: 2 1/s}\nobserved: [w]\n"
        "equations:\n  - u' = a*(e - u)\n  - w' = a*(u - w)\n"
    )
    found = graph(Equations(path=str(tmp_path / "rc.yaml")))
    assert found.links == (Link("u", "w", False),)
    assert "w follows u" in " ".join(describe_sketch(asdict(found)))


@pytest.mark.parametrize("name", ["function", "fmu", "structure", "pendulum", "planar_rotor"])
def test_every_kind_of_system_has_a_sketch(name):
    found = asdict(graph(registry().make("system", name)))
    assert found["nodes"]
    ElementTree.fromstring(sketch(found))


def test_effects_on_inputs_and_sensors_stand_there_and_hidden_states_are_named():
    found = asdict(graph(Oscillator(), ActuatorLag(), Delay()))
    said = " ".join(describe_sketch(found))
    assert "On the input force: actuator lag (added)." in said
    assert "On the sensors: delay (added)." in said
    assert "has a hidden state" in sketch(found)


def test_a_picture_is_the_same_each_time_and_no_box_lies_on_another(tmp_path):
    found = asdict(graph(chain(tmp_path, 12), CubicStiffness(port="q1-q2")))
    drawn = sketch(found)
    assert drawn == sketch(asdict(graph(chain(tmp_path, 12), CubicStiffness(port="q1-q2"))))
    root = ElementTree.fromstring(drawn)
    assert root.attrib["role"] == "img"
    named = {e.attrib.get("id"): e.text for e in root.iter()}
    assert all(named[one] for one in root.attrib["aria-labelledby"].split())
    boxes = [
        tuple(float(e.attrib[k]) for k in ("x", "y", "width", "height"))
        for e in root.iter("{http://www.w3.org/2000/svg}rect")
    ]
    outer = [b for b in boxes if b[3] >= 30]
    assert len(outer) == 12 + 1 + 6 + 13  # states, input, sensors, ports with one between two
    for i, (x, y, width, height) in enumerate(outer):
        for a, b, wide, high in outer[:i]:
            inside = a > x and b > y and a + wide < x + width  # the second frame of a sensor
            assert inside or x + width <= a or a + wide <= x or y + height <= b or b + high <= y


def test_names_are_text_and_a_file_that_is_no_graph_draws_nothing():
    found = asdict(graph(Oscillator()))
    found["nodes"][0]["unit"] = "<script>alert(1)</script>"
    assert "<script" not in sketch(found)
    for other in (None, [], {"nodes": 3}, {**found, "links": [{"source": "no"}]}):
        assert sketch_figure(other) == ""


def test_a_notebook_shows_the_sketch_of_a_model():
    assert spiral.plot.sketch(seed_model(Oscillator()))._repr_svg_().startswith("<svg")
