"""Rates of inputs by a spline as smooth as the noise of the samples asks for."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from spiral.engine.series import rate_per_sample

DT = 1 / 400


def _moved(seed=0):
    """A base that moves at 1 to 20 Hz, and its rate by the spectrum."""
    rng = np.random.default_rng(seed)
    band = butter(4, [1, 20], "band", fs=1 / DT, output="sos")
    values = sosfiltfilt(band, rng.normal(size=4000)) * np.hanning(4000)
    turns = 2j * np.pi * np.fft.rfftfreq(4000, DT)
    return values, np.fft.irfft(turns * np.fft.rfft(values), 4000), rng


@pytest.mark.parametrize(("noise", "most"), [(0.0, 0.02), (0.01, 0.04)])
def test_a_base_that_moves_fast_has_its_own_rate(noise, most):
    """With knots 64 samples apart, as a rotor's speed has them, nearly nothing of it is left."""
    values, rate, rng = _moved()
    seen = values + noise * values.std() * rng.normal(size=len(values))
    samples = np.arange(len(values), dtype=float)
    found = rate_per_sample(seen, samples, samples) / DT
    assert np.std(found - rate) < most * np.std(rate)


def test_a_rotors_noisy_speed_keeps_a_smooth_rate():
    """A run-down of 2 rad/s^2 at 1 kHz, its speed with noise of 0.2 %."""
    samples = np.arange(5000.0)
    speed = 250 - 0.002 * samples + 0.5 * np.random.default_rng(0).normal(size=5000)
    found = rate_per_sample(speed, samples, samples)
    assert np.std(found + 0.002) < 0.02


def test_waves_of_six_samples_have_their_own_rate():
    """Swell on a buoy, read twice a second to four digits: a spline of fifth order follows it."""
    rng, samples = np.random.default_rng(2), np.arange(2000.0)
    turns, phase = 2 * np.pi * rng.uniform(0.02, 0.165, 60), rng.uniform(0, 6.28, 60)
    fine = np.arange(1999 * 2 + 1) / 2
    seen = np.round(np.sin(samples[:, None] * turns + phase).sum(axis=1), 4)
    rate = (turns * np.cos(fine[:, None] * turns + phase)).sum(axis=1)
    found = rate_per_sample(seen, samples, fine)
    assert np.std(found - rate) < 0.002 * np.std(rate)
