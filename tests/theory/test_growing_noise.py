"""Noise that grows with its reading: a concentration that is read within a share of itself."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task, with_start_spread
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import predict_readings, vary_noise
from spiral.types.record import make_record

DT, COUNT, SHARE = 0.1, 900, 0.04
TRUE = {"k12": 0.5, "k21": 0.2, "ke": 0.17}


def compartments():
    def rhs(t, x, u, p):
        return [u.dose / p.V - (p.k12 + p.ke) * x.c + p.k21 * x.d, p.k12 * x.c - p.k21 * x.d]

    return spiral.system(
        rhs, states={"c": "g/l", "d": "g/l"}, observed=["c"],
        inputs={"dose": {"unit": "g/s", "interpolation": "zero_order"}},
        parameters={"V": (1.0, "l"), "k12": (0.4, "1/s"), "k21": (0.25, "1/s"), "ke": (0.2, "1/s")},
        free=["k12", "k21", "ke"],
    )  # fmt: skip


def measured(seed, pushed=0.0):
    """Doses with long pauses: readings from 10 to 0.01, within 4 % and 0.004 of what they are.

    ``pushed`` : deviation (1/s) of a random exchange with the hidden compartment, by sample.
    """
    rng, dose = np.random.default_rng(seed), np.zeros(COUNT)
    for begin in range(10, COUNT, 300):
        dose[begin : begin + 20] = rng.uniform(3.0, 8.0)
    states = [np.array([0.2, 0.2])]
    for u in dose[:-1]:
        more = pushed * rng.normal() if pushed else 0.0

        def rate(t, x, u=u, more=more):
            exchanged = TRUE["k12"] * x[0] - TRUE["k21"] * x[1] + more
            return [u - exchanged - TRUE["ke"] * x[0], exchanged]

        states.append(solve_ivp(rate, (0, DT), states[-1], rtol=1e-9, atol=1e-12).y[:, -1])
    c = np.array(states)[:, 0]
    c = c + np.hypot(SHARE * c, 0.004) * rng.normal(size=COUNT)
    return make_record(compartments(), "doses", DT * np.arange(COUNT), {"c": c}, {"dose": dose})


def test_each_reading_has_its_own_variance():
    """Of a machine whose beginning is known and that nothing disturbs s_k is the noise's."""
    record = replace(measured(1), growth={"c": (0.5, 2.0, 1.7)})
    values = {f"system.{k}": v for k, v in TRUE.items()}
    task = prepare_task(spiral.Model(compartments(), (), values), record)
    task = with_start_spread(task, np.full(2, 1e-9))
    noise = first_noise(task, 1e-9).with_values({"white.c": 0.03})
    run = predict_readings(*prepare_filter(task, (), {}), noise, keep=True)
    smooth = task.series.smooth_readings(11)[0]
    due = 0.03**2 * (1 + ((smooth - 0.5) / 2.0) ** 2) / 1.7
    due[run.spreads == 0] = 0.0  # what is taken for a spike is left out
    np.testing.assert_allclose(run.spreads, due, rtol=1e-6)
    larger = noise.with_values({"white.c": 0.06})
    ((_, spreads),) = vary_noise(*prepare_filter(task, (), {}), noise, [larger], run)
    np.testing.assert_allclose(spreads, 4 * due, rtol=1e-6)


@pytest.fixture(scope="module")
def runs():
    return [spiral.discover(measured(seed), compartments(), holdout=0.3) for seed in range(4)]


def test_nothing_is_missing_beside_noise_that_grows(runs):
    for run in runs:
        assert (run.verdict, run.missing) == ("nothing_missing", ())
        assert "noise of sensor c grows with its reading" in run.summary


def test_values_are_right_within_their_errors(runs):
    off = [
        (run.model.values[f"system.{k}"] - v) / run.model.errors[f"system.{k}"]
        for run in runs
        for k, v in TRUE.items()
    ]
    assert np.sqrt(np.mean(np.square(off))) < 1.6
    errors = [run.model.errors["system.k12"] for run in runs]
    assert np.max(errors) < 0.01  # the small readings tell as much as the large ones


def test_it_is_told_beside_a_random_flow_of_some_size():
    """Beside a flow of more than five hundredths the noise is no less of that kind."""
    for seed in range(2):
        run = spiral.discover(measured(seed, 0.4), compartments(), holdout=0.3)
        assert (run.verdict, run.missing) == ("nothing_missing", ())
        assert "noise of sensor c grows with its reading" in run.summary
        assert "random flow" in run.summary
