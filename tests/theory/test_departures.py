"""Records that depart from the model of their noise: honest standard errors, and words for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.oscillator import Oscillator

from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.fit import add_standard_errors, maximise_likelihood
from spiral.engine.likelihood.noise import first_noise
from spiral.inference.likelihood.departures import _noise_shape_remarks as shapes_told
from spiral.inference.likelihood.departures import (
    describe_departures,
    drifting_parameters,
    far_value_sentences,
    reversed_sign_sentences,
)
from spiral.inference.simulate import simulate
from spiral.types.formatting import number
from spiral.types.model import seed_model
from spiral.types.record import make_record

TRUTH = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 2.0}
KEYS = tuple(TRUTH)
TIME = np.arange(2000) / 200.0


def force(time):
    """Eleven sines from 1 to 6 Hz."""
    return sum(5 * np.sin(2 * np.pi * (1 + 0.5 * k) * time + k**2) for k in range(11))


FORCE = force(TIME)
MODEL = seed_model(Oscillator(), values=TRUTH)


def moved(values=None):
    """The motion without noise."""
    model = seed_model(Oscillator(), values={**TRUTH, **(values or {})})
    return simulate(model, TIME, {"force": FORCE}, 0.0, np.random.default_rng(0)).channels["x"]


CLEAN = moved()
SPREAD = 0.02 * CLEAN.std()


def fitted(x, level=1e-4):
    record = make_record(MODEL.system, "record", TIME, {"x": x}, {"force": FORCE})
    task = prepare_task(MODEL, replace(record, spoilt={}), substeps=4, every=True)
    both = (prepare_filter(task, ()),)
    return add_standard_errors(maximise_likelihood(both, KEYS, first_noise(task, level)))


def growing(rng):
    return rng.normal(size=len(CLEAN)) * SPREAD * (0.2 + 2 * np.abs(CLEAN / CLEAN.std()))


def steady(rng):
    return rng.normal(size=len(CLEAN)) * SPREAD


def pooled(noise, widened=True):
    squares = []
    for seed in range(30):
        found = fitted(CLEAN + noise(np.random.default_rng(seed)))
        errors = found.errors if widened else replace(found, widened=()).errors
        squares += [((found.values[k] - TRUTH[k]) / errors[k]) ** 2 for k in KEYS]
    return float(np.mean(squares))


def test_blocks_mend_standard_errors_where_the_noise_grows_with_the_motion():
    """Pooled squared t of 30 records; of the information alone it is far from 1."""
    assert pooled(growing, widened=False) > 1.8
    assert 0.6 < pooled(growing) < 1.5


def test_blocks_leave_standard_errors_alone_where_the_noise_is_as_it_is_said_to_be():
    factors = [fitted(CLEAN + steady(np.random.default_rng(s))).widened for s in range(30)]
    assert np.mean(np.array(factors) > 1) < 0.1  # tested at 5 %


def test_nothing_is_told_of_white_noise():
    told = [
        describe_departures(MODEL, fitted(CLEAN + steady(np.random.default_rng(s))), True, ())
        for s in range(30)
    ]
    assert not any(told)


@pytest.mark.parametrize(("hertz", "told"), [(11.3, True), (3.0, False)])
def test_a_line_that_no_input_has_is_told_with_its_frequency(hertz, told):
    """Of 11.3 Hz the force has nothing; at 3 Hz the line may be the machine's answer to it."""
    line = 0.1 * CLEAN.std() * np.sin(2 * np.pi * hertz * TIME + 0.3)
    found = fitted(CLEAN + line + steady(np.random.default_rng(2)))
    said = describe_departures(MODEL, found, False, ())
    assert any(f"one line at {hertz} Hz" in x for x in said) is told, said


@pytest.mark.parametrize(
    ("noise", "word"),
    [
        (growing, "grows with the amplitude"),
        (lambda rng: rng.standard_t(3, size=len(CLEAN)) * SPREAD, "heavy tails"),
    ],
)
def test_the_shape_of_the_noise_is_told(noise, word):
    (told,) = describe_departures(MODEL, fitted(CLEAN + noise(np.random.default_rng(1))), True, ())
    assert word in told


def test_noise_that_grows_from_zero_is_told_of_a_reading_that_is_never_negative():
    """A concentration between 5 and 15 that is read within 3 %; its mean is nothing special."""
    rng = np.random.default_rng(4)
    reading = 10 + 5 * np.sin(np.linspace(0, 40, 2000))
    misses = (0.03 * reading * rng.normal(size=2000))[:, None]
    spreads = np.full((2000, 1), float(np.var(misses)))
    part = SimpleNamespace(misses=misses, spreads=spreads, whitened=misses / np.sqrt(spreads))
    series = SimpleNamespace(y=reading[:, None] + misses, dt=0.01, grown=None)
    compiled = SimpleNamespace(traced=SimpleNamespace(channels=("c",)))
    task = SimpleNamespace(series=series, compiled=compiled)
    (told,) = shapes_told(SimpleNamespace(prepared=((task, None),), predictions=(part,)))
    assert told.startswith("the noise of sensor c grows with its reading, ")
    assert float(told.partition(", ")[2].split("-")[0]) == pytest.approx(3.0, abs=0.3)


