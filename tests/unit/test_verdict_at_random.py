"""Verdicts where something acts at random: what it excuses, and what it does not."""

from dataclasses import replace

import pytest
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.advice import advice_for
from spiral.inference.disturbances import record_sentence
from spiral.inference.verdict import (
    seed_verdict,
    verdict_sentence,
)
from spiral.types.horizon import Horizon
from spiral.types.model import seed_model
from spiral.types.run import RANDOM_OR_MISSING, UNTOLD, Round
from spiral.view.report.text import _headline
from tests.judged import CUBIC, GOOD, POOR, SETTINGS, ahead, model, rounds, said


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


@pytest.mark.parametrize(("values", "most"), [(1.0, 2.576), (10.0, 1.523), (1000.0, 1.415)])
def test_forces_that_make_many_values_of_a_record_explain_less(values, most):
    """sqrt(chi2 / nu) at one in a hundred, at least that of chi2 itself."""
    for share, told in ((0.99, "nothing_missing"), (1.01, "unknown_structure")):
        pushed = replace(GOOD, random={"force.observed": 0.1}, disturbed=0.1, noise_floor=0.0,
                         test_error=share * most * 0.1, disturbed_values=values)  # fmt: skip
        seed = Round(0, (), {}, {}, (), pushed, 1.0)
        assert seed_verdict(seed, "no_candidate", SETTINGS) == told


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


def test_a_model_that_needs_a_large_random_force_is_no_other_machine():
    pushed = replace(GOOD, model=seed_model(Oscillator()), fit_error=0.3, test_error=0.4,
                     random={"force.hidden": 1.0}, innovation_chi2=1.0, disturbed=0.5)  # fmt: skip
    verdict, words, _ = said((Round(0, (), {}, {}, (), pushed, 1.0),))
    assert verdict == "unknown_structure"
    assert "random force of 100 %" in words
    assert "another machine" not in words


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


@pytest.mark.parametrize(("fitted", "verdict"), [
    (0.034, "effect_missing"), (0.025, "unknown_structure"),
])  # fmt: skip
def test_where_a_test_hardly_moves_the_fitted_records_tell(fitted, verdict):
    """Its error of 7 % is mostly noise, before and after; that of the fit falls to 2 %."""
    near = (Horizon("one_sample", 1, 0.1, {"x": (0.0025,) * 5}), ahead(0.05))
    seed = replace(POOR, fit_error=fitted, test_error=0.073, noise_floor=0.052, unseen=near)
    last = replace(GOOD, test_error=0.074, noise_floor=0.052, random={"force.observed": 0.03},
                   disturbed=0.05, unseen=near)  # fmt: skip
    given, words, _ = said(rounds(last, seed), "whiteness")
    assert given == verdict
    assert ("of the record that was fitted 3.40 % -> 2.00 %" in words) == (fitted == 0.034)


def test_a_free_run_that_open_values_carry_away_says_which():
    """Of a machine in chaos no value is open: there nothing predicts so long."""
    lost = replace(GOOD, test_error=0.9, uncertain=0.8)
    assert "no model predicts such a motion for so long" in record_sentence(lost)
    open_value = replace(lost, model=model(CUBIC, cubic_stiffness__stiffness=(3.0, 2.0)))
    words = record_sentence(open_value)
    assert words.startswith("This record leaves stiffness (3.0 ± 2.0) open")
    assert "no model predicts" not in words
