"""Errors on unseen records by horizon: against Kalman's predictions, and in the limits known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from spiral_plugins.strategies.shooting import Shooting
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from experiments.studies.signals import band_limited
from spiral.engine.filter.noise import sampled_covariance
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.free_uncertainty import doubt_along_readings, free_doubt
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import predict_readings
from spiral.engine.resting import state_jacobian
from spiral.inference.compare import compare
from spiral.inference.evidence.horizons import FilterNoise, forecast_misses
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.types.horizon import Horizon, changes
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.marks import others_slow

TRUTH = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 0.8}
RATE, NOISE = 200.0, 0.05


def driven(seed, samples=2000, rate=RATE):
    """A linear oscillator of 3.2 Hz under a force that changes at every 5 ms."""
    model = seed_model(Oscillator(), values=TRUTH)
    fine = np.arange(round(samples * RATE / rate)) / RATE
    force = 30 * np.sin(2 * np.pi * (1 + 0.4 * fine) * fine)
    record = simulate(model, fine, {"force": force}, NOISE, np.random.default_rng(seed))
    step = round(RATE / rate)
    return replace(
        record,
        time=record.time[::step],
        channels={k: v[::step] for k, v in record.channels.items()},
        inputs={k: v[::step] for k, v in record.inputs.items()},
        noise=record.sigma(),
    )


@pytest.fixture(scope="module")
def free():
    """A task without a force, so that the flow is a matrix power, and the filter's settings."""
    model = seed_model(Oscillator(), values=TRUTH)
    time = 0.005 * np.arange(600)
    quiet = {"force": np.zeros(600)}
    record = simulate(model, time, quiet, 0.05, np.random.default_rng(0), {"x": 1.0})
    task = prepare_task(model, replace(record, noise=record.sigma()), substeps=24)
    return task, FilterNoise(np.array([0.0, 4.0]), np.diag(task.spread**2), ())


def test_on_a_linear_model_they_are_kalmans_predictions(free):
    task, disturbed = free
    first, steps = 40, 20
    one, ahead = forecast_misses(task, disturbed, first, steps)
    f = expm(state_jacobian(task.compiled, task.values, np.zeros(1)) * task.series.dt)
    h, r = np.array([[1.0, 0.0]]), np.diag(task.series.sigma**2)
    q = sampled_covariance(task, disturbed.intensity)
    x, p, expected_one, states = task.start, disturbed.covariance, [], []
    for y in task.series.y:
        expected_one.append(y - h @ x)
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        x, p = x + gain @ (y - h @ x), (np.eye(2) - gain @ h) @ p
        states.append(x)
        x, p = f @ x, f @ p @ f.T + q
    assert one == pytest.approx(np.array(expected_one)[first:], abs=1e-8)
    starts = np.unique(np.linspace(first, len(states) - 1 - steps, len(ahead)).astype(int))
    far = np.linalg.matrix_power(f, steps)
    expected = [task.series.y[s + steps] - h @ far @ states[s] for s in starts]
    assert ahead == pytest.approx(np.array(expected), abs=1e-8)


def test_nothing_that_is_predicted_is_seen(free):
    """Other measurements from a sample on change no prediction that was made before it."""
    task, disturbed = free
    at, first, steps = 400, 40, 20
    y = task.series.y.copy()
    y[at:] += np.random.default_rng(1).normal(size=y[at:].shape)
    other = replace(task, series=replace(task.series, y=y))
    given, changed = (forecast_misses(t, disturbed, first, steps) for t in (task, other))
    starts = np.linspace(first, 600 - 1 - steps, len(given[1])).astype(int)
    for which, ends, made in ((0, np.arange(first, 600), np.arange(first, 600) - 1),
                              (1, starts + steps, starts)):  # fmt: skip
        predicted = task.series.y[ends] - given[which], y[ends] - changed[which]
        before = made < at
        assert predicted[0][before] == pytest.approx(predicted[1][before], abs=1e-12)
        assert not np.allclose(predicted[0][~before], predicted[1][~before], atol=1e-3)


