"""What acts at random: what it makes of fits and free runs, and the ladder that takes it up."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from spiral.engine.likelihood.fit import add_standard_errors, maximise_likelihood
from spiral.engine.likelihood.free_spread import FreeSpread, free_spread, independent_values
from spiral.engine.likelihood.noise import (
    NoiseModel,
    NoiseTerm,
    first_noise,
    noise_matrices,
)
from spiral.engine.likelihood.predict import predict_readings
from spiral.engine.resting import state_jacobian
from spiral.inference.evidence.horizons import misses_ahead
from spiral.inference.likelihood.fitting import (
    continue_fit,
    fit_by_likelihood,
    restart_vanished_noise,
)
from spiral.inference.likelihood.noise_selection import (
    likeliest_noise,
    reselect_noise_model,
    select_noise_model,
)
from spiral.inference.likelihood.noise_terms import additional_noise_terms
from spiral.inference.likelihood.reported_noise import ReportedNoise
from spiral.inference.problem import silent
from tests.swept_oscillator import (
    KEYS,
    TRUTH,
    record_of,
    relaxed,
    shaken,
    states_alone,
    task_of,
    unfitted,
)


def test_estimates_bear_a_random_force():
    """With a real random force the standard errors stay honest, and its size is told."""
    squares, levels = [], []
    for seed in range(20):
        record = shaken(seed, 0.05)
        task, settings = task_of(record)
        found = maximise_likelihood(((task, settings),), KEYS, first_noise(task, 0.1))
        squares += [((found.values[k] - TRUTH[k]) / found.errors[k]) ** 2 for k in KEYS]
        levels.append(found.noise.values["force.observed"])
    assert 0.6 < np.mean(squares) < 1.6
    assert np.median(levels) == pytest.approx(0.05, rel=0.3)


def test_random_forces_move_a_free_run_as_far_as_it_says():
    """Against 40 simulated records; the motion without forces is that of the model."""
    misses = []
    for seed in range(40):
        record = shaken(seed, 0.05)
        task, settings = task_of(record)
        misses.append(record.truth["x"] - states_alone(task, settings)[:, 0])
    spread = free_spread(task, settings, first_noise(task, 0.05))
    assert np.sqrt(np.mean(np.square(misses))) == pytest.approx(
        np.sqrt(np.mean(spread.rms**2)), rel=0.15
    )
    seen = np.mean(np.square(misses), axis=1)
    assert independent_values([spread]) == pytest.approx(2 * seen.mean() ** 2 / seen.var(), rel=0.6)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
@pytest.mark.parametrize("records", [1, 3])
def test_independent_values_of_a_stationary_motion(memory, records):
    """nu = N (1 - phi^2) / (1 + phi^2) of N values of an AR(1); from below where few are drawn."""
    rng, samples = np.random.default_rng(5), 2000

    def spread(drawn):
        x = lfilter([1.0], [1.0, -memory], rng.normal(size=(drawn, samples + 1000)))[:, 1000:, None]
        return FreeSpread(np.sqrt(np.mean(x**2, axis=0)), np.mean(x**2, axis=(1, 2)))

    exact = records * samples * (1 - memory**2) / (1 + memory**2)
    told = [independent_values([spread(64) for _ in range(records)]) for _ in range(20)]
    few = [independent_values([spread(8) for _ in range(records)]) for _ in range(20)]
    assert 0.5 * exact < np.median(told) < exact
    assert np.median(few) < np.median(told)
    assert independent_values([FreeSpread(np.zeros((5, 1)), np.zeros(8))]) == 1.0


def test_a_free_run_is_carried_no_further_than_two_motions_differ():
    """Forces many times the machine's own: sqrt(2) of what the reading does, and no more."""
    record = record_of(0)
    task, settings = task_of(record)
    spread = free_spread(task, settings, first_noise(task, 50.0)).rms[:, 0]
    most = np.sqrt(2) * np.std(record.channels["x"])
    assert spread[0] == 0.0
    assert 0.5 * most < np.median(spread) <= np.max(spread) <= most * (1 + 1e-9)


def test_forces_without_bounds_carry_a_free_run_as_far_as_can_be():
    """A value that ran away leaves them no covariance; that is told, and ends no study."""
    record = record_of(0)
    task, settings = task_of(record)
    spread = free_spread(task, settings, first_noise(task, np.inf)).rms[:, 0]
    assert spread == pytest.approx(np.sqrt(2) * np.std(record.channels["x"]))


