"""What is done to a user's numbers on request: a known rotor comes back from a spoilt record."""

from functools import lru_cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from spiral_plugins.strategies.shooting import Shooting

from spiral.types.errors import SpiralError
from tests.scenes import SEED_TRUTH, planar_record
from tests.spoilt import (
    NOISE,
    OSCILLATOR,
    ROTOR,
    angle_error,
    columns,
    key_phasor,
    load,
    note,
    refusal,
    rms,
    rotor,
    with_key,
)

# --- pulses and the sense of rotation ------------------------------------------------------------


def test_phase_and_speed_from_a_pulse():
    """Each sampled pulse is late by up to 1 ms, 0.25 rad at 40 Hz; the phase is far better."""
    record = rotor()
    found = load(with_key(record), pulse="key")
    typical, worst = angle_error(found.inputs["phase"], record.inputs["phase"])
    assert typical < 0.02
    assert worst < 0.08
    speed = record.inputs["speed"]
    assert rms(found.inputs["speed"] - speed) < 1e-3 * speed.max()
    assert set(found.measured) == {"phase", "speed"}
    assert "135 pulses of 'key' (falling edge" in note(found, "pulses")


@pytest.mark.parametrize("count", [500, 1000, 2000, 4000])
def test_phase_error_falls_with_the_sample_interval(count):
    """Marks scatter by dt/sqrt(12) in time, uniformly; the smoothed phase by less than that."""
    time = np.arange(6 * count) / count
    phase = 2 * np.pi * (20 * time - time**2)
    quiet = np.random.default_rng(0).normal(size=(2, len(time)))
    table = {"t": time, "a": quiet[0], "b": quiet[1], "key": key_phasor(phase, noise=0.0)}
    found = load(table, pulse="key")
    scatter = 2 * np.pi * 20 / count / np.sqrt(12)
    assert angle_error(found.inputs["phase"], phase)[0] < 0.5 * scatter


def test_a_pulse_beside_a_column_of_speed():
    record = rotor()
    table = with_key(record, "speed")
    found = load(table, pulse="key", inputs={"speed": "speed"}, pulse_edge="rising")
    np.testing.assert_array_equal(found.inputs["speed"], record.inputs["speed"])
    assert angle_error(found.inputs["phase"], record.inputs["phase"])[0] < 0.02
    assert "rising edge" in note(found, "pulses")
    wrong = refusal(table, pulse="key", inputs={"speed": "speed"}, units={"speed": "rpm"})
    assert "turns by phase" in wrong.given
    assert "record.units" in wrong.try_


def test_clockwise_makes_speed_and_phase_negative():
    """A tachometer and a pulse do not tell the sense; the motion and its phase do."""
    record = rotor(-1)
    table = {**with_key(record), "n": np.abs(record.inputs["speed"]) * 30 / np.pi}
    fields = {"inputs": {"speed": "n"}, "units": {"speed": "rpm"}, "rotation": "clockwise"}
    found = load(table, pulse="key", **fields)
    np.testing.assert_allclose(found.inputs["speed"], record.inputs["speed"])
    assert angle_error(found.inputs["phase"], record.inputs["phase"])[0] < 0.02
    assert "clockwise" in note(found, "clockwise")
    alone = load(with_key(record), pulse="key", rotation="clockwise")
    assert rms(alone.inputs["speed"] - record.inputs["speed"]) < 0.3
    negative = refusal(columns(record, "speed"), inputs={"speed": "speed"}, rotation="clockwise")
    assert "negative already" in negative.given


