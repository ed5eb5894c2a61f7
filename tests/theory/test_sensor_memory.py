"""Noise of a sensor with a memory, which a random flow into a state that relaxes looks like."""

import numpy as np
import pytest
from scipy.signal import lfilter
from spiral_plugins.effects.inputs import RateLimit

import spiral
from spiral.inference.disturbances import random_forces
from spiral.types.record import make_record

DT, COUNT = 0.1, 3000


def vessel():
    """Two vessels in a row, the first with a gauge."""
    return spiral.system(
        ["C*p' = q - f", "L*f' = p - R*f"],
        states={"p": "Pa", "f": "m^3/s"}, inputs={"q": "m^3/s"}, observed=["p"],
        parameters={"C": (1.1, "m^3/Pa"), "L": (0.11, "Pa*s^2/m^3"), "R": (0.9, "Pa*s/m^3")},
        free=["C", "L", "R"],
    )  # fmt: skip


def test_coloured_noise_is_not_told_as_a_random_flow():
    """3 % of a gauge's motion, correlated over 0.5 s, beside 1 % of white noise."""
    rng = np.random.default_rng(3)
    flow = np.repeat(rng.uniform(0, 1, COUNT // 30), 30)
    made = spiral.simulate(
        vessel(), COUNT * DT, 1 / DT, inputs={"q": flow},
        values={"system.C": 1.0, "system.L": 0.1, "system.R": 1.0},
    )  # fmt: skip
    clean = made.channels["p"]
    keep = np.exp(-DT / 0.5)
    coloured = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=COUNT))
    read = clean + clean.std() * (0.03 * coloured + 0.01 * rng.normal(size=COUNT))
    record = make_record(vessel(), "vessel", made.time, {"p": read}, {"q": flow})
    compared = spiral.compare(record, vessel())
    assert compared.random["coloured.p"] == pytest.approx(0.03, rel=0.15)
    assert compared.random_times["coloured.p"] == pytest.approx(0.5, rel=0.3)
    assert not random_forces(compared)


def test_a_rate_limit_that_is_not_reached_is_a_lag_of_width_over_rate():
    assert RateLimit().limit_values({"share": 1.0, "rate": 2.0, "width": 100.0}) == {
        "time_constant": 50.0
    }