def test_slow_noise_counts_by_how_far_it_goes_over_the_record():
    """A zero of four deviations, taken for noise that hardly moves: the reading still shows x."""
    record = record_of(3)
    spread = float(np.std(record.channels["x"]))
    record = replace(record, channels={"x": record.channels["x"] + 4 * spread})
    task, settings = task_of(record)
    term = NoiseTerm("coloured", "x")
    noise = first_noise(task, 0.0).with_terms(
        (term,), {term.size: 4 * spread, term.time: 0.3 * record.dt * record.samples}
    )
    found = maximise_likelihood(((task, settings),), (), noise, steps=3)
    assert found.noise.values[term.size] > spread
    assert ReportedNoise(found).sensor_deviation("x") < 0.5 * spread
    shares, _ = ReportedNoise(found).sizes(0.0, 1.0)
    assert shares.get(term.size, 0.0) < 0.5  # beyond that a sensor shows mostly noise


def test_slow_noise_that_hardly_moves_is_told_as_an_offset_and_is_part_of_a_free_runs_error():
    record = record_of(3)
    spread = float(np.std(record.channels["x"]))
    record = replace(record, channels={"x": record.channels["x"] - 0.3 * spread})
    system = unfitted(record)[0].problem.model.system
    task, settings = task_of(record)
    term = NoiseTerm("coloured", "x")
    noise = first_noise(task, 0.0).with_terms(
        (term,), {term.size: 0.3 * spread, term.time: 10 * record.dt * record.samples}
    )
    found = add_standard_errors(maximise_likelihood(((task, settings),), (), noise, steps=3))
    (said,) = ReportedNoise(found).offsets(system)
    share = float(said.split(" all along, ")[1].split(" %")[0])
    assert said.startswith("sensor x reads")
    assert " m less than the model" in said
    assert share == pytest.approx(30, abs=2)


def test_what_a_sensor_has_drifted_by_is_part_of_what_is_forecast():
    """A zero that wandered off: ten samples ahead white noise alone is missed."""
    record = record_of(3, samples=3000)
    spread = float(np.std(record.channels["x"]))
    wander = spread * np.linspace(0.0, 1.0, record.samples)
    record = replace(record, channels={"x": record.channels["x"] + wander})
    task, settings = task_of(record)
    term = NoiseTerm("drift", "x")
    noise = first_noise(task, 0.0).with_terms((term,), {term.size: 0.1 * spread})
    found = maximise_likelihood(((task, settings),), (), noise, steps=10)
    run = predict_readings(task, settings, found.noise, keep=True)
    parts = noise_matrices(task, settings, found.noise)
    steps, first = 10, 500
    known = parts.seen @ np.linalg.matrix_power(parts.phi, steps)
    with_it = misses_ahead(task, settings, run.means, first, steps, known)
    without = misses_ahead(task, settings, run.means, first, steps)
    assert np.std(with_it) == pytest.approx(found.noise.values["white.x"], rel=0.1)
    assert np.sqrt(np.mean(without**2)) > 0.4 * spread


def test_a_force_with_a_memory_carries_a_free_run_as_a_linear_machine_says():
    """Covariances of oscillator and force together, P <- F P F^T + Q, from a machine at rest."""
    task, settings = task_of(record_of(0))
    noise = first_noise(task, 0.0).with_terms(
        (NoiseTerm("gust", "observed"),), {"gust.observed": 0.2, "gust.time": 5 * task.series.dt}
    )
    spread = free_spread(task, settings, noise).rms[:, 0]
    dt, time = task.series.dt, noise.values["gust.time"]
    a = np.zeros((3, 3))
    a[:2, :2] = state_jacobian(task.compiled, task.values, task.mean_inputs, task.centre)
    flow, p, said = expm(a * dt), np.zeros((3, 3)), []
    size = 0.2 * task.rates[1]
    flow[:2, 2] = flow[:2, :2] @ [0, dt]
    flow[2, 2], p[2, 2] = np.exp(-dt / time), size**2
    for _ in range(task.series.samples):
        said.append(np.sqrt(p[0, 0]))
        p = flow @ p @ flow.T
        p[2, 2] = size**2
    assert np.sqrt(np.mean(spread**2)) == pytest.approx(np.sqrt(np.mean(np.square(said))), rel=0.1)


