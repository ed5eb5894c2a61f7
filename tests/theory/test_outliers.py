"""Readings of a force or an acceleration that stand out: the sensor's fault, or the machine's."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.problem import silent
from spiral.types.record import in_blocks, make_record, split_off_test

DT, COUNT = 0.01, 1500
AT = np.array([211, 640, 902, 1333])


def table():
    """A mass between a spring and a damper, its acceleration and its place read."""
    return spiral.system(
        ["m*x'' + c*x' + k*x = F"], states={"x": "m"}, observed=["x''", "x"],
        inputs={"F": {"unit": "N", "interpolation": "zero_order"}},
        parameters={"m": (2.0, "kg"), "c": (3.0, "N*s/m"), "k": (180.0, "N/m")}, free=["c", "k"],
    )  # fmt: skip


def measured(spikes=0.0, kicks=0.0, seed=0):
    """Noise of 1 %; four readings off by ``spikes`` (m/s^2), or four samples with ``kicks`` (N)."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(size=COUNT // 10), 10) * 10
    acting = force.copy()
    acting[AT] += kicks
    states, rates = [np.zeros(2)], []
    for f in acting:

        def rate(t, x, f=f):
            return [x[1], (f - 3.0 * x[1] - 180.0 * x[0]) / 2.0]

        rates.append(rate(0, states[-1])[1])
        step = solve_ivp(rate, (0, DT), states[-1], rtol=1e-8, atol=1e-10)
        states.append(step.y[:, -1])
    x, a = np.array(states)[:-1, 0], np.array(rates)
    a = a + 0.01 * a.std() * rng.normal(size=COUNT)
    a[AT] += spikes * np.array([1, -1, 1, 1])
    x = x + 0.01 * x.std() * rng.normal(size=COUNT)
    channels = {"x_acceleration": a, "x": x}
    return make_record(table(), "table", DT * np.arange(COUNT), channels, {"F": force})


def told(record):
    return spiral.discover(record, table(), candidates=[], holdout=0.2, progress=silent)


def test_a_reading_that_neither_model_nor_motion_knows_is_left_out():
    """Of the part that is kept apart, too."""
    record = measured(spikes=40.0)
    assert not record.spoilt  # the signal alone does not tell
    run = told(record)
    assert "sensor x_acceleration: 3 readings (0.25 %) stand out" in run.summary.lower()
    assert "in the test record, sensor x_acceleration: 1 reading" in run.summary.lower()
    clean = told(measured())
    for key in ("system.c", "system.k"):
        assert run.model.errors[key] == pytest.approx(clean.model.errors[key], rel=0.1)


def test_a_force_that_acted_for_one_sample_is_no_fault_of_the_sensor():
    """Nobody recorded it, and the acceleration stands out as much: but the mass moves on."""
    record = measured(kicks=80.0)
    assert "stand out" not in told(record).summary


def test_parts_of_a_record_are_the_record_again():
    record = measured(spikes=40.0).without_readings({"x": np.arange(COUNT) == 1400})
    first, last = split_off_test(record, 0.2)
    whole = first.followed_by(last)
    np.testing.assert_array_equal(whole.time, record.time)
    np.testing.assert_array_equal(whole.channels["x"], record.channels["x"])
    np.testing.assert_array_equal(whole.inputs["F"], record.inputs["F"])
    assert np.flatnonzero(whole.gone("x")).tolist() == [1400]
    assert in_blocks(whole, 1) == (whole,)


def body():
    """A body and a slow store behind it, of which nobody reads the second."""
    return spiral.system(
        ["C*T' = P - g*(T - S)", "D*S' = g*(T - S)"],
        states={"T": "K", "S": "K"}, observed=["T"],
        inputs={"P": {"unit": "W", "interpolation": "zero_order"}},
        parameters={"C": (500.0, "J/K"), "D": (4e4, "J/K"), "g": (4.0, "W/K")}, free=["C", "g"],
    )  # fmt: skip


def test_a_test_that_goes_on_from_a_fitted_record_begins_where_that_ends():
    """A settling part of minutes does not tell a store of hours; what was read before does."""
    rng, dt, count = np.random.default_rng(3), 10.0, 1500
    power = np.repeat(rng.uniform(-150, 200, count // 50), 50)
    states, x = [], np.zeros(2)
    for p in power:
        states.append(x)
        for _ in range(10):
            passed = 4.0 * (x[0] - x[1])
            x = x + dt / 10 * np.array([(p - passed) / 500, passed / 4e4])
    seen = np.array(states)[:, 0]
    seen = seen + 0.05 * seen.std() * rng.normal(size=count)
    record = make_record(body(), "body", dt * np.arange(count), {"T": seen}, {"P": power})
    run = spiral.discover(record, body(), candidates=[], progress=silent, settle=200.0)
    last = run.rounds[-1].comparison
    assert run.verdict == "nothing_missing"
    assert last.test_error < 1.1 * last.noise_floor
