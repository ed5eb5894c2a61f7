"""The loop on machines whose truth is known."""

from dataclasses import replace

import pytest
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.inference.compare import compare
from spiral.inference.diagnose import diagnose
from spiral.inference.discover import add, discover
from spiral.types.model import seed_model
from spiral.types.record import split_off_test
from tests.scenes import (
    BRIEF,
    PROJECTION,
    SEED_TRUTH,
    admitted,
    coastdown_problem,
    effect,
    planar_problem,
    planar_record,
)


@pytest.fixture(scope="module")
def coastdown():
    return discover(coastdown_problem(11, **BRIEF))


def test_the_hidden_tilt_is_named_in_order(coastdown):
    names = admitted(coastdown)
    assert names[:3] == ["cross_stiffness", "cubic_stiffness", "gyroscopic"]
    assert set(names[3:]) <= {"cross_damping", "speed_stiffness"}
    assert all(r.second_order for r in coastdown.rounds[4:])
    assert coastdown.verdict == "effect_missing"


def test_the_error_falls_to_the_noise(coastdown):
    errors = [r.comparison.test_error for r in coastdown.rounds]
    assert errors == sorted(errors, reverse=True)
    assert coastdown.final.test_error <= 1.1 * coastdown.final.noise_floor
    assert 0.97 <= coastdown.final.chi2_per_dof <= 1.03
    assert coastdown.final.horizon == 5000


def test_coefficients_agree_with_the_exact_projection(coastdown):
    table = coastdown.model.estimates()
    for key, truth in PROJECTION.items():
        owner, name = key.rsplit(".", 1)
        found = table[owner][name]
        share = 0.10 if owner == "gyroscopic" else 0.01  # the projection is of leading order
        assert found.estimate == pytest.approx(truth, rel=share)
        assert found.se is not None
        assert found.se > 0


def test_without_the_gyroscopic_effect_the_whole_record_does_not_fit(coastdown):
    problem = coastdown_problem(11, **BRIEF)
    model = coastdown.model.without("gyroscopic")
    assert compare(replace(problem, model=model)).chi2_per_dof > 1.1


def test_nothing_hidden_is_called_nothing_missing():
    run = discover(planar_problem(planar_record(5), planar_record(105, phase=1.3)))
    assert run.verdict == "nothing_missing"
    assert run.stopped == "whiteness"
    assert run.final.test_error <= 1.1 * run.final.noise_floor
    for key, truth in SEED_TRUTH.items():
        owner, name = key.rsplit(".", 1)
        found = run.model.estimates()[owner][name]
        assert abs(found.estimate - truth) < 4.5 * found.se


def _constant_speed(settled: bool, seed: int):
    source = Simulation(
        system=TiltingRotor(),
        inputs={"speed": {"constant": 30.0, "unit": "Hz"}},
        duration=2.0,
        rate=1000.0,
        seed=seed,
        noise_level=0.02,
        settled=settled,
    )
    return source.load(PlanarRotor())[0]


@pytest.mark.slow
def test_constant_speed_in_steady_state_is_refused_with_groups_and_advice():
    problem = planar_problem(_constant_speed(True, 1), _constant_speed(True, 2))
    run = discover(problem)
    assert run.verdict == run.stopped == "not_identifiable"
    assert any({"linear_stiffness", "unbalance"} <= set(g) for g in run.alias_groups)
    assert "weep the speed" in run.advice
    told = diagnose(problem)
    assert told.verdict == "not_identifiable"


@pytest.mark.slow
def test_constant_speed_with_its_start_up_transient_is_judged_by_its_signatures():
    run = discover(planar_problem(_constant_speed(False, 1), _constant_speed(False, 2)))
    assert run.verdict == "effect_missing"
    assert admitted(run)[0] == "cross_stiffness"


def test_three_effects_added_at_once_lead_to_the_same_place():
    """What ``diagnose`` says before, tests/experiments/test_tutorial.py shows on this record."""
    problem = coastdown_problem(11, **BRIEF)
    three = tuple(effect(e) for e in ("cross_stiffness", "cubic_stiffness", "gyroscopic"))
    before, after, run = add(problem, three)
    assert after.test_error < 0.05 * before.test_error
    assert after.test_error <= 1.1 * after.noise_floor
    assert run.model.labels[-3:] == tuple(e.label for e in three)


@pytest.mark.slow
def test_phase_integrated_from_exact_speed_serves_as_well_as_measured_phase():
    hidden = (effect("gyroscopic"),), {"gyroscopic.coefficient": 0.01}
    record, test = (
        planar_record(seed, *hidden, phase=phase, duration=7.0, with_phase=False)
        for seed, phase in ((3, 0.4), (103, 1.3))
    )
    assert record.measured == ("speed",)
    run = discover(planar_problem(record, test))
    assert admitted(run) == ["gyroscopic"]
    assert run.final.test_error <= 1.1 * run.final.noise_floor


def test_two_records_share_the_machine_and_keep_their_own_phase():
    records = tuple(
        planar_record(s, phase=p, duration=7.0, with_phase=False) for s, p in ((1, 0.4), (2, 2.0))
    )
    one = planar_problem(records[0], planar_record(101, duration=7.0, with_phase=False))
    both = replace(one, records=records)
    single, joint = compare(one), compare(both)
    assert joint.chi2_per_dof == pytest.approx(1.0, abs=0.03)
    key = ("linear_stiffness", "stiffness_x")
    se = [c.model.estimates()[key[0]][key[1]].se for c in (single, joint)]
    assert se[1] == pytest.approx(se[0] / 2**0.5, rel=0.15)


def test_a_seed_model_keeps_its_frozen_past():
    model = seed_model(PlanarRotor())
    wider = model.add(effect("gyroscopic"))
    assert "gyroscopic" not in model.labels
    assert wider.without("gyroscopic").labels == model.labels


@pytest.mark.slow
def test_a_look_alike_admitted_first_is_let_go_when_the_true_effect_comes():
    source = Simulation(
        system=Oscillator(),
        effects=(effect("cubic_stiffness"),),
        values={
            "system.mass": 1.0,
            "linear_stiffness.stiffness": 40_000.0,
            "linear_damping.damping": 4.0,
            "cubic_stiffness.stiffness": 1e12,
        },
        inputs={"force": {"noise": 1, "band": [5, 100]}},
        duration=10.0,
        rate=1000.0,
        noise_level=0.02,
    )
    record, test = split_off_test(source.load(Oscillator())[0], 0.2)
    run = discover(planar_problem(record, test, seed_model(Oscillator())))
    assert set(run.model.labels) == {"linear_stiffness", "linear_damping", "cubic_stiffness"}
    found = run.model.estimates()["cubic_stiffness"]["stiffness"]
    assert found.estimate == pytest.approx(1e12, rel=0.02)
    assert any(r.retired for r in run.rounds)
    for r in run.rounds:
        assert not set(r.retired) & set(r.admitted)
