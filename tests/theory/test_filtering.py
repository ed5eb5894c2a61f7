"""Filters against what they must equal: Kalman's on a linear model, filterpy's, and theory."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2
from spiral_plugins.observers.kalman import Ekf, Rts
from spiral_plugins.observers.paper import EkfPaper
from spiral_plugins.observers.static import Static
from spiral_plugins.sources.rotor_coastdown import RotorCoastdown
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.tilting_rotor import TiltingRotor

from spiral.engine.filter.extended import filter_record
from spiral.engine.filter.noise import (
    added_covariance,
    noise_groups,
    noise_intensity,
    sampled_covariance,
)
from spiral.engine.filter.setup import choose_levels, prepare_filter, with_level
from spiral.engine.filter.smoother import smooth_record
from spiral.engine.filter.static import static_map
from spiral.engine.filter.stochastic import simulate_disturbed
from spiral.engine.filter.task import prepare_task, with_record
from spiral.engine.resting import state_jacobian
from spiral.inference.reconstruction.consistency import mean_with_bounds, normalised_squares
from spiral.inference.reconstruction.estimate import reconstruct_record
from spiral.inference.reconstruction.observability import observability
from spiral.inference.simulate import simulate, with_defaults
from spiral.types.model import seed_model

OSCILLATOR = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0,
              "linear_damping.damping": 0.8}  # fmt: skip


def linear_task(samples=400, substeps=24):
    model = seed_model(Oscillator(), values=OSCILLATOR)
    time = 0.005 * np.arange(samples)
    quiet = {"force": np.zeros(samples)}
    record = simulate(model, time, quiet, 0.05, np.random.default_rng(0), {"x": 1.0})
    return prepare_task(model, record, substeps=substeps)


def rotor_task(rate=2000.0, duration=14.0, **fields):
    system = TiltingRotor()
    source = RotorCoastdown(rate=rate, duration=duration, **fields)
    return prepare_task(with_defaults(seed_model(system)), source.load(system)[0])


def kalman(task, settings):
    """The textbook filter with the exact transition; means, covariances and likelihood."""
    f = expm(state_jacobian(task.compiled, task.values, np.zeros(1)) * task.series.dt)
    h, r = np.array([[1.0, 0.0]]), np.diag(settings.noise)
    x, p = settings.start, settings.covariance
    means, covariances, predicted, likelihood = [], [], [], 0.0
    for y in task.series.y:
        predicted.append((x, p))
        s = h @ p @ h.T + r
        gain = p @ h.T @ np.linalg.inv(s)
        v = y - h @ x
        likelihood -= 0.5 * float(np.log(np.linalg.det(2 * np.pi * s)) + v @ np.linalg.solve(s, v))
        x, p = x + gain @ v, (np.eye(2) - gain @ h) @ p
        means.append(x)
        covariances.append(p)
        x, p = f @ x, f @ p @ f.T + settings.process
    return np.array(means), np.array(covariances), predicted, likelihood, f


def rauch(means, covariances, predicted, f):
    """The textbook smoother."""
    x, p = means.copy(), covariances.copy()
    for k in range(len(x) - 2, -1, -1):
        ahead, spread = predicted[k + 1]
        gain = p[k] @ f.T @ np.linalg.inv(spread)
        x[k] += gain @ (x[k + 1] - ahead)
        p[k] += gain @ (p[k + 1] - spread) @ gain.T
    return x, p


@pytest.fixture(scope="module")
def linear():
    task, settings = prepare_filter(linear_task())
    settings = with_level(task, settings, {"observed": 0.3})
    return task, settings, kalman(task, settings)


def close(given, expected, tolerance):
    scale = np.abs(expected).max(axis=0)
    assert np.max(np.abs(given - expected) / scale) < tolerance


def test_extended_filter_is_kalmans_on_a_linear_model(linear):
    task, settings, (means, covariances, _, likelihood, _) = linear
    found = filter_record(task, settings, keep=True)
    close(found.means, means, 1e-10)
    close(found.covariances, covariances, 1e-10)
    assert found.log_likelihood == pytest.approx(likelihood, rel=1e-10)


def test_unscented_filter_is_kalmans_on_a_linear_model(linear):
    from spiral.engine.filter.sigma_points import filter_sigma_points

    task, settings, (means, covariances, _, likelihood, _) = linear
    for shape in ((1.0, 0.0, 0.0), (0.5, 2.0, 1.0)):
        found = filter_sigma_points(task, settings, shape, keep=True)
        close(found.means, means, 1e-9)
        close(found.covariances, covariances, 1e-9)
        assert found.log_likelihood == pytest.approx(likelihood, rel=1e-9)


def smoothed(task, settings):
    found = filter_record(task, settings, keep=True)
    before = found.covariances.copy()
    smooth_record(
        found.means,
        found.covariances,
        found.innovations,
        found.spreads,
        found.transitions,
        found.gains,
        found.slopes,
    )
    return found, before


def test_smoother_is_rauch_tung_striebels_on_a_linear_model(linear):
    task, settings, (means, covariances, predicted, _, f) = linear
    found, _ = smoothed(task, settings)
    x, p = rauch(means, covariances, predicted, f)
    close(found.means, x, 1e-9)
    close(found.covariances, p, 1e-9)


@pytest.mark.parametrize("level", [0.0, 0.1])
def test_smoother_is_never_less_certain_than_the_filter(level):
    task = rotor_task(duration=2.0)
    task, settings = prepare_filter(task)
    found, before = smoothed(
        task, with_level(task, settings, dict.fromkeys(noise_groups(task), level))
    )
    unit = np.append(task.scales, 1.0)
    traces = [
        np.trace(c / np.outer(unit, unit), axis1=1, axis2=2) for c in (found.covariances, before)
    ]
    assert np.all(traces[0] <= traces[1])
    assert np.all(np.diagonal(found.covariances, axis1=1, axis2=2) >= 0)


def test_agrees_with_filterpy():
    pytest.importorskip("filterpy")
    from benchmarks.peer_filter import filterpy_run

    task, settings = prepare_filter(rotor_task(duration=1.0), track=())
    settings = with_level(task, settings, {"observed": 0.1, "hidden": 0.05})
    ours, theirs = filter_record(task, settings, keep=True), filterpy_run(task, settings, 2000)
    close(ours.means, theirs.means, 1e-8)
    close(ours.covariances, theirs.covariances, 1e-8)


def test_transition_is_the_derivative_of_the_step():
    task, settings = prepare_filter(rotor_task(duration=0.2))
    settings = with_level(task, settings, dict.fromkeys(noise_groups(task), 0.1))
    fine = replace(task, start=np.zeros(8))
    found = filter_record(fine, settings, keep=True)
    k, small = 300, 1e-4
    from benchmarks.peer_filter import runge_kutta

    begin = found.means[k, :8]
    for i in range(8):
        kick = np.zeros(8)
        kick[i] = small * task.scales[i]
        turned = task.with_values({"system.phase_origin": found.means[k, 8]})
        ahead, back = (runge_kutta(turned, begin + sign * kick, k)[0] for sign in (1, -1))
        expected = (ahead - back) / (2 * kick[i])
        got = found.transitions[k, :8, i]
        assert np.allclose(got / task.scales, expected / task.scales,
                           atol=1e-6 * np.abs(expected / task.scales).max())  # fmt: skip


def test_second_order_transition_is_the_papers():
    task, settings = prepare_filter(rotor_task(duration=0.2), track=())
    settings = replace(with_level(task, settings, {"observed": 0.1}), second_order=True)
    found = filter_record(task, settings, keep=True)
    k, n = 200, 8
    a, b, f = np.zeros((n, n)), np.zeros((n, len(task.values))), np.empty(n)
    task.compiled.rate(found.means[k], task.inputs[3 * k], task.values, f, a, b)
    h = task.series.dt
    assert task.series.substeps == 1
    assert np.allclose(found.transitions[k], np.eye(n) + h * a + h * h * a @ a / 2, rtol=1e-12)


def test_static_map_is_that_of_the_papers_matrices():
    task = rotor_task(duration=0.2)
    hidden = np.array([[1564.1781, -178.7632], [-178.7632, 1307.5252]])
    mixed = np.array([[-238.3509, -2085.5708], [1743.3669, 238.3509]])
    assert task.static.hidden == ("alpha", "beta")
    assert np.allclose(task.static.matrix, -np.linalg.solve(hidden, mixed), atol=1e-6)
    assert static_map(linear_task(64, 1).compiled.traced, linear_task(64, 1).values) is None


def test_process_noise_is_the_exact_integral(linear):
    """A double integrator: q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]]."""
    task = linear[0]
    free = task.with_values({"linear_stiffness.stiffness": 0.0, "linear_damping.damping": 0.0})
    q, dt = 0.7, task.series.dt
    expected = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    assert np.allclose(sampled_covariance(free, np.array([0.0, q])), expected, rtol=1e-9)
    assert noise_intensity(task, {"observed": 0.1})[0] == 0.0


def test_units_do_not_matter():
    """The same motion in metres and micrometres: the same result, number for number."""
    from spiral_plugins.systems.planar_rotor import PlanarRotor

    from tests.scenes import PROJECTION

    found = []
    for unit, scale in (("m", 1.0), ("um", 1e6)):
        system = PlanarRotor(position_unit=unit)
        values = {k: PROJECTION.get(k, 3.0) for k, _ in seed_model(PlanarRotor()).pairs}
        values["unbalance.moment"] *= scale
        model = seed_model(system, values={**values, "system.phase_origin": 0.4})
        record = RotorCoastdown(rate=1000.0, duration=2.0).load(system)[0]
        part = Ekf().reconstruct(prepare_task(model, record))
        found.append(part.means[:, :4] / scale)
    assert np.allclose(found[0], found[1], rtol=1e-6, atol=1e-6 * np.abs(found[0]).max())


def test_true_process_noise_gives_honest_bands_and_the_smoother_gains():
    base = rotor_task(rate=1000.0, duration=3.0)
    levels = {"observed": 0.3, "hidden": 0.3}
    inside, filter_error, smoother_error, nis, nees = [], [], [], [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        record = simulate_disturbed(base, levels, 0.02, rng)
        task = with_record(base, record)
        truth = np.column_stack(list(record.truth.values()))[1000:]
        for observer, errors in ((Ekf, filter_error), (Rts, smoother_error)):
            part = observer(process_noise=levels, track=()).reconstruct(task)
            error = part.means[1000:] - truth
            errors.append(np.mean(error**2, axis=0))
            inside.append(np.mean(np.abs(error) < 1.96 * part.deviations[1000:], axis=0)[2:4])
            if observer is Ekf:
                nis.append(normalised_squares(part.innovations[1000:], part.spreads[1000:]))
                nees.append(normalised_squares(error, part.covariances[1000:]).mean())
    assert 0.92 <= np.mean(inside) <= 0.98
    assert np.all(np.mean(smoother_error, axis=0) < np.mean(filter_error, axis=0))
    assert mean_with_bounds(np.concatenate(nis), 2).inside
    assert 6.5 < np.mean(nees) < 9.5


def test_likelihood_does_not_reject_the_process_noise_there_is():
    """2 (max log L - log L at the truth) ~ chi2(2), the measured coordinates' level within 10 %."""
    truth = {"observed": 0.3, "hidden": 0.3}
    base = rotor_task(rate=1000.0, duration=4.0)
    record = simulate_disturbed(base, truth, 0.01, np.random.default_rng(3))
    task, settings = prepare_filter(with_record(base, record), track=())
    levels = choose_levels(task, settings, None)
    best, at = (
        filter_record(task, with_level(task, settings, found)).log_likelihood
        for found in (levels, truth)
    )
    assert -4.0 < 2 * (best - at) < chi2.ppf(0.999, 2)  # the search stops within 0.5 to 2
    assert levels["observed"] == pytest.approx(0.3, rel=0.1)


