"""The sentence that says where a model fails, on machines whose fault is known."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from spiral_plugins.effects.dissipative import CoulombFriction
from spiral_plugins.effects.restoring import ConstantLoad, CrossCoupledStiffness, CubicStiffness
from spiral_plugins.effects.rotating import Crack
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.evidence.comparison import last_stage, prepare_study
from spiral.inference.evidence.fit_state import all_samples
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.inference.where.latent import (
    add_latent_force,
    latent_keys,
    missing_force,
    smoothed_states,
)
from spiral.inference.where.orders import (
    first_order,
    full_spectrum,
    noise_power,
    order_map,
    time_map,
)
from spiral.inference.where.regions import _channels_in_unit_of, locate_failure
from spiral.types.effect import Effect
from spiral.types.model import seed_model
from tests.scenes import planar_record

CRITICAL = 60 * np.sqrt([8085.0, 9672.0]) / (2 * np.pi)  # rpm, of x and of y


@dataclass(frozen=True)
class Case:
    """A fault: effects of the truth and their values, or what is added to the channels.

    ``rpm`` are the speeds that the named range must lie about; None where all speeds fail.
    """

    rpm: tuple[float, float] | None
    order: int | None
    state: str | None
    power: int | None
    words: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    values: dict | None = None
    known: tuple[Effect, ...] = ()
    sensor: dict | None = None
    hertz: tuple[float, float] = (27.0, 5.0)


CASES = {
    "cubic_stiffness": Case(
        tuple(CRITICAL), 1, "x|y", 3, ("order 1", "amplitude cubed", "both channels"),
        (CubicStiffness(),), {"cubic_stiffness.stiffness": 3e10},
    ),
    "crack": Case(
        tuple(CRITICAL / 2), 2, "phase", 2, ("order 2", "twice per turn"),
        (ConstantLoad(), Crack()),
        {"constant_load.force_x": 0.0, "constant_load.force_y": -9.81, "crack.cosine": 300.0,
         "crack.sine": 0.0},
        (ConstantLoad(),), hertz=(12.0, 5.0),
    ),
    "coulomb_friction": Case(
        tuple(CRITICAL), 1, "x_rate|y_rate", 0,
        ("order 1", "direction of velocity", "both channels"),
        (CoulombFriction(),),
        {"coulomb_friction.level_x": 0.02, "coulomb_friction.level_y": 0.02,
         "coulomb_friction.width": 1e-4},
    ),
    "mains_hum": Case(
        None, None, None, None, ("all speeds", "at 50 Hz", "no single state", "channel x"),
        sensor={"x": lambda t, a: 4e-6 * np.cos(2 * np.pi * 50 * t)},
    ),
    "runout": Case(
        None, 1, "phase", 1, ("all speeds", "order 1", "once per turn", "both channels"),
        sensor={"x": lambda t, a: 1e-5 * np.cos(a + 1), "y": lambda t, a: 1e-5 * np.sin(a + 1)},
    ),
    "cross_coupled_stiffness": Case(
        tuple(CRITICAL), 1, "x|y", 1, ("order 1", "the force on", "following the displacement"),
        (CrossCoupledStiffness(),), {"cross_coupled_stiffness.stiffness": 120.0},
    ),
}  # fmt: skip


def faulty(case):
    record = planar_record(1, case.effects, case.values, duration=12.0, hertz=case.hertz)
    added = {k: v(record.time, record.inputs["phase"]) for k, v in (case.sensor or {}).items()}
    return replace(record, channels={k: v + added.get(k, 0) for k, v in record.channels.items()})


QUICK = ("cubic_stiffness", "mains_hum")


@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in CASES]
)
def test_the_sentence_names_speed_order_and_state(name):
    case = CASES[name]
    model = seed_model(PlanarRotor(), case.known)
    assembly, fit_state = prepare_study(Problem(model, (faulty(case),), ()), ())
    found = locate_failure(assembly, last_stage(assembly, fit_state, all_samples(assembly)))
    if case.rpm is None:
        assert found.speed_rad_s is None
    else:
        low, high = np.array(found.speed_rad_s) * 30 / np.pi
        assert low < max(case.rpm)
        assert high > min(case.rpm)
        assert np.mean((low, high)) == pytest.approx(np.mean(case.rpm), rel=0.2)
        assert high - low < 0.5 * np.mean(case.rpm)
    order = None if found.order is None else round(np.mean(found.order))
    assert order == case.order
    assert found.state is None if case.state is None else found.state in case.state.split("|")
    assert found.power == case.power
    assert [w for w in case.words if w not in found.sentence] == []


def test_noise_alone_has_no_sentence_about_speed():
    record = planar_record(3, duration=4.0)
    assembly, fit_state = prepare_study(Problem(seed_model(PlanarRotor()), (record,), ()), ())
    found = locate_failure(assembly, last_stage(assembly, fit_state, all_samples(assembly)))
    assert found.sentence == "The residual is at the level of the noise everywhere."
    assert found.speed_rad_s is found.order is found.state is None


OSCILLATOR = {"system.mass": 2.0, "linear_stiffness.stiffness": 800.0,
              "linear_damping.damping": 1.6}  # fmt: skip


def test_the_size_of_a_motion_mixes_no_units():
    """Leaves in kg/m^2 beside insects in 1/m^2, thousands of times as large a number."""
    channels = {"leaves": np.arange(4.0), "insects": 1e3 * np.arange(4.0), "eggs": np.ones(4)}
    units = {"leaves": "kg/m^2", "insects": "1/m^2", "eggs": "1/m^2"}
    system = SimpleNamespace(observed=tuple(channels), unit_of=units.get)
    seen = SimpleNamespace(record=SimpleNamespace(channels=channels))
    assert _channels_in_unit_of("leaves", seen, system).tolist() == [[0.0], [1.0], [2.0], [3.0]]
    assert _channels_in_unit_of("eggs", seen, system)[:, 0].tolist() == [0.0, 1e3, 2e3, 3e3]


@pytest.fixture(scope="module")
def walked():
    """An oscillator on which a random walk acts that its model does not know, in N."""
    model = seed_model(Oscillator(), values=OSCILLATOR)
    rng = np.random.default_rng(4)
    time = 0.005 * np.arange(6000)
    force = np.cumsum(rng.normal(0.0, 0.1, len(time)))
    record = simulate(model, time, {"force": force}, 0.02, rng)
    return model, replace(record, inputs={"force": np.zeros(len(time))}), force


def test_the_missing_force_lies_in_its_band_as_often_as_the_band_says(walked):
    model, record, force = walked
    found = missing_force(model, record)
    inner = slice(100, -100)
    error = (found.force[:, 0] - force)[inner]
    inside = np.mean(np.abs(error) < 1.96 * found.deviation[inner, 0])
    assert 0.92 < inside < 0.98
    assert np.sqrt(np.mean(error**2)) < 0.1 * np.std(force)
    assert found.unit == "N"
    assert found.axes == ("x",)


def test_a_hidden_level_lies_in_its_band_as_often_as_the_band_says():
    """Two tanks whose pump gives more or less than it was told to, at random."""
    values = {"pump.gain": 0.04, "outlets.upper": 0.06, "outlets.lower": 0.05, "outlets.width": 0.1}
    rng, time = np.random.default_rng(0), 4.0 * np.arange(1000)
    told = 2.8 + 3 * np.convolve(rng.normal(size=1000), np.ones(30) / 30, "same")
    given = {"pump": told + 0.3 * rng.normal(size=1000)}
    model = seed_model(CascadedTanks(), values=values)
    record = simulate(model, time, given, 0.02, rng)
    found = smoothed_states(model, replace(record, inputs={"pump": told}))
    error = np.abs(found[0][:, 0] - record.truth["upper"])[50:]
    assert 0.9 < np.mean(error < 1.96 * found[1][50:, 0]) < 0.99
    assert np.mean(error) < 0.05 * record.truth["upper"].std()


def test_a_right_model_lacks_no_force(walked):
    model, record, force = walked
    found = missing_force(model, replace(record, inputs={"force": force}))
    assert np.mean(np.abs(found.force)) < 0.01 * np.std(force)


def test_the_force_of_a_known_load_is_found_in_its_unit():
    """m x'' + c x' + k x = 0 pulled aside by 5 N: the smoothed force is 5 N all along."""
    model = seed_model(Oscillator(), values=OSCILLATOR)
    time = 0.005 * np.arange(2000)
    record = simulate(model, time, {"force": np.full(len(time), 5.0)}, 0.01)
    found = missing_force(model, replace(record, inputs={"force": np.zeros(len(time))}))
    assert found.force[200:-200, 0] == pytest.approx(5.0, rel=0.02)


