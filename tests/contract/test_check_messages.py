"""What ``spiral check`` says of systems from files: at values given, and of the first cause."""

from dataclasses import replace

import numpy as np
import pytest

from spiral.commands.plugins import check_plugins
from spiral.io.request import Request
from spiral.io.testing import check_system, failed
from tests.scenes import registry

COUPLED = """
equations: ["A*p'' + B*d'' + k*p = 0", "B*p'' + D*d'' + k*d = T"]
states: {p: rad, d: rad}
inputs: {T: N*m}
parameters: {A: MASS kg*m^2, B: 2.3194 kg*m^2, D: 0.29784 kg*m^2, k: 3 N*m}
free: [A, k]
observed: [d]
"""
CELL = """
equations: ["C*V' = I - g*V - G*V*exp(V/W)"]
states: {V: V}
inputs: {I: {unit: A, interpolation: linear}}
constants: {W: 0.018 V}
parameters: {C: 200e-12 F, g: 24e-9 S, G: 39e-9 S}
free: [g, G]
observed: [V]
"""
ICE = """
equations: ["r*h' = k/h + u"]
states: {h: m}
inputs: {u: W/m^2}
parameters: {r: 3e8 J/m^3, k: 36 W/m}
free: [k]
observed: [h]
"""
RUNAWAY = """
equations: ["x' = a*x + u"]
states: {x: m}
inputs: {u: m/s}
parameters: {a: 1000 1/s}
free: [a]
observed: [x]
"""


def checks_of(text):
    """The checks of a system from a text, by name."""
    return {c.name: c for c in check_system(registry().make("system", "equations", {"text": text}))}


def test_a_mass_matrix_is_tried_at_the_values_given():
    """92 * 0.298 > 2.32^2 is positive, what 0.3 to 0.9 for each would give is not."""
    found = checks_of(COUPLED.replace("MASS", "92"))
    assert not failed(found.values())


def test_a_mass_matrix_that_is_not_positive_says_where_and_nothing_follows():
    found = checks_of(COUPLED.replace("MASS", "9.2"))
    (first,) = failed(found.values())
    assert first.name == "mass"
    assert "A = 9.2 (given), B = 2.319 (given), D = 0.2978 (given)" in first.seen
    assert "bounds" in first.try_
    assert "jacobians" not in found
    assert "injections" in found


def test_inputs_are_as_small_as_the_machine_needs():
    """Rates of an ampere into 200 pF are 5e9 V/s; it stays finite at some smaller decade."""
    found = checks_of(CELL)
    assert not failed(found.values())
    assert "each input held at 1e-" in found["simulates"].seen
    share = float(found["jacobians"].seen.split()[1])
    assert 0 <= share <= 1e-5
    assert "of their size" in found["jacobians"].seen


def test_growth_at_every_size_of_the_inputs_is_told():
    (first,) = failed(checks_of(RUNAWAY).values())
    assert first.name == "simulates"
    assert "all sizes down to 1e-15" in first.seen


def test_of_a_file_only_functions_of_files_are_advised():
    found = checks_of(ICE)
    told = found["finite at rest"]
    assert not told.passed
    assert "rate of 'h' at rest (inputs 0, states" in told.seen
    assert "maximum(x, small)" in told.try_
    assert "spiral.math" not in " ".join(c.try_ for c in found.values())
    assert "simulates" not in found


@pytest.mark.parametrize("value", [1e-12, 1.0, 1e9])
def test_derivatives_are_judged_by_their_share_at_any_size(value):
    """x' = -k x |x| has exact slopes, whatever the size of k."""
    text = 'equations: ["x\' = -k*x*abs(x) + u"]\nstates: {x: m}\ninputs: {u: m/s}\n'
    text += f"parameters: {{k: {value!r} 1/m/s}}\nfree: [k]\nobserved: [x]\n"
    assert float(checks_of(text)["jacobians"].seen.split()[1]) <= np.sqrt(1e-10)


def test_a_system_may_leave_out_ports_and_seed():
    """Each injection's state is a place, in the unit of its flow; effects act there."""
    from spiral.types.parameter import Input, Parameter, State
    from spiral.types.placement import at_every_place
    from spiral.types.system import System

    class Room(System):
        """A room and its walls: C T' = P - k (T - W), D W' = k (T - W) - l W."""

        states = (State("air", "K"), State("wall", "K", like="air"))
        observed = ("air",)
        inputs = (Input("heat", "K/s"),)
        injections = (State("air", "K/s"), State("wall", "K/s"))
        parameters = (
            Parameter("passes", "1/s", lower=0.0, start=0.1),
            Parameter("leaves", "1/s", lower=0.0, start=0.01),
        )

        def rate(self, x, u, p, injected):
            through = p.passes * (x.air - x.wall)
            return {
                "air": injected["air"] + u.heat - through,
                "wall": injected["wall"] + through - p.leaves * x.wall,
            }

    room = Room()
    assert not failed(check_system(room))
    assert [(p.name, p.position_unit, p.force_unit) for p in room.ports] == [
        ("air", "K", "K/s"), ("wall", "K", "K/s")
    ]  # fmt: skip
    places = [e.port for e in at_every_place(room, registry().make("effect", "linear_loss"))]
    assert "wall" in places


def test_units_are_told_as_they_are_written_and_what_follows_from_them_in_short():
    told = {k: c.seen for k, c in checks_of(COUPLED.replace("MASS", "92")).items()}
    assert "T in N*m" in told["parameters"]
    assert "p_rate in rad/s" in told["parameters"]
    assert "(" not in told["units of the equations"] + told["injections"]


def test_a_model_in_python_is_checked_under_its_own_name(tmp_path, monkeypatch):
    (tmp_path / "slab.py").write_text(
        "import spiral\n"
        "system = spiral.system(lambda t, x, u, p: [(u.q - p.g * x.T) / p.C], states={'T': 'K'},\n"
        "    inputs={'q': 'W'}, parameters={'C': (2.0, 'J/K'), 'g': (1.0, 'W/K')}, "
        "observed=['T'])\n"
    )
    monkeypatch.chdir(tmp_path)
    told = []
    named = replace(registry(), programs=frozenset({"slab.py"}))
    outcome = check_plugins(Request("check", ("slab.py",)), named, told.append)
    assert outcome.result["passed"]
    assert told == ["checking slab.py"]
    ((entry, checks),) = outcome.parts["checked"]
    assert entry.name == "slab.py"
    assert "docstring" not in {c.name for c in checks}