@pytest.fixture(scope="module")
def true_model():
    return compare(
        Problem(seed_model(Oscillator()), (driven(1),), (driven(2),), strategy=Shooting())
    )


def test_the_true_model_misses_by_noise_at_every_horizon(true_model):
    one, ahead, free_run = true_model.unseen
    floor = true_model.noise_floor
    assert [one.samples, ahead.samples, free_run.samples] == [1, 20, None]
    assert ahead.seconds == pytest.approx(0.1)
    for horizon in true_model.unseen:
        assert horizon.error == pytest.approx(floor, rel=0.1)
    assert free_run.error == pytest.approx(true_model.test_error, rel=1e-12)
    assert len(one.squares["x"]) == 20


def test_a_wrong_model_misses_more_the_further_it_predicts():
    """A spring of a fifth more, held: one sample ahead hides it, the free run does not."""
    wrong = seed_model(Oscillator(), values={**TRUTH, "linear_stiffness.stiffness": 480.0})
    wrong = replace(wrong, fixed=tuple(TRUTH))
    found = compare(Problem(wrong, (driven(1),), (driven(2),), strategy=Shooting()))
    one, ahead, free_run = found.unseen
    assert found.noise_floor < one.error < ahead.error < free_run.error
    assert one.error < 2 * found.noise_floor
    assert free_run.error > 5 * found.noise_floor


def test_a_slow_record_is_predicted_ten_samples_ahead():
    slow = [driven(seed, 500, 10.0) for seed in (1, 2)]
    model = replace(seed_model(Oscillator(), values=TRUTH), fixed=tuple(TRUTH))
    ahead = compare(Problem(model, (slow[0],), (slow[1],), strategy=Shooting())).unseen[1]
    assert (ahead.samples, ahead.seconds) == (10, pytest.approx(1.0))


def horizon(squares, name="ahead"):
    return Horizon(name, 10, 0.1, {f"x{j}": tuple(row) for j, row in enumerate(squares)})


def test_the_standard_error_is_that_of_paired_blocks():
    """Of two equal models the difference lies within one standard error two times in three."""
    rng = np.random.default_rng(3)
    common = rng.gamma(1.0, size=(2000, 2, 20))  # what both miss alike
    pairs = [
        changes((horizon(c + a),), (horizon(c + b),))[0]
        for c, a, b in zip(common, *rng.gamma(4.0, size=(2, 2000, 2, 20)), strict=True)
    ]
    z = np.array([(p.after - p.before) / p.standard_error for p in pairs])
    assert z.std() == pytest.approx(1.0, abs=0.08)
    same = np.mean([p.judged == "same" for p in pairs])
    assert same == pytest.approx(0.67, abs=0.04)


def test_what_is_common_to_both_hides_no_difference():
    rng = np.random.default_rng(4)
    common = 100 * rng.gamma(0.3, size=(1, 20))
    (found,) = changes((horizon(common),), (horizon(1.05 * common),))
    assert found.judged == "worse"
    assert found.after / found.before == pytest.approx(np.sqrt(1.05))
    (found,) = changes((horizon(common),), (horizon(common / 1.05),))
    assert found.judged == "better"


@pytest.mark.parametrize(
    ("before", "after", "judged"),
    [(1.0, np.inf, "worse"), (np.inf, 1.0, "better"), (np.inf, np.inf, "same"),
     (1.0, 1.000_001, "same"), (0.0, 0.0, "same")],
)  # fmt: skip
def test_a_model_that_runs_away_and_one_that_hardly_changes(before, after, judged):
    (found,) = changes((horizon([[before] * 20]),), (horizon([[after] * 20]),))
    assert found.judged == judged


def test_horizons_are_matched_by_name():
    one, two = horizon([[1.0] * 20], "one_sample"), horizon([[1.0] * 20], "free_run")
    assert [c.horizon for c in changes((one, two), (two,))] == ["free_run"]
    assert changes((), (one, two)) == ()


