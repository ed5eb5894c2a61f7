"""Verdicts: what is said of a study follows from its figures, and from nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.advice import advice_for
from spiral.inference.nearness import (
    is_near_noise,
    noise_factor,
    shortfalls,
)
from spiral.inference.problem import Settings
from spiral.inference.verdict import (
    LIKELIHOOD_RATIO_T,
    missing_effects,
    reasons_for_doubt,
    seed_verdict,
    study_summary,
    study_verdict,
    undetermined_effects,
    verdict_sentence,
)
from spiral.types.horizon import Horizon
from spiral.types.model import Model, seed_model
from spiral.types.run import RANDOM_OR_MISSING, UNTOLD, Comparison, Round
from spiral.view.report.text import _headline
from tests.scenes import effect

SETTINGS = Settings()
WORDS_OF_SUCCESS = ("Missing was", "Missing were", "Nothing is missing", "white noise")


def model(*effects, **estimates):
    """An oscillator with effects; ``NAME__parameter=(value, error)``."""
    base = seed_model(Oscillator())
    keys = {k.replace("__", "."): v for k, v in estimates.items()}
    return Model(
        base.system,
        (*base.effects, *effects),
        values={k: v for k, (v, _) in keys.items()},
        errors={k: e for k, (_, e) in keys.items()},
    )


CUBIC = effect("cubic_stiffness")
TOLD = model(CUBIC, cubic_stiffness__stiffness=(3.0, 0.1))
GOOD = Comparison(TOLD, 0.02, 0.0201, {}, 0.02, 1.01, 0.4, 0.003, 1024, True)
POOR = replace(GOOD, model=seed_model(Oscillator()), fit_error=0.5, test_error=0.6,
               chi2_per_dof=900.0, whiteness_p=0.0, whiteness_effect=8.0)  # fmt: skip


def test_no_wrong_model_is_better_than_a_perfect_one():
    """What is fitted as noise with a colour beside a wrong model may be more than its error."""
    hidden = replace(POOR, noise_floor=0.9)
    assert hidden.floor == hidden.as_dict()["noise_floor"] == hidden.test_error
    assert hidden.noise_floor == 0.9
    assert GOOD.floor == GOOD.noise_floor


def rounds(last, first=POOR):
    return (Round(0, (), {}, {}, (), first, 1.0),
            Round(1, ("cubic_stiffness",), {}, {}, (), last, 1.0))  # fmt: skip


def held(known):
    """A round with this model."""
    return Round(1, (), {}, {}, (), replace(GOOD, model=known), 1.0)


def said(found, stopped="no_candidate"):
    verdict = study_verdict(found, stopped, SETTINGS)
    words = study_summary(found, verdict, stopped, SETTINGS)
    return verdict, words, advice_for(verdict, stopped, found, (), SETTINGS)


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


@pytest.mark.parametrize(
    ("error", "moved", "words"),
    [
        (0.3, 0.4, "Nothing is missing but what acts at random:"),
        (0.7, 0.4, "This record does not tell whether more is missing than what acts at random:"),
        (1.4, 1.5, "Nothing is missing but what acts at random:"),  # errors ahead tell there
    ],
)
def test_a_free_run_that_misses_half_of_all_motion_is_no_proof(error, moved, words):
    unseen = (Horizon("one_sample", 1, 0.1, {"x": (0.02**2,) * 5}),)
    pushed = replace(GOOD, random={"force.observed": 0.1}, disturbed=moved, test_error=error,
                     unseen=unseen)  # fmt: skip
    assert verdict_sentence("nothing_missing", pushed, SETTINGS).startswith(words)


def test_a_noisy_sensor_hides_nothing():
    noisy = replace(GOOD, random={}, disturbed=1e-5, test_error=0.54, noise_floor=0.55)
    seed = Round(0, (), {}, {}, (), noisy, 1.0)
    assert seed_verdict(seed, "no_candidate", SETTINGS) == "nothing_missing"
    assert verdict_sentence("nothing_missing", noisy, SETTINGS).startswith("Nothing is missing:")


@pytest.mark.parametrize(
    ("error", "stopped", "verdict"),
    [
        (0.3, "no_candidate", "nothing_missing"),
        (0.7, "no_candidate", "unknown_structure"),  # a free run tells little
        (0.3, "max_seconds", "unknown_structure"),  # a candidate might have taken it away
        (0.021, "max_seconds", "nothing_missing"),  # nothing is left to take away
    ],
)
def test_what_random_forces_may_hide_is_not_nothing(error, stopped, verdict):
    pushed = replace(GOOD, random={"force.observed": 0.1}, disturbed=0.4, test_error=error)
    seed = Round(0, (), {}, {}, (), pushed, 1.0)
    assert seed_verdict(seed, stopped, SETTINGS) == verdict
    if verdict == "unknown_structure" and stopped != "max_seconds":
        assert verdict_sentence(verdict, pushed, SETTINGS).startswith(UNTOLD)
        assert "Record what drives" in advice_for(verdict, stopped, [seed], (), SETTINGS)


@pytest.mark.parametrize(("p", "begins"), [(0.4, True), (1e-9, False)])
def test_where_only_a_random_force_is_too_large_it_may_be_one(p, begins):
    """Misses that are not white speak against the model whatever acts at random."""
    pushed = replace(
        GOOD, random={"force.observed": 0.47}, disturbed=0.13, test_error=0.14, whiteness_p=p,
        whiteness_effect=0.2,
    )  # fmt: skip
    words = verdict_sentence("unknown_structure", pushed, SETTINGS)
    assert words.startswith(RANDOM_OR_MISSING) == begins
    assert "a random force of 47.0 % of the machine's own forces would have to act" in words
    head = _headline({"summary": words, "verdict": "unknown_structure"})
    assert head == (
        RANDOM_OR_MISSING if begins else "Something is missing that no known effect explains"
    )


@pytest.mark.parametrize(("moved", "told"), [(0.05, False), (0.4, True)])
def test_random_forces_that_carry_a_free_run_are_no_quiet_end(moved, told):
    pushed = replace(GOOD, random={"force.observed": 0.04}, disturbed=moved, test_error=0.3)
    seed = Round(0, (), {}, {}, (), pushed, 1.0)
    for found in (rounds(pushed), (seed,)):
        verdict, _, advice = said(found, "whiteness")
        assert ("if nothing shakes the machine so" in advice) == told, verdict
        assert ("40.0 %" in advice) == told


@pytest.mark.parametrize(("moved", "lead"), [
    (0.01, "Nothing is missing: "), (0.05, "Nothing is missing but what acts at random: "),
])  # fmt: skip
def test_a_verdict_names_random_forces_that_move_a_free_run_more_than_noise(moved, lead):
    pushed = replace(GOOD, random={"force.observed": 0.04}, disturbed=moved)
    verdict, words, _ = said((Round(0, (), {}, {}, (), pushed, 1.0),), "whiteness")
    assert verdict == "nothing_missing"
    assert words.startswith(lead)
    assert "4.00 % of the machine's own forces" in words


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


@pytest.mark.parametrize(
    ("share", "moved", "verdict"),
    [
        (0.45, 0.6, "effect_missing"),
        (0.55, 0.6, "unknown_structure"),
        (0.7, 0.1, "effect_missing"),  # of what large forces leave of one another
    ],
)
def test_beside_random_forces_of_half_the_machine_s_own_no_name_is_given(share, moved, verdict):
    """They must make as much of a free run, too."""
    pushed = replace(GOOD, random={"force.hidden": share}, disturbed=moved, test_error=0.3)
    assert said(rounds(pushed), "whiteness")[0] == verdict


def ahead(error):
    """An error some time ahead, the same in every block."""
    return Horizon("ahead", 5, 0.5, {"x": (error**2,) * 5})


@pytest.mark.parametrize(("before", "later", "verdict"), [
    (0.21, 0.05, "unknown_structure"), (0.21, 0.04, "effect_missing"),
    (0.23, 0.05, "effect_missing"),
])  # fmt: skip
def test_random_forces_that_are_to_explain_the_rest_excuse_no_effect_that_does_nothing(
    before, later, verdict
):
    """A free run off by 21 % before and after, and nothing better some time ahead either.

    From 23 to 20.8 % an effect of 9.8 % of the motion went: forces make what is left.
    """
    seed = replace(POOR, test_error=before, unseen=(ahead(0.05),))
    pushed = replace(GOOD, test_error=0.208, random={"force.observed": 0.1}, disturbed=0.11,
                     unseen=(ahead(later),))  # fmt: skip
    given, words, _ = said(rounds(pushed, seed), "whiteness")
    assert given == verdict
    assert ("explains little of it" in words) == (verdict == "unknown_structure")
    assert words.startswith(UNTOLD) == (verdict == "unknown_structure")


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


def test_a_model_that_needs_a_large_random_force_is_no_other_machine():
    pushed = replace(GOOD, model=seed_model(Oscillator()), fit_error=0.3, test_error=0.4,
                     random={"force.hidden": 1.0}, innovation_chi2=1.0, disturbed=0.5)  # fmt: skip
    verdict, words, _ = said((Round(0, (), {}, {}, (), pushed, 1.0),))
    assert verdict == "unknown_structure"
    assert "random force of 100 %" in words
    assert "another machine" not in words


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


def test_a_slow_flow_beside_a_model_without_forces_may_be_a_state_that_it_lacks():
    tanks = seed_model(CascadedTanks())
    slow = replace(
        POOR, model=tanks, random={"force.hidden": 0.3}, random_times={"force.hidden": 200.0}
    )
    words = verdict_sentence("unknown_structure", slow, SETTINGS)
    assert "a random flow of 30.0 % of the machine's own flows would have to act" in words
    assert "A random flow acts on the hidden states: 30.0 % of the machine's own flows" in words
    assert "may be a state that the model lacks" in words
    for other in (replace(slow, random_times={}), replace(slow, random={"force.hidden": 0.01})):
        assert "a state that the model lacks" not in verdict_sentence(
            "unknown_structure", other, SETTINGS
        )
