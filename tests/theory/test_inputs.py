"""Inputs: how they run between samples, and what an actuator makes of them."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.linalg import expm
from spiral_plugins.effects.inputs import (
    ActuatorLag,
    InputDeadZone,
    InputDelay,
    InputGain,
    InputSaturation,
)
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

import spiral
from experiments.studies.signals import band_limited
from spiral.engine.filter.noise import noise_groups
from spiral.engine.filter.task import build_task, run_from_rest
from spiral.engine.series import stage_inputs
from spiral.inference.likelihood.interpolation import _is_interpolation_open, held_inputs
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.errors import InputError, SpiralError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.marks import others_slow

TRUTH = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 2.0}
WRONG = {**TRUTH, "system.mass": 1.1, "linear_stiffness.stiffness": 430.0}
HIDDEN = {
    "input_dead_zone": (InputDeadZone(), {"share": 1.0, "gap": 2.0, "width": 0.1}),
    "input_saturation": (InputSaturation(), {"share": 1.0, "limit": 10.0, "width": 0.2}),
    "actuator_lag": (ActuatorLag(), {"share": 1.0, "time_constant": 0.03}),
}


def driven(seed, name):
    """An oscillator under noise of 0.3 to 10 Hz for 12 s, 1 % noise that nobody declares."""
    effect, values = HIDDEN[name]
    named = {f"{name}.{k}": v for k, v in values.items()}
    model = seed_model(Oscillator(), (effect,), values={**TRUTH, **named})
    time = np.arange(2400) / 200
    force = band_limited(np.random.default_rng(seed), 8.0, (0.3, 10.0), 12.0)(time)
    record = simulate(model, time, {"force": force}, 0.01, np.random.default_rng(seed))
    return replace(record, noise={})


@pytest.mark.parametrize("name", others_slow(HIDDEN, 1))
def test_what_an_actuator_does_is_named_and_measured(name):
    run = spiral.discover(driven(0, name), "oscillator", test=driven(50, name), values=WRONG)
    assert run.missing == (name,)
    found = run.model.estimates()
    assert found[name]["share"].estimate == pytest.approx(1.0, abs=0.05)
    key = next(k for k in HIDDEN[name][1] if k not in ("share", "width"))
    assert found[name][key].estimate == pytest.approx(HIDDEN[name][1][key], rel=0.05)
    last = run.rounds[-1].comparison
    assert last.test_error < 1.05 * last.noise_floor


def held(count, seed=0, noise=0.01, push=0.0):
    """The motion under a force that changes every fifth sample and stays, by exact steps.

    ``push`` : m/s, standard deviation of random kicks to the velocity, one a sample.
    """
    rng, dt = np.random.default_rng(seed), 0.01
    force = np.repeat(rng.normal(size=count // 5) * 8, 5)
    whole = np.array([[0.0, 1.0, 0.0], [-400.0, -2.0, 1.0], [0.0, 0.0, 0.0]])
    step, state, found = expm(whole * dt), np.zeros(2), []
    for value in force:
        found.append(state[0])
        state = step[:2, :2] @ state + step[:2, 2] * value
        state[1] += push * rng.normal() if push else 0.0
    x = np.array(found)
    return np.arange(count) * dt, force, x + noise * x.std() * rng.normal(size=count)


def recorded(hold, count=2000, noise=0.01, push=0.0):
    time, force, x = held(count, noise=noise, push=push)
    return make_record(Oscillator(), "held", time, {"x": x}, {"force": force}, hold=hold)


def test_a_staircase_is_taken_for_held_from_the_start():
    """Neither a smooth signal in coarse steps nor one that its record declares."""
    time, force, x = held(2000)

    def ways(values, hold=None):
        hold = {} if hold is None else hold
        record = make_record(Oscillator(), "", time, {"x": x}, {"force": values}, hold=hold)
        return dict(held_inputs(Problem(seed_model(Oscillator(), values=TRUTH), (record,), ())))

    assert ways(force) == {"force": "zero_order"}
    assert ways(force, {"force": "linear"}) == {}
    assert ways(np.round(np.sin(0.2 * time) * 60) / 60) == {}
    assert ways(np.random.default_rng(0).normal(size=2000)) == {}


def test_an_input_that_is_held_is_integrated_as_one():
    """Against the matrix exponential; run between samples as measured signals it is far off."""
    time, force, x = held(2000, noise=0.0)
    system = Oscillator()
    model = seed_model(system, values=TRUTH)
    errors = {}
    for hold in ("zero_order", "band_limited"):
        record = make_record(system, "held", time, {"x": x + 1e-9 * np.cos(1e4 * time)},
                             {"force": force}, hold=hold)  # fmt: skip
        values = model.row("truth", "")
        task = build_task(model, compile_model(trace(system, model.effects)), values, record,
                         substeps=8)  # fmt: skip
        run = run_from_rest(task.compiled, task.series, task.inputs, task.values)
        errors[hold] = np.std(run[:, 0] - x) / np.std(x)
    assert errors["zero_order"] < 1e-6
    assert errors["band_limited"] > 0.02


@pytest.mark.parametrize("late", [1, 2, 3])
def test_a_held_input_that_acts_late_is_the_one_before(late):
    """As the record of what acted, held: each value from so many samples on."""
    system, (time, force, x) = Oscillator(), held(200)
    acting = force[np.maximum(np.arange(200) - late, 0)]
    told, as_it_acted = (
        stage_inputs(system, make_record(system, "", time, {"x": x}, {"force": f}, hold=hold), 2)
        for f, hold in ((force, f"zero_order_{late}"), (acting, "zero_order"))
    )
    np.testing.assert_array_equal(told, as_it_acted)


@pytest.mark.parametrize("hold", ["zero_order", pytest.param({}, marks=pytest.mark.slow)])
def test_a_held_input_that_acts_two_samples_late_is_found(hold):
    """Of a fast flow, which shows its steps: a delay that is rational in frequency is less likely.

    Also where nobody told that the input is held.
    """
    rng, decay = np.random.default_rng(0), np.exp(-0.01 / 0.04)
    asked, x = np.repeat(rng.normal(size=500), 4), np.zeros(2000)
    for k in range(2, 1999):
        x[k + 1] = decay * x[k] + (1 - decay) * 2.0 * asked[k - 2]
    system = spiral.system(
        ["T*x' = k*u - x"], states={"x": "m"}, inputs={"u": "m"}, observed=["x"],
        parameters={"T": (0.046, "s"), "k": (1.9, "1")}, free=["T", "k"],
    )  # fmt: skip
    noisy = x + 0.01 * x.std() * rng.normal(size=2000)
    record = make_record(system, "", np.arange(2000) / 100, {"x": noisy}, {"u": asked}, hold=hold)
    run = spiral.discover(record, system)
    assert run.verdict == "nothing_missing"
    assert run.rounds[-1].comparison.between == {"u": "zero_order_2"}
    assert "is most likely held until the next sample, two samples late" in run.summary
    assert "2.5 samples of lag or delay looks the same" in run.summary
    for name, true in (("T", 0.04), ("k", 2.0)):
        one = run.model.estimates()["system"][name]
        assert abs(one.estimate - true) < 3 * one.se


def test_a_hold_that_is_declared_late_is_believed():
    """A record that declares how late its input acts is asked nothing."""
    record = replace(recorded("zero_order_1", 400), name="told")
    problem = Problem(seed_model(Oscillator(), values=TRUTH), (record,), ())
    (force,) = Oscillator().inputs
    assert not _is_interpolation_open(problem, force)
    held_one = replace(problem, records=(recorded("zero_order", 400),))
    assert _is_interpolation_open(held_one, force)


@pytest.mark.slow
def test_a_hold_that_nobody_told_of_is_found():
    """Nothing is missing then, the values are the truth, and the notes name the hold."""
    run = spiral.discover(recorded(None), "oscillator", values=WRONG)
    assert run.verdict == "nothing_missing"
    last = run.rounds[-1].comparison
    assert last.between == {"force": "zero_order"}
    assert "record.hold=zero_order" in " ".join(last.notes)
    assert "record.hold=zero_order" in run.summary
    for key, value in TRUTH.items():
        owner, name = key.split(".")
        found = run.model.estimates()[owner][name]
        assert abs(found.estimate - value) < 3 * found.se


def test_a_model_of_which_nothing_is_free_is_compared():
    """All values known: there is nothing to fit but the noise."""
    found = spiral.compare(recorded("zero_order"), "oscillator", values=TRUTH, fixed=list(TRUTH))
    assert found.chi2_per_dof == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_a_hold_that_is_declared_is_believed_and_its_half_sample_told():
    """Declared as a measured signal, a held input comes half a sample late."""
    run = spiral.discover(recorded("band_limited"), "oscillator", values=WRONG)
    assert run.missing in (("input_delay",), ("actuator_lag",), ("delay",))
    assert "record.hold=zero_order" in run.summary
    assert not run.rounds[-1].comparison.between


def straight(seed, rate):
    """The motion under a force in straight lines between its samples, by an exact step for each."""
    count, dt = 3000, 1 / rate
    force = 8 * np.random.default_rng(seed).normal(size=count)
    whole = np.zeros((4, 4))
    whole[:2] = [[0.0, 1.0, 0.0, 0.0], [-400.0, -2.0, 1.0, 0.0]]
    whole[2, 3] = 1.0
    step, state, found = expm(whole * dt), np.zeros(2), []
    for now, following in zip(force, np.append(force[1:], 0.0), strict=True):
        found.append(state[0])
        state = step[:2] @ np.array([*state, now, (following - now) / dt])
    x = np.array(found)
    noise = 0.01 * x.std() * np.random.default_rng(seed + 1).normal(size=count)
    return make_record(
        Oscillator(), "straight", np.arange(count) * dt, {"x": x + noise}, {"force": force}
    )


@pytest.mark.parametrize("seed", others_slow([0, 1], 1))
def test_straight_lines_between_samples_are_found(seed):
    """A rough force at seven samples a period: a spline through it is another force."""
    run = spiral.discover(straight(seed, 20.0), "oscillator", values=WRONG)
    assert run.verdict == "nothing_missing"
    assert run.rounds[-1].comparison.between == {"force": "linear"}
    for key, value in TRUTH.items():
        owner, name = key.split(".")
        found = run.model.estimates()[owner][name]
        assert abs(found.estimate - value) < 3 * found.se


def test_an_input_that_the_record_cannot_tell_runs_as_its_system_says():
    """Under 10 Hz at 200 samples per second lines, splines and filters are one."""
    time = np.arange(2400) / 200
    force = band_limited(np.random.default_rng(0), 8.0, (0.3, 10.0), 12.0)(time)
    model = seed_model(Oscillator(), values=TRUTH)
    record = simulate(model, time, {"force": force}, 0.01, np.random.default_rng(1))
    found = spiral.compare(replace(record, noise={}), "oscillator", values=WRONG)
    assert not found.between


@pytest.mark.slow
def test_a_lag_is_no_hold():
    """Half a sample late is a little of a lag that is missing; the lag itself is likelier."""
    run = spiral.discover(driven(1, "actuator_lag"), "oscillator", values=WRONG)
    assert run.missing == ("actuator_lag",)  # and no rate limit that is never reached
    assert not any(r.comparison.between for r in run.rounds)


@pytest.mark.slow
def test_a_hold_is_found_beside_a_random_force():
    """Gusts that the model cannot explain: the hold is likelier than any actuator."""
    run = spiral.discover(recorded(None, 4000, push=0.025), "oscillator", values=WRONG)
    last = run.rounds[-1].comparison
    assert run.missing == ()
    assert last.between == {"force": "zero_order"}
    assert last.random is not None
    assert last.random.get("force.observed", 0.0) > 0.05  # too much for the model to explain


@pytest.mark.parametrize(
    ("hold", "word"), [("zero", "zero_order"), ({"torque": "zero_order"}, "force")]
)
def test_a_hold_that_is_none_is_refused(hold, word):
    with pytest.raises(InputError) as caught:
        recorded(hold)
    assert word in f"{caught.value.expected} {caught.value.try_}"


def test_an_actuator_needs_an_input_that_nothing_follows_from():
    with pytest.raises(SpiralError, match="acts on an input"):
        PlanarRotor().place(InputDeadZone())


@pytest.mark.parametrize("fixed", [["system.mass"], []])
def test_a_wrong_scale_of_an_input_is_named_where_the_mass_is_known(fixed):
    """Where mass, damper and spring are all free, the scale is theirs: nothing is missing."""
    model = seed_model(Oscillator(), (InputGain(),), values={**TRUTH, "input_gain.error": 0.15})
    time, given = np.arange(3000) / 200, []
    for seed in (0, 50):
        force = band_limited(np.random.default_rng(seed), 8.0, (0.3, 10.0), 15.0)(time)
        made = simulate(model, time, {"force": force}, 0.01, np.random.default_rng(seed))
        given.append(replace(made, noise={}))
    values = {**WRONG, "system.mass": 1.0}
    run = spiral.discover(given[0], "oscillator", test=given[1], values=values, fixed=fixed)
    if not fixed:
        assert run.verdict == "nothing_missing"
        return
    assert run.missing == ("input_gain",)
    found = run.model.estimates()["input_gain"]["error"]
    assert abs(found.estimate - 0.15) < 3 * found.se


def test_what_an_actuator_does_is_done_to_what_it_has_done_before():
    """A gain beside a delay: m x'' = (1 + e) u(t - T), and nothing of u(t) is let through."""
    system, late = Oscillator(), InputDelay()
    alone = trace(system, (late,))
    both = trace(system, (late, InputGain()))
    error = both.p[both.keys.index("input_gain.error")]
    assert both.keys[: len(alone.keys)] == alone.keys
    assert sp.simplify(both.rate[1] - (1 + error) * alone.rate[1]) == 0


@pytest.fixture(scope="module")
def valve():
    """A study of a level behind a valve that moves by 0.3 a second at most, sharply limited."""
    rng, fine = np.random.default_rng(1), 20
    asked = np.repeat(rng.uniform(-1, 1, 50), 50)
    step, level = 0.1 / fine, np.zeros(asked.size)
    decay, position, x = np.exp(-step / 4.0), 0.0, 0.0
    for k in range(asked.size - 1):
        for _ in range(fine):
            reached = position + np.clip(asked[k] - position, -0.3 * step, 0.3 * step)
            x, position = x * decay + (position + reached) * (1 - decay), reached
        level[k + 1] = x
    system = spiral.system(
        ["T*x' = k*u - x"], states={"x": "m"}, inputs={"u": "m"}, observed=["x"],
        parameters={"T": (4.4, "s"), "k": (1.9, "1")}, free=["T", "k"],
    )  # fmt: skip
    noisy = level + 0.01 * level.std() * rng.normal(size=level.size)
    time = 0.1 * np.arange(asked.size)
    record = make_record(system, "valve", time, {"x": noisy}, {"u": asked}, hold="zero_order")
    return spiral.discover(record, system, candidates=["rate_limit", "actuator_lag", "input_delay"])


@pytest.mark.slow
def test_a_limit_has_an_error_where_its_soft_zone_is_not_told(valve):
    """Of two shapes the record tells one: that is free, and the zone is held where it is likely."""
    found = valve.model.estimates()["rate_limit"]
    assert found["width"].se is None
    assert found["rate"].se is not None
    assert found["rate"].estimate == pytest.approx(0.3, abs=3 * found["rate"].se)


def test_a_value_that_was_held_is_free_once_an_effect_tells_it(valve):
    """Without the limit T and k are told only together; k stayed as given, 5 % off."""
    assert "system.k" in valve.rounds[0].details["tied"]["parameters"]
    assert valve.missing == ("rate_limit",)
    assert not valve.alias_groups
    assert "keeps the value" not in valve.summary
    for name, true in (("T", 4.0), ("k", 2.0)):
        one = valve.model.estimates()["system"][name]
        assert one.se is not None
        assert one.estimate == pytest.approx(true, abs=3 * one.se)


def test_no_random_force_acts_on_states_of_an_effect():
    """Of a late actuator, a slow sensor, a hysteresis; whatever the study calls its copy of it."""
    from spiral.io.registry import load_registry

    registry = load_registry(local=False)
    names = ("input_delay", "sensor_lag", "bouc_wen", "hidden_mode")
    effects = tuple(registry.make("effect", n) for n in names)
    model, record = seed_model(Oscillator(), values=TRUTH), recorded("zero_order", 400)
    groups = []
    for more in ((), effects, tuple(replace(e, variant="1") for e in effects)):
        compiled = compile_model(trace(model.system, (*model.effects, *more)))
        values = np.array([model.values.get(k, 0.1) for k in compiled.traced.keys])
        task = build_task(model, compiled, values, record)
        groups.append(
            {w: tuple(task.states[i] for i in at) for w, at in noise_groups(task).items()}
        )
    assert groups[0] == groups[1] == groups[2]


def late_and_dead(seed, samples=2000, rate=100.0):
    """m x'' + c x' + k x = d(u of the sample before), held over each sample; d stops below 2 N."""
    rng, h = np.random.default_rng(seed), 1 / rate / 20
    u = np.repeat(rng.normal(size=samples // 4), 4) * 12.0
    acting = np.concatenate([[0.0], np.sign(u[:-1]) * np.maximum(np.abs(u[:-1]) - 2.0, 0.0)])
    q, v, x = 0.0, 0.0, np.empty(samples)
    for k in range(samples):
        x[k] = q
        for _ in range(20):
            v += h * (acting[k] - 2.0 * v - 400.0 * q)
            q += h * v
    y = x + 0.01 * x.std() * rng.normal(size=samples)
    return make_record(Oscillator(), f"{seed}", np.arange(samples) / rate, {"x": y}, {"force": u})


@pytest.mark.slow
def test_a_dead_zone_behind_a_command_that_acts_a_sample_late_is_alone_what_is_missing():
    """What is late is how the command is held; a lag, a limit of rate and a delay come close."""
    candidates = ["input_delay", "actuator_lag", "rate_limit", "input_dead_zone"]
    run = spiral.discover(
        late_and_dead(1), Oscillator(), test=late_and_dead(2), candidates=candidates
    )
    assert run.missing == ("input_dead_zone",)
    assert run.rounds[-1].comparison.between == {"force": "zero_order_1"}
    gap = run.model.estimates()["input_dead_zone"]["gap"]
    assert gap.estimate == pytest.approx(2.0, abs=3 * gap.se)


def test_an_input_that_was_recorded_late_by_itself_is_told():
    """Of two smooth inputs one is written two samples late: it acts before its record says so."""
    rng, dt, count = np.random.default_rng(7), 0.05, 3000
    turns, fine = rng.uniform(0.1, 3.0, (2, 20)), 20
    phases = rng.uniform(0, 2 * np.pi, (2, 20))

    def given(which, time):
        return np.sin(turns[which] * time[:, None] + phases[which]).sum(axis=1)

    steps = dt / fine * np.arange(count * fine)
    acting, decay, value = (
        1.5 * given(0, steps) + 0.7 * given(1, steps),
        np.exp(-dt / fine / 0.8),
        0,
    )
    x = np.zeros(count)
    for k in range(count * fine):
        if k % fine == 0:
            x[k // fine] = value
        value = value * decay + 0.5 * (acting[k] + acting[min(k + 1, len(acting) - 1)]) * (
            1 - decay
        )
    seen = x + 0.01 * x.std() * rng.normal(size=count)
    system = spiral.system(
        ["T*x' = k*u + d*w - x"], states={"x": "m"}, inputs={"u": "1", "w": "1"}, observed=["x"],
        parameters={"T": (0.85, "s"), "k": (1.4, "m"), "d": (0.75, "m")}, free=["T", "k", "d"],
    )  # fmt: skip
    time = dt * np.arange(count)
    inputs = {"u": given(0, time - 2 * dt), "w": given(1, time)}
    record = make_record(system, "late", time, {"x": seen}, inputs)
    candidates = ["input_delay", "input_delay@w", "actuator_lag", "actuator_lag@w", "input_gain"]
    run = spiral.discover(record, system, candidates=candidates)
    assert run.missing == ("input_delay",)
    found = run.model.estimates()["input_delay"]["time"]
    assert found.estimate == pytest.approx(-2 * dt, abs=0.1 * dt)
    assert "recorded 0.1 s late" in run.summary