def ran(task, start, values):
    """Readings of a free run from a start with some values, by SciPy."""
    row = dict(zip(task.keys, task.with_values(values).values, strict=True))
    a = np.array([[0.0, 1.0], [-row["linear_stiffness.stiffness"], -row["linear_damping.damping"]]])
    step = expm(a / row["system.mass"] * [[row["system.mass"]], [1.0]] * task.series.dt)
    x, found = np.array(start), []
    for _ in range(task.series.samples):
        found.append(x[0])
        x = step @ x
    return np.array(found)


def test_what_a_free_run_is_not_known_to_is_what_draws_make_of_it(free):
    """Starts and values drawn as they are known, before any reading: rms over 400 free runs."""
    task, _ = free
    keys = ("linear_stiffness.stiffness", "linear_damping.damping")
    middle, start = np.array([400.0, 0.8]), np.array([1.0, 0.0])
    covariance = np.array([[0.25, 0.004], [0.004, 1e-4]])
    task = replace(task, spread=np.array([0.01, 0.2]))
    expected = free_doubt(task, start, keys, covariance, first_noise(task, 0.0), 0)[:, 0]
    rng = np.random.default_rng(1)
    values = rng.multivariate_normal(middle, covariance, 400)
    starts = start + task.spread * rng.normal(size=(400, 2))
    runs = [
        ran(task, x, dict(zip(keys, v, strict=True))) for x, v in zip(starts, values, strict=True)
    ]
    made = np.sqrt(np.mean((np.array(runs) - ran(task, start, {})) ** 2, axis=0))
    assert np.allclose(expected, made, atol=0.12 * made.max())


def test_what_the_head_of_a_record_tells_makes_a_free_run_surer(free):
    """A second of readings tells the start; of the values little is left to be known too."""
    task, _ = free
    noise, none = first_noise(task, 0.0), np.zeros((0, 0))
    before = free_doubt(task, task.start, (), none, noise, 0)[200:]
    after = free_doubt(task, task.start, (), none, noise, 200)
    assert after.max() < 0.3 * before.max()


@pytest.mark.parametrize("drag", others_slow([0.0, 0.25], 1))
def test_what_integrates_is_judged_by_what_it_is_known_to(drag):
    """A mass that nothing holds: its free run drifts with values that are off within their errors.

    Every model of the study is judged on the same stretch of the test.
    """
    time = 0.02 * np.arange(3000)
    thrust = 11.772 + band_limited(np.random.default_rng(1), 1.0, (0.05, 2.0), 60.0)(time)
    command = CubicSpline(time, thrust)

    def truth(t, x):
        return [x[1], (x[2] - drag * x[1] * abs(x[1])) / 1.2 - 9.81, (command(t) - x[2]) / 0.15]

    motion = solve_ivp(truth, (0, 60), [0, 0, 11.77], "DOP853", time, rtol=1e-9, atol=1e-12).y
    z = motion[0] + 0.01 * motion[0].std() * np.random.default_rng(2).normal(size=3000)
    system = spiral.system(
        lambda t, x, u, p: [x.v, x.thrust / p.m - 9.81, (p.k * u.cmd - x.thrust) / p.tau],
        states={"z": "m", "v": "m/s", "thrust": "N"}, inputs={"cmd": "V"}, observed=["z"],
        parameters={"m": (1.2, "kg"), "k": (0.9, "N/V"), "tau": (0.17, "s")}, free=["k", "tau"],
    )  # fmt: skip
    run = spiral.discover(make_record(system, "lift", time, {"z": z}, {"cmd": thrust}), system)
    assert run.missing == (("quadratic_damping",) if drag else ())
    assert run.verdict == ("effect_missing" if drag else "nothing_missing")


