"""A parameter that follows a variable is named beside a flow that really acts at random."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.types.record import make_record

DT, HELD = 10.0, 50  # s; samples for which inputs stay


def vessel():
    """A stirred vessel with one reaction; only its product is measured."""
    return spiral.system(
        ["A' = q*(Af - A) - k*A", "B' = k*A - q*B"],
        states={"A": "mol/m^3", "B": "mol/m^3"},
        inputs={"q": {"unit": "1/s", "interpolation": "zero_order"},
                "T": {"unit": "K", "interpolation": "zero_order"}},
        parameters={"Af": (2000.0, "mol/m^3"), "k": {"value": 1.6e-3, "unit": "1/s", "lower": 0}},
        free=["k"], observed=["B"],
    )  # fmt: skip


def measured(seed, samples, slope, varies):
    """The rate grows by ``slope`` per K, and the feed ``varies`` (mol/m^3) within ten minutes."""
    rng = np.random.default_rng(seed)
    q, warm = (np.repeat(rng.uniform(*span, samples // HELD), HELD)
               for span in ((0.8e-3, 2.4e-3), (322.0, 342.0)))  # fmt: skip
    keep, feed, a, b, seen = np.exp(-DT / 600), 0.0, 1000.0, 800.0, []
    for k in range(samples):
        seen.append(b)
        feed = keep * feed + varies * np.sqrt(1 - keep**2) * rng.normal()
        rate = 1.8e-3 * np.exp(slope * (warm[k] - 332))
        for _ in range(20):
            a, b = (a + DT / 20 * (q[k] * (2000 + feed - a) - rate * a),
                    b + DT / 20 * (rate * a - q[k] * b))  # fmt: skip
    read = np.array(seen)
    read += 0.01 * read.std() * rng.normal(size=samples)
    return make_record(vessel(), f"r{seed}", DT * np.arange(samples), {"B": read},
                       {"q": q, "T": warm})  # fmt: skip


def study(seed, slope, progress=False, varies=120):
    return spiral.discover(
        measured(seed, 2000, slope, varies), vessel(),
        test=measured(seed + 1, 1200, slope, varies),
        settings={"max_rounds": 1}, progress=progress,
    )  # fmt: skip


def test_a_rate_that_follows_the_temperature_is_named_beside_a_random_feed():
    run = study(1, 0.025)
    assert len(run.missing) == 1
    assert run.missing[0].endswith("_change@k-T")
    assert max(run.rounds[-1].comparison.random.values()) > 0.3
    assert "random flow" in run.summary


@pytest.mark.slow
def test_a_change_that_leads_all_candidates_is_asked_with_them():
    """It passes in the first round, among whose suggestions are forms of the same change."""
    said = []
    run = study(3, 0.025, said.append)
    assert sum("score better than any candidate" in m for m in said) == 1
    assert not any("laws with a closed form" in m for m in said)
    assert run.rounds[-1].admitted[0].endswith("_change@k-T")


def test_beside_a_change_that_explains_all_candidates_are_not_raced_to_their_end():
    said = []
    run = study(5, 0.025, said.append, varies=0)
    assert run.rounds[-1].admitted[0].endswith("_change@k-T")
    assert not any("trying candidates" in m for m in said)


@pytest.mark.parametrize("seed", [pytest.param(10, marks=pytest.mark.slow), 12])
def test_no_parameter_follows_anything_where_only_the_feed_varies(seed):
    assert not study(seed, 0.0).missing


def swinging(seed, samples=3000, rate=200.0):
    """An oscillator with a cubic spring under a random force; its sensor's zero is off by 10 %."""
    rng = np.random.default_rng(seed)
    force = sosfilt(butter(4, [1.0, 12.0], "band", fs=rate, output="sos"), rng.normal(size=samples))
    force *= 25.0 / force.std()
    x, v, seen, parts = 0.0, 0.0, [], 10
    for k in range(samples):
        seen.append(x)
        for i in range(parts):
            push = force[k] + (force[min(k + 1, samples - 1)] - force[k]) * i / parts
            v += (push - 2.0 * v - 900.0 * x - 2.5e5 * x**3) / (rate * parts)
            x += v / (rate * parts)
    read = np.array(seen)
    read += read.std() * (0.1 + 0.02 * rng.normal(size=samples))
    return make_record(
        Oscillator(), f"s{seed}", np.arange(samples) / rate, {"x": read}, {"force": force}
    )


@pytest.mark.slow
def test_a_spring_that_a_parabola_of_stiffness_stands_for_keeps_its_name():
    """k (1 + a x + b x^2) is a quadratic and a cubic spring: two amplitudes, which show no lead.

    Beside a sensor whose zero is off both are of use, the cubic spring alone is not enough.
    """
    values = {"system.mass": 1.0, "linear_stiffness.stiffness": 8e2, "linear_damping.damping": 1.8}
    run = spiral.discover(
        swinging(0), Oscillator(), test=swinging(1), values=values,
        candidates=["cubic_stiffness", "offset", "constant_load"], progress=False,
    )  # fmt: skip
    assert run.rounds[1].admitted[0].startswith("cubic_stiffness")
    assert not any("_change" in name for name in run.missing)