def test_a_stiffness_that_drifts_is_told_with_its_size():
    """m x'' = F - k (1 + 0.04 t / T) x - c x', by SciPy."""

    def rate(t, state):
        stiffness = 400.0 * (1 + 0.04 * t / TIME[-1])
        return state[1], force(t) - stiffness * state[0] - 2.0 * state[1]

    drifting = solve_ivp(rate, TIME[[0, -1]], [0, 0], "DOP853", TIME, rtol=1e-9).y[0]
    found = fitted(drifting + steady(np.random.default_rng(2)), level=0.02)
    (told,) = describe_departures(MODEL, found, False, ())
    assert told.startswith("as if linear_stiffness.stiffness")
    share = float(told.partition("changed by +")[2].split(" ")[0])
    assert share == pytest.approx(4.0, abs=1.0)
    assert drifting_parameters(found)["linear_stiffness.stiffness"] == pytest.approx(0.04, abs=0.01)


def test_a_clock_that_jitters_is_told_with_its_seconds():
    """Readings of a motion of 1 to 6 Hz at times off by a millisecond, by its slope."""
    rng = np.random.default_rng(6)
    seconds = SPREAD / np.std(np.gradient(CLEAN, TIME))
    late = CLEAN + np.gradient(CLEAN, TIME) * rng.normal(size=len(TIME)) * seconds
    (told,) = describe_departures(MODEL, fitted(late + 0.3 * steady(rng)), True, ())
    assert "jitter" in told
    told_seconds = float(told.partition("off by ")[2].split(" ")[0])
    assert told_seconds == pytest.approx(seconds, rel=0.2)


def test_a_coarse_converter_is_told_with_its_step():
    step = 0.1 * CLEAN.std()
    coarse = step * np.round((CLEAN + steady(np.random.default_rng(5))) / step)
    (told,) = (t for t in describe_departures(MODEL, fitted(coarse), False, ()) if "steps" in t)
    assert told.startswith(f"sensor x reads in steps of {number(step)} m (9.98 % of its motion)")
    fine = describe_departures(MODEL, fitted(CLEAN + steady(np.random.default_rng(5))), False, ())
    assert not any("steps" in t for t in fine)


def test_an_input_may_be_what_pushes():
    noisy = fitted(CLEAN + steady(np.random.default_rng(3)))
    (told,) = describe_departures(MODEL, noisy, True, ("force.observed",))
    assert "measured input force" in told


def test_a_value_that_went_far_from_the_one_given_is_told():
    """A mass of 1.5 kg that a fit takes to 5 g, a sign that turns; not a factor of five."""
    estimate = SimpleNamespace(
        keys=("system.mass", "linear_stiffness.stiffness", "linear_damping.damping"),
        values={"system.mass": 0.005, "linear_stiffness.stiffness": -80.0,
                "linear_damping.damping": 5.0},
        errors={"system.mass": 0.001, "linear_stiffness.stiffness": 1.0},
    )  # fmt: skip
    given = {"system.mass": 1.5, "linear_stiffness.stiffness": 100.0, "linear_damping.damping": 1.0}
    mass, spring = far_value_sentences(estimate, given)
    assert mass.startswith("system.mass ended at 0.005, far from the 1.5 that it was given")
    assert spring.startswith("linear_stiffness.stiffness ended at -80")
    assert not far_value_sentences(estimate, {})
    estimate.errors["linear_stiffness.stiffness"] = 50.0
    assert far_value_sentences(estimate, given)[1] == (
        "linear_stiffness.stiffness is zero within its error, where 100 was given: what else the "
        "model holds does its work"
    )
    estimate.errors["linear_stiffness.stiffness"] = 100.0  # it may be as given
    assert len(far_value_sentences(estimate, given)) == 1


def test_a_damper_that_ends_up_feeding_the_machine_is_told_where_it_was_given_as_one():
    """Signs of the given model only, and only those that surely turned."""
    ended = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0,
             "linear_damping.damping": -0.5}  # fmt: skip
    model = replace(MODEL, values=ended, errors={"linear_damping.damping": 0.1})
    (told,) = reversed_sign_sentences(model, {**ended, "linear_damping.damping": 2.0})
    assert told.startswith("linear_damping.damping ended at -0.5 where 2 was given: negative damp")
    assert not reversed_sign_sentences(model, ended)  # given so: something feeds it
    assert not reversed_sign_sentences(model, {})
    unsure = replace(model, errors={"linear_damping.damping": 0.3})
    assert not reversed_sign_sentences(unsure, {"linear_damping.damping": 2.0})


def test_slow_misses_are_no_line():
    """A random walk has most of its power at the lowest frequencies, and none stands out."""
    said = []
    for seed in range(10):
        walk = np.cumsum(np.random.default_rng(seed).normal(size=len(CLEAN))) * SPREAD
        said += describe_departures(MODEL, fitted(CLEAN + walk), False, ())
    assert not any("one line" in x for x in said)
