"""Bands that know the doubt of parameters: against the dense Gaussian, and by coverage."""

from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np
import pytest
from spiral_plugins.effects.dissipative import CoulombFriction
from spiral_plugins.effects.restoring import ConstantLoad
from spiral_plugins.observers.kalman import Ekf, Rts
from spiral_plugins.observers.static import Static
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.tilting_rotor import TiltingRotor

import spiral
from spiral.engine.filter.curved_posterior import build_expansion, draw_samples
from spiral.engine.filter.prior import Prior, covariance_root
from spiral.engine.filter.rounding import rounding_level
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.free_uncertainty import _bounded_root
from spiral.inference.reconstruction.estimate import BAND, estimate
from spiral.inference.reconstruction.uncertain import (
    declared_prior,
    model_prior,
    pattern_names,
)
from spiral.inference.simulate import simulate
from spiral.inference.strategies.likelihood.superfluous import _is_shown_far_from_zero
from spiral.types.errors import ConfigError
from spiral.types.model import correlations_by_name, seed_model

VALUES = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 0.8}
LOAD = "constant_load.force"
TIME = 0.01 * np.arange(300)


def model(**values):
    return seed_model(Oscillator(), (ConstantLoad(),), values={**VALUES, LOAD: 5.0, **values})


def record(rng, truth):
    """Begins at rest under noise of a force and a constant load; 5 % noise."""
    force = {"force": 20.0 * rng.normal(size=len(TIME))}
    return simulate(truth, TIME, force, 0.05, rng)


def dense(task, keys, spread):
    """Means and variances of all states: linear in (x_0, theta), so that all is Gaussian."""
    n = len(task.states)

    def run(start, load):
        moved = task.with_values({LOAD: load})
        states = np.empty((task.series.samples, n))
        from spiral.engine.kernel import trajectories

        assert trajectories(
            task.compiled.rate_value, task.compiled.output_value, start[None, :].copy(),
            np.zeros(1, dtype=np.int64), np.array([len(states)]), moved.values[None, :],
            task.inputs, task.series.substeps, task.series.dt, states, np.empty_like(task.series.y),
        )  # fmt: skip
        return states

    mean = float(task.parameter_values(keys)[0])
    base = run(task.start, mean)
    slopes = [run(task.start + row, mean) - base for row in np.eye(n)]
    slopes = np.stack([*slopes, run(task.start, mean + 1.0) - base], axis=2)
    prior = np.diag([*task.spread**-2, spread**-2])
    seen = slopes[:, 0] / np.sqrt(task.series.sigma[0] ** 2)
    left = (task.series.y[:, 0] - base[:, 0]) / task.series.sigma[0]
    covariance = np.linalg.inv(prior + seen.T @ seen)
    states = base + slopes @ (covariance @ (seen.T @ left))
    return states, np.einsum("kip,pq,kiq->ki", slopes, covariance, slopes)


def test_smoothed_bands_are_the_dense_gaussians_on_a_linear_model():
    rng = np.random.default_rng(3)
    made = record(rng, model(**{LOAD: 6.0}))
    task = prepare_task(model(), made)
    task = replace(task, prior=declared_prior(task.model, task, {LOAD: 0.4}))
    found = Rts(process_noise=0.0).reconstruct(task)
    states, variances = dense(task, (LOAD,), 2.0)
    scale = states.std(axis=0)
    assert np.max(np.abs(found.means - states) / scale) < 1e-6
    np.testing.assert_allclose(found.deviations**2, variances, rtol=1e-5)


@pytest.mark.slow
def test_bands_hold_95_percent_where_machines_are_drawn():
    """Mass, stiffness, damping and load of 10 %, 10 %, 30 % and 50 %; 1.96 deviations: 95 %."""
    doubt = {"system.mass": 0.1, "linear_stiffness.*": 0.1, "linear_damping.*": 0.3, LOAD: 0.5}
    inside = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 5])
        shares = dict(zip((*VALUES, LOAD), (0.1, 0.1, 0.3, 0.5), strict=True))
        nominal = {**VALUES, LOAD: 5.0}
        truth = {k: v * (1 + shares[k] * rng.normal()) for k, v in nominal.items()}
        made = record(rng, model(**truth))
        part = estimate([model()], [made], Rts(), uncertain=doubt).parts[0]
        true = np.column_stack([made.truth[n] for n in part.task.states])
        held = np.abs(part.reconstruction.means - true) <= BAND * part.reconstruction.deviations
        inside.append(held[::30].mean())
    assert abs(np.mean(inside) - 0.95) < 3 * np.std(inside) / np.sqrt(len(inside)) + 0.01
    assert 0.90 < np.mean(inside) < 0.98