def test_what_pulses_cannot_be():
    record = rotor()
    table = with_key(record)
    late = record.time > 2.0
    first = int(np.flatnonzero(late & (table["key"] < -14))[0])
    lost, doubled = table["key"].copy(), table["key"].copy()
    lost[first - 1 : first + 4] = -9.0
    doubled[first + 10] = -16.0
    start = table["key"].copy()
    start[record.time < 0.5] = -9.0
    cases = [
        ({"key": lost}, {}, "a pulse is missing"),
        ({"key": doubled}, {}, "a pulse too many"),
        ({"key": np.where(late, -9.0, table["key"])}, {}, "no pulse in the last"),
        ({"key": start}, {}, "no pulse in the first"),
        ({"key": np.full(len(late), -9.0)}, {}, "constant"),
        ({"key": np.where(record.time < 5.8, -9.0, table["key"])}, {}, "pulses"),
        ({}, {"pulse_level": 3.0}, "pulse_level"),
        ({}, {"pulse": "kee"}, "kee"),
        ({"phase": record.inputs["phase"]}, {"inputs": {"phase": "phase"}}, "column of phase"),
    ]
    for changed, fields, word in cases:
        error = refusal({**table, **changed}, **{"pulse": "key", **fields})
        assert word in error.given, word
        assert error.try_
    place = refusal({**table, "key": lost}, pulse="key").given
    before, after = (float(w) for w in place.split("between ")[1].split(" s ")[0].split(" and "))
    assert before < record.time[first] < after
    other = {"system": OSCILLATOR, "channels": {"x": "a"}, "inputs": {"force": "b"}}
    assert "a rotor" in refusal(table, **other, pulse="key").expected
    assert "a rotor" in refusal(table, **other, rotation="clockwise").expected


def test_a_phase_that_jumps_by_a_turn_is_made_continuous():
    record = rotor()
    table = columns(record, "speed", "phase")
    table["phase"] = np.degrees(table["phase"]) % 360.0
    found = load(table, units={"phase": "deg"})
    assert angle_error(found.inputs["phase"], record.inputs["phase"])[1] < 1e-9
    assert note(found, "continuous")


def test_a_fit_with_pulses_is_the_fit_with_measured_phase():
    """Stiffness, damping and unbalance agree within their standard errors, and with the truth."""
    from spiral.inference.compare import compare
    from spiral.inference.problem import Problem
    from spiral.types.model import seed_model

    record = planar_record(3, noise=0.05, duration=4.0, hertz=(30.0, 8.0))
    found = load({**with_key(record), "key": np.cos(record.inputs["phase"])}, pulse="key")
    fits = [
        compare(Problem(seed_model(ROTOR), (r,), (), strategy=Shooting())) for r in (record, found)
    ]
    assert all(f.converged and f.chi2_per_dof < 1.1 for f in fits)
    for key, value in SEED_TRUTH.items():
        measured, pulsed = (f.model.values[key] for f in fits)
        error = fits[1].model.errors[key]
        assert abs(pulsed - value) < 4 * error
        assert abs(pulsed - measured) < 2 * error


# --- probes and run-out --------------------------------------------------------------------------


@pytest.mark.parametrize("angles", [(45.0, 135.0), (-45.0, 45.0), (30.0, 100.0), (90.0, 180.0)])
def test_turned_probes_read_the_same_motion(angles):
    record = rotor()
    x, y = record.channels["x"], record.channels["y"]
    one, two = np.radians(angles)
    table = {**columns(record, "speed"), "a": x * np.cos(one) + y * np.sin(one),
             "b": x * np.cos(two) + y * np.sin(two)}  # fmt: skip
    found = load(table, probe_angles=dict(zip("xy", angles, strict=True)))
    np.testing.assert_allclose(found.channels["x"], x, atol=1e-12)
    np.testing.assert_allclose(found.channels["y"], y, atol=1e-12)
    assert ("correlated" in note(found, "probes")) == (angles == (30.0, 100.0))


def test_declared_noise_follows_the_probes():
    """Noise of the turned readings, measured, against the declared one turned: within 3 %."""
    rng = np.random.default_rng(0)
    count = 20_000
    table = {"t": 1e-3 * np.arange(count), "a": 1e-6 * rng.normal(size=count),
             "b": 3e-6 * rng.normal(size=count), "speed": np.full(count, 100.0)}  # fmt: skip
    fields = {"probe_angles": {"x": 20, "y": 80}, "noise": {"x": 1e-6, "y": 3e-6}}
    found = load(table, **fields)
    for name in "xy":
        assert np.std(found.channels[name]) == pytest.approx(found.noise[name], rel=0.03)
    assert "both probes" in refusal(table, **{**fields, "noise": {"x": 1e-6}}).expected