def test_the_phase_origin_is_found_wherever_it_is():
    task = rotor_task(rate=1000.0, duration=6.0, phase=3.0)  # the model believes 0.4
    part = Ekf(process_noise=1e-3).reconstruct(task)
    mean, deviation = part.state("system.phase_origin")
    turned = np.angle(np.exp(1j * (mean[-1] - 3.0)))
    assert abs(turned) < 4 * deviation[-1] + 2e-3


def test_matched_filter_beats_the_static_map_a_hundredfold():
    task = rotor_task(duration=4.0)
    rng = np.random.default_rng(1)
    truth = np.array([v[0] for v in task.series.record.truth.values()])
    task = replace(task, start=truth + rng.normal(size=8) * task.spread)
    parts = {o: reconstruct_record(task, o) for o in (Ekf(track=(), process_noise=1e-5), Static())}
    first = int(1.0 / task.series.dt)
    for state in ("alpha", "beta"):
        truth = task.series.record.truth[state][first:]
        errors = [
            np.std(p.reconstruction.state(state)[0][first:] - truth) / np.std(truth)
            for p in parts.values()
        ]
        assert errors[0] < 0.001
        assert errors[1] > 100 * errors[0]


def test_paper_settings_echo_the_measurement():
    part = reconstruct_record(rotor_task(duration=4.0), EkfPaper())
    record = part.record
    for channel in ("x", "y"):
        error = part.reconstruction.state(channel)[0] - record.truth[channel]
        noise = record.noise[channel]
        assert np.std(error) == pytest.approx(noise, rel=0.02)  # filtered = measured
        assert np.corrcoef(error, record.channels[channel] - record.truth[channel])[0, 1] > 0.99
    assert part.consistency.nis.mean < 0.05
    assert not part.consistency.nis.inside