def test_process_noise_is_zero_where_the_model_is_exact():
    chosen = []
    for seed in range(6):
        made = record(np.random.default_rng(seed), model())
        task = prepare_task(model(), made)
        chosen.append(Ekf().reconstruct(task).levels["observed"] <= rounding_level(task))
    assert sum(chosen) >= 5


def test_zero_is_what_the_steps_err_by():
    """Half the step, a sixteenth of the error."""
    time = 0.001 * np.arange(4000)
    force = {"force": np.zeros(len(time))}  # the load alone moves it
    made = simulate(model(), time, force, 0.05, np.random.default_rng(0))
    levels = [rounding_level(prepare_task(model(), made, substeps=s)) for s in (1, 2)]
    assert 1e-12 < levels[1] < levels[0] < 1e-5
    assert levels[0] / levels[1] == pytest.approx(16, rel=0.1)


def test_what_a_fit_knows_of_this_record_is_not_told_twice():
    made = record(np.random.default_rng(0), model())
    task = prepare_task(model(), made)
    known = Prior((LOAD,), task.parameter_values((LOAD,)), np.array([[4.0]]), settled=True)
    wide = Rts(process_noise=1e-4).reconstruct(replace(task, prior=known))
    alone = Rts(process_noise=1e-4).reconstruct(task)
    np.testing.assert_allclose(wide.means, alone.means)
    slope = 1.0 / VALUES["linear_stiffness.stiffness"]  # of the settled position by the load
    more = np.sqrt(wide.deviations[150:, 0] ** 2 - alone.deviations[150:, 0] ** 2)
    assert wide.values[LOAD] == (5.0, 2.0)
    np.testing.assert_allclose(more, 2.0 * slope, rtol=0.1)  # the transient of it is not over


def test_bands_of_a_fitted_model_hold_its_standard_errors():
    """Errors of the parameters are common to all samples: over records, not within one, 95 %."""
    values = {**VALUES, LOAD: 5.0}
    held = {True: [], False: []}
    for seed in range(8):
        made = record(np.random.default_rng(seed), model())
        begun = seed_model(Oscillator(), (ConstantLoad(),), values=values, fixed=("system.mass",))
        fitted = spiral.compare(made, begun).model
        declared = made.running({i.name: i.interpolation for i in Oscillator().inputs})
        for exact in held:
            bands = estimate([fitted], [declared], Rts(), uncertain={} if exact else None)
            held[exact] += [s.coverage_95 for s in bands.states.values()]
    assert np.mean(held[False]) > 0.85
    assert np.mean(held[True]) < 0.75


def oscillator(interpolation):
    return spiral.system(
        ["m*x'' + c*x' + k*x = F"], states={"x": "m"}, observed=["x"],
        inputs={"F": {"unit": "N", "interpolation": interpolation}},
        parameters={"m": "1 kg", "c": "0.8 N*s/m", "k": "400 N/m"},
    )  # fmt: skip


def test_bands_hold_each_way_in_which_an_input_may_run_between_its_samples():
    """Straight lines taken for a spline: readings hardly tell, the hidden rate is another."""
    held, plain, rng = [], [], np.random.default_rng(0)
    truth, ours = (seed_model(oscillator(way)) for way in ("linear", "smooth"))
    for _ in range(6):
        force = {"F": np.convolve(rng.normal(size=len(TIME)), np.ones(3), "same")}
        made = simulate(truth, TIME, force, 0.01, rng)
        declared = made.running({"F": "smooth"})
        asked, wrong = (estimate([ours], [r], Rts(), uncertain={}) for r in (made, declared))
        assert [b.parts[0].undecided for b in (asked, wrong)] == [("F",), ()]
        assert "F may run" in asked.band_sentence
        held.append(asked.states["x_rate"].coverage_95)
        plain.append(wrong.states["x_rate"].coverage_95)
    assert np.mean(held) > 0.9
    assert np.mean(plain) < 0.6
