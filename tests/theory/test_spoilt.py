"""Readings that are no measurement: found where they are, nowhere else, and harmless then."""

import numpy as np
import pytest
from spiral_plugins.effects.restoring import CubicStiffness
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.types.errors import InputError
from spiral.types.invalid import (
    InvalidReadings,
    bridged,
    clipping,
    invalid_words,
    reading_step,
    spoilt_readings,
)
from spiral.types.model import seed_model
from spiral.types.record import make_record

N = 4000
TIME = 0.01 * np.arange(N)
MOTION = np.sin(2 * np.pi * TIME) * np.exp(-0.01 * TIME) + 0.3 * np.sin(2 * np.pi * 3.1 * TIME)


def noisy(seed, level=0.02):
    return MOTION + level * MOTION.std() * np.random.default_rng(seed).normal(size=N)


def kinds(values, inputs=()):
    return {s.kind: s.where for s in spoilt_readings(values, inputs)}


@pytest.mark.parametrize("seed", range(3))
def test_spikes_are_found_where_they_are(seed):
    rng = np.random.default_rng(seed)
    values, at = noisy(seed), np.arange(7, N, 97)
    values[at] += 5 * MOTION.std() * rng.choice([-1, 1], len(at))
    found = np.flatnonzero(kinds(values)["spike"])
    assert set(found) <= set(at)
    assert len(found) >= 0.9 * len(at)


@pytest.mark.parametrize("lost", [0.0, -9.99])
@pytest.mark.parametrize("step", [0.0, 0.05])
def test_dropouts_to_one_value_are_found_where_they_are(lost, step):
    """Of one to four readings each, of a coarse converter too; where the motion passes, not all."""
    values, gone = noisy(4), np.zeros(N, dtype=bool)
    values = step * np.round(values / step) if step else values
    for k, at in enumerate(range(40, N - 10, 211)):
        gone[at : at + 1 + k % 4] = True
    far = gone & (np.abs(MOTION - lost) > 0.4 + 6 * step)  # twelve deviations of its rounding
    values[gone] = lost
    out = np.logical_or.reduce(list(kinds(values).values()))
    assert not np.any(out & ~gone)
    assert out[far].mean() > 0.9


def test_pulses_of_a_signal_are_no_dropouts():
    """A current that a switch interrupts, each time for another while; a square wave."""
    rng = np.random.default_rng(0)
    on = np.repeat(rng.integers(0, 2, N // 3 + 1), 3)[:N]
    assert "dropout" not in kinds((2 + MOTION) * on + 0.01 * rng.normal(size=N))
    assert "dropout" not in kinds((2 + MOTION) * on)


def test_what_noise_does_where_it_is_loud_is_no_spike():
    """A concentration that is read within 5 % of itself, over two decades: and spikes in it are."""
    rng = np.random.default_rng(5)
    level = np.exp(2.3 * np.sin(2 * np.pi * np.arange(N) / N))
    values = level * (1 + 0.05 * rng.normal(size=N))
    assert "spike" not in kinds(values)
    at = np.arange(60, N, 197)
    values[at] += 2 * level[at] * rng.choice([-1, 1], len(at))
    found = np.flatnonzero(kinds(values)["spike"])
    assert set(found) <= set(at)
    assert len(found) >= 0.9 * np.sum(level[at] > 0.5)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5])
def test_a_coarse_converter_s_steps_are_measured_and_are_no_spikes(share):
    """Also where a text rounds them; values of any other kind have no step."""
    step = share * MOTION.std()
    coarse = step * np.round(noisy(2, 0.002) / step) - 0.123
    assert reading_step(coarse) == pytest.approx(step, rel=1e-6)
    assert reading_step(np.array([float(f"{v:.4f}") for v in coarse])) == pytest.approx(
        step, rel=0.02
    )
    assert not kinds(coarse)
    assert not clipping("x", coarse)
    assert reading_step(noisy(2)) == 0.0
    assert reading_step(np.full(N, 3.0)) == 0.0
    stopped = np.minimum(coarse, 0.8 * coarse.max())
    assert "looks clipped" in clipping("x", np.minimum(noisy(2), 0.8 * MOTION.max()))
    assert "looks clipped" in clipping("x", stopped) or share > 0.01  # each level lasts


@pytest.mark.parametrize("each", [2, 5, 20, 4.3])
def test_repeats_of_a_slow_sensor_are_told_once(each):
    """Every value that is new stays, and a spike among these is found where they are dense."""
    fresh = np.unique(np.floor(np.floor(np.arange(N) / each) * each).astype(int))
    base = noisy(3)
    base[fresh[60]] += 5 * MOTION.std()
    values = base[fresh][np.searchsorted(fresh, np.arange(N), side="right") - 1]
    found = kinds(values)
    left = np.flatnonzero(~found["repeat"])
    assert set(left) <= set(fresh)
    assert len(left) >= len(fresh) - 1
    if each < 10:
        assert list(np.flatnonzero(found["spike"])) == [fresh[60]]


