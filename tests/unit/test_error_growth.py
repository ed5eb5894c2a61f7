"""Growth of errors on unseen data: which is chance, which follows from noise, which refuses."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.nearness import unexplained_error_growth
from spiral.inference.problem import Settings
from spiral.types.horizon import Horizon
from spiral.types.model import seed_model
from spiral.types.run import Comparison

SETTINGS = Settings()
GOOD = Comparison(seed_model(Oscillator()), 0.02, 0.0201, {}, 0.02, 1.01, 0.4, 0.003, 1024, True)
SIGNS = (1, -1) * 10


def predicting(next_reading, freely):
    """A model with these errors on unseen data, one sample ahead and running freely."""
    errors = (("one_sample", 1, next_reading), ("free_run", None, freely))
    unseen = tuple(Horizon(n, s, None, {"x": (e**2,) * 20}) for n, s, e in errors)
    return replace(GOOD, unseen=unseen, test_error=freely)


@pytest.mark.parametrize(
    ("after", "where"),
    [
        (predicting(0.0206, 0.0216), None),  # within noise: what wandered had followed readings
        (predicting(0.030, 0.0216), "one_sample"),  # beyond noise (2 %)
        (predicting(0.0206, 0.10), "one_sample"),  # no free run for it
        (predicting(0.0206, 0.11), "one_sample"),
    ],
)
def test_a_next_reading_missed_by_no_more_than_noise_is_worth_a_free_run_that_noise_explains(
    after, where
):
    worse = unexplained_error_growth(predicting(0.0200, 0.10), after, SETTINGS)
    assert (None if worse is None else worse.horizon) == where


@pytest.mark.parametrize(("force", "where"), [(0.15, None), (0.8, "free_run")])
def test_random_forces_that_explain_nothing_excuse_no_error(force, where):
    """They carry the free run as far as it errs, one sample ahead the model is better."""
    before, after = predicting(0.030, 0.30), predicting(0.020, 0.40)
    after = replace(after, random={"force.hidden": force}, innovation_chi2=1.0, disturbed=0.35)
    worse = unexplained_error_growth(before, after, SETTINGS)
    assert (None if worse is None else worse.horizon) == where


@pytest.mark.parametrize(("fitted", "where"), [(0.30, None), (0.42, "free_run")])
def test_chance_makes_no_free_run_worse_on_the_fitted_records_as_well(fitted, where):
    """What acts at random is the same with either model, and other in other records."""
    before = replace(predicting(0.030, 0.30), fit_error=0.29)
    after = replace(predicting(0.020, 0.40), fit_error=fitted)
    after = replace(after, random={"force.hidden": 0.15}, innovation_chi2=1.0, disturbed=0.35)
    worse = unexplained_error_growth(before, after, SETTINGS)
    assert (None if worse is None else worse.horizon) == where


@pytest.mark.parametrize(
    ("ahead", "freely", "where"),
    [(0.0210, 0.30, None), (0.0225, 0.30, "one_sample"), (0.0210, 0.315, "free_run")],
)
def test_an_error_ahead_grows_by_chance_up_to_two_standard_errors_a_free_run_up_to_one(
    ahead, freely, where
):
    """Of 20 blocks, errors of 0.020 and 0.30 before, with standard errors of 0.001 and 0.01."""
    before = predicting(0.020, 0.30)
    told = zip(before.unseen, (ahead, freely), (0.001, 0.01), strict=True)
    unseen = tuple(
        replace(h, squares={"x": tuple(e**2 + d * (e + h.error) * np.sqrt(19) * s for s in SIGNS)})
        for h, e, d in told
    )
    worse = unexplained_error_growth(
        before, replace(before, unseen=unseen, test_error=freely), SETTINGS
    )
    assert (None if worse is None else worse.horizon) == where


@pytest.mark.parametrize("lost", [np.inf, np.nan])
def test_an_error_that_leaves_all_bounds_has_grown(lost):
    worse = unexplained_error_growth(predicting(0.02, 0.10), predicting(0.02, lost), SETTINGS)
    assert worse is not None
    assert worse.horizon == "free_run"
