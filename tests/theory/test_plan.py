"""Planned tests: what they promise is what comes when they are simulated and identified."""

import json
from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.strategies.shooting import Shooting
from spiral_plugins.systems.equations import Equations
from spiral_plugins.systems.planar_rotor import PlanarRotor

from spiral.cli import main
from spiral.inference.compare import compare
from spiral.inference.discover import discover
from spiral.inference.plan import PlanQuestion, plan
from spiral.inference.plan_options import PlanOptions
from spiral.inference.planned_tests import planned_tests, record_overrides, simulator
from spiral.inference.problem import Problem
from spiral.types.errors import ConfigError
from spiral.types.model import Model, seed_model
from spiral.types.record import make_record
from tests.marks import others_slow
from tests.scenes import SEED_TRUTH, effect, planar_record, registry

GYROSCOPIC, DAMPING = effect("gyroscopic"), effect("antisymmetric_damping")
LABELS = {"gyroscopic": ("coefficient", 0.02), "antisymmetric_damping": ("damping", 2.0)}
SPEEDS = PlanOptions(speeds=([16.0, 16.0], [30.0, 0.0]), durations=(4.0, 8.0), unbalances=(1.0,))


def question(record):
    model = seed_model(PlanarRotor())
    return Problem(model, (record,), (record,), candidates=(GYROSCOPIC, DAMPING),
                   strategy=Shooting())  # fmt: skip


def truth(label):
    base, (key, value) = seed_model(PlanarRotor()), LABELS[label]
    values = {**SEED_TRUTH, "system.phase_origin": 0.4, f"{label}.{key}": value}
    return Model(base.system, (*base.effects, effect(label)), values)


def run_once(model, test, problem, seed=11):
    """The planned test, run once with the noise that it was planned for."""
    record = simulator(problem, registry().simulation)(model, test)
    noise = {c: problem.records[0].sigma()[c] for c in record.channels}
    rng = np.random.default_rng(seed)
    noisy = {c: v + rng.normal(0.0, noise[c], len(v)) for c, v in record.channels.items()}
    return replace(record, channels=noisy, noise=noise)


@pytest.fixture(scope="module")
def steady():
    """At constant speed a gyroscopic term is a constant antisymmetric damping."""
    values = {"gyroscopic.coefficient": 0.02}
    return question(planar_record(3, (GYROSCOPIC,), values, duration=4.0, hertz=(16.0, 16.0)))


@pytest.fixture(scope="module")
def planned(steady):
    made = simulator(steady, registry().simulation)
    return plan(steady, PlanQuestion((GYROSCOPIC, DAMPING)), planned_tests(steady, SPEEDS), made)


def test_what_the_record_cannot_tell_a_plan_says_it_cannot(steady, planned):
    first = discover(steady).rounds[1]
    assert {first.admitted[0], *first.aliases[first.admitted[0]]} == set(LABELS)
    assert planned.now.probability < 0.01
    assert max(p.angle for p in planned.now.pairs) < 0.01


def test_the_shortest_test_that_suffices_comes_first(planned):
    assert planned.suffices == 2
    assert [o.test.duration for o in planned.tests[:2]] == [4.0, 8.0]
    assert all(o.test.inputs["speed"]["sweep"] == [30.0, 0.0] for o in planned.tests[:2])
    assert all(o.probability < 0.01 for o in planned.tests[2:])


@pytest.mark.parametrize("label", others_slow(LABELS, 1))
def test_the_proposed_test_separates_when_it_is_run(label, steady, planned):
    """Whichever is the truth, it is named alone; the test that came last names nothing or both."""
    model = truth(label)
    found = discover(question(run_once(model, planned.tests[0].test, steady))).rounds[1]
    assert found.admitted == (label,)
    assert found.aliases == {label: ()}
    last = discover(question(run_once(model, planned.tests[-1].test, steady)))
    assert last.verdict == "not_identifiable" or last.rounds[1].aliases[last.rounds[1].admitted[0]]


def test_a_promised_standard_error_is_the_one_of_the_fit(steady):
    """From the Fisher information of the simulated test, within a twentieth of the fitted one's."""
    model, key = truth("gyroscopic"), "gyroscopic.coefficient"
    problem = replace(steady, model=model)
    wishes = replace(SPEEDS, parameter=key)
    made = simulator(problem, registry().simulation)
    found = plan(problem, PlanQuestion(parameter=key), planned_tests(problem, wishes), made)
    assert [o.error for o in found.tests] == sorted(o.error for o in found.tests)
    for outlook in found.tests[:2]:
        record = run_once(model, outlook.test, problem)
        fitted = compare(Problem(model, (record,), (record,), strategy=Shooting()))
        assert outlook.error == pytest.approx(fitted.model.errors[key], rel=0.05)


