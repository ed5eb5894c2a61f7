"""An effect must improve what is predicted of unseen data, by a size that counts."""

from dataclasses import replace

import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.problem import Settings
from spiral.inference.strategies.likelihood.benefit import refuse_unhelpful
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.horizon import Horizon
from spiral.types.model import Model, seed_model
from spiral.types.run import Comparison
from tests.scenes import effect

SETTINGS, OPTIONS = Settings(), LikelihoodOptions()
SEED = seed_model(Oscillator())
WITH_IT = Model(SEED.system, (*SEED.effects, effect("cubic_stiffness")))


def horizons(*free):
    """The free run's errors by channel in per cent, the same in every block of time."""
    squares = {f"c{j}": (1e-4 * e**2,) * 5 for j, e in enumerate(free)}
    return (Horizon("free_run", None, None, squares),)


def known(errors, model=SEED, floor=0.01, **more):
    """A model with the free run's errors by channel, in per cent."""
    mean = 0.01 * sum(errors) / len(errors)
    plain = Comparison(model, mean, mean, {}, floor, 1.0, 0.5, 0.0, 1024, True, random={})
    return replace(plain, unseen=horizons(*errors), **more)


def ahead(comparison, error):
    """A comparison that has an error one sample ahead as well, in per cent."""
    next_reading = Horizon("one_sample", 1, None, {"c0": (1e-4 * error**2,) * 5})
    return replace(comparison, unseen=(*comparison.unseen, next_reading))


def reason(before, after):
    refused = refuse_unhelpful(OPTIONS, before, after, SETTINGS)
    return "" if refused is None else refused.reason


@pytest.mark.parametrize(
    ("before", "after", "counts"),
    [
        ((1.20,), (1.12,), False),  # 0.43 % of the motion, beneath the noise of 1 %
        ((1.20,), (1.08,), True),  # 0.52 %
        ((1.60,), (1.57,), True),  # above the noise: a tenth of what is left is enough
        ((1.60,), (1.595,), False),
        ((1.00, 1.30), (1.00, 1.17), True),  # of one reading alone: 0.57 %
    ],
)
def test_beneath_the_noise_an_effect_must_count_in_the_motion_too(before, after, counts):
    told = reason(known(before), known(after, WITH_IT))
    assert (told == "") == counts
    if not counts:
        assert "too small to matter" in told


def test_the_share_of_the_motion_is_a_setting():
    small = replace(SETTINGS, smallest_share=0.004)
    before, after = known((1.20,)), known((1.12,), WITH_IT)
    assert refuse_unhelpful(OPTIONS, before, after, small) is None


@pytest.mark.parametrize(("test", "helps"), [(0.193, True), (0.195, False)])
def test_random_forces_are_replaced_where_free_runs_improve(test, helps):
    """A free run that random forces move is no witness alone: force, fit and test must all fall."""
    before = known((20.0,), random={"force.observed": 0.13}, disturbed=0.15)
    after = known((20.0,), WITH_IT, random={"force.observed": 0.09}, disturbed=0.10)
    after = replace(after, fit_error=0.15, test_error=test)
    assert (reason(before, after) == "") == helps


@pytest.mark.parametrize(
    ("free", "disturbed", "helps"),
    [
        (25.4, 0.123, False),  # 25.5 -> 25.4 %, where chance makes 12 %
        (25.4, 0.20, True),  # chance makes more than half of what it errs by, squared
        (24.0, 0.123, True),  # it takes something of that error
    ],
)
def test_an_effect_takes_something_of_an_error_that_chance_does_not_make(free, disturbed, helps):
    """The next readings are predicted better, as beside a smaller random force."""
    before = ahead(known((25.5,), disturbed=0.16), 1.0)
    after = ahead(known((free,), WITH_IT, disturbed=disturbed), 0.9)
    refused = refuse_unhelpful(OPTIONS, before, after, SETTINGS)
    assert (refused is None) == helps
    if refused is not None:
        assert refused.alone
        assert "leaves the free run" in refused.reason


@pytest.mark.parametrize(("moves", "helps"), [(0.1, True), (0.6, False), (float("nan"), False)])
def test_a_force_as_large_as_the_machines_own_is_none_where_it_moves_it_little(moves, helps):
    """A white flow of a slow state, sampled often, is large beside its rate and moves it little."""
    pushed = {"random": {"force.observed": 1.0}, "disturbed": moves}
    after = ahead(known((6.0,), WITH_IT, **pushed), 0.9)
    refused = refuse_unhelpful(OPTIONS, ahead(known((12.0,)), 1.0), after, SETTINGS)
    assert (refused is None) == helps
