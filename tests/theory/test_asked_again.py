"""What looked like an effect while another was missing, asked again beside the final model."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.problem import silent
from spiral.inference.rounds import (
    admit_step,
    choose_candidate,
    rank_last_round,
    start_study,
    strategy_for,
)
from spiral.physics.formulas.expression import effect_from_expression

VALUES = {
    "system.mass": 1.2, "linear_stiffness.stiffness": 4e3, "linear_damping.damping": 6.0,
    "cubic_stiffness.stiffness": 2e9, "coulomb_friction.level": 0.25,
    "coulomb_friction.width": 1e-3,
}  # fmt: skip
CANDIDATES = ["cubic_stiffness", "quadratic_damping", "clearance", "coulomb_friction"]


@pytest.fixture(scope="module")
def record():
    """Three seconds, short enough that a spring that stiffens looks like drag beside friction."""
    return spiral.simulate(
        "oscillator", duration=3.0, rate=500.0,
        inputs={"force": {"noise": 1.0, "band": [2, 40]}},
        effects=["cubic_stiffness", "coulomb_friction"], values=VALUES, noise_level=0.02, seed=3,
    )  # fmt: skip


@pytest.mark.slow
def test_what_is_told_apart_in_the_end_is_no_look_alike(record):
    run = spiral.discover(record, "oscillator", candidates=CANDIDATES)
    first = run.rounds[1]
    assert run.missing == ("cubic_stiffness", "coulomb_friction")
    assert first.details["told_apart"]["cubic_stiffness"]
    assert not first.aliases["cubic_stiffness"]
    assert "cannot tell" not in run.summary


@pytest.mark.slow
def test_a_likelier_look_alike_takes_the_place_of_what_was_admitted(record):
    """A gap is admitted by hand in place of the spring; beside friction it is not as likely."""
    question = spiral.discover(record, "oscillator", candidates=CANDIDATES).question
    strategy = strategy_for(question)
    begun = strategy.begin(question, silent)
    at, step = rank_last_round(strategy, begun.assembly, start_study(begun, 0.0), silent)
    wrong = choose_candidate(strategy, begun.assembly, at, step, "clearance")
    at = admit_step(strategy, begun.assembly, at, wrong, silent)
    at, step = rank_last_round(strategy, begun.assembly, at, silent)
    assert step.admitted == ("coulomb_friction",)
    at = admit_step(strategy, begun.assembly, at, step, silent)
    at, step = rank_last_round(strategy, begun.assembly, at, silent)
    assert step.admitted == ("cubic_stiffness",)
    at = admit_step(strategy, begun.assembly, at, step, silent)
    assert at.rounds[-1].retired == ("clearance",)
    model = at.rounds[-1].comparison.model
    added = ("coulomb_friction", "cubic_stiffness")
    assert {*model.labels} == {"linear_stiffness", "linear_damping", *added}
    found = model.estimates()["cubic_stiffness"]["stiffness"]
    assert np.isclose(found.estimate, 2e9, atol=3 * found.se)


def _sledge(t, x, u, p):
    return [u.w - x.v, (p.k * x.s + p.c * (u.w - x.v)) / 2.0]


@pytest.mark.slow
def test_a_special_case_that_explains_as_much_takes_the_place():
    """v x / (K + |x|) with K = 0 is dry friction: chosen by hand, it gives way to that name."""
    sledge = spiral.system(
        _sledge, states={"s": "m", "v": "m/s"}, inputs={"w": "m/s"}, observed=["s"],
        parameters={"k": (50.0, "N/m"), "c": (2.0, "N*s/m")}, free=["k", "c"],
    )  # fmt: skip
    record = spiral.simulate(
        sledge, duration=10.0, rate=100.0, inputs={"w": {"noise": 0.5, "band": [0.2, 4]}},
        effects=["dry_loss@v"], values={"dry_loss@v.level": 0.8, "dry_loss@v.width": 1e-2},
        noise_level=0.01, seed=1,
    )  # fmt: skip
    candidates = ["saturating_loss@v", "dry_loss@v", "quadratic_loss@v"]
    question = spiral.discover(record, sledge, candidates=candidates).question
    strategy = strategy_for(question)
    begun = strategy.begin(question, silent)
    at, step = rank_last_round(strategy, begun.assembly, start_study(begun, 0.0), silent)
    assert step.admitted == ("dry_loss@v",)
    wrong = choose_candidate(strategy, begun.assembly, at, step, "saturating_loss@v")
    at = admit_step(strategy, begun.assembly, at, wrong, silent)
    at, step = rank_last_round(strategy, begun.assembly, at, silent)
    assert step.admitted == ("dry_loss@v",)
    level = admit_step(strategy, begun.assembly, at, step, silent).rounds[-1].comparison.model
    found = level.estimates()["dry_loss@v"]["level"]
    assert np.isclose(found.estimate, 0.8, atol=3 * found.se)


@pytest.mark.slow
def test_one_effect_takes_the_place_of_two_that_do_the_same_with_more_numbers():
    """-k (x^3 + d x^2) with a known d, and its two parts admitted by hand one after the other."""
    bent = effect_from_expression("bent", "-k*(x**3 + d*x**2)", Oscillator(), shape={"d": 1e-3})
    parts = ("cubic_stiffness", "quadratic_stiffness")
    values = {k: VALUES[k] for k in ("system.mass", "linear_stiffness.stiffness",
                                     "linear_damping.damping")}  # fmt: skip
    values |= {"cubic_stiffness.stiffness": 1e9, "quadratic_stiffness.stiffness": 1e6}
    record = spiral.simulate(
        "oscillator", duration=3.0, rate=500.0, inputs={"force": {"noise": 1.0, "band": [2, 40]}},
        effects=list(parts), values=values, noise_level=0.02, seed=3,
    )  # fmt: skip
    question = spiral.discover(record, "oscillator", candidates=[*parts, bent]).question
    strategy = strategy_for(question)
    begun = strategy.begin(question, silent)
    at, step = rank_last_round(strategy, begun.assembly, start_study(begun, 0.0), silent)
    for part in parts:
        step = choose_candidate(strategy, begun.assembly, at, step, part)
        at = admit_step(strategy, begun.assembly, at, step, silent)
        at, step = rank_last_round(strategy, begun.assembly, at, silent)
    assert step.admitted == ("bent",)
    at = admit_step(strategy, begun.assembly, at, step, silent)
    assert set(at.rounds[-1].retired) == set(parts)
    found = at.rounds[-1].comparison.model.estimates()["bent"]["k"]
    assert np.isclose(found.estimate, 1e9, atol=3 * found.se)


def test_a_contradicted_model_with_an_effect_that_has_states_is_asked_for_more():
    """Its states are not those of the bare model, nor are their first deviations."""
    values = {**VALUES, "lag.stiffness": 3e3, "lag.time_constant": 0.01}
    values = {k: v for k, v in values.items() if k.split(".")[0] not in CANDIDATES}
    record = spiral.simulate(
        "oscillator", duration=3.0, rate=500.0, inputs={"force": {"noise": 1.0, "band": [2, 40]}},
        effects=["lag"], values=values, noise_level=0.01, seed=4,
    )  # fmt: skip
    question = spiral.discover(
        record, "oscillator", candidates=["lag"], settings={"max_rounds": 1}
    ).question
    strategy = strategy_for(question)
    begun = strategy.begin(question, silent)
    at, step = rank_last_round(strategy, begun.assembly, start_study(begun, 0.0), silent)
    assert step.admitted == ("lag",)
    at = admit_step(strategy, begun.assembly, at, step, silent)
    state, last = at.fit_state, at.rounds[-1].comparison
    spreads = tuple(np.full(3, 0.1) for _ in question.records)
    state = replace(state, starts=tuple(np.zeros(3) for _ in spreads), spreads=spreads)
    told = replace(last, contradictions=("the damper feeds the machine",))
    step = strategy.propose(begun.assembly, state, told, 2, silent)
    assert step.stopped == "no_candidate"