def test_a_model_with_the_unknown_force_keeps_its_own_parameters():
    model = seed_model(Oscillator(), values=OSCILLATOR)
    wide = add_latent_force(model)
    assert latent_keys(wide) == ("latent_force.force",)
    assert {k: wide.values[k] for k in OSCILLATOR} == OSCILLATOR


def test_an_order_stays_one_line_while_the_speed_moves():
    """cos 2 theta over a sweep: all of its power in order 2, half the amplitude's square."""
    time = 1e-3 * np.arange(8000)
    speed = 2 * np.pi * (30.0 - 2.5 * time)
    phase = 2 * np.pi * (30.0 * time - 1.25 * time**2)
    found = order_map(3.0 * np.cos(2 * phase)[:, None], phase, speed, 1e-3)
    peak = found.axis[np.argmax(found.power, axis=1)]
    assert np.all(peak == 2.0)
    assert found.power.max(axis=1) == pytest.approx(4.5, rel=0.02)
    assert found.at[0] > found.at[-1]


def test_first_order_gives_amplitude_and_lag():
    """A cos(theta - lag) has amplitude A and that lag, in degrees behind the mark."""
    time = 1e-3 * np.arange(6000)
    phase = 2 * np.pi * 20.0 * time
    y = np.column_stack([2.0 * np.cos(phase - 0.5), 1.0 + np.sin(phase)])
    found = first_order(y, phase, np.full(6000, 40 * np.pi), turns=6)
    assert np.abs(found.amplitude) == pytest.approx(np.tile([2.0, 1.0], (len(found.speed), 1)))
    assert found.lag[:, 0] == pytest.approx(np.degrees(0.5))
    assert found.lag[:, 1] == pytest.approx(90.0)


