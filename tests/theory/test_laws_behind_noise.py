"""A law that a sensor's coloured noise would hide: laws are tried where curves are."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.problem import silent
from spiral.math import exp, where
from spiral.types.record import make_record

STEP, HELD = 10.0, 60  # s; samples for which inputs stay


def reactor():
    """A cooled tank with an exothermic reaction (Arrhenius); the concentration is not measured."""

    def rhs(t, x, u, p):
        hot = where(x.temp > 250, x.temp, 250)
        reacts = p.rate * exp(8000 * (1 / 330 - 1 / hot)) * x.c
        through = p.ua * (x.temp - x.jacket)
        taken = 4180 * u.coolant * (x.jacket - 288)
        return (
            (2000 - x.c) / 600 - reacts,
            (u.feed - x.temp) / 600 + 0.015 * reacts - through / 8e5,
            (through - taken) / 1.2e5,
        )

    return spiral.system(
        rhs,
        states={"c": "mol/m^3", "temp": "K", "jacket": "K"},
        inputs={"feed": {"unit": "K", "interpolation": "zero_order"},
                "coolant": {"unit": "kg/s", "interpolation": "zero_order"}},
        observed=["temp", "jacket"],
        parameters={"rate": (1.8e-3, "1/s"), "ua": (1300.0, "W/K")},
        free=["rate", "ua"],
    )  # fmt: skip


def record_of(system, slope, seed, samples):
    """A record in which ``ua`` falls with time, with white noise of 0.5 % on both sensors."""
    rng = np.random.default_rng(seed)
    feed, coolant = (np.repeat(rng.uniform(*span, samples // HELD), HELD)
                     for span in ((300, 325), (0.02, 0.25)))  # fmt: skip

    def rates(t, x, k):
        reacts = 2e-3 * np.exp(8000 * (1 / 330 - 1 / x[1])) * x[0]
        through = 1500 * (1 + slope * t) * (x[1] - x[2])
        return [(2000 - x[0]) / 600 - reacts,
                (feed[k] - x[1]) / 600 + 0.015 * reacts - through / 8e5,
                (through - 4180 * coolant[k] * (x[2] - 288)) / 1.2e5]  # fmt: skip

    x, rows = [1300.0, 315.0, 300.0], []
    for k in range(0, samples, HELD):
        time = STEP * np.arange(k, k + HELD + 1)
        part = solve_ivp(rates, time[[0, -1]], x, "LSODA", time, args=(k,), rtol=1e-9, atol=1e-9)
        rows.append(part.y[1:, :HELD])
        x = part.y[:, -1]
    seen = np.hstack(rows)
    seen += 0.005 * seen.std(axis=1, keepdims=True) * rng.normal(size=seen.shape)
    time, channels = STEP * np.arange(samples), dict(zip(("temp", "jacket"), seen, strict=True))
    return make_record(system, f"seed {seed}", time, channels, {"feed": feed, "coolant": coolant})


@pytest.mark.slow
def test_a_surface_that_fouls_is_named_though_coloured_noise_explains_as_much():
    system = reactor()
    fit, test = (record_of(system, -2e-5, seed, 1440) for seed in (1, 2))
    run = spiral.discover(fit, system, test=test, progress=silent)
    assert run.missing == ("linear_change@ua-time",)
    told = run.model.estimates()["linear_change@ua-time"]["slope"]
    assert abs(told.estimate + 2e-5) < 3 * told.se
    assert run.rounds[0].comparison.floor <= run.rounds[0].comparison.test_error