@pytest.mark.parametrize(
    ("angles", "word"),
    [({"x": 45}, "probe_angles"), ({"x": 0, "z": 9}, "'z'"), ({"x": 10, "y": 185}, "at 185")],
)
def test_probe_angles_that_make_no_plane(angles, word):
    assert word in refusal(columns(rotor(), "speed"), probe_angles=angles).given


@lru_cache(maxsize=1)
def run_up():
    """From 1 Hz, where the shaft does not bend, to 25 Hz, through both resonances."""
    return planar_record(4, noise=NOISE, duration=20.0, hertz=(1.0, 25.0))


RUN_OUT = {"a": (3e-4, 2e-4, 0.0), "b": (-1e-4, -1e-4, 2e-4)}  # mean, cosine, sine in m


def run_out(record):
    """Probe readings with a mean and a run-out several times the motion."""
    phase = record.inputs["phase"]
    table = columns(record, "phase", "speed")
    for key, (mean, cosine, sine) in RUN_OUT.items():
        table[key] = table[key] + mean + cosine * np.cos(phase) + sine * np.sin(phase)
    return table


SLOW = SEED_TRUTH["unbalance.moment"] * 25.0**2 / (8085.0 - 25.0**2)
"""Motion at 25 rad/s, U W^2 / (k - W^2) in m: what is subtracted with the run-out."""


@pytest.mark.parametrize("where", [{"speed": [0, 240]}, {"rows": [0, 2000]}])
def test_slow_roll_is_subtracted_everywhere(where):
    record = run_up()
    fields = {"units": {"speed": "rpm"}, "slow_roll": where}
    table = run_out(record)
    table["speed"] = table["speed"] * 30 / np.pi
    found = load(table, **fields)
    for name in "xy":
        left = rms(found.channels[name] - record.channels[name])
        assert left < SLOW + 3 * record.sigma()[name] * np.sqrt(3 / 2000)
    assert "on a mean of 0.0003" in note(found, "slow roll")
    later = load(table, **{**fields, "slow_roll": {"rows": [0, 2000]}, "rows": [5000, 20000]})
    assert rms(later.channels["x"] - record.channels["x"][5000:20000]) < 2 * SLOW


def test_slow_roll_from_another_file_and_pulses(tmp_path):
    """The mark on the shaft gives both files the same angle."""
    record = run_up()
    table = {**run_out(record), "key": np.cos(record.inputs["phase"] - 1.0)}
    slow = tmp_path / "slow.parquet"
    pd.DataFrame({k: v[:4000] for k, v in table.items()}).to_parquet(slow)
    fast = {k: v[8000:] for k, v in table.items() if k not in ("phase", "speed")}
    where = {"path": str(slow), "rows": [0, 3000]}
    found = load(fast, pulse="key", slow_roll=where, inputs={})
    for name in "xy":
        assert rms(found.channels[name] - record.channels[name][8000:]) < 5 * SLOW


@pytest.mark.parametrize(
    ("fields", "word"),
    [
        ({"slow_roll": {"speed": [200, 300]}}, "no sample"),
        ({"slow_roll": {"rows": [0, 500]}}, "turns in 500 samples"),
        ({"slow_roll": {"rows": [15000, 20000]}}, "speed reaches"),
        ({"slow_roll": {"rows": [0, 30000]}}, "slow_roll rows"),
        ({"slow_roll": {}}, "slow_roll"),
        ({"slow_roll": {"row": [0, 10]}}, "row"),
        ({"slow_roll": {"speed": [9, 3]}}, "speed"),
        ({"slow_roll": {"rows": [0, 2000]}, "inputs": {"speed": "speed"}}, "measured phase"),
    ],
)
def test_slow_rolls_that_are_none(fields, word):
    error = refusal(run_out(run_up()), **fields)
    assert word in error.given
    assert error.expected


# --- together ------------------------------------------------------------------------------------