def test_all_states_of_the_rotor_are_observable():
    found = observability(rotor_task(duration=0.2))
    assert found.rank == 8
    assert list(found.singular_values) == sorted(found.singular_values, reverse=True)
    assert found.weakest in ("alpha_rate", "beta_rate")


def test_divergence_is_a_result():
    """A model with negative stiffness runs away: reported with the stable window, not raised."""
    task = rotor_task(duration=2.0)
    wrong = task.with_values({"linear_stiffness@bearing_1.stiffness_x": -3e6})
    part = reconstruct_record(wrong, Ekf(process_noise=0.0, track=()))
    assert part.diverged
    assert part.stable < part.record.samples


@pytest.mark.parametrize("rate", [1e-3, 1.0, 50.0, 5e4, 1e7])
def test_noise_behind_any_decay_adds_its_exact_covariance(rate):
    """q (1 - e^{-2 r t}) / 2 r, also where e^{r t} is beyond all digits."""
    wanted = -3.0 * np.expm1(-2 * rate * 0.002) / (2 * rate)
    found = added_covariance(np.array([[-rate]]), np.array([[3.0]]), 0.002)
    np.testing.assert_allclose(found, [[wanted]], rtol=1e-12)


def test_noise_on_a_mass_that_friction_holds_adds_a_covariance():
    """Near rest dry friction decays 1e4 times faster than the spring moves."""
    a = np.array([[0.0, 1.0], [-1.25e5, -4.5e4]])
    steps = 20_000
    flow, added = expm(a * 0.002 / steps), np.zeros((2, 2))
    for _ in range(steps):
        added = flow @ added @ flow.T + np.diag([0.0, 3.0]) * 0.002 / steps
    found = added_covariance(a, np.diag([0.0, 3.0]), 0.002)
    assert np.linalg.eigvalsh(found)[0] > 0
    np.testing.assert_allclose(found[1, 1], added[1, 1], rtol=0.01)
    np.testing.assert_allclose(found[0, 0], added[0, 0], rtol=0.01)
