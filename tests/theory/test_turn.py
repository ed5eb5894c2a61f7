"""Turning by hand: any candidate may be admitted, by the loop's own steps."""

from dataclasses import replace

import numpy as np
import pytest

from spiral.app.fit_worker import FitWorker
from spiral.inference.discover import discover
from spiral.inference.evidence.comparison import chi2_on_windows, compare_fitted_model
from spiral.inference.evidence.enlarge import enlarge_for
from spiral.inference.problem import ScoreMessage, silent
from spiral.inference.rounds import (
    admit_step,
    choose_candidate,
    rank_last_round,
    start_study,
    strategy_for,
)
from spiral.inference.strategies.base import StartedStudy
from spiral.inference.suggest import suggestions_by_evidence, top_suggestions
from spiral.io.compute_curves import free_curves
from spiral.io.config import build_problem, compose
from spiral.io.curves import FINAL
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError

SHORT = ("experiment=rotor_coastdown", "record.duration=1.5", "test.duration=1.5")


@pytest.fixture(scope="module", params=["likelihood", "shooting"])
def study(request):
    registry = load_registry(None)
    words = ("candidates=[cross_stiffness,cubic_stiffness,gyroscopic]", "settings.max_rounds=1",
             f"strategy={request.param}")  # fmt: skip
    problem = build_problem(compose((*SHORT, *words), registry), registry)
    strategy = strategy_for(problem)
    begun = strategy.begin(problem, silent)
    at, step = rank_last_round(strategy, begun.assembly, start_study(begun, 0.0), silent)
    return problem, strategy, begun.assembly, at, step


def test_the_proposed_effect_by_hand_is_the_loops_own_round(study):
    problem, strategy, assembly, at, step = study
    by_hand = admit_step(strategy, assembly, at, step, silent).rounds
    by_loop = discover(problem).rounds
    assert [r.admitted for r in by_hand] == [r.admitted for r in by_loop]
    for one, other in zip(by_hand, by_loop, strict=True):
        assert one.comparison.test_error == other.comparison.test_error
        assert one.comparison.model.values == other.comparison.model.values


def test_scores_of_all_candidates_are_told_before_any_refit(study):
    problem, strategy, assembly, at, step = study
    if strategy.plugin_name() != "likelihood":
        pytest.skip("ranks without refits")
    heard = []
    rank_last_round(strategy, assembly, at, heard.append)
    scored = [m for m in heard if isinstance(m, ScoreMessage)]
    refits = [m for m in heard if m.startswith("refitting with")]
    assert len(scored) == 1
    assert heard.index(scored[0]) < heard.index(refits[0])
    told = [s.effect for s in scored[0].suggestions]
    assert set(told) == {e.label for e in problem.candidates}
    assert told[0] == step.admitted[0]
    assert refits[0].endswith("(1 of 2)")  # the third is not worth its penalty


def better(strategy, after, before):
    """If what the strategy fits rose: the likelihood, or the free run of the fitted record."""
    if strategy.plugin_name() == "likelihood":
        return after.details["log_likelihood"] > before.details["log_likelihood"]
    return after.comparison.fit_error < before.comparison.fit_error


def test_another_than_the_proposed_effect_may_be_admitted(study):
    _, strategy, assembly, at, step = study
    others = [s.effect for s in strategy.ranked(step) if s.effect not in step.admitted]
    after = admit_step(
        strategy, assembly, at, choose_candidate(strategy, assembly, at, step, others[0]), silent
    )
    assert after.rounds[-1].admitted == (others[0],)
    assert others[0] in after.rounds[-1].comparison.model.labels
    assert better(strategy, after.rounds[-1], at.rounds[-1])


def test_all_candidates_are_listed_and_no_other_can_be_added(study):
    _, strategy, assembly, at, step = study
    listed = [s.effect for s in strategy.ranked(step)]
    assert sorted(listed) == ["cross_stiffness", "cubic_stiffness", "gyroscopic"]
    assert listed[0] == step.admitted[0]
    with pytest.raises(ConfigError, match="cubic_stifness"):
        choose_candidate(strategy, assembly, at, step, "cubic_stifness")


