"""How near a model is to its noise: what noise explains, and what only looks explained."""

from dataclasses import replace

from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.nearness import may_noise_stand_in, predicts_nothing, shortfalls
from spiral.inference.problem import Settings
from spiral.inference.verdict import seed_verdict
from spiral.types.model import seed_model
from spiral.types.run import Comparison, Round

SETTINGS = Settings()
GOOD = Comparison(seed_model(Oscillator()), 0.02, 0.0201, {}, 0.02, 1.01, 0.4, 0.003, 1024, True)


def test_a_model_that_errs_by_all_the_motion_is_never_complete():
    """White noise of 158 % of the motion explained a pendulum in degrees that was taken in rad."""
    lost = replace(GOOD, fit_error=1.1, test_error=1.58, noise_floor=1.58, random={})
    assert seed_verdict(Round(0, (), {}, {}, (), lost, 1.0), "whiteness", SETTINGS) == (
        "unknown_structure"
    )
    assert any("misses 110 %" in said for said in shortfalls(lost, SETTINGS))
    assert predicts_nothing(lost, SETTINGS)
    faint = replace(lost, fit_error=0.97)  # a little of the motion is told, the noise is the rest
    assert not shortfalls(faint, SETTINGS)
    assert not predicts_nothing(faint, SETTINGS)


def test_noise_may_stand_in_where_it_carries_the_free_run_or_is_mostly_not_white():
    carried = replace(GOOD, test_error=0.06, random={"gust.hidden": 0.014})
    assert may_noise_stand_in(carried, SETTINGS)
    assert not may_noise_stand_in(replace(carried, whiteness_p=0.0), SETTINGS)
    assert not may_noise_stand_in(replace(GOOD, random={"gust.hidden": 0.014}), SETTINGS)
    assert not may_noise_stand_in(replace(carried, random={}), SETTINGS)
    ringing = replace(GOOD, random={"vibration.x": 0.018}, whiteness_p=0.0)
    assert may_noise_stand_in(ringing, SETTINGS)
    assert not may_noise_stand_in(replace(GOOD, random={"vibration.x": 0.01}), SETTINGS)