def decaying():
    """A record of x' = -(a + b) x + u, in which only the sum of a and b shows."""
    time = 0.02 * np.arange(400)
    system = spiral.system(
        ["x' = u - (a + b)*x"], states={"x": "m"}, inputs={"u": "m/s"}, observed=["x"],
        parameters={"a": (1.0, "1/s"), "b": (2.0, "1/s")},
    )  # fmt: skip
    model = seed_model(system, values={"system.a": 1.0, "system.b": 2.0})
    push = {"u": np.sin(3 * time)}
    record = simulate(model, time, push, 0.02, np.random.default_rng(3), {"x": 1.0})
    return prepare_task(model, replace(record, noise=record.sigma()))


def test_doubts_that_cancel_leave_predictions_sure():
    """Of two rates of which one is as much too large as the other too small nothing shows."""
    task, noise = decaying(), None
    spreads = {}
    for name, shared in (("apart", 0.0), ("cancelling", -1.0), ("together", 1.0)):
        own, settings = prepare_filter(
            task, ("system.a", "system.b"), {"system.a": 0.5, "system.b": 0.5}
        )
        settings = replace(settings, correlation=np.array([[1.0, shared], [shared, 1.0]]))
        noise = noise or first_noise(own, 0.0)
        spreads[name] = predict_readings(own, settings, noise).spreads
    own, settings = prepare_filter(task, ())
    sure = predict_readings(own, settings, noise).spreads
    assert spreads["cancelling"] == pytest.approx(sure, rel=1e-9)
    assert np.all(spreads["apart"][1:20] > 1.1 * sure[1:20])
    assert np.all(spreads["together"][1:20] > spreads["apart"][1:20])


def test_doubt_along_readings_is_the_slope_times_the_error(free):
    """Of a linear machine the growth along what is measured is that of the free run itself."""
    task, _ = free
    key, error = "linear_stiffness.stiffness", 4.0
    own, settings = prepare_filter(task, (key,), {key: error})
    grown = doubt_along_readings(own, settings, first_noise(own, 0.0), 0)[:, 0]
    runs = []
    for step in (0.5, -0.5):
        moved = task.with_values({key: task.values[task.keys.index(key)] + step})
        sure, none = prepare_filter(moved, ())
        still = replace(none, covariance=np.zeros_like(none.covariance))
        runs.append(predict_readings(sure, still, first_noise(sure, 0.0)).misses[:, 0])
    slope = np.abs(runs[0] - runs[1])
    assert grown[50:] == pytest.approx(error * slope[50:], abs=0.05 * error * slope.max())


def test_a_free_run_of_what_only_its_controller_holds_judges_nothing():
    """An upright rod under feedback: it falls in a free run, and nothing is missing."""
    rng, dt, samples = np.random.default_rng(0), 0.01, 2400
    angle, rate, angles, torques, push = 0.0, 0.0, [], [], 0.0
    for k in range(samples):
        read = angle + 0.002 * rng.normal()
        push = 0.3 * np.sin(2 * np.pi * 0.7 * k * dt) if k % 40 else rng.uniform(-0.5, 0.5)
        torque = -22.0 * read - 3.0 * rate + push
        angles.append(read)
        torques.append(torque)
        motion = solve_ivp(
            lambda _, x, torque=torque: [x[1], 12.0 * np.sin(x[0]) - 0.1 * x[1] + torque],
            (0, dt), [angle, rate], rtol=1e-9, atol=1e-12,
        )  # fmt: skip
        angle, rate = motion.y[:, -1]
    system = spiral.system(
        ["th'' = w*sin(th) - c*th' + T"], states={"th": "rad"}, inputs={"T": "rad/s^2"},
        parameters={"w": (11.0, "1/s^2"), "c": (0.12, "1/s")}, free=["w", "c"], observed=["th"],
    )  # fmt: skip
    time, read = dt * np.arange(samples), {"th": np.array(angles)}
    record = make_record(
        system, "upright", time, read, {"T": np.array(torques)}, hold="zero_order"
    )  # fmt: skip
    run = spiral.discover(record, system, holdout=0.3)
    assert run.verdict == "nothing_missing"
    assert "a free run is no test here" in run.summary
