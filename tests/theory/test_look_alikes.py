"""Pairs that look alike, tried in both orders: what was hidden is named, or both where none can."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import pytest
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.inference.discover import discover
from spiral.inference.problem import silent
from spiral.inference.rounds import (
    admit_step,
    choose_candidate,
    rank_last_round,
    start_study,
    strategy_for,
)
from spiral.inference.strategies.likelihood import look_alikes
from spiral.inference.strategies.likelihood.look_alikes import _runners_up
from spiral.io.registry import load_registry
from spiral.types.model import Model, seed_model
from spiral.types.run import Suggestion
from tests.marks import others_slow
from tests.scenes import SEED_TRUTH, admitted, effect, planar_problem, planar_record

REGISTRY = load_registry()
STIFF = SEED_TRUTH["linear_stiffness.stiffness_x"] - SEED_TRUTH["linear_stiffness.stiffness_y"]
ANGLE = 0.05
HIDDEN = {
    "axis_rotation": {"axis_rotation.angle": ANGLE},
    "cross_stiffness": {"cross_stiffness.stiffness": STIFF * ANGLE},
    "cross_damping": {"cross_damping.damping": 0.5},
    "runout": {"runout.cosine": 3e-6, "runout.sine": 2e-6},
    "shaft_bow": {"shaft_bow.cosine": 0.1, "shaft_bow.sine": 0.05},
}
TURNED = ("axis_rotation", "cross_stiffness", "cross_damping")
ROUND = ("runout", "shaft_bow", "unbalance")
ORDERS = [
    *(each for group in (TURNED, ROUND[:2]) for each in itertools.permutations(group, 2)),
    *((one, one) for one in (*TURNED, *ROUND[:2])),
]


def _problem(name, values=None, model=None, only=(), seed=1):
    values = {**HIDDEN.get(name, {}), **(values or {})}
    record, test = (
        planar_record(s, (effect(name),), values, phase=phase, duration=4.0)
        for s, phase in ((seed, 0.4), (seed + 100, 1.3))
    )
    problem = planar_problem(record, test, model)
    kept = tuple(c for c in problem.candidates if not only or c.label in only)
    return replace(problem, candidates=kept)


def _led(problem, first, rounds=3):
    """The rounds of a study whose first admission a person chose."""
    strategy = strategy_for(problem)
    begun = strategy.begin(problem, silent)
    at = start_study(begun, 0.0)
    for number in range(rounds):
        at, step = rank_last_round(strategy, begun.assembly, at, silent)
        if number == 0:
            step = choose_candidate(strategy, begun.assembly, at, step, first)
        if not step.admitted:
            return at
        at = admit_step(strategy, begun.assembly, at, step, silent)
    return rank_last_round(strategy, begun.assembly, at, silent)[0]


def _ends_with(at, truth):
    """The truth alone was added, unbiased, and as many standard errors off as noise makes it."""
    model = at.rounds[-1].comparison.model
    assert set(model.labels) == {*seed_model(PlanarRotor()).labels, truth}
    assert at.rounds[-1].comparison.test_error <= 1.1 * at.rounds[-1].comparison.noise_floor
    for key, value in HIDDEN[truth].items():
        found = model.estimates()[truth][key.rsplit(".", 1)[1]]
        assert abs(found.estimate - value) < 4.5 * found.se


@pytest.mark.parametrize(("truth", "first"), others_slow(ORDERS, 2))
def test_whichever_comes_first_the_hidden_one_remains_alone(truth, first):
    """A turned probe pair reads K' = R K R^T and C' = R C R^T: a cross stiffness a (k_x - k_y) and
    a cross damping a (c_x - c_y) at once. So the three span two directions, and each is a pair of
    the others; what needs one effect goes before what needs two.
    """  # fmt: skip
    among = TURNED if truth in TURNED else ROUND
    at = _led(_problem(truth, only=(*among, "cubic_stiffness", "gyroscopic")), first)
    assert at.rounds[1].admitted == (first,)
    _ends_with(at, truth)
    if truth != first:
        assert [r.retired for r in at.rounds[2:]] == [(first,)]
        assert at.rounds[2].aliases[truth] == ()


@pytest.mark.parametrize(("truth", "first"), [TURNED[:2], TURNED[1::-1]])
def test_with_equal_damping_a_turned_probe_pair_and_a_cross_stiffness_are_one_alias_group(
    truth, first
):
    """C = c I does not turn: nothing is left to tell them by, whichever is admitted."""
    damping = {"linear_damping.damping_x": 3.0, "linear_damping.damping_y": 3.0}
    at = _led(_problem(truth, damping, only=(*TURNED, "gyroscopic")), first)
    other = next(x for x in TURNED[:2] if x != first)
    assert [r.admitted for r in at.rounds[1:]] == [(first,)]
    assert at.rounds[1].aliases[first] == (other,)
    assert first in at.rounds[1].details["not_separable"][other]
    assert at.rounds[1].comparison.test_error <= 1.1 * at.rounds[1].comparison.noise_floor


def _without_unbalance():
    model = seed_model(PlanarRotor())
    values = {k: v for k, v in model.values.items() if not k.startswith("unbalance")}
    return Model(model.system, tuple(e for e in model.effects if e.label != "unbalance"), values)


COMMON = {"gain.error_x": 0.05, "gain.error_y": 0.05}
AMONG = ("gain", "unbalance", "runout", "shaft_bow", "cubic_stiffness")


def test_a_gain_error_is_no_unbalance_of_its_own_and_is_said_to_be_inseparable_from_it():
    """Without an unbalance nothing moves that a gain could scale; beside it there is no telling."""
    run = discover(_problem("gain", COMMON, _without_unbalance(), AMONG))
    assert admitted(run) == ["unbalance"]
    assert run.rounds[0].suggestions[0].effect == "unbalance"
    assert run.rounds[-1].details["not_separable"]["gain"] == ["unbalance"]
    assert run.final.test_error <= 1.1 * run.final.noise_floor


def test_a_gain_error_is_found_where_the_unbalance_is_known():
    """A trial weight tells the moment: then U' = (1 + e) U is a gain, of both channels."""
    model = seed_model(PlanarRotor())
    moment = {"unbalance.moment": SEED_TRUTH["unbalance.moment"]}
    weighed = replace(model, values={**model.values, **moment}, fixed=tuple(moment))
    run = discover(_problem("gain", COMMON, weighed, AMONG))
    assert admitted(run) == ["gain"]
    assert run.rounds[1].aliases["gain"] == ()
    for found in run.model.estimates()["gain"].values():
        assert abs(found.estimate - 0.05) < 4.5 * found.se