@pytest.mark.parametrize("backward", [False, True])
def test_forward_whirl_stands_at_positive_frequency(backward):
    turn = -1.0 if backward else 1.0
    time = 1e-3 * np.arange(4096)
    angle = turn * 2 * np.pi * 125.0 * time
    frequency, amplitude = full_spectrum(np.cos(angle), np.sin(angle), 1e-3, backward)
    assert frequency[np.argmax(amplitude)] == pytest.approx(125.0)
    assert amplitude.max() == pytest.approx(1.0, rel=1e-2)


def test_maps_know_what_white_noise_makes_of_them():
    """Mean power over time x frequency and over speed x order, of two channels of variance one."""
    rng = np.random.default_rng(8)
    dt, noise = 1e-3, rng.normal(size=(20000, 2))
    time = dt * np.arange(len(noise))
    found = time_map(noise, dt)
    assert np.mean(found.power[:, 2:-2].T / noise_power(found, dt, 2)) == pytest.approx(1, abs=0.02)
    angle, speed = 2 * np.pi * (10 * time + 0.5 * time**2), 2 * np.pi * (10 + time)
    turned = order_map(noise, angle, speed, dt)
    ratio = turned.power / noise_power(turned, dt, 2, turning=True)[:, None]
    assert np.mean(ratio[:, 2:]) == pytest.approx(1, abs=0.05)
    slow = order_map(noise, angle / 10, speed / 10, dt)  # less than one sample for each of its own
    ratio = slow.power / noise_power(slow, dt, 2, turning=True)[:, None]
    assert np.mean(ratio[:, 2:]) == pytest.approx(1, abs=0.2)
