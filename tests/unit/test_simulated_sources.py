"""Simulated and embedded records, and inputs described in words."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spiral.inference.excitation import excite
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError, InputError

REGISTRY = load_registry()
ROTOR = REGISTRY.make("system", "planar_rotor")
OSCILLATOR = REGISTRY.make("system", "oscillator")
VALUES = {
    "system.mass": 1.0,
    "linear_stiffness.stiffness": 4e4,
    "linear_damping.damping": 4.0,
}
TIME = 0.001 * np.arange(2000)


def rng(seed=0):
    return np.random.default_rng(seed)


def source(name, **fields):
    return REGISTRY.make("source", name, fields, "record")


def oscillation(**fields):
    usual = {"values": VALUES, "inputs": {"force": {"noise": 1.0, "band": [5, 100]}}}
    return source("simulation", **{**usual, "duration": 1.0, **fields})


def test_sweep_is_linear_and_converted():
    values = excite("speed", {"sweep": [40, 0], "unit": "Hz"}, TIME, "rad/s", rng())
    assert math.isclose(values[0], 80 * math.pi)
    np.testing.assert_allclose(np.diff(values), -80 * math.pi / len(TIME))


@pytest.mark.parametrize("form", ["noise", "multisine"])
def test_random_inputs_have_their_size_and_band(form):
    values = excite("force", {form: 2.0, "band": [50, 100]}, TIME, "N", rng())
    assert math.isclose(np.sqrt(np.mean(values**2)), 2.0, rel_tol=1e-9)
    power = np.abs(np.fft.rfft(values)) ** 2
    frequency = np.fft.rfftfreq(len(TIME), 0.001)
    outside = (frequency < 50) | (frequency > 100)
    assert power[outside].sum() < 1e-20 * power.sum()


def test_chirp_runs_through_its_band():
    values = excite("force", {"chirp": 3.0, "band": [5, 50]}, TIME, "N", rng())
    assert math.isclose(np.abs(values).max(), 3.0, rel_tol=1e-3)
    crossings = np.flatnonzero(np.diff(np.sign(values)) != 0)
    assert np.diff(crossings)[0] > 4 * np.diff(crossings)[-1]


@pytest.mark.parametrize(
    ("description", "word"),
    [
        ({"swep": [1, 2]}, "'swep'"),
        ({}, "0 forms"),
        ({"sweep": [1, 2], "constant": 1}, "2 forms"),
        ({"sweep": 3}, "sweep"),
        ({"noise": "loud"}, "noise"),
        ({"noise": 1.0, "band": [10, 5000]}, "band"),
        ({"noise": 1.0, "band": [10.1, 10.2]}, "band"),
        ("fast", "fast"),
        ({"constant": 1, "unit": "kg"}, "kg"),
    ],
)
def test_descriptions_that_do_not_fit(description, word):
    with pytest.raises((ConfigError, InputError)) as caught:
        excite("speed", description, TIME, "rad/s", rng())
    assert word in caught.value.given


def test_simulation_declares_its_noise_and_keeps_the_truth():
    record = oscillation(noise_level=0.05).load(OSCILLATOR)[0]
    left = record.channels["x"] - record.truth["x"]
    assert math.isclose(np.std(left), record.noise["x"], rel_tol=0.1)
    assert math.isclose(record.noise["x"], 0.05 * np.std(record.truth["x"]), rel_tol=1e-6)
    assert set(record.truth) == {"x", "x_rate"}


def test_simulation_solves_its_equation():
    """m x'' + c x' + k x = force, with x'' from a spline through x'."""
    from scipy.interpolate import CubicSpline

    record = oscillation(duration=2.0, rate=4000.0, noise_level=0.0).load(OSCILLATOR)[0]
    x, v, f = record.truth["x"], record.truth["x_rate"], record.inputs["force"]
    a = CubicSpline(record.time, v).derivative()(record.time)
    balance = (a + 4.0 * v + 4e4 * x - f)[20:-20]
    assert np.std(balance) < 1e-3 * np.std(f)


def test_seeds_decide_everything():
    one, same, other = (oscillation(seed=s).load(OSCILLATOR)[0] for s in (3, 3, 4))
    assert one.sha256 == same.sha256
    assert one.sha256 != other.sha256
    assert not np.array_equal(one.inputs["force"], other.inputs["force"])


def test_effects_are_added_and_left_out():
    plain = oscillation().truth(OSCILLATOR)
    cubic = oscillation(effects=["cubic_stiffness"], without=["linear_damping"])
    labels = cubic_labels = None
    with pytest.raises(ConfigError, match="linear_damping"):
        cubic.truth(OSCILLATOR)  # its value has no parameter any more
    values = {k: v for k, v in VALUES.items() if "damping" not in k}
    cubic = oscillation(
        effects=["cubic_stiffness"], without=["linear_damping"],
        values={**values, "cubic_stiffness.stiffness": 1e9},
    )  # fmt: skip
    labels, cubic_labels = plain.labels, cubic.truth(OSCILLATOR).labels
    assert labels == ("linear_stiffness", "linear_damping")
    assert cubic_labels == ("linear_stiffness", "cubic_stiffness")


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"effects": ["cubic_stifness"]}, "cubic_stifness"),
        ({"without": ["linear_dampin"]}, "linear_dampin"),
        ({"inputs": {"torque": {"constant": 1}}}, "torque"),
        ({"inputs": None}, "force"),
        ({"values": {"system.mas": 1.0}}, "system.mas"),
        ({"values": {}}, "system.mass"),
        ({"duration": 0.0}, "duration"),
        ({"noise_level": -1.0}, "noise_level"),
        ({"system": "oscilator"}, "oscilator"),
    ],
)
def test_simulations_that_cannot_be(fields, word):
    with pytest.raises((ConfigError, InputError)) as caught:
        oscillation(**fields).load(OSCILLATOR)
    assert word in caught.value.given


def coastdown(**fields):
    return source("rotor_coastdown", duration=1.0, **fields).load(ROTOR)[0]


def test_coastdown_is_the_papers():
    record = coastdown(start_hz=40.0, stop_hz=37.0)
    assert math.isclose(record.inputs["speed"][0], 80 * math.pi)
    assert record.measured == ("speed", "phase")
    assert record.inputs["phase"][0] == 0.0
    assert {"alpha", "beta"} <= set(record.truth)
    assert record.truth["x"][0] == 0.0
    assert record.noise["x"] > 0


def test_phase_of_the_mark_turns_the_response():
    """A settled isotropic response turns with the mark; here only: another mark, another record."""
    one, other = coastdown(phase=0.4), coastdown(phase=1.3)
    assert np.std(one.truth["x"] - other.truth["x"]) > 0.1 * np.std(one.truth["x"])


def test_settled_record_starts_without_a_transient():
    """At constant speed the settled response repeats after one turn from the first sample on."""
    record = coastdown(start_hz=40.0, stop_hz=40.0, settled=True)
    x, turn = record.truth["x"], 25
    assert np.abs(x[turn : 2 * turn] - x[:turn]).max() < 1e-3 * np.abs(x).max()
    fresh = coastdown(start_hz=40.0, stop_hz=40.0).truth["x"]
    assert np.abs(fresh[turn : 2 * turn] - fresh[:turn]).max() > 0.1 * np.abs(fresh).max()


def test_records_in_the_studys_units():
    millimetres = REGISTRY.make("system", "planar_rotor", {"position_unit": "mm"})
    metres = coastdown()
    record = source("rotor_coastdown", duration=1.0).load(millimetres)[0]
    np.testing.assert_allclose(record.channels["x"], 1e3 * metres.channels["x"], rtol=1e-12)
    assert math.isclose(record.noise["x"], 1e3 * metres.noise["x"])


def test_a_system_that_does_not_match_is_refused():
    with pytest.raises(InputError, match="'y'"):
        source("rotor_coastdown", duration=1.0).load(OSCILLATOR)


def test_phase_can_be_left_to_follow_from_speed():
    record = source(
        "simulation", system="tilting_rotor", duration=1.0, measured_phase=False,
        inputs={"speed": {"sweep": [40, 35], "unit": "Hz"}},
    ).load(ROTOR)[0]  # fmt: skip
    assert record.measured == ("speed",)
    turned = np.trapezoid(record.inputs["speed"], record.time)
    assert math.isclose(record.inputs["phase"][-1], turned, rel_tol=1e-6)


def test_undamped_motion_never_settles():
    values = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e4}
    with pytest.raises(ConfigError, match="decays"):
        oscillation(settled=True, without=["linear_damping"], values=values).load(OSCILLATOR)


@settings(max_examples=30, deadline=None)
@given(a=st.floats(-1e3, 1e3), b=st.floats(-1e3, 1e3))
def test_sweep_ends_where_it_should(a, b):
    values = excite("force", {"sweep": [a, b]}, TIME, "N", rng())
    end = values[-1] + (b - a) / len(TIME)
    assert math.isclose(values[0], a, abs_tol=1e-9)
    assert math.isclose(end, b, abs_tol=1e-9)
