"""Whether what is left follows the motion, or is noise with a colour of its own."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task, run_from
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import predict_readings
from spiral.inference.likelihood.independence import (
    _PAST,
    _channel_explained_share,
    _regression_rows,
)
from spiral.types.model import seed_model
from spiral.types.record import make_record

N, RATE = 2000, 100.0


def _columns(e, s):
    """Past of misses and what moves, as for one channel and one signal."""
    past = np.column_stack([np.ones(N - _PAST), *(e[_PAST - k : N - k] for k in range(1, _PAST))])
    return past, np.column_stack([s, s**2, s**3])[_PAST:]


@pytest.mark.parametrize("seed", range(5))
def test_noise_that_its_past_predicts_follows_nothing_else(seed):
    """Autoregressive noise beside a motion: of 3 columns chance explains 3 / N, which is taken."""
    rng = np.random.default_rng(seed)
    e, s = lfilter([1.0], [1.0, -0.6, 0.3], rng.normal(size=N)), rng.normal(size=N)
    past, moved = _columns(e, s)
    assert _channel_explained_share(e[_PAST:], past, moved) < 0.006


@pytest.mark.parametrize("seed", range(5))
def test_the_share_that_follows_the_motion_is_told(seed):
    """e = w + a s^3 with var(a s^3) a twentieth of var(w): 1 / 21 of e."""
    rng = np.random.default_rng(seed)
    s = rng.normal(size=N)
    cubes = s**3 / np.sqrt(15.0)  # of unit variance
    e = rng.normal(size=N) + np.sqrt(0.05) * cubes
    past, moved = _columns(e, s)
    assert _channel_explained_share(e[_PAST:], past, moved) == pytest.approx(1 / 21, abs=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_what_motion_explains_beside_a_sharp_filter_is_a_share_of_the_noise(seed):
    """e = noise without a part above an eighth of the rate, of unit variance, + s of variance q.

    Of what the past leaves s is nearly all, of e it is q.
    """
    rng, q = np.random.default_rng(seed), 1e-4
    spectrum = np.fft.rfft(rng.normal(size=N))
    spectrum[N // 8 :] = 0.0
    noise, s = np.fft.irfft(spectrum, N), rng.normal(size=N)
    e = noise / noise.std() + np.sqrt(q) * s
    past, moved = _columns(e, s)
    assert _channel_explained_share(e[_PAST:], past, moved) == pytest.approx(q, rel=0.5)


def _record(seed):
    """m x'' + c x' + k x = u + random force, its reading beside noise of a steep low-pass."""
    rng = np.random.default_rng(seed)
    band = butter(4, [0.5, 8.0], "band", fs=RATE, output="sos")
    u = sosfilt(band, rng.normal(size=N))
    u *= 30.0 / u.std()
    q, v, x, h = 0.0, 0.0, np.empty(N), 1 / RATE / 10
    pushes = 1.5 * rng.normal(size=N)
    for k in range(N):
        x[k] = q
        for i in range(10):
            f = u[k] + (u[min(k + 1, N - 1)] - u[k]) * i / 10 + pushes[k]
            v += h * (f - 2.0 * v - 400.0 * q)
            q += h * v
    low = butter(6, 0.3, fs=1.0, output="sos")
    noise = sosfilt(low, rng.normal(size=N + 200))[200:]
    y = x + 0.01 * x.std() * noise / noise.std()
    return make_record(Oscillator(), f"{seed}", np.arange(N) / RATE, {"x": y}, {"force": u})


def test_records_of_one_study_have_the_same_columns_whatever_stands_still_in_one():
    """A forced record and a free decay, some readings missing in it: nothing of either is lost."""
    values = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e2, "linear_damping.damping": 2.0}
    model, rng = seed_model(Oscillator(), values=values), np.random.default_rng(0)
    time, y = np.arange(600) / RATE, rng.normal(size=(2, 600))
    y[1, 300:310] = np.nan
    columns = []
    for readings, force in zip(y, (np.sin(time), 0 * time), strict=True):
        whole = np.nan_to_num(readings)
        record = make_record(Oscillator(), "r", time, {"x": whole}, {"force": force})
        task, settings = prepare_filter(prepare_task(model, record, substeps=2, every=True), ())
        task = replace(task, series=replace(task.series, y=readings[:, None].copy()))
        rows = _regression_rows(task, predict_readings(task, settings, first_noise(task, 0.1)))
        assert all(np.isfinite(part).all() for part in rows)
        columns.append([part.shape[1] for part in rows])
    assert columns[0] == columns[1]