@pytest.mark.parametrize("kind", ["white", "coloured", "alone", "drift", "vibration"])
def test_the_ladder_takes_up_the_noise_that_is_there(kind):
    """``alone``: no white noise beside the coloured one."""
    record = record_of(5, samples=3000, noise=0.02)
    rng = np.random.default_rng(5)
    spread = np.std(record.channels["x"])
    clean = record.channels["x"]
    if kind == "alone":
        clean, kind = record.truth["x"] + relaxed(rng, len(clean), 0.9) * 0.02 * spread, "coloured"
    elif kind == "coloured":
        clean = clean + relaxed(rng, len(clean), 0.95) * 0.05 * spread
    if kind == "drift":
        clean = clean + np.cumsum(rng.normal(size=len(clean))) * 0.005 * spread
    if kind == "vibration":  # at a tenth of the rate, damped by 0.05
        clean = clean + ringing(rng, len(clean), 2 * np.pi * 0.1, 0.05) * 0.03 * spread
    found = laddered(replace(record, channels={"x": clean}, noise={}))
    if kind == "vibration":
        assert 2 * np.pi * 0.1 * found.values["vibration.time"] == pytest.approx(
            record.dt, rel=0.05
        )
        assert found.values["vibration.damping"] == pytest.approx(0.05, rel=0.5)
    kinds = {t.kind for t in found.terms} - {"white", "force"}
    assert kinds == (set() if kind == "white" else {kind})


def test_noise_of_a_sensor_is_looked_for_beside_smaller_forces_too():
    """A force that has taken in the noise leaves misses far larger than it: no size to begin with.

    From half the misses two steps do not lead to where the noise is seen at all.
    """
    record = record_of(5, samples=3000, noise=0.02)
    size = 0.0003 * np.std(record.truth["x"])
    own = record.truth["x"] + relaxed(np.random.default_rng(5), 3000, 0.8) * size
    prepared = (task_of(replace(record, channels={"x": own}, noise={})),)
    large = first_noise(prepared[0][0], 0.05, np.array([0.1 * size]))
    now = maximise_likelihood(prepared, (), large, steps=0)
    (offered,) = (a for a in additional_noise_terms(now) if a.terms[0].kind == "coloured")
    looks = [
        maximise_likelihood(prepared, (), large.with_terms(offered.terms, start), steps=2)
        for start in offered.starts
    ]
    best, _ = likeliest_noise(
        prepared, [large.with_terms(offered.terms, start) for start in offered.starts[1:]]
    )
    begun = maximise_likelihood(prepared, (), best, steps=2)
    assert begun.log_likelihood > looks[0].log_likelihood + 100
    assert begun.log_likelihood == max(look.log_likelihood for look in looks)


def test_noise_that_did_the_work_of_an_effect_gives_way_to_what_is_there():
    """A drift that made up for an effect stays by itself once the effect is in the model."""
    record = record_of(5, samples=3000, noise=0.02)
    own = relaxed(np.random.default_rng(5), 3000, 0.95) * 0.05 * np.std(record.channels["x"])
    seen = {"x": record.channels["x"] + own}
    assembly, state = unfitted(replace(record, channels=seen, noise={}))
    white = fit_by_likelihood(assembly, state)
    drift, size = NoiseTerm("drift", "x"), 0.1 * float(np.std(own))
    drifting = continue_fit(
        assembly, white, white.estimate.noise.with_terms((drift,), {drift.size: size}), rough=True
    )
    anew = reselect_noise_model(assembly, drifting, silent)
    assert {t.kind for t in anew.estimate.noise.terms} - {"white", "force"} == {"coloured"}
    assert anew.log_likelihood > drifting.log_likelihood + 5
    assert reselect_noise_model(assembly, anew, silent) is anew


def ringing(rng, count, turn, ratio):
    """Noise of a mode sampled at ``turn`` rad a sample, of variance one."""
    rate = np.array([[0.0, 1.0], [-(turn**2), -2 * ratio * turn]])
    phi, first = expm(rate), np.diag([1.0, turn**2])
    root = np.linalg.cholesky(first - phi @ first @ phi.T)
    z, found = rng.normal(size=2) * np.sqrt(np.diag(first)), np.empty(count)
    for k in range(count):
        found[k], z = z[0], phi @ z + root @ rng.normal(size=2)
    return found


def laddered(record) -> NoiseModel:
    assembly, state = unfitted(record)
    return select_noise_model(assembly, fit_by_likelihood(assembly, state), silent).estimate.noise


def test_noise_that_vanished_beside_a_large_random_force_is_found_again():
    """On a logarithmic scale a size near zero has no slope: a fit from there stays there."""
    record = shaken(3, 0.3)
    size = 0.02 * np.std(record.truth["x"])
    assembly, state = unfitted(replace(record, noise={}))
    vanished = first_noise(task_of(record)[0], 0.3, np.array([1e-5 * size]))
    stuck = fit_by_likelihood(assembly, state, vanished)
    assert stuck.estimate.noise.values["white.x"] < 0.01 * size
    found = restart_vanished_noise(assembly, stuck)
    assert found.log_likelihood > stuck.log_likelihood + 10
    assert found.estimate.noise.values["white.x"] == pytest.approx(size, rel=0.15)
    assert restart_vanished_noise(assembly, found) is found
