"""A random force around a frequency is told as one, and not as something that is missing."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.problem import silent
from spiral.types.record import make_record

SAMPLES, STEP = 2400, 0.2
TRUE = {"m": 50.0, "c": 12.0, "k": 30.0}


def pontoon():
    """m x'' + c x' + k x = F, moored; its place is measured."""

    def rhs(t, x, u, p):
        return x.v, (u.F - p.c * x.v - p.k * x.x) / p.m

    return spiral.system(
        rhs, states={"x": "m", "v": "m/s"}, inputs={"F": "N"}, observed=["x"],
        parameters={"m": (50.0, "kg"), "c": (14.0, "N*s/m"), "k": (26.0, "N/m")},
        free=["c", "k"],
    )  # fmt: skip


def band_limited(rng, low, high, fine):
    """Gaussian noise between two frequencies, of unit deviation, at ``fine`` points a sample."""
    count = SAMPLES * fine
    hertz = np.fft.rfftfreq(count, STEP / fine)
    inside = (hertz >= low) & (hertz <= high)
    spectrum = np.where(inside, rng.normal(size=hertz.size) + 1j * rng.normal(size=hertz.size), 0)
    series = np.fft.irfft(spectrum, count)
    return series / series.std()


def record_of(system, seed, hardening=0.0, waves=1.5):
    """By DOP853; waves of 0.25 to 0.5 Hz push at random, and nobody measures them."""
    rng = np.random.default_rng(seed)
    force = 12.0 * band_limited(rng, 0.005, 0.2, 10)
    wave = waves * band_limited(rng, 0.25, 0.5, 10)
    fine, time = np.arange(SAMPLES * 10) * STEP / 10, np.arange(SAMPLES) * STEP
    push = force + wave

    def rates(t, s):
        pull = TRUE["k"] * s[0] + TRUE["c"] * s[1] + hardening * s[0] ** 3
        return [s[1], (np.interp(t, fine, push) - pull) / TRUE["m"]]

    run = solve_ivp(
        rates, (0, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-8, atol=1e-10, max_step=STEP
    )
    x = run.y[0]
    seen = x + 0.004 * np.std(x) * rng.normal(size=SAMPLES)
    return make_record(system, f"seed {seed}", time, {"x": seen}, {"F": force[::10]})


@pytest.fixture(scope="module")
def pushed():
    system = pontoon()
    return spiral.discover(record_of(system, 1), system, progress=silent)


@pytest.mark.slow
def test_waves_are_told_with_their_frequency(pushed):
    last = pushed.rounds[-1].comparison
    assert pushed.verdict == "nothing_missing", pushed.summary
    assert "swell.observed" in last.random
    hertz = 1 / (2 * np.pi * last.random_times["swell.observed"])
    assert 0.25 < hertz < 0.5
    assert "machine's own forces, around 0.3" in pushed.summary


@pytest.mark.slow
def test_values_beside_waves_are_the_true_ones(pushed):
    told = pushed.model.estimates()["system"]
    for name in ("c", "k"):
        assert abs(told[name].estimate - TRUE[name]) < 3 * told[name].se


@pytest.mark.slow
def test_a_spring_that_hardens_is_named_beside_waves():
    system = pontoon()
    run = spiral.discover(record_of(system, 2, hardening=40.0), system, progress=silent)
    assert run.missing == ("cubic_stiffness",), run.summary