@pytest.mark.slow
def test_a_random_force_beside_an_anti_alias_filter_is_nothing_missing():
    """Next to nothing of what is left follows the motion: no other noise is looked for."""
    candidates, said = ["cubic_stiffness", "quadratic_damping"], []
    run = spiral.discover(
        _record(3), Oscillator(), test=_record(4), candidates=candidates, progress=said.append
    )
    assert (run.verdict, run.missing) == ("nothing_missing", ())
    assert "trying a random force around a frequency" not in said
    assert run.rounds[-1].comparison.followed < 0.01


def _told_by(motion, y, task, settings, size):
    """The largest share of the misses' energy that their past leaves and the motion explains."""
    part = predict_readings(task, settings, first_noise(task, 0.1, np.array([size * y.std()])))
    miss, past, moved = _regression_rows(task, part, motion)
    return _channel_explained_share(miss[:, 0], past, moved)


def test_noise_of_a_steep_band_follows_no_free_run():
    """The filter's own predictions have its past in them, and tell of it what 20 misses do not.

    A cubic force a fiftieth as large as the motion, beside white noise as large, is told.
    """
    values = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e2, "linear_damping.damping": 2.0}
    model, told = seed_model(Oscillator(), values=values), []
    for seed in range(6):
        rng, time = np.random.default_rng(seed), np.arange(N) / RATE
        u = sosfilt(butter(4, [0.5, 8.0], "band", fs=RATE, output="sos"), 30 * rng.normal(size=N))
        still = make_record(Oscillator(), "r", time, {"x": u}, {"force": u})
        task, settings = prepare_filter(prepare_task(model, still, substeps=2, every=True), ())
        free = run_from(task, np.zeros(2))[:, :1]
        spectrum = np.fft.rfft(rng.normal(size=N))
        spectrum[N // 8 :] = 0.0  # to an eighth of the rate, nothing beyond
        noise, bent = np.fft.irfft(spectrum, N), free[:, 0] ** 3
        rows = []
        for y, motion, size in (
            (0.2 * noise / noise.std(), free, 0.2),
            (0.2 * noise / noise.std(), None, 0.2),
            (0.02 * (rng.normal(size=N) + bent / bent.std()), free, 0.02),
        ):
            y = free[:, 0] + free.std() * y
            read = replace(task, series=replace(task.series, y=y[:, None].copy()))
            rows.append(_told_by(motion, y, read, settings, size))
        told.append(rows)
    band, by_filter, law = np.mean(told, axis=0)
    assert band < 0.01
    assert by_filter > 3 * band
    assert law > 0.05


@pytest.mark.parametrize("seed", range(3))
def test_a_controller_that_answers_to_the_noise_of_its_sample_follows_no_motion(seed):
    """u_t = w_t - k y_t of a held force: its part that the reading's own noise makes acts later."""
    values = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e2, "linear_damping.damping": 2.0}
    model, rng = seed_model(Oscillator(), values=values), np.random.default_rng(seed)
    time, noise = np.arange(N) / RATE, 0.01 * rng.normal(size=N)
    u = sosfilt(butter(4, [0.5, 8.0], "band", fs=RATE, output="sos"), 30 * rng.normal(size=N))
    record = make_record(
        Oscillator(), "r", time, {"x": u}, {"force": u - 500.0 * noise}, hold="zero_order"
    )
    task, settings = prepare_filter(prepare_task(model, record, substeps=2, every=True), ())
    free = run_from(task, np.zeros(2))[:, :1]
    y = free[:, 0] + noise
    read = replace(task, series=replace(task.series, y=y[:, None].copy()))
    assert _told_by(free, y, read, settings, 0.01 / y.std()) < 0.005
