"""Likelihood beside innovations that follow their own past."""

import numpy as np
import pytest
from scipy import special

from spiral.engine.likelihood.autoregression import (
    autoregressive_order,
    coloured_log_likelihood,
    fit_autoregression,
)
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.predict import Prediction

SAMPLES = 1500


def estimate_of(misses, slopes=None):
    """A maximum whose whitened innovations and their slopes are given (records, samples, ..)."""
    none = np.zeros((0, 0, 0))
    slopes = [np.zeros((*e.shape, 0)) for e in misses] if slopes is None else slopes
    parts = tuple(
        Prediction(e, np.ones_like(e), x, none, none, none, none, none, len(e))
        for e, x in zip(misses, slopes, strict=True)
    )
    keys = tuple(f"k{j}" for j in range(slopes[0].shape[2]))
    height = sum(float(p.sample_log_likelihoods.sum()) for p in parts)
    return MaximumLikelihood((), None, keys, height, parts, None, True, 0)


def order_of(at, masks=None):
    """The order of the autoregression of an estimate's innovations."""
    return autoregressive_order(at.predictions, masks)


def first_order(rng, samples=SAMPLES, share=0.9, channels=1):
    """An autoregression of first order with innovations of size one."""
    e = rng.normal(size=(samples, channels))
    for k in range(1, samples):
        e[k] += share * e[k - 1]
    return e


def test_white_misses_follow_no_past():
    orders = [
        autoregressive_order(
            estimate_of([np.random.default_rng(s).normal(size=(SAMPLES, 2))]).predictions
        )
        for s in range(40)
    ]
    assert orders == [0] * 40


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_order_of_an_autoregression_is_found(order):
    rng = np.random.default_rng(order)
    e = rng.normal(size=(4000, 1))
    for k in range(order, len(e)):
        e[k] += 0.7 * e[k - order]
    assert order_of(estimate_of([e])) == order


def test_without_a_past_it_is_the_gaussian_likelihood():
    """Innovations of size one, uncorrelated: both are -1/2 sum (log 2 pi + e^2)."""
    at = estimate_of([np.random.default_rng(3).normal(size=(SAMPLES, 2))])
    assert coloured_log_likelihood(at, 0) == pytest.approx(at.log_likelihood, abs=3.0)


def test_the_gain_is_that_of_the_smaller_innovations():
    """N/2 log of the variance over that of what the past does not tell: 1 / (1 - 0.81)."""
    rng = np.random.default_rng(5)
    e = first_order(rng, 20000)
    at = estimate_of([e])
    gain = coloured_log_likelihood(at, 1) - coloured_log_likelihood(at, 0)
    assert gain == pytest.approx(0.5 * len(e) * np.log(1 / (1 - 0.81)), rel=0.02)


def test_rows_are_whitened_with_the_innovations():
    """Two channels that follow each other: what is left is white and of covariance one."""
    rng = np.random.default_rng(13)
    a, e = np.array([[0.5, 0.4], [-0.3, 0.6]]), rng.normal(size=(6000, 2)) * [1.0, 3.0]
    for k in range(1, len(e)):
        e[k] += a @ e[k - 1]
    past = fit_autoregression(estimate_of([e]).predictions)
    assert pytest.approx(a, abs=0.05) == past.weights.T
    left = past.whiten(np.stack([e, 2.0 * e], axis=2))
    assert np.cov(left[1:, :, 0].T) == pytest.approx(np.eye(2), abs=0.05)
    assert left[:, :, 1] == pytest.approx(2.0 * left[:, :, 0])
    assert order_of(estimate_of([left[:, :, 0]])) == 0
    assert fit_autoregression(estimate_of([rng.normal(size=(SAMPLES, 2))]).predictions) is None


def test_records_and_masks_are_taken_apart():
    rng = np.random.default_rng(7)
    records = [first_order(rng, 700), first_order(rng, 900)]
    masks = [np.arange(700) < 300, None]
    whole = coloured_log_likelihood(estimate_of(records), 1, masks)
    parts = [np.zeros((700, 1)), np.zeros((900, 1))]
    for e, out in zip(records, parts, strict=True):
        out[1:] = e[:-1]
    now = np.concatenate([records[0][:300], records[1]])
    past = np.concatenate([parts[0][:300], parts[1]])
    left = now - past * float((past.T @ now / (past.T @ past)).item())
    expected = -0.5 * len(now) * (np.log(2 * np.pi) + np.log(np.mean(left**2)) + 1)
    assert whole == pytest.approx(expected, rel=1e-12)


def test_a_channel_that_is_not_read_there_does_not_count():
    """Masked samples in which one of two sensors has no reading: the other one alone."""
    rng = np.random.default_rng(9)
    one, x = first_order(rng, 900), rng.normal(size=(900, 2, 1))
    both = estimate_of([np.hstack([one, rng.normal(size=(900, 1))])], [x])
    part = both.predictions[0]
    part.misses[:400, 1] = part.spreads[:400, 1] = 0.0
    masks = [np.arange(900) < 400]
    alone = estimate_of([one], [x[:, :1]])
    assert order_of(both, masks) == order_of(alone, masks) == 1
    assert coloured_log_likelihood(both, 1, masks) == pytest.approx(
        coloured_log_likelihood(alone, 1, masks), rel=1e-12
    )


def test_parameters_follow_to_the_values_of_generalised_least_squares():
    """What is left at the maximum does not depend on where the parameters were before."""
    rng = np.random.default_rng(11)
    e, x = first_order(rng, 4000), rng.normal(size=(4000, 1, 2)).cumsum(axis=0)
    heights = [
        coloured_log_likelihood(estimate_of([e + x @ np.array(shift)], [x]), 1)
        for shift in ([0.0, 0.0], [0.5, -0.2])
    ]
    assert heights[0] == pytest.approx(heights[1], abs=0.1)


def test_wilks_test_holds_its_level_beside_coloured_misses():
    """A slow column beside AR(0.9) misses: half pass a test at 5 % that takes them for white."""
    passed = np.zeros(2, dtype=int)
    seeds = 300
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        e, x = first_order(rng, 600), first_order(rng, 600)[:, :, None]
        with_it, without = estimate_of([e], [x]), estimate_of([e])
        order = order_of(without)
        for i, p in enumerate((0, order)):
            heights = [coloured_log_likelihood(at, p) for at in (with_it, without)]
            passed[i] += special.chdtrc(1, 2 * max(heights[0] - heights[1], 0.0)) < 0.05
    assert passed[0] > 0.4 * seeds
    assert passed[1] < 0.09 * seeds  # 0.05 and three standard errors