@pytest.mark.parametrize("truth", ROUND[:2])
def test_run_out_bow_and_unbalance_are_told_apart_by_a_sweep(truth):
    """U W^2, a constant turning force, a constant turning reading: three things."""
    run = discover(_problem(truth, model=_without_unbalance(), only=ROUND))
    assert sorted(admitted(run)) == sorted(["unbalance", truth])
    assert run.rounds[2].aliases[run.rounds[2].admitted[0]] == ()
    assert not any({"runout"} & set(names) for r in run.rounds for names in r.aliases.values())
    assert run.final.test_error <= 1.1 * run.final.noise_floor
    known = {**HIDDEN[truth], "unbalance.moment": SEED_TRUTH["unbalance.moment"]}
    for key, value in known.items():
        found = run.model.estimates()[key.split(".")[0]][key.split(".")[1]]
        assert abs(found.estimate - value) < 4.5 * found.se


@pytest.mark.parametrize(
    ("net", "close"), [(0.2226, ("saturating_loss",)), (0.21, ()), (0.30, ("saturating_loss",))]
)
def test_a_candidate_close_behind_an_effect_is_asked_again(net, close):
    """By log-likelihood, -log(1 - share): where both explain nearly all, shares are no measure."""
    told = [Suggestion(n, "", (), 0.0, 0.0, 0.0, s, net=s)
            for n, s in (("exponential_loss", 0.2282), ("saturating_loss", net))]  # fmt: skip
    assert _runners_up("exponential_loss", told) == close
    much = [replace(told[0], net=0.999), replace(told[1], net=0.97)]
    assert _runners_up("exponential_loss", much) == ()
    assert _runners_up("another", told) == ()


LATE = [e for e in REGISTRY.entries if e.kind == "effect" and getattr(e.plugin, "twins", ())]


@pytest.mark.parametrize("name", [e.name for e in LATE])
def test_an_effect_tells_all_values_that_its_twins_begin_with(name):
    """A sensor's lag that begins at 0.01 s where an actuator's is 266 s leads nowhere."""
    one = REGISTRY.make("effect", name)
    own = {p.name: 2.0 for p in one.parameters}
    told = {**own, **one.limit_values(own)}
    for twin in (REGISTRY.make("effect", t) for t in one.twins):
        assert {p.name for p in twin.parameters} <= set(told)


def test_twins_are_late_by_the_same_time():
    lag, delay = (REGISTRY.make("effect", n) for n in ("actuator_lag", "input_delay"))
    assert lag.limit_values({"share": 0.5, "time_constant": 4.0})["time"] == 2.0
    assert delay.limit_values({"time": 3.0, "scale": 1.0})["time_constant"] == 3.0
    pair = {"time_x": 2.0, "time_y": 4.0, "scale": 1.0}
    for name in ("delay", "sensor_lag"):
        assert REGISTRY.make("effect", name).limit_values(pair)["time"] == 3.0
        early = {"time_x": -2.0, "time_y": 1.0, "scale": 1.0}  # its own scale stays
        assert not REGISTRY.make("effect", name).limit_values(early)


@pytest.mark.parametrize(
    ("first", "again", "asked", "told"),
    [
        (("lag",), ("lag",), [("part", ("lag", "stop")), ("whole", ("lag",))], "whole"),
        ((), None, [("part", ("lag", "stop")), ("whole", ())], "part"),  # told apart already
        (None, None, [("part", ("lag", "stop"))], None),
    ],
)
def test_all_samples_decide_only_between_what_stretches_do_not_tell_apart(
    monkeypatch, first, again, asked, told
):
    left, calls = {"part": first, "whole": again}, []

    def contest(options, assembly, model, admitted, others, progress, always=None):
        calls.append((assembly, others))
        named = left[assembly]
        return None if named is None else SimpleNamespace(aliases=named, where=assembly)

    monkeypatch.setattr(look_alikes, "_contest_effects", contest)
    result = look_alikes._contest_on_all_samples(
        None, "whole", None, ("part", None), (), ("lag", "stop"), silent
    )
    assert calls == asked
    assert (result.where if result else None) == told
