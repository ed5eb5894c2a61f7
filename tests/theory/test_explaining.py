"""A candidate that explains all, where a large random force hides it from half of the record."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.problem import Settings
from spiral.inference.strategies.likelihood.explaining import stands_in_for_all
from spiral.types.horizon import Horizon
from spiral.types.model import seed_model
from spiral.types.record import make_record
from spiral.types.run import Comparison

STEP = 0.25  # min
TISSUE, GIVEN = 38.0, 24.0  # L, of the tissue's pool


def dialysis():
    return spiral.system(
        [
            "Vp*a' = K*(b - a) - e*Q*a",
            "Vt*b' = G - K*(b - a)",
            "Vd*c' = e*Q*a - D*c",
        ],
        states={"a": {"unit": "mol/m^3", "start": 25}, "b": {"unit": "mol/m^3", "start": 25},
                "c": {"unit": "mol/m^3", "start": 5}},
        inputs={"Q": "m^3/s", "D": "m^3/s"}, observed=["c"], free=["Vp", "K", "Vd"],
        parameters={
            "Vp": {"value": 10e-3, "unit": "m^3", "lower": 0}, "Vt": (GIVEN / 1e3, "m^3"),
            "Vd": {"value": 0.45e-3, "unit": "m^3", "lower": 0}, "e": (0.72, "1"),
            "K": {"value": 0.8e-3 / 60, "unit": "m^3/s", "lower": 0},
            "G": (0.16e-3 / 60, "mol/s"),
        },
    )  # fmt: skip


def held(count, least, most, levels, rng):
    values = np.empty(count)
    at = 0
    while at < count:
        width = int(rng.integers(least, most + 1))
        values[at : at + width] = rng.choice(levels)
        at += width
    return values


def record(seed, count=1200):
    """A session; the blood flow is recorded with noise of 3 %, the machine ran on the true one."""
    rng = np.random.default_rng(seed)
    blood = held(count, 50, 170, [0, 0, 150, 220, 300, 350, 400], rng) / 1e3
    blood[:60] = 0.3
    spent = held(count, 150, 400, [400, 500, 600], rng) / 1e3
    first = rng.uniform(22, 30)
    states = [np.array([first, 1.01 * first, 0.1])]
    for q, d in zip(blood[:-1], spent[:-1], strict=True):

        def rate(_, x, q=q, d=d):
            exchanged = 0.62 * (x[1] - x[0])
            gone = 0.72 * q * x[0]
            return [
                (exchanged - gone) / 13, (0.16 - exchanged) / TISSUE, (gone - d * x[2]) / 0.35
            ]  # fmt: skip

        states.append(solve_ivp(rate, (0, STEP), states[-1], rtol=1e-9, atol=1e-10).y[:, -1])
    urea = np.array(states)[:, 2]
    urea = urea + 0.01 * urea.std() * rng.normal(size=count)
    noisy = blood + 0.03 * blood.std() * rng.normal(size=count)
    inputs = {"Q": noisy / 6e4, "D": spent / 6e4}
    time = 60 * STEP * np.arange(count)
    return make_record(dialysis(), f"{seed}", time, {"c": urea}, inputs, hold="zero_order")


@pytest.mark.slow
def test_a_known_volume_that_is_wrong_is_not_taken_for_a_random_flow():
    """All volumes, the exchange and the pump scale together: either name is right."""
    run = spiral.discover(record(81), dialysis(), test=record(82))
    assert run.verdict == "effect_missing"
    assert run.missing[0] in ("input_gain", "input_gain@Q", "other_value@Vt")
    assert run.final.test_error < 0.3 * run.rounds[0].comparison.test_error


def test_only_a_large_force_that_explains_nothing_is_doubted():
    settings, ahead = Settings(), Horizon("one_sample", 1, 0.1, {"x": (4e-4,)})
    hidden = Comparison(
        seed_model(Oscillator()), 0.05, 0.11, {}, 0.01, 1.0, 0.4, 0.003, 1024, True,
        random={"force.hidden": 0.5}, disturbed=0.03, unseen=(ahead,),
    )  # fmt: skip
    assert stands_in_for_all(hidden, settings)
    assert not stands_in_for_all(replace(hidden, random={"force.hidden": 0.1}), settings)
    assert not stands_in_for_all(replace(hidden, unseen=()), settings)  # nothing could confirm it
    wind = replace(hidden, driven_unseen=True, disturbed=0.9)
    assert not stands_in_for_all(wind, settings)