SWING = (
    "system=oscillator", "record=simulation", "record.duration=4", "record.rate=100",
    "record.inputs={force: {noise: 20, band: [0.5, 6]}}", "effect=[cubic_stiffness]",
    "record.effects=[cubic_stiffness]", "tracking.enabled=false",
    "record.values={system.mass: 1, linear_stiffness.stiffness: 400, linear_damping.damping: 1, "
    "cubic_stiffness.stiffness: 30000}",
)  # fmt: skip


def run_json(tmp_path, *given):
    file = tmp_path / "plan.json"
    code = main(["plan", *SWING, f"out={tmp_path}", *given, "--json", str(file)])
    return code, json.loads(file.read_text())


def test_a_wanted_standard_error_on_the_command_line(tmp_path, capsys):
    given = ("plan.parameter=cubic_stiffness.stiffness", "plan.forms=[noise]",
             "plan.amplitudes=[1,2]", "plan.durations=[4,8]")  # fmt: skip
    code, found = run_json(tmp_path, *given)
    assert (code, found["verdict"], found["question"]["unit"]) == (0, "not_answered", "N/m^3")
    errors = [t["standard_error"] for t in found["tests"]]
    assert errors == sorted(errors)
    assert len(errors) == 8
    assert "8 s" in found["tests"][0]["test"]
    assert "standard error" in capsys.readouterr().out
    code, found = run_json(tmp_path, *given, f"plan.standard_error={errors[3]}")
    assert (code, found["suffices"]) == (0, 4)
    words = found["tests"][0]["overrides"]
    assert main(["simulate", *SWING, *words, "--out", str(tmp_path / "planned.csv")]) == 0
    code, found = run_json(tmp_path, *given, f"plan.standard_error={errors[0] / 100}")
    assert (code, found["suffices"]) == (3, 0)
    assert "plan.durations" in found["error"]["try"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((), ["without a question", "plan.parameter="]),
        (("gyroscopic",), ["gyroscopic alone"]),
        (("plan.parameter=cubic_stifness.stiffness",), ["'cubic_stiffness.stiffness'"]),
        (("cubic_stiffness", "clearance", "plan.parameter=system.mass"), ["one question"]),
        (("plan.parameter=system.mass", "plan.durations=[-1]"), ["plan.durations"]),
        (("plan.parameter=system.mass", "plan.forms=[nose]"), ["'nose'", "noise"]),
        (("plan.parameter=system.mass", "plan.speds=[1]"), ["'speeds'"]),
    ],
)
def test_a_bad_plan_is_one_message(given, words, tmp_path, capsys):
    assert main(["plan", *SWING, f"out={tmp_path}", *given]) == 2
    told = capsys.readouterr().err
    assert all(w in told for w in words)


HEATER = """
equations: ["C*T' = P - k*(T - T_a)", "C*W' = k*(T - W)"]
states: {T: K, W: {unit: K, like: T}}
inputs: {P: W}
parameters: {C: 1 J/K, k: 0.5 W/K, T_a: 275 K}
observed: [T]
"""


def test_a_test_asks_of_an_input_what_it_can_do():
    """A heater does not cool; the test begins where the record did."""
    heated = Equations(text=HEATER)
    time = np.arange(400) * 0.1
    record = make_record(heated, "r", time, {"T": 295 + np.sin(time)}, {"P": 10 + 6 * np.sin(time)})
    problem = Problem(seed_model(heated), (record,), (record,), candidates=())
    tests = planned_tests(problem, PlanOptions(durations=(10.0,), rates=(10.0,)))
    sizes = {t.words: t.inputs["P"] for t in tests}
    assert len(sizes) == len(tests) > 2
    for given in sizes.values():
        assert 4 * given.get("noise", 0.0) <= given["offset"] * (1 + 1e-3)
        assert given.get("chirp", 0.0) <= given["offset"] * (1 + 1e-3)
    assert tests[0].start == {"T": 295.0, "W": 295.0}
    words = record_overrides(tests[0], 0.01, problem.model)
    assert "record.start={T: 295, W: 295}" in words
    asked = planned_tests(problem, PlanOptions(durations=(10.0,), rates=(10.0,), amplitudes=(3.0,)))
    assert max(t.inputs["P"].get("noise", 0.0) for t in asked) > 10


def test_a_plan_has_an_end(steady):
    with pytest.raises(ConfigError, match="at most 200"):
        planned_tests(steady, PlanOptions(durations=tuple(range(1, 90))))
