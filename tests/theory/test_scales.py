"""Shapes are tried at shares of what the records visit, also where only hidden states move."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.strategies.shooting import Shooting
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.discover import discover
from spiral.inference.evidence.assembly import assemble, initial_values
from spiral.inference.evidence.scales import (
    largest_port_motion,
    states_along_records,
    with_scaled_shapes,
)
from spiral.inference.problem import Problem
from spiral.math import sqrt
from spiral.types.effect import ForceEffect
from spiral.types.model import seed_model
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import Port
from spiral.types.record import make_record
from spiral.types.system import MechanicalSystem
from tests.scenes import admitted, effect

DRIVE = {"linear_stiffness.stiffness": 50.0, "linear_damping.damping": 1.0}


class FlexibleDrive(MechanicalSystem):
    """A motor whose angle is measured turns a hidden load through a shaft; ``wall`` never moves."""

    @property
    def coordinates(self):
        return (State("motor", "rad"), State("load", "rad"))

    @property
    def injections(self):
        return (State("motor", "N*m"), State("load", "N*m"))

    @property
    def observed(self):
        return ("motor",)

    @property
    def inputs(self):
        return (Input("torque", "N*m", interpolation="band_limited"),)

    @property
    def parameters(self):
        return (Parameter("motor_inertia", "kg*m^2", lower=0.0, start=0.01),
                Parameter("load_inertia", "kg*m^2", lower=0.0, start=0.05),
                Parameter("shaft", "N*m/rad", lower=0.0, start=80.0),
                Parameter("loss", "N*m*s/rad", lower=0.0, start=0.02))  # fmt: skip

    @property
    def ports(self):
        def at(f):
            return lambda q, p: [f(q)]

        return (Port("motor", ("phi",), at(lambda q: q.motor), "rad", "N*m"),
                Port("load", ("phi",), at(lambda q: q.load), "rad", "N*m"),
                Port("wall", ("phi",), at(lambda q: 0 * q.load), "rad", "N*m"))  # fmt: skip

    @property
    def seed(self):
        return (LinearStiffness(), LinearDamping())

    def mass(self, q, p):
        return [[p.motor_inertia, 0], [0, p.load_inertia]]

    def force(self, q, v, u, p):
        twist, slip = q.motor - q.load, v.motor - v.load
        inner = p.shaft * twist + p.loss * slip
        return [u.torque - inner, inner]


class ShortRoot(ForceEffect):
    """F = -k sqrt(r^2 - q^2): a number at rest, and none at any angle beyond r."""

    parameters = (Parameter("stiffness", "force/position"),
                  Parameter("reach", "position", start=1e-6, role="shape"))  # fmt: skip

    def force(self, at, u, p):
        return [-p.stiffness * sqrt(p.reach**2 - q * q) for q in at.position]


def drive_records(friction=0.0, noise=0.01, duration=20.0):
    hidden = effect("coulomb_friction", port="load")
    source = Simulation(
        system=FlexibleDrive(),
        effects=(hidden,) if friction else (),
        values={**DRIVE, **({"coulomb_friction@load.level": friction,
                             "coulomb_friction@load.width": 0.05} if friction else {})},
        inputs={"torque": {"noise": 2.0, "band": [0.2, 8]}},
        duration=duration,
        rate=200.0,
        noise_level=noise,
        seed=3,
    )  # fmt: skip
    return tuple(s.load(FlexibleDrive())[0] for s in (source, source.as_test()))


@pytest.fixture(scope="module")
def records():
    return drive_records(friction=0.6)


def test_hidden_states_are_inferred_not_taken_as_zero(records):
    """Scales at the hidden port agree with the simulated truth, though the seed lacks friction."""
    model = replace(seed_model(FlexibleDrive()), values=DRIVE)
    along = states_along_records(model, records[:1])
    largest = largest_port_motion(model.system, records[:1], along)
    for port, state in (("load.position", "load"), ("load.velocity", "load_rate")):
        truth = np.abs(records[0].truth[state]).max()
        assert 0.5 * truth < largest[port] < 2.0 * truth
    assert largest["wall.velocity"] == 0.0


def test_values_that_are_unknown_do_not_stop_the_inference(records):
    largest = largest_port_motion(
        FlexibleDrive(), records[:1], states_along_records(seed_model(FlexibleDrive()), records[:1])
    )
    assert largest["load.velocity"] > 0.0


def test_places_that_no_sensor_sees_have_the_motion_that_a_filter_expects(records):
    """What lies between a measured and a hidden coordinate is no difference of two estimates."""
    model = replace(seed_model(FlexibleDrive()), values=DRIVE)
    along = states_along_records(model, records[:1])
    expected = (0.01 * along[0],)
    plain, given = (
        largest_port_motion(model.system, records[:1], along, e) for e in ((), expected)
    )
    ports = {p.name: p for p in (*model.system.ports, *model.system.links)}
    hidden = [n for n in plain if n.split(".")[0] in ports and "motor" not in n and plain[n]]
    assert {"load.position", "load.velocity"} <= set(hidden)
    assert all(given[n] == pytest.approx(0.01 * plain[n]) for n in hidden)
    assert all(given[n] == plain[n] for n in plain if n.startswith(("motor.", "torque.")))


def test_a_port_where_nothing_moves_leaves_its_candidate_out_by_name(records):
    model = replace(seed_model(FlexibleDrive()), values=DRIVE)
    names = [effect("coulomb_friction", port=p) for p in ("load", "wall")]
    assembly = assemble(Problem(model, records[:1], records[1:], None, tuple(names)))
    assert "nothing moves at wall" in assembly.left_out["coulomb_friction@wall"]
    assert {v.original.label for v in assembly.variants} == {"coulomb_friction@load"}
    assert np.isfinite(initial_values(assembly)).all()


def test_a_candidate_that_is_no_number_leaves_the_study_to_the_others(records):
    model = replace(seed_model(FlexibleDrive()), values=DRIVE)
    candidates = (effect("cubic_stiffness"), ShortRoot(port="load"))
    assembly = assemble(Problem(model, records[:1], records[1:], None, candidates))
    assert list(assembly.left_out) == ["short_root@load"]
    assert "not a number" in assembly.left_out["short_root@load"]
    assert {v.original.label for v in assembly.variants} == {"cubic_stiffness"}


def test_measured_states_are_those_of_the_polynomial():
    """Where every state is measured no filter runs and nothing depends on the model."""
    source = Simulation(system=Oscillator(), values={"system.mass": 1.0,
        "linear_stiffness.stiffness": 4e4, "linear_damping.damping": 20.0},
        inputs={"force": {"noise": 1.0, "band": [5, 60]}}, duration=2.0, rate=1000.0)  # fmt: skip
    record = source.load(Oscillator())[0]
    known = replace(seed_model(Oscillator()), values={"system.mass": 7.0})
    first, second = (
        states_along_records(m, (record,))[0] for m in (seed_model(Oscillator()), known)
    )
    np.testing.assert_array_equal(first, second)


def test_friction_at_a_hidden_load_is_found_and_the_still_wall_named(records):
    """Before, its width was zero there, 0/0 made the whole study 'diverged'."""
    names = ("coulomb_friction@load", "cubic_stiffness@load", "quadratic_damping@load")
    candidates = tuple(effect(n) for n in (*names, "coulomb_friction@wall"))
    model = replace(seed_model(FlexibleDrive()), values={k: 0.7 * v for k, v in DRIVE.items()})
    run = discover(Problem(model, records[:1], records[1:], None, candidates, strategy=Shooting()))
    assert run.stopped != "diverged"
    assert admitted(run)[:1] == ["coulomb_friction@load"]
    assert "nothing moves" in run.rounds[0].rejected["coulomb_friction@wall"]


def test_times_that_nobody_gave_are_the_middle_of_what_the_record_can_show(records):
    """Geometric, between four periods in the record and ten samples a period."""
    wide = replace(seed_model(FlexibleDrive()), values=DRIVE).add(effect("lag", port="load"))
    found, scaled = with_scaled_shapes(wide, records[:1])
    samples, dt = records[0].samples, records[0].dt
    middle = np.sqrt(4 / (samples * dt) * 0.1 / dt)
    assert scaled == ("lag@load.time_constant",)
    assert found.values[scaled[0]] == pytest.approx(1 / (2 * np.pi * middle))


def test_shapes_that_nobody_gave_are_the_middle_of_their_grids(records):
    """Of what the record shows at the port without the effect; those given stay."""
    model = replace(seed_model(FlexibleDrive()), values=DRIVE)
    known = {"clearance@load.gap": 0.01}
    wide = model.add(effect("coulomb_friction", port="load"))
    wide = wide.add(effect("clearance", port="load"), known)
    found, scaled = with_scaled_shapes(wide, records[:1])
    largest = largest_port_motion(
        model.system, records[:1], states_along_records(model, records[:1])
    )
    width = 0.02 * largest["load.velocity"]
    added = {k: v for k, v in found.values.items() if k not in DRIVE}
    assert added == known | {"coulomb_friction@load.width": pytest.approx(width)}
    assert scaled == ("coulomb_friction@load.width",)
    assert with_scaled_shapes(found, records[:1]) == (found, ())


def _warm_plate(start):
    """A plate whose temperature is measured, declared to begin at ``start``, and a hidden store."""
    system = spiral.system(
        ["C*T' = P - h*(T - To) - g*(T - S)", "D*S' = g*(T - S)"],
        states={"T": {"unit": "K", "start": start}, "S": {"unit": "K", "like": "T"}},
        inputs={"P": "W", "To": "K"}, observed=["T"], free=["h", "g"],
        parameters={"C": (400.0, "J/K"), "D": (900.0, "J/K"), "h": (3.0, "W/K"), "g": (2.0, "W/K")},
    )  # fmt: skip
    time = np.arange(400.0)
    power = 60.0 * (np.sin(time / 30) > 0)
    warm = 310.0 + 8.0 * np.sin(time / 30 - 1.2)
    return make_record(
        system, "plate", time, {"T": warm}, {"P": power, "To": 0 * time + 293}
    ), system


def test_a_measured_state_moves_wherever_it_is_declared_to_begin():
    """It stood still where a definition says its start: shapes were scaled by that one value."""
    seen = []
    for start in (0.0, 305.0):
        record, system = _warm_plate(start)
        (states,) = states_along_records(seed_model(system), (record,))
        seen.append(states[:, 0])
        assert np.ptp(states[:, 0]) == pytest.approx(16.0, rel=0.02)
    np.testing.assert_allclose(seen[0], seen[1])


def test_a_reference_that_nobody_gave_is_the_middle_of_what_it_is_counted_from():
    """A temperature in K: from zero, a parabola over 302 to 318 K is one with the constant."""
    record, system = _warm_plate(305.0)
    model = seed_model(system).add(effect("quadratic_change", port="h-T"))
    found, scaled = with_scaled_shapes(model, (record,))
    assert scaled == ("quadratic_change@h-T.reference",)
    assert found.values[scaled[0]] == pytest.approx(310.0, abs=0.5)
    given = seed_model(system).add(effect("quadratic_change", port="h-T"), {scaled[0]: 300.0})
    assert with_scaled_shapes(given, (record,)) == (given, ())
