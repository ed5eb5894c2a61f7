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
        found = estimate([ours], [made], Rts(), uncertain={}, between={"F": "linear"})
        assert found.parts[0].task.series.record.hold == {"F": "linear"}  # as a study found it
        assert found.states["x_rate"].coverage_95 > 0.85
        held.append(asked.states["x_rate"].coverage_95)
        plain.append(wrong.states["x_rate"].coverage_95)
    assert np.mean(held) > 0.9
    assert np.mean(plain) < 0.6


def test_a_model_keeps_the_covariance_of_its_fit():
    root = np.random.default_rng(0).normal(size=(3, 3)) * [[1.0], [10.0], [0.1]]
    keys, whole = ("a.x", "b.y", "c.z"), root @ root.T
    known = replace(model(), errors=dict(zip(keys, np.sqrt(np.diag(whole)), strict=True)),
                    correlations=correlations_by_name(keys, whole))  # fmt: skip
    np.testing.assert_allclose(known.covariance(keys), whole)
    np.testing.assert_allclose(known.covariance(keys[::-1]), whole[::-1, ::-1])
    whole[1] = whole[:, 1] = np.inf  # a value that the fit did not determine
    assert set(correlations_by_name(keys, whole)) == {"c.z"}


def test_a_value_that_the_data_did_not_tell_is_no_doubt():
    level, width = "coulomb_friction.level", "coulomb_friction.width"  # neither below zero
    values = {**VALUES, level: 0.5, width: 0.02}
    told = seed_model(Oscillator(), (CoulombFriction(),), values=values, errors={level: 0.1})
    task = prepare_task(told, record(np.random.default_rng(0), model()))
    assert model_prior(replace(told, errors={level: 0.1, width: 0.3}), task).keys == (level,)
    assert model_prior(replace(told, errors={level: np.nan, width: 0.0}), task) is None


def test_draws_follow_a_bent_ridge():
    """log p(a, b) = -(a^2 + s^2 (b - c a^2)^2) / 2: a has variance 1, b mean c, across it 1 / s."""
    c, s = 3.0, 10.0
    second = np.zeros((2, 2, 2))
    second[0, 0] = [0.0, -2 * c * s]
    slopes = np.array([[0.0, 0.0], [0.0, s]])
    found = build_expansion(np.zeros(2), slopes, second, np.zeros(1), np.array([[1.0, 0.0]]))
    # in steps of one standard deviation of the Gaussian at the top, b / s
    w = np.diag([1.0, 1.0 / s])
    bend = np.einsum("ijd,ia,jb->abd", found.second, w, w)
    scaled = replace(found, slopes=found.slopes @ w, second=bend)
    draws = draw_samples(scaled, 2000, np.random.default_rng(0)) @ w
    assert np.mean(draws[:, 0] ** 2) == pytest.approx(1.0, rel=0.15)
    assert np.mean(draws[:, 1]) == pytest.approx(c, rel=0.15)
    assert np.std(draws[:, 1] - c * draws[:, 0] ** 2) == pytest.approx(1 / s, rel=0.15)
    assert not scaled.straight


def test_a_prior_may_know_a_combination_exactly():
    """V of rank one: the values move along it alone."""
    covariance = np.array([[1.0, 2.0], [2.0, 4.0]])
    np.testing.assert_allclose(
        covariance_root(covariance) @ covariance_root(covariance).T, covariance
    )
    prior = Prior(("a", "b"), np.array([1.0, 1.0]), covariance)
    x = np.array([[1.0, 0.0], [0.0, 1.0]])
    step = prior.step(x, np.array([1.0, 2.0]), np.array([1.0, 1.0]))
    np.testing.assert_allclose(step, 5 / 6 * np.array([1.0, 2.0]))  # z = 5 / (1 + 5)
    np.testing.assert_allclose(prior.posterior_covariance(x), covariance / 6)


@pytest.mark.parametrize(
    ("uncertain", "said"),
    [
        ({"bearing.*": 0.2}, "names no parameter"),
        ({"linear_stifness.stiffness": 0.2}, "linear_stiffness.stiffness"),
        ({"system.mass": -0.1}, "system.mass"),
        ({"system.mass": "wide"}, "a share of the value"),
        ({"system.mass": {"absolut": 1}}, "a share of the value"),
        ({LOAD: 0.1}, "zero"),
    ],
)
def test_doubt_that_cannot_be(uncertain, said):
    made = record(np.random.default_rng(0), model())
    with pytest.raises(ConfigError, match=said):
        estimate([model(**{LOAD: 0.0})], [made], Rts(), uncertain=uncertain)


def test_an_observer_without_bands_refuses_doubt():
    made = record(np.random.default_rng(0), model())
    with pytest.raises(ConfigError, match="observer=static"):
        estimate([model()], [made], Static(), uncertain={"system.mass": 0.1})


def test_patterns_name_places():
    keys = [k for k, _ in seed_model(TiltingRotor()).pairs]

    def named(pattern):
        return [k for k in keys if any(fnmatchcase(n, pattern) for n in pattern_names(k))]

    assert len(named("bearing.*")) == 14
    assert len(named("bearing_1.*")) == 7
    assert named("bearing.stiffness_x") == [
        "linear_stiffness@bearing_1.stiffness_x", "linear_stiffness@bearing_2.stiffness_x"
    ]  # fmt: skip
    assert named("system.mass") == ["system.mass"]


def test_a_value_of_which_nothing_is_known_has_a_finite_root():
    """A variance that overflows: of a value that no reading tells."""
    covariance = np.diag([4.0, np.inf, 9.0])
    covariance[0, 2] = covariance[2, 0] = 1.0
    root = _bounded_root(covariance)
    assert np.all(np.isfinite(root))
    np.testing.assert_allclose((root @ root.T)[::2, ::2], covariance[::2, ::2], rtol=1e-12)
    assert (root @ root.T)[1, 1] > 1e90


@pytest.mark.parametrize(("error", "far"), [(0.01, True), (26.0, False)])
def test_an_effect_is_far_from_zero_by_the_errors_that_are_shown(error, far):
    label = "coulomb_friction"
    found = seed_model(Oscillator()).add(CoulombFriction(), {f"{label}.level": 1.0})
    shown = replace(found, errors={f"{label}.level": error})
    assert _is_shown_far_from_zero(shown, label, 3.0) is far
