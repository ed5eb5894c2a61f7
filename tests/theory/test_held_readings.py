"""Readings that an input enters directly, where the input is held between samples."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.engine.filter.extended import filter_record
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import predict_readings
from spiral.engine.series import prepare_series, sample_inputs
from spiral.inference.simulate import integrate
from spiral.types.model import seed_model
from spiral.types.record import make_record

R, C, OHMIC, DT = 2.0, 0.4, 0.7, 0.05
TRUTH = {"system.R": R, "system.C": C, "system.Rs": OHMIC}


def cell(between="zero_order"):
    """A cell: v' = (i - v / R) / C, its voltage E - v - Rs i read."""
    return spiral.system(
        ["v' = (i - v/R)/C"],
        states={"v": "V"},
        inputs={"i": {"unit": "A", "interpolation": between}},
        parameters={"R": f"{R} ohm", "C": f"{C} F", "Rs": f"{OHMIC} ohm"},
        observed=["U = -v - Rs*i"],
        free=["R", "C", "Rs"],
    )


def steps(samples, seed=2):
    """A current that jumps every few samples."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(size=samples // 5 + 1), 5)[:samples]


def exact_voltage(current):
    """The readings, each with the current of its own sample; v integrated from jump to jump."""
    v, read = 0.0, []
    for i in current:
        read.append(-v - OHMIC * i)
        run = solve_ivp(lambda _, s, i=i: (i - s / R) / C, (0, DT), [v], rtol=1e-11, atol=1e-13)
        v = run.y[0, -1]
    return np.array(read)


def test_a_reading_has_the_value_that_its_own_sample_holds():
    current = steps(80)
    time = DT * np.arange(len(current))
    model = seed_model(cell(), values=TRUTH)
    _, readings = integrate(model, time, {"i": current}, substeps=4)
    np.testing.assert_allclose(readings[:, 0], exact_voltage(current), atol=1e-8)


@pytest.mark.parametrize("substeps", [1, 3])
def test_stages_hold_from_one_sample_to_the_next(substeps):
    current, system = steps(80), cell()
    record = make_record(system, "r", DT * np.arange(80), {"U": current + 0.0}, {"i": current})
    stages = prepare_series(system, record, substeps).inputs[:, 0]
    np.testing.assert_array_equal(stages[:-1], np.repeat(current[:-1], 3 * substeps))
    assert stages[-1] == current[-1]
    middle = np.append(current[0], 0.5 * (current[1:] + current[:-1]))
    np.testing.assert_array_equal(sample_inputs(stages[:, None], substeps)[:, 0], middle)


def test_filters_read_so_too():
    """At the true values nothing is missed but noise, of either filter."""
    current = steps(400)
    read = exact_voltage(current) + 1e-3 * np.random.default_rng(1).normal(size=400)
    record = make_record(cell(), "r", DT * np.arange(400), {"U": read}, {"i": current})
    task, settings = prepare_filter(
        prepare_task(seed_model(cell(), values=TRUTH), record, substeps=1), ()
    )
    run = predict_readings(task, settings, first_noise(task, 0.0))
    assert np.std(run.misses[50:]) == pytest.approx(1e-3, rel=0.1)
    other = filter_record(task, settings)
    assert np.std(other.innovations[50:]) == pytest.approx(1e-3, rel=0.1)


def test_values_of_a_held_input_are_found():
    """The study of such a record: right values, nothing invented, the hold confirmed."""
    rng = np.random.default_rng(4)

    def record(seed):
        current = steps(1500, seed)
        read = exact_voltage(current) + 0.01 * rng.normal(size=1500)
        return make_record(cell(), f"r{seed}", DT * np.arange(1500), {"U": read}, {"i": current})

    start = {k: v * f for (k, v), f in zip(TRUTH.items(), (1.1, 0.9, 1.15), strict=True)}
    run = spiral.compare(record(5), cell(), test=record(6), values=start)
    for key, value in TRUTH.items():
        assert abs(run.model.values[key] - value) < 4 * run.model.errors[key]