def test_a_steady_motion_under_a_coarse_converter_is_no_slow_sensor():
    steady = np.arange(N)
    there_and_back = np.abs(steady % 400 - 200)
    for values in (np.round(steady / 7), np.round(there_and_back / 7), np.floor(steady / 5)):
        assert not kinds(values.astype(float))


def test_a_slow_sensor_s_machine_is_found_with_honest_errors():
    """Readings held for five samples, told as they are; held ones would look like a late sensor."""
    truth = {"linear_stiffness.stiffness": 400.0, "linear_damping.damping": 2.0}
    model = seed_model(Oscillator(), values={"system.mass": 1.0, **truth})
    rng = np.random.default_rng(1)
    force = sum(np.sin(2 * np.pi * f * TIME + f**2) for f in np.arange(1.0, 6.0, 0.5))
    clean = simulate(model, TIME, {"force": force}, 0.0, rng).channels["x"]
    held = (clean + 0.01 * clean.std() * rng.normal(size=N))[np.arange(N) // 5 * 5]
    record = make_record(model.system, "held", TIME, {"x": held}, {"force": force})
    result = spiral.compare(record, model)
    for key, value in truth.items():
        assert abs(result.model.values[key] - value) < 4 * result.model.errors[key]
    assert result.test_error < 0.015
    assert record.sigma()["x"] == pytest.approx(0.01 * clean.std(), rel=0.3)


@pytest.mark.parametrize("apart", [1, 2, 3])
def test_two_spikes_that_meet_are_found_beside_others_and_pulses_are_left(apart):
    """Two readings off by the same; a record that has nothing but such pairs has pulses."""
    size = 5 * MOTION.std()
    meeting, alone = np.array([1000, 1000 + apart]), np.arange(1500, 3900, 300)
    both = noisy(4)
    both[meeting] += size
    assert not kinds(both)
    both[alone] += size
    found = np.flatnonzero(kinds(both)["spike"])
    np.testing.assert_array_equal(found, [*meeting, *alone])


@pytest.mark.parametrize("seed", [0, 2, 4, 5])  # of these more than 2 of 1000 repeat
def test_a_fine_converter_s_few_repeats_do_not_hide_that_it_clips(seed):
    """Of 1000 readings a handful repeat by chance: runs as long as those at the stop do not."""
    q = 0.001 * MOTION.std()  # a twentieth of the noise: one reading in 70 repeats at rest
    values = np.round(np.minimum(noisy(seed), 0.8 * MOTION.max())[:1000] / q) * q
    most = values.max()
    assert np.mean(np.diff(values[values < most]) == 0) > 0.002
    np.testing.assert_array_equal(kinds(values)["clipped"], values == most)


@pytest.mark.parametrize("seed", range(4))
def test_a_coarse_encoder_that_rests_is_neither_held_nor_clipped(seed):
    """It stays at one step at rest, and at its turning points, which may be its extremes."""
    rng = np.random.default_rng(seed)
    moving = np.where(TIME > 13, 0.6 * np.sin(0.5 * (TIME - 13)) ** 3, 0.0)
    values = 0.02 * np.round((0.6 + moving + 0.002 * rng.normal(size=N)) / 0.02)
    assert not kinds(values)


def test_a_rest_at_the_least_value_is_no_clipping():
    assert not clipping("drive", np.where(TIME > 13, 1 + np.sin(TIME), 0.0))
    assert "looks clipped" in clipping("drive", np.clip(np.sin(TIME), -1.0, 0.7))


@pytest.mark.parametrize("seed", range(4))
def test_a_fine_encoder_stays_on_a_step_where_the_motion_turns(seed):
    """At a usual speed no two readings are equal; at turning points several are."""
    turning = np.sin(0.6 * TIME) * (1 + 0.2 * np.sin(0.17 * TIME))
    q = 0.05 * np.abs(np.diff(turning)).mean()
    values = q * np.round((turning + 0.5 * q * np.random.default_rng(seed).normal(size=N)) / q)
    assert np.mean(np.diff(values) == 0) < 0.03
    assert not kinds(values)
    dropped = values.copy()
    dropped[1000:1006] = values[999]
    assert list(np.flatnonzero(kinds(dropped)["held"])) == list(range(1000, 1006))


def test_a_machine_that_comes_to_rest_at_either_end_is_not_clipped():
    """Trips of a lift between two floors: it slows down before it stands."""
    share = np.clip((TIME % 20) / 5, 0, 1) - np.clip((TIME % 20 - 10) / 5, 0, 1)
    trips = 10 * (1 - np.cos(np.pi * share)) / 2
    assert np.mean(np.diff(trips) == 0) > 0.3
    assert not clipping("height", np.round(trips, 4))
    assert "looks clipped" in clipping("height", np.clip(np.round(trips, 4), 0.0, 8.0))


@pytest.mark.parametrize("at", [600, 601])
def test_one_reading_at_a_jump_of_an_input_is_its_doing(at):
    """A fast answer to a jump looks like a spike where the neighbours agree by chance."""
    values, given = noisy(1), np.repeat(np.arange(40) % 2, N // 40).astype(float)
    values[at] += 0.5 * MOTION.std()
    assert list(np.flatnonzero(kinds(values)["spike"])) == [at]
    assert not kinds(values, (given,))


def test_runs_of_one_value_are_held_and_extremes_are_clipped():
    values = noisy(0)
    held = np.zeros(N, dtype=bool)
    for start in (500, 1200, 3100):
        values[start : start + 5] = values[start - 1]
        held[start : start + 5] = True
    np.testing.assert_array_equal(kinds(values)["held"], held)
    most = 0.8 * np.abs(MOTION).max()
    clipped = np.clip(noisy(1), -most, most)
    np.testing.assert_array_equal(kinds(clipped)["clipped"], np.abs(clipped) == most)


def test_a_stop_that_is_met_two_readings_at_a_time_is_no_signal_that_repeats_itself():
    """Of 400 swings each is cut at its top, for two readings."""
    values = np.cos(2 * np.pi * (np.arange(N) - 0.5) / 10) + 0.002 * np.random.default_rng(
        0
    ).normal(size=N)
    clipped = np.minimum(values, 0.94)
    at = clipped == 0.94
    assert np.mean(np.diff(clipped) == 0) > 0.05
    assert max(len(run) for run in "".join("x" if a else " " for a in at).split()) == 2
    np.testing.assert_array_equal(kinds(clipped)["clipped"], at)


def _harmless():
    rng = np.random.default_rng(5)
    square, step = np.sign(np.sin(TIME)), np.ptp(MOTION)
    quiet = 0.02 * MOTION.std()
    return {
        "nothing": MOTION,
        "noise": noisy(0),
        "rest before": np.concatenate([np.zeros(500), MOTION]),
        "8 bit": np.round(noisy(0) / (step / 256)) * (step / 256),
        "12 bit": np.round(noisy(0) / (step / 4096)) * (step / 4096),
        "square": square + quiet * rng.normal(size=N),
        "square, no noise": square,
        "triangle": np.abs(TIME % 1 - 0.5),
        "saw": TIME % 1 + quiet * rng.normal(size=N),
        "white": rng.normal(size=N),
        "random walk": np.cumsum(rng.normal(size=N)),
        "uniform": rng.uniform(size=N),
        "stick-slip": np.sign(np.sin(TIME)) * np.maximum(np.abs(np.sin(TIME)) - 0.5, 0),
    }


@pytest.mark.parametrize("name", _harmless())
def test_other_signals_have_none(name):
    assert not kinds(_harmless()[name])


def test_white_noise_is_hardly_ever_called_a_spike():
    """12 robust standard deviations off, and neighbours that agree: none in 400 000 readings."""
    rng = np.random.default_rng(6)
    assert sum(len(kinds(MOTION + 0.1 * rng.normal(size=N))) for _ in range(100)) == 0


def test_a_reading_that_an_input_moves_is_no_spike():
    values, blow = noisy(2), np.zeros(N)
    values[1000] += 5.0
    assert "spike" in kinds(values)
    blow[1000] = 3.0
    assert "spike" not in kinds(values, [blow])


@pytest.mark.parametrize("at", [0, 1, 3, N - 4, N - 2, N - 1])
def test_a_spike_at_an_end_is_found_and_a_move_there_is_none(at):
    spoilt = noisy(5)
    spoilt[at] += 5 * MOTION.std()
    assert np.flatnonzero(kinds(spoilt)["spike"]).tolist() == [at]
    moved = noisy(5)
    moved[-3:] += 5 * MOTION.std()
    moved[:3] -= 5 * MOTION.std()
    assert "spike" not in kinds(moved)


def test_spikes_that_stand_near_moves_of_an_input_by_chance_are_found():
    """An input that is at work for a third of the record excuses no spike; one that kicks does."""
    values, at = noisy(3), np.arange(150, N, 401)
    values[at] += 5 * MOTION.std()
    worked = np.zeros(N)
    worked[1200:2500] = np.random.default_rng(0).choice([0.0, 1.0], 1300)
    np.testing.assert_array_equal(np.flatnonzero(kinds(values, [worked])["spike"]), at)
    kicks = np.zeros(N)
    kicks[at] = 1.0
    assert "spike" not in kinds(values, [kicks])
    assert "spike" not in kinds(values, [worked, kicks])


def test_gone_readings_are_bridged_by_straight_lines():
    gone = np.array([False, True, True, False, False, True])
    np.testing.assert_allclose(
        bridged(np.array([0.0, 9.0, 9.0, 3.0, 4.0, 9.0]), gone), [0, 1, 2, 3, 4, 4]
    )


TRUTH = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 0.8,
         "cubic_stiffness.stiffness": 2e3}  # fmt: skip


def test_the_missing_spring_is_found_beside_spikes_and_dropouts():
    """1 % of spikes and ten dropouts: named, left out, and the coefficient within 3 errors."""
    rng = np.random.default_rng(3)
    model = seed_model(Oscillator(), (CubicStiffness(),), values=TRUTH)
    time = np.arange(3000) / 200.0
    force = 30 * np.sin(2 * np.pi * (1 + 3 * time / time[-1]) * time)
    clean = simulate(model, time, {"force": force}, 0.02, rng)
    x = clean.channels["x"].copy()
    at = np.arange(11, 3000, 101)
    x[at] += 5 * x.std() * rng.choice([-1, 1], len(at))
    for start in range(250, 3000, 303):
        x[start : start + 5] = x[start - 1]
    record = make_record(Oscillator(), "spoilt", time, {"x": x}, {"force": force})
    run = spiral.discover(record, "oscillator", candidates=["cubic_stiffness", "quadratic_damping"])
    assert run.rounds[1].admitted == ("cubic_stiffness",)
    assert "like spikes" in run.summary
    assert "dropout" in run.summary
    found = run.model.estimates()["cubic_stiffness"]["stiffness"]
    assert abs(found.estimate - 2e3) < 3 * found.se
    assert run.rounds[-1].comparison.fit_error < 0.03  # 0.024 without any of them


def test_missing_readings_are_done_without():
    """A tenth of the readings, in long and short gaps: errors grow by what was lost, no more."""
    record = simulate(
        seed_model(Oscillator(), values={"system.mass": 1.0, "linear_stiffness.stiffness": 400.0,
                                         "linear_damping.damping": 2.0}),
        np.arange(3000) / 200, {"force": np.sin(np.arange(3000) ** 1.3 / 60)}, 0.02,
        np.random.default_rng(3),
    )  # fmt: skip
    x = record.channels["x"].copy()
    x[700:900] = np.nan
    x[np.random.default_rng(0).integers(0, 3000, 100)] = np.nan
    lacking = make_record(Oscillator(), "gaps", record.time, {"x": x}, record.inputs)
    assert "missing" in lacking.spoilt_words[0]
    whole, parts = (spiral.compare(r, "oscillator").model.estimates() for r in (record, lacking))
    for owner, rows in whole.items():
        for name, known in rows.items():
            found = parts[owner][name]
            assert abs(found.estimate - known.estimate) < 3 * known.se
            assert 1.0 < found.se / known.se < 1.2


def test_a_channel_without_most_of_its_readings_is_refused():
    x = MOTION.copy()
    x[: N // 2 + 1] = np.nan
    with pytest.raises(InputError, match="missing"):
        make_record(Oscillator(), "gaps", TIME, {"x": x}, {"force": MOTION})


def test_what_is_invalid_in_several_records_is_told_once():
    def record(missing, samples):
        x = np.sin(np.arange(samples) / 9) + np.random.default_rng(samples).normal(size=samples)
        x[np.arange(missing) * 7 + 20] = np.nan
        time = np.arange(samples) / 200
        return make_record(Oscillator(), "part", time, {"x": x}, {"force": np.cos(time)})

    parts = (record(5, 300), record(0, 400), record(15, 1300))
    problem = Problem(seed_model(Oscillator()), parts, parts[1:])
    whole, tested = problem.spoilt_sentences()
    assert whole.startswith("sensor x: 20 readings (1 %) are missing")
    assert tested.startswith("in the test record, sensor x: 15 readings (0.88 %) are missing")
    assert parts[1].spoilt_words == ()


def test_parts_of_one_kind_are_counted_together():
    """A record that was joined from two has what each of them lacked."""
    first, second = np.zeros((2, 100), dtype=bool)
    first[:2], second[50:53] = True, True
    spoilt = {"x": tuple(InvalidReadings("missing", where) for where in (first, second))}
    (words,) = invalid_words([(spoilt, 100)])
    assert words.startswith("sensor x: 5 readings (5 %) are missing")
