"""Verdicts: what is said of a study follows from its figures, and from nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.nearness import (
    is_near_noise,
    noise_factor,
    shortfalls,
)
from spiral.inference.verdict import (
    LIKELIHOOD_RATIO_T,
    missing_effects,
    reasons_for_doubt,
    seed_verdict,
    undetermined_effects,
)
from spiral.types.horizon import Horizon
from spiral.types.model import Model, seed_model
from spiral.types.run import Round
from tests.judged import CUBIC, GOOD, POOR, SETTINGS, TOLD, model, rounds, said
from tests.scenes import effect

WORDS_OF_SUCCESS = ("Missing was", "Missing were", "Nothing is missing", "white noise")


def test_no_wrong_model_is_better_than_a_perfect_one():
    """What is fitted as noise with a colour beside a wrong model may be more than its error."""
    hidden = replace(POOR, noise_floor=0.9)
    assert hidden.floor == hidden.as_dict()["noise_floor"] == hidden.test_error
    assert hidden.noise_floor == 0.9
    assert GOOD.floor == GOOD.noise_floor


def held(known):
    """A round with this model."""
    return Round(1, (), {}, {}, (), replace(GOOD, model=known), 1.0)


def test_an_effect_that_leaves_noise_is_named_with_its_figures():
    verdict, words, advice = said(rounds(GOOD), "whiteness")
    assert verdict == "effect_missing"
    assert words == ("Missing was cubic_stiffness: test error 60.0 % -> 2.01 % "
                     "(noise floor 2.00 %).")  # fmt: skip
    assert advice == "What is left is white noise."


def test_where_all_effects_were_let_go_the_verdict_is_that_of_the_seed():
    """An offset had been there for noise that grows with its reading, which was found later."""
    seed = replace(GOOD, model=seed_model(Oscillator()))
    found = rounds(seed, replace(seed, test_error=0.0203))
    verdict, words, _ = said(found, "whiteness")
    assert verdict == "nothing_missing"
    assert words.startswith("Nothing is missing")
    assert "2.01 %" in words


@pytest.mark.parametrize(("second", "words"), [(0.001, "sensor_lag at x:"), (0.01, "sensor_lag:")])
def test_of_several_sensors_the_one_that_is_late_is_named(second, words):
    """One effect has a time for each sensor of a unit; within three errors of zero none is late."""
    base = seed_model(PlanarRotor())
    values = {"sensor_lag.time_x": 0.02, "sensor_lag.time_y": second}
    late = Model(
        base.system, (*base.effects, effect("sensor_lag")),
        values=values, errors=dict.fromkeys(values, 0.001),
    )  # fmt: skip
    seed, last = rounds(replace(GOOD, model=late), replace(POOR, model=base))
    _, told, _ = said((seed, replace(last, admitted=("sensor_lag",))), "whiteness")
    assert told.startswith(f"Missing was {words}")


@pytest.mark.parametrize(("between", "apart"), [(0.027, True), (0.030, False)])
def test_what_is_smaller_than_the_noise_is_named_last(between, apart):
    """Once e^2 - f^2 <= f^2: beside the one effect that matters it is not another of its kind."""
    both = model(CUBIC, effect("coulomb_friction"), cubic_stiffness__stiffness=(3.0, 0.1),
                 coulomb_friction__level=(0.2, 0.01))  # fmt: skip
    first, second = rounds(replace(GOOD, test_error=between))
    third = Round(2, ("coulomb_friction",), {}, {}, (), replace(GOOD, model=both), 1.0)
    _, words, _ = said((first, second, third), "whiteness")
    assert words == (
        "Missing was cubic_stiffness: test error 60.0 % -> 2.70 % (noise floor 2.00 %). Missing "
        "too, and smaller than the noise: coulomb_friction; test error 2.70 % -> 2.01 % (noise "
        "floor 2.00 %). At this size a name may stand for something else." if apart else
        "Missing were cubic_stiffness, coulomb_friction: test error 60.0 % -> 2.01 % (noise floor "
        "2.00 %)."
    )  # fmt: skip


def test_what_takes_the_place_of_another_effect_does_the_work_of_both():
    """A resistance that follows the temperature within, found by that of the surface first."""
    first, second = rounds(replace(GOOD, test_error=0.021))
    both = model(effect("coulomb_friction"), coulomb_friction__level=(0.2, 0.01))
    third = Round(
        2, ("coulomb_friction",), {}, {}, (), replace(GOOD, model=both), 1.0,
        retired=("cubic_stiffness",),
    )  # fmt: skip
    _, words, _ = said((first, second, third), "whiteness")
    assert words == (
        "Missing was coulomb_friction: test error 60.0 % -> 2.01 % (noise floor 2.00 %)."
    )


def test_what_was_never_larger_than_the_noise_is_named_with_that():
    _, words, _ = said(rounds(GOOD, replace(POOR, test_error=0.025)), "whiteness")
    assert words == (
        "Missing was cubic_stiffness: test error 2.50 % -> 2.01 % (noise floor 2.00 %). What that "
        "does is smaller than the noise. At this size a name may stand for something else."
    )


def test_more_is_missing_where_the_rest_is_far_from_noise():
    far = replace(GOOD, chi2_per_dof=798.0, whiteness_p=0.0, whiteness_effect=3.0, test_error=0.13)
    verdict, words, advice = said(rounds(far))
    assert verdict == "effect_missing"
    assert "More is missing: chi2 per degree of freedom is 798" in words
    assert "13.0 %" in words
    assert "not quite white" not in words + advice
    assert "white noise" not in words + advice


@pytest.mark.parametrize(
    ("after", "verdict"), [(0.55, "unknown_structure"), (0.5, "effect_missing")]
)
def test_what_explains_little_of_what_is_left_unexplained_is_not_what_was_missing(after, verdict):
    """A tenth of the error at least (``settings.smallest``), where noise does not tell the rest."""
    far = replace(GOOD, chi2_per_dof=798.0, whiteness_p=0.0, whiteness_effect=3.0, test_error=after)
    given, words, _ = said(rounds(far))
    assert given == verdict
    assert ("cubic_stiffness, which explains little of it" in words) == (after > 0.54)
    assert "More is missing" in words


def test_a_fit_that_did_not_converge_is_not_judged():
    _, words, advice = said(rounds(replace(GOOD, converged=False, chi2_per_dof=1435.0)))
    assert "Whether more is missing cannot be told: the fit did not converge" in words
    assert "white noise" not in words + advice


def test_an_error_that_grew_on_unseen_data_is_no_success():
    worse = replace(GOOD, test_error=22.9)
    verdict, words, advice = said(rounds(worse), "whiteness")
    assert verdict == "unknown_structure"
    assert "error grew: test error 60.0 % -> 2290 %" in words
    assert missing_effects(rounds(worse), SETTINGS) == ()
    assert not any(s in words + advice for s in WORDS_OF_SUCCESS)


def test_a_free_run_that_grew_within_its_noise_is_told_beside_the_next_sample():
    def horizons(ahead, free):
        return tuple(
            Horizon(name, samples, None, {"x": (error**2,) * 20})
            for name, samples, error in (("one_sample", 1, ahead), ("free_run", None, free))
        )

    first = replace(POOR, test_error=0.0200, unseen=horizons(0.05, 0.0200))
    last = replace(GOOD, test_error=0.0201, unseen=horizons(0.02, 0.0201))
    _, words, _ = said(rounds(last, first), "whiteness")
    assert "which noise and random forces explain in a free run" in words
    assert "one sample ahead 5.00 % -> 2.00 %" in words


@pytest.mark.parametrize("estimate", [(1.9, 3.3), (0.0, 1.0), (np.nan, 1.0)])
def test_an_effect_within_three_standard_errors_of_zero_is_never_what_was_missing(estimate):
    doubtful = model(CUBIC, cubic_stiffness__stiffness=estimate)
    found = rounds(replace(GOOD, model=doubtful))
    verdict, words, _ = said(found, "whiteness")
    assert verdict == "unknown_structure"
    assert "does not determine cubic_stiffness: stiffness is" in words
    assert not any(s in words for s in WORDS_OF_SUCCESS)


def test_an_amplitude_at_its_bound_is_not_determined():
    tank = seed_model(CascadedTanks()).add(effect("overflow"))
    uppers = {f"overflow.{p.name}": p.upper for p in effect("overflow").amplitudes()}
    errors = {k: v / 50 for k, v in uppers.items()}
    at_bound = replace(tank, values=uppers, errors=errors)
    inside = replace(at_bound, values={k: v / 2 for k, v in uppers.items()})
    assert "bound" in reasons_for_doubt(held(at_bound), "overflow", SETTINGS)
    assert reasons_for_doubt(held(inside), "overflow", SETTINGS) == ""


def test_one_determined_axis_is_enough():
    friction = effect("coulomb_friction")
    known = model(
        friction, coulomb_friction__level=(2.0, 0.1), coulomb_friction__width=(1e-3, 1e-3)
    )
    assert reasons_for_doubt(held(known), "coulomb_friction", SETTINGS) == ""


def test_a_likelihood_far_below_without_an_effect_determines_it():
    """A rim that spills all there is has no slope, and is there all the same."""
    doubtful = held(model(CUBIC, cubic_stiffness__stiffness=(1.9, 3.3)))
    assert reasons_for_doubt(doubtful, "cubic_stiffness", SETTINGS)
    sure = replace(doubtful, details={LIKELIHOOD_RATIO_T: {"cubic_stiffness": 12.0}})
    assert reasons_for_doubt(sure, "cubic_stiffness", SETTINGS) == ""


def test_nothing_is_missing_only_near_the_noise():
    assert is_near_noise(GOOD, SETTINGS)
    for change in ({"chi2_per_dof": 3.96}, {"test_error": 0.05}, {"converged": False},
                   {"whiteness_p": 1e-9, "whiteness_effect": 0.5},
                   {"chi2_per_dof": np.inf}, {"test_error": np.nan},
                   {"contradictions": ("c ended at -2 where 3 was given",)}):  # fmt: skip
        bad = replace(GOOD, **change)
        assert not is_near_noise(bad, SETTINGS)
        assert len(shortfalls(bad, SETTINGS)) == 1
        seed = Round(0, (), {}, {}, (), bad, 1.0)
        assert seed_verdict(seed, "no_candidate", SETTINGS) == "unknown_structure"


def test_a_filter_s_evidence_is_judged_by_its_innovations():
    """Process noise moves the machine: no free run follows, and the model is right all the same."""
    driven = replace(GOOD, chi2_per_dof=40.0, test_error=0.6, innovation_chi2=1.02)
    assert is_near_noise(driven, SETTINGS)
    assert not is_near_noise(replace(driven, innovation_chi2=3.0), SETTINGS)


def test_colour_smaller_than_the_smallest_effect_is_harmless():
    """N = 65000: Ljung-Box is certain of a colour that predicts half a percent of the rest."""
    faint = replace(GOOD, whiteness_p=1e-12, whiteness_effect=0.005)
    assert is_near_noise(faint, SETTINGS)
    assert not is_near_noise(faint, replace(SETTINGS, smallest=0.05))


@pytest.mark.parametrize(("declared", "chi2"), [(0.5, 3.96), (2.0, 0.25)])
def test_noise_declared_wrong_is_said_and_not_taken_for_physics(declared, chi2):
    wrong = replace(GOOD, chi2_per_dof=chi2, noise_ratio=1 / declared,
                    noise_floor=0.02 * declared)  # fmt: skip
    assert noise_factor(wrong, SETTINGS) == pytest.approx(1 / declared, rel=0.02)
    seed = Round(0, (), {}, {}, (), wrong, 1.0)
    verdict, _, advice = said((seed,), "whiteness")
    assert verdict == "nothing_missing"
    assert "what the record declares" in advice
    assert "record.noise" in advice


def test_white_but_larger_than_any_estimate_of_the_noise_is_not_noise():
    wide = replace(GOOD, chi2_per_dof=9.0, noise_ratio=1.0)
    assert noise_factor(wide, SETTINGS) == 1.0
    assert not is_near_noise(wide, SETTINGS)


def test_a_record_of_another_machine_is_recognised():
    other = replace(GOOD, model=seed_model(Oscillator()), fit_error=0.02, test_error=1.56)
    seed = Round(0, (), {}, {}, (), other, 1.0)
    verdict, words, _ = said((seed,), "whiteness")
    assert verdict == "unknown_structure"
    assert "not the test record" in words
    assert "another machine" in words


@pytest.mark.parametrize("stopped", ["whiteness", "no_candidate", "max_rounds", "diverged"])
@pytest.mark.parametrize("chi2", [0.1, 1.0, 4.0, 1e10, np.inf, np.nan])
@pytest.mark.parametrize("error", [0.02, 0.5, 50.0, np.inf, np.nan])
def test_no_words_of_success_beside_figures_of_failure(stopped, chi2, error):
    last = replace(GOOD, chi2_per_dof=chi2, test_error=error)
    for found in (rounds(last), (replace(rounds(last)[0], comparison=last),)):
        _, words, advice = said(found, stopped)
        success = [s for s in WORDS_OF_SUCCESS if s in words + " " + advice]
        if not is_near_noise(last, SETTINGS) and "ore is missing" not in words:
            assert not success
        if not error <= POOR.test_error:
            assert not success


MEMORY = {"memory": {"sentence": "What is missing has memory: at mass."}}
STANDS_IN = {"memory": {**MEMORY["memory"], "stand_ins": ["cubic_stiffness"]}}


def test_what_is_left_with_memory_is_not_told_in_names_of_effects_without():
    first, last = rounds(replace(GOOD, whiteness_p=0.0, whiteness_effect=0.5))
    verdict, words, advice = said((first, replace(last, details=STANDS_IN)))
    assert verdict == "unknown_structure"
    assert missing_effects((first, replace(last, details=STANDS_IN)), SETTINGS) == ()
    assert "has memory" in words
    assert not any(w in words for w in WORDS_OF_SUCCESS)
    assert "states of their own" in advice


def test_an_effect_that_stays_beside_memory_is_named_and_what_gives_way_to_it_is_told():
    first, last = rounds(replace(GOOD, whiteness_p=0.0, whiteness_effect=0.5))
    verdict, words, _ = said((first, replace(last, details=MEMORY)))
    assert verdict == "effect_missing"
    assert "Missing was cubic_stiffness" in words
    assert "has memory" in words
    more = effect("quadratic_damping")
    both = replace(
        last.comparison, model=model(effect("cubic_stiffness"), more,
                                     cubic_stiffness__stiffness=(3.0, 0.1),
                                     quadratic_damping__damping=(3.0, 0.1)),
    )  # fmt: skip
    details = {"memory": {**MEMORY["memory"], "stand_ins": [more.label]}}
    later = Round(2, (more.label,), {}, {}, (), both, 1.0, details=details)
    assert missing_effects((first, last, later), SETTINGS) == ("cubic_stiffness",)
    assert "also contains quadratic_damping" in said((first, last, later))[1]


def test_an_effect_with_memory_is_named_whatever_memory_is_left():
    label = "bouc_wen"
    held = replace(GOOD, model=model(effect(label), bouc_wen__stiffness=(3.0, 0.1)))
    first = Round(0, (), {}, {}, (), POOR, 1.0)
    last = Round(1, (label,), {}, {}, (), held, 1.0, details=MEMORY)
    verdict, words, _ = said((first, last))
    assert verdict == "effect_missing"
    assert f"Missing was {label}" in words
    assert "has memory" in words


def test_a_seed_that_lacks_memory_alone_is_unknown_structure_though_near_its_noise():
    seed = Round(0, (), {}, {}, (), GOOD, 1.0, details=MEMORY)
    verdict, words, _ = said((seed,))
    assert verdict == "unknown_structure"
    assert words.endswith(MEMORY["memory"]["sentence"])


def test_undetermined_effects_are_those_without_an_amplitude_above_its_error():
    unsure = model(CUBIC, cubic_stiffness__stiffness=(3.0, 2.0))
    assert undetermined_effects(unsure, ("cubic_stiffness",), SETTINGS) == ("cubic_stiffness",)
    assert undetermined_effects(TOLD, ("cubic_stiffness",), SETTINGS) == ()
    assert undetermined_effects(unsure, (), SETTINGS) == ()
