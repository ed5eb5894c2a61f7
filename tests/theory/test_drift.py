"""A sensor that drifts and a state that is pushed at random: both wander, and are told apart."""

import numpy as np
import pytest
from scipy.linalg import expm

import spiral
from spiral.inference.problem import silent
from spiral.types.record import make_record

SAMPLES, STEP, HELD = 2400, 10.0, 60  # samples, s, samples for which the power stays
TRUE = {"g": 6.0, "h": 3.0, "C": 3000.0, "Cl": 15000.0}


def oven():
    """C T' = P - g (T - Tl) - h T, Cl Tl' = g (T - Tl), above the room; both are measured."""

    def rhs(t, x, u, p):
        passed = p.g * (x.T - x.Tl)
        return (u.P - passed - p.h * x.T) / p.C, passed / p.Cl

    return spiral.system(
        rhs, states={"T": "K", "Tl": "K"},
        inputs={"P": {"unit": "W", "interpolation": "zero_order"}}, observed=["T", "Tl"],
        parameters={"g": (5.0, "W/K"), "h": (3.6, "W/K"), "C": (3000.0, "J/K"),
                    "Cl": (18000.0, "J/K")},
        free=["g", "h", "Cl"],
    )  # fmt: skip


def record_of(system, seed, drift=0.0, pushed=0.0, loss=0.0):
    """Exact for a held power (``loss`` T^2 by steps of a sample); ``drift`` K over a record on T.

    ``pushed`` K a sample are added to T itself at random.
    """
    rng = np.random.default_rng(seed)
    power = np.repeat(rng.uniform(0, 900, SAMPLES // HELD), HELD)
    g, h, c, cl = TRUE.values()
    rates = np.zeros((3, 3))
    rates[0], rates[1] = [-(g + h) / c, g / c, 1 / c], [g / cl, -g / cl, 0.0]
    over = expm(rates * STEP)
    states, x = np.empty((SAMPLES, 2)), np.zeros(2)
    for k in range(SAMPLES):
        states[k] = x
        x = over[:2, :2] @ x + over[:2, 2] * (power[k] - loss * x[0] ** 2)
        x[0] += pushed * rng.normal()
    seen = states + 0.3 * rng.normal(size=states.shape)
    seen[:, 0] += drift * np.cumsum(rng.normal(size=SAMPLES)) / np.sqrt(SAMPLES)
    seen[:, 0] += drift * np.linspace(0, 1, SAMPLES)
    readings = {"T": seen[:, 0], "Tl": seen[:, 1]}
    return make_record(system, f"seed {seed}", np.arange(SAMPLES) * STEP, readings, {"P": power})


@pytest.fixture(scope="module")
def drifting():
    system = oven()
    return spiral.discover(record_of(system, 4, drift=5.0), system, progress=silent)


def test_a_sensor_that_drifts_is_no_random_flow(drifting):
    last = drifting.rounds[-1].comparison
    assert drifting.verdict == "nothing_missing", drifting.summary
    assert "drift.T" in last.random
    assert not {k for k in last.random if k.startswith(("force", "gust"))}
    assert "ensor T drifts by" in drifting.summary


def test_values_beside_a_drift_are_the_true_ones(drifting):
    told = drifting.model.estimates()["system"]
    for name in ("g", "h", "Cl"):
        assert abs(told[name].estimate - TRUE[name]) < 3 * told[name].se


def test_what_a_drift_makes_of_a_free_run_counts_by_the_motion_of_the_test(drifting):
    """The same drift is a larger share of a test record that moves less."""
    last = drifting.rounds[-1].comparison
    assert last.drifting > 0.5 * last.random["drift.T"] / np.sqrt(2)
    assert last.test_error < 3 * np.hypot(last.noise_floor, last.drifting)


def test_a_random_flow_is_no_drift():
    system = oven()
    run = spiral.discover(record_of(system, 5, pushed=0.1), system, progress=silent)
    random = run.rounds[-1].comparison.random
    assert not {k for k in random if k.startswith("drift")}
    assert any(k.startswith(("force", "gust")) for k in random)


@pytest.mark.slow
def test_a_loss_beside_a_drift_is_named_alone():
    system = oven()
    run = spiral.discover(record_of(system, 6, drift=5.0, loss=0.02), system, progress=silent)
    assert run.missing in (("quadratic_loss@T",), ("quadratic_loss",)), run.summary
    told = run.model.estimates()[run.missing[0]]["rate"]
    assert abs(told.estimate - 0.02 / TRUE["C"]) < 3 * told.se
