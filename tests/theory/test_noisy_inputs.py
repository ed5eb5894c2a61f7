"""Inputs that are measured beside white noise: it is taken from them where the record says so.

L i' = u - R i                     u is read as u + n, and -n acts like a force at random,
                                   but one that u tells
"""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, sosfilt

import spiral
from spiral.engine.series import interpolate_input, without_white_noise
from spiral.types.record import make_record

N, RATE = 4000, 2000.0


def smooth(seed, edge, count=N):
    """A signal of unit variance up to a share ``edge`` of half the rate."""
    rng = np.random.default_rng(seed)
    u = sosfilt(butter(6, edge, output="sos"), rng.normal(size=count + 200))[200:]
    return u / u.std()


@pytest.mark.parametrize("edge", [0.02, 0.05, 0.1, 0.2])
def test_noise_is_left_where_the_signal_is(edge):
    """Of white noise a filter that knows the spectrum leaves the share ``edge`` of its power."""
    u, noise = smooth(1, edge), 0.02 * np.random.default_rng(2).normal(size=N)
    left = without_white_noise(u + noise) - u
    assert np.mean(left**2) < (1.5 * edge + 0.15) * np.mean(noise**2)


def test_a_signal_without_noise_stays():
    u = smooth(3, 0.1)
    assert np.abs(without_white_noise(u) - u).max() < 1e-3
    straight = 3.0 - 0.01 * np.arange(N)
    assert without_white_noise(straight) == pytest.approx(straight, abs=1e-9)


def test_several_columns_are_done_one_by_one_and_short_ones_are_left():
    values = np.column_stack([smooth(k, 0.1) for k in range(2)]) + 0.01 * np.ones((N, 2))
    both = without_white_noise(values)
    assert np.array_equal(both[:, 1], without_white_noise(values[:, 1]))
    count = np.arange(50.0)
    assert interpolate_input(count**2, count, count, "denoised") == pytest.approx(count**2)


def circuit():
    return spiral.system(
        ["L*i' = u - R*i"], states={"i": "A"}, inputs={"u": "V"},
        parameters={"L": {"value": 0.012, "unit": "H", "lower": 0},
                    "R": {"value": 1.8, "unit": "ohm", "lower": 0}},
        free=["L", "R"], observed=["i"],
    )  # fmt: skip


def measured(seed, share):
    """A coil of 10 mH and 2 ohm under a smooth voltage, read with noise of a share of it."""
    u, fine = smooth(seed, 0.08), 10
    push = CubicSpline(np.arange(N), u)((np.arange(N * fine) + 0.5) / fine)
    kept = np.exp(-2.0 / 0.01 / (RATE * fine))
    i = lfilter([(1 - kept) / 2.0], [1.0, -kept], push)[fine - 1 :: fine]
    read, rng = np.concatenate([[0.0], i[:-1]]), np.random.default_rng(100 + seed)
    return make_record(
        circuit(), f"r{seed}", np.arange(N) / RATE,
        {"i": read + 0.002 * read.std() * rng.normal(size=N)},
        {"u": u + share * rng.normal(size=N)},
    )  # fmt: skip


def study(share):
    return spiral.discover(measured(1, share), circuit(), test=measured(2, share), progress=False)


def test_noise_of_a_measured_voltage_is_nothing_missing():
    """It is told, and values are right within their errors: L was off by 13 of these."""
    run = study(0.01)
    assert (run.verdict, run.missing) == ("nothing_missing", ())
    last = run.rounds[-1].comparison
    assert last.between == {"u": "denoised"}
    assert "record.hold=denoised" in run.summary
    assert last.noise_floor == pytest.approx(0.002, rel=0.15)
    for name, true in (("R", 2.0), ("L", 0.01)):
        told = run.estimates().loc[("system", name)]
        assert abs(told["estimate"] - true) < 3 * told["se"] < 0.01 * true


def test_a_voltage_without_noise_runs_as_it_did():
    assert not study(0.0).rounds[-1].comparison.between