@pytest.mark.parametrize("turns", [0, 1])
def test_what_is_drawn_at_once_has_the_error_that_is_told(study, turns):
    """Free runs with the study's own compilation agree with the comparison, turn by turn."""
    problem, strategy, assembly, at, step = study
    if turns:
        at = admit_step(strategy, assembly, at, step, silent)
    told = at.rounds[-1].comparison
    curves = free_curves(assembly, FINAL, at.fit_state, told)
    record = len(problem.records)
    y, first = curves.get(record, "y"), curves.meta["records"][record]["settled"]
    left = (y - curves.get(record, FINAL, "free"))[first:]
    relative = np.sqrt(np.mean(left**2, axis=0)) / y[first:].std(axis=0)
    assert np.mean(relative) == pytest.approx(told.test_error, rel=1e-3)


def test_candidates_side_by_side_are_judged_on_windows_of_one_length(study, tmp_path):
    """One was fitted on the whole record, the other got no further than 512 samples."""
    _, strategy, assembly, at, step = study
    if strategy.plugin_name() == "likelihood":
        pytest.skip("one likelihood judges the whole record: nothing has windows of its own")
    bench = FitWorker(
        tmp_path, lambda kind, data: told.append((kind, data)), "a", strategy=strategy
    )
    bench.begun = StartedStudy(assembly, at.fit_state, at.rounds[0].comparison)
    bench.ranked[0] = (at, step)
    other = admit_step(
        strategy, assembly, at, choose_candidate(strategy, assembly, at, step, "gyroscopic"), silent
    )
    place, last = enlarge_for(assembly, other.fit_state), other.rounds[-1]
    short = compare_fitted_model(place, other.fit_state, last.comparison.model, 512, True)
    rounds = (*other.rounds[:-1], replace(last, comparison=short))
    bench.tried[0, "gyroscopic"] = replace(other, rounds=rounds)
    told = []
    names = ["cross_stiffness", "gyroscopic"]
    bench.contrast({"study": "a", "overrides": [], "base": 0, "effects": names})
    kind, said = told[-1]
    assert (kind, said["horizon"]) == ("contrast", short.horizon)
    first = bench.tried[0, "cross_stiffness"]
    own = first.rounds[-1].comparison
    assert own.horizon > short.horizon
    same = chi2_on_windows(enlarge_for(assembly, first.fit_state), first.fit_state, short.horizon)
    assert [r["chi2_per_dof"] for r in said["rows"]] == pytest.approx([same, short.chi2_per_dof])
    assert same < 0.9 * own.chi2_per_dof  # short windows hide what is missing
    assert [r["unseen"][-1]["error"] for r in said["rows"]] == pytest.approx(
        [own.test_error, short.test_error]
    )


def test_the_order_is_that_of_its_first_figure_whatever_is_proposed(study):
    _, strategy, _, _, step = study
    found = strategy.ranked(step)
    assert [s.net for s in found] == sorted((s.net for s in found), reverse=True)
    if strategy.plugin_name() == "likelihood":
        return
    assert all(s.net < s.explains for s in found)  # every parameter has its price
    proposal = step.result
    last = next(r for r in proposal.evidence.ranked if r.variant.original.label == found[-1].effect)
    other = replace(proposal.admitted, variant=last.variant)
    again = suggestions_by_evidence(proposal.evidence, other, ("gyroscopic",))
    assert [s.effect for s in again] == [s.effect for s in found]
    assert again[-1].aliases == ("gyroscopic",)
    assert top_suggestions(strategy, proposal.evidence, other, ())[0].effect == found[-1].effect


def test_a_step_says_at_each_horizon_what_it_does_to_unseen_data(study):
    _, strategy, assembly, at, step = study
    last = admit_step(strategy, assembly, at, step, silent).rounds[-1]
    assert [c.horizon for c in last.changes] == ["one_sample", "ahead", "free_run"]
    assert [c.judged for c in last.changes] == ["better"] * 3
    before = at.rounds[-1].comparison.test_error
    assert last.changes[-1].before == pytest.approx(before, rel=1e-12)
    assert last.changes[-1].after == pytest.approx(last.comparison.test_error, rel=1e-12)
    assert last.as_dict()["changes"][0] == last.changes[0].as_dict()
