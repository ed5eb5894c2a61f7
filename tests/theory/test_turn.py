"""Turning by hand: any candidate may be admitted, by the loop's own steps."""

import numpy as np
import pytest

from spiral.inference.discover import discover
from spiral.inference.problem import silent
from spiral.inference.rounds import candidates, chosen, looked, started, strategy_for, turned
from spiral.io.config import build_problem, compose
from spiral.io.curves import FINAL, free_curves
from spiral.io.registry import load_registry
from spiral.types.errors import ConfigError

SHORT = ("experiment=rotor_coastdown", "record.duration=4", "test.duration=4")


@pytest.fixture(scope="module")
def study():
    registry = load_registry(None)
    wanted = "candidates=[cross_stiffness,cubic_stiffness,gyroscopic]"
    problem = build_problem(compose((*SHORT, wanted, "settings.max_rounds=1"), registry), registry)
    strategy = strategy_for(problem)
    begun = strategy.begin(problem, silent)
    at, step = looked(strategy, begun.assembly, started(begun, 0.0), silent)
    return problem, strategy, begun.assembly, at, step


def test_the_proposed_effect_by_hand_is_the_loops_own_round(study):
    problem, strategy, assembly, at, step = study
    by_hand = turned(strategy, assembly, at, step, silent).rounds
    by_loop = discover(problem).rounds
    assert [r.admitted for r in by_hand] == [r.admitted for r in by_loop]
    for one, other in zip(by_hand, by_loop, strict=True):
        assert one.comparison.test_error == other.comparison.test_error
        assert one.comparison.model.values == other.comparison.model.values


def test_another_than_the_proposed_effect_may_be_admitted(study):
    _, strategy, assembly, at, step = study
    others = [s.effect for s in candidates(strategy, step) if s.effect not in step.admitted]
    after = turned(strategy, assembly, at, chosen(strategy, assembly, at, step, others[0]), silent)
    assert after.rounds[-1].admitted == (others[0],)
    assert others[0] in after.rounds[-1].comparison.model.labels
    assert after.rounds[-1].comparison.fit_error < at.rounds[-1].comparison.fit_error


def test_all_candidates_are_listed_and_no_other_can_be_added(study):
    _, strategy, assembly, at, step = study
    listed = [s.effect for s in candidates(strategy, step)]
    assert sorted(listed) == ["cross_stiffness", "cubic_stiffness", "gyroscopic"]
    assert listed[0] == step.admitted[0]
    with pytest.raises(ConfigError, match="cubic_stifness"):
        chosen(strategy, assembly, at, step, "cubic_stifness")


@pytest.mark.parametrize("turns", [0, 1])
def test_what_is_drawn_at_once_has_the_error_that_is_told(study, turns):
    """Free runs with the study's own compilation agree with the comparison, turn by turn."""
    problem, strategy, assembly, at, step = study
    if turns:
        at = turned(strategy, assembly, at, step, silent)
    told = at.rounds[-1].comparison
    curves = free_curves(assembly, FINAL, at.standing, told)
    record = len(problem.records)
    y, first = curves.get(record, "y"), curves.meta["records"][record]["settled"]
    left = (y - curves.get(record, FINAL, "free"))[first:]
    relative = np.sqrt(np.mean(left**2, axis=0)) / y[first:].std(axis=0)
    assert np.mean(relative) == pytest.approx(told.test_error, rel=1e-3)