def test_all_of_it_at_once():
    """Turned probes with run-out, a pulse, clockwise, gaps, uneven steps: the rotor comes back."""
    record = planar_record(4, noise=NOISE, duration=20.0, hertz=(-1.0, -25.0))
    x, y = record.channels["x"], record.channels["y"]
    phase = record.inputs["phase"]
    half = np.sqrt(0.5)
    table = {"t": record.time, "a": half * (x + y) + 1e-4 * np.cos(phase) + 2e-4,
             "b": half * (y - x) + 1e-4 * np.sin(phase), "key": np.cos(phase)}  # fmt: skip
    table["a"][[3000, 9000, 9001]] = np.nan
    kept = np.delete(np.arange(record.samples), [12_000, 12_001])
    table = {k: v[kept] for k, v in table.items()}
    found = load(
        table, pulse="key", rotation="clockwise", fill_gaps=2, probe_angles={"x": 45, "y": 135},
        slow_roll={"speed": [0, 25]}, resample=250, noise={"x": 1e-6, "y": 1e-6},
    )  # fmt: skip
    for name in "xy":
        true = np.interp(found.time, record.time, record.channels[name])
        assert rms(found.channels[name] - true) < SLOW + 2 * record.sigma()[name]
    at = np.interp(found.time, record.time, phase)
    assert angle_error(found.inputs["phase"], at)[0] < 0.01
    assert len(found.notes) == 8


def test_a_dead_or_clipped_probe_shows_before_it_is_turned():
    record = rotor()
    table = columns(record, "speed")
    dead = refusal({**table, "b": np.full(record.samples, 1e-3)}, probe_angles={"x": 45, "y": 135})
    assert "'y' is constant" in dead.given
    clipped = {**table, "a": np.clip(table["a"], -4e-5, 4e-5)}
    found = load(clipped, probe_angles={"x": 45, "y": 135})
    assert "'x' looks clipped" in note(found, "clipped")


OPTIONS = {
    "pulse": st.sampled_from(["key", "a", "t", "nothing"]),
    "pulse_level": st.floats(-20, 20),
    "pulse_edge": st.sampled_from(["rising", "falling", "both"]),
    "rotation": st.sampled_from(["clockwise", "counterclockwise", "left"]),
    "probe_angles": st.dictionaries(st.sampled_from("xyz"), st.floats(), max_size=3),
    "slow_roll": st.dictionaries(
        st.sampled_from(["rows", "speed", "path"]),
        st.one_of(st.tuples(st.integers(-5, 500), st.integers(-5, 500)), st.just("a")),
        max_size=2,
    ),
    "fill_gaps": st.integers(-2, 9),
    "resample": st.floats(),
}


@settings(max_examples=80, deadline=None)
@given(
    fields=st.fixed_dictionaries({}, optional=OPTIONS),
    holes=st.lists(st.integers(0, 399), max_size=6),
    dropped=st.sets(st.integers(0, 399), max_size=6),
)
def test_any_options_give_a_record_or_one_clear_message(fields, holes, dropped):
    record = rotor()
    table = {k: v[:400].copy() for k, v in with_key(record, "speed").items()}
    table["a"][holes] = np.nan
    kept = np.setdiff1d(np.arange(400), list(dropped))
    found, refused = None, None
    try:
        found = load({k: v[kept] for k, v in table.items()}, **fields)
    except SpiralError as error:
        refused = error
    if found is None:
        assert refused.given
        assert refused.expected
        return
    values = (found.time, *found.channels.values(), *found.inputs.values())
    assert all(np.all(np.isfinite(v)) for v in values)


@pytest.mark.slow
def test_a_study_of_pulses_turning_clockwise():
    """The embedded run-down seen from behind: the same effects, cross stiffness turned."""
    from dataclasses import replace

    from spiral.inference.discover import discover
    from tests.scenes import admitted, coastdown_problem

    problem = coastdown_problem(11)
    seen = []
    for record, stop in ((problem.records[0], 13_200), (problem.test[0], 13_100)):
        table = {**with_key(record), "b": -record.channels["y"]}
        seen.append(load(table, pulse="key", rotation="clockwise", rows=[0, stop]))
    run = discover(replace(problem, records=(seen[0],), test=(seen[1],)))
    assert admitted(run)[:3] == ["cross_stiffness", "cubic_stiffness", "gyroscopic"]
    values = run.model.values
    assert values["gyroscopic.coefficient"] == pytest.approx(4.80e-3, rel=0.05)
    assert values["cross_stiffness.stiffness"] == pytest.approx(-1105, rel=0.01)
    assert run.final.chi2_per_dof < 1.15
