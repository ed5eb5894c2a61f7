"""The tests' own error rates: uniform p-values where nothing is there, power where something is."""

import numpy as np
import pytest
from scipy import stats

from spiral.engine.statistics import ljung_box, paired_errors, round_level, whiteness
from spiral.types.noise import estimate_noise, expected_noise_estimate


def test_whiteness_p_values_are_uniform_on_white_noise():
    rng = np.random.default_rng(0)
    p = [whiteness((rng.normal(size=(1500, 1)),), 20).p for _ in range(200)]
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_whiteness_over_channels_is_bonferroni_and_sees_colour():
    rng = np.random.default_rng(1)
    white = rng.normal(size=(1500, 2))
    coloured = white.copy()
    coloured[1:, 1] += 0.5 * white[:-1, 1]
    assert whiteness((white,), 20).p > 0.001
    found = whiteness((coloured,), 20)
    assert found.p < 1e-6
    assert found.effect > 0.1


def test_samples_left_out_do_not_make_a_residual_white_or_coloured():
    rng = np.random.default_rng(2)
    values = rng.normal(size=(2000, 1))
    values[500:1000] = 0.0
    assert whiteness((values,), 20).p > 0.001


def test_the_level_spent_over_all_rounds_is_the_study_level():
    assert sum(round_level(0.01, r) for r in range(1, 100_000)) == pytest.approx(0.01, rel=1e-4)


def test_equal_predictors_are_told_apart_at_the_nominal_rate():
    rng = np.random.default_rng(3)
    p = []
    for _ in range(400):
        noise = rng.normal(size=(2560, 1))
        envelope = np.exp(-(np.linspace(-3, 3, 2560) ** 2))[:, None]  # energy in few blocks
        miss = 0.3 * envelope * rng.normal(size=(2560, 1))
        other = 0.3 * envelope * rng.normal(size=(2560, 1))
        p.append(paired_errors((noise + miss,), (noise + other,), 32).p_differ)
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_a_better_predictor_is_seen_even_where_few_blocks_hold_the_energy():
    rng = np.random.default_rng(4)
    noise = rng.normal(size=(2560, 1))
    missing = np.zeros((2560, 1))
    missing[1000:1040] = 3.0 * np.sin(np.arange(40))[:, None]
    found = paired_errors((noise + missing,), (noise,), 32)
    assert found.fall > 0
    assert found.share == pytest.approx(1.0, abs=0.2)
    assert found.p_fall < 1e-4


def test_the_share_is_above_one_half_exactly_where_the_error_falls():
    rng = np.random.default_rng(5)
    for _ in range(50):
        a, b = rng.normal(size=(2, 640, 2))
        found = paired_errors((a,), (b,), 32)
        assert found.fall == pytest.approx(np.sum(a * a) - np.sum(b * b))
        assert (found.share > 0.5) == (found.fall > 0)


def test_a_diverged_model_never_wins():
    rng = np.random.default_rng(6)
    good, bad = rng.normal(size=(640, 1)), np.full((640, 1), np.inf)
    assert paired_errors((good,), (bad,), 32).p_fall == 1.0
    assert paired_errors((bad,), (good,), 32).p_fall == 0.0


@pytest.mark.parametrize("sigma", [1e-6, 0.02, 3.0])
def test_noise_is_estimated_without_a_model(sigma):
    rng = np.random.default_rng(7)
    time = np.arange(20_000) * 1e-3
    signal = 50 * sigma * np.sin(2 * np.pi * 15 * time)
    found = estimate_noise(signal + sigma * rng.normal(size=len(time)))
    assert found == pytest.approx(sigma, rel=0.05)


def test_kinks_of_a_signal_leave_the_robust_estimate_alone():
    """A rate under a force that jumps every fifty samples: its kinks are no noise."""
    rng = np.random.default_rng(8)
    rate = 1.0 * np.cumsum(np.repeat(rng.uniform(-40, 40, 80), 50))
    values = rate + rng.normal(size=len(rate))
    assert estimate_noise(values) > 1.2
    assert estimate_noise(values, robust=True) == pytest.approx(1.0, rel=0.1)
    assert estimate_noise(values - rate, robust=True) == pytest.approx(1.0, rel=0.1)


def test_ljung_box_is_that_of_statsmodels():
    from statsmodels.stats.diagnostic import acorr_ljungbox

    values = np.cumsum(np.random.default_rng(2).normal(size=300)) * 0.1 + 3.0
    for lags in (1, 7, 40):
        expected = acorr_ljungbox(values, lags=[lags])["lb_stat"].iloc[0]
        assert ljung_box(values, lags) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8])
def test_what_the_model_free_estimate_tells_of_coloured_noise_is_known(memory):
    """AR(1) noise of deviation one: differences see only what changes from sample to sample."""
    rng = np.random.default_rng(4)
    noise = np.zeros(100_000)
    for t, e in enumerate(rng.normal(scale=np.sqrt(1 - memory**2), size=len(noise))):
        noise[t] = memory * noise[t - 1] + e
    expected = expected_noise_estimate(memory ** np.arange(13.0))
    assert expected == pytest.approx(estimate_noise(noise), rel=0.02)
    assert expected == pytest.approx(1.0) if memory == 0 else expected < 0.9
