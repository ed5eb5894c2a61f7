"""The likelihood of one-step predictions: against dense Gaussians, differences and simulation."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm
from scipy.stats import chi2, multivariate_normal
from spiral_plugins.effects.dissipative import CoulombFriction
from spiral_plugins.effects.memory import BoucWen, HiddenMode
from spiral_plugins.effects.restoring import Clearance, CubicStiffness
from spiral_plugins.effects.sensors import Gain
from spiral_plugins.strategies.likelihood import Likelihood
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.engine.likelihood.fit import maximise_likelihood
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm, first_noise, noise_matrices
from spiral.engine.likelihood.own_states import arrange_own_states, own_states_along
from spiral.engine.likelihood.predict import log_likelihood, predict_readings
from spiral.engine.resting import state_jacobian
from spiral.inference.likelihood import candidates
from spiral.inference.likelihood.fitting import fit_by_likelihood
from spiral.inference.likelihood.scores import predicted_motion, rank_candidates
from spiral.inference.problem import silent
from spiral.io.problem_setup import pose_problem
from spiral.io.registry import load_registry
from spiral.physics.signatures import SystemMotion, signatures
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.swept_oscillator import KEYS, TRUTH, record_of, shaken, states_alone, task_of

TERMS = {
    "white": (),
    "coloured": ((NoiseTerm("coloured", "x"),), {"coloured.x": 0.02, "coloured.time": 0.03}),
    "band": ((NoiseTerm("band", "x"),), {"band.x": 0.02, "band.time": 0.02}),
    "steep": ((NoiseTerm("band", "x", 6),), {"band.x": 0.02, "band.time": 0.02}),
    "vibration": (
        (NoiseTerm("vibration", "x"),),
        {"vibration.x": 0.02, "vibration.time": 0.01, "vibration.damping": 0.1},
    ),
    "drift": ((NoiseTerm("drift", "x"),), {"drift.x": 0.05}),
    "gust": ((NoiseTerm("gust", "observed"),), {"gust.observed": 0.3, "gust.time": 0.1}),
    "smooth gust": (
        (NoiseTerm("gust", "observed", 2),),
        {"gust.observed": 0.3, "gust.time": 0.1},
    ),
    "swell": (
        (NoiseTerm("swell", "observed"),),
        {"swell.observed": 0.3, "swell.time": 0.05, "swell.damping": 0.2},
    ),
    "steep swell": (
        (NoiseTerm("swell", "observed", 6),),
        {"swell.observed": 0.3, "swell.time": 0.05, "swell.damping": 0.4},
    ),
}


@pytest.mark.parametrize("kind", TERMS)
def test_it_is_that_of_the_joint_gaussian_of_all_readings(kind):
    """A linear machine's readings are jointly Gaussian: mean and covariance written out densely."""
    record = record_of(0, samples=64)
    task, settings = task_of(record, substeps=16)
    noise = first_noise(task, 0.2)
    if TERMS[kind]:
        noise = noise.with_terms(*TERMS[kind])
    parts = noise_matrices(task, settings, noise)
    n, dt = len(task.states), task.series.dt
    flow = expm(state_jacobian(task.compiled, task.values, np.zeros(task.inputs.shape[1])) * dt)
    size = len(parts.q)
    f = np.zeros((size, size))
    f[:n, :n], f[n:, n:] = flow, parts.phi
    f[:n, n:] = 0.5 * dt * (flow @ parts.driven + parts.driven)
    c = np.concatenate([[[1.0, 0.0]], parts.seen], axis=1)[0]
    p, joint, count = parts.p, np.zeros((64, 64)), 64
    for i in range(count):
        cross = p @ c
        for j in range(i, count):
            joint[i, j] = joint[j, i] = c @ cross
            cross = f @ cross
        p = f @ p @ f.T + parts.q
    joint += np.eye(count) * parts.r[0]
    mean = states_alone(task, settings)[:, 0]
    expected = multivariate_normal(mean, joint).logpdf(task.series.y[:, 0])
    found = log_likelihood((predict_readings(task, settings, noise),))
    assert found == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_noise_behind_a_low_pass_has_its_spectrum(order):
    """Covariances over k samples are those of the power 1 / (1 + (w / w0)^2n), by quadrature."""
    task, settings = task_of(record_of(0, samples=64))
    time, size, dt = 0.02, 0.3, task.series.dt
    noise = first_noise(task, 0.0).with_terms(
        (NoiseTerm("band", "x", order),), {"band.x": size, "band.time": time}
    )
    parts, n = noise_matrices(task, settings, noise), len(task.states)
    first, step = parts.p[n:, n:], parts.phi
    np.testing.assert_allclose(step @ first @ step.T + parts.q[n:, n:], first, atol=1e-12)
    for k in range(12):
        found = (np.linalg.matrix_power(step, k) @ first)[0, 0]
        power, whole = (
            quad(lambda w, t=t: np.cos(w * t) / (1 + w ** (2 * order)), 0, 60, limit=500)[0]
            for t in (k * dt / time, 0.0)
        )
        assert found == pytest.approx(size**2 * power / whole, abs=2e-6)


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_a_force_around_a_frequency_has_its_spectrum(order):
    """Covariances of what acts: those of 1 / (1 + ((w / w0 - w0 / w) / 2 d)^n), by quadrature."""
    task, settings = task_of(record_of(0, samples=64))
    time, size, damping, dt = 0.02, 0.3, 0.25, task.series.dt
    term = NoiseTerm("swell", "observed", order)
    values = {term.size: size, term.time: time, term.damping: damping}
    parts = noise_matrices(task, settings, first_noise(task, 0.0).with_terms((term,), values))
    n, acts = len(task.states), parts.driven[1] > 0
    first, step = parts.p[n:, n:], parts.phi
    np.testing.assert_allclose(
        step @ first @ step.T + parts.q[n:, n:], first, atol=1e-9 * first.max()
    )
    for k in range(12):
        found = (np.linalg.matrix_power(step, k) @ first)[acts][0, acts][0]
        power, whole = (
            quad(lambda w, t=t: np.cos(w * t) / (1 + ((w - 1 / w) / (2 * damping)) ** order),
                 1e-6, 60, limit=2000)[0]
            for t in (k * dt / time, 0.0)
        )  # fmt: skip
        whole_power = (size * task.rates[1]) ** 2  # of two poles 0.6 % lies beyond the quadrature
        near = (8e-3 if order == 2 else 2e-4) * whole_power
        assert found == pytest.approx(whole_power * power / whole, abs=near)


@pytest.mark.parametrize("order", [1, 2])
def test_a_force_that_lasts_has_its_autocovariance(order):
    """a^2 exp(-t / T), or a^2 (1 + 2 t / T) exp(-2 t / T)."""
    task, settings = task_of(record_of(0, samples=64))
    term, dt, time = NoiseTerm("gust", "observed", order), task.series.dt, 0.07
    values = {term.size: 0.3, term.time: time}
    parts = noise_matrices(task, settings, first_noise(task, 0.0).with_terms((term,), values))
    n, acts = len(task.states), parts.driven[1] > 0
    first, step, power = parts.p[n:, n:], parts.phi, (0.3 * task.rates[1]) ** 2
    for k in range(12):
        apart = order * k * dt / time
        expected = power * np.exp(-apart) * (1.0 if order == 1 else 1.0 + apart)
        result = (np.linalg.matrix_power(step, k) @ first)[acts][0, acts][0]
        assert result == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_time_of_a_force_is_the_integral_of_its_autocorrelation(order):
    """Whatever its order, by the trapezoidal rule; its standard deviation is its size."""
    task, settings = task_of(record_of(0, samples=64))
    term, time = NoiseTerm("gust", "observed", order), 40 * task.series.dt
    values = {term.size: 0.3, term.time: time}
    parts = noise_matrices(task, settings, first_noise(task, 0.0).with_terms((term,), values))
    n, acts = len(task.states), parts.driven[1] > 0
    ahead, told = parts.p[n:, n:], []
    for _ in range(1000):
        told.append(ahead[acts][0, acts][0])
        ahead = parts.phi @ ahead
    assert np.sqrt(told[0]) == pytest.approx(0.3 * task.rates[1], rel=1e-9)
    assert np.trapezoid(told, dx=task.series.dt) / told[0] == pytest.approx(time, rel=1e-3)


def test_white_noise_takes_the_place_of_terms_that_go():
    """What had vanished beside them has no slope on a logarithmic scale."""
    terms = tuple(NoiseTerm(k, w) for k, w in (("white", "x"), ("force", "observed"), ("band", "x"),
                                               ("gust", "observed"), ("drift", "x")))  # fmt: skip
    values = {"white.x": 1e-7, "force.observed": 0.03, "band.x": 0.02, "band.time": 0.1,
              "gust.observed": 0.04, "gust.time": 1.0, "drift.x": 5.0}  # fmt: skip
    noise = NoiseModel(terms, values)
    less = noise.replace_with_white("band", "gust", "drift")
    assert less.values == pytest.approx({"white.x": 0.02, "force.observed": 0.05})
    assert {t.kind for t in noise.replace_with_white("band").terms} == {
        "white",
        "force",
        "gust",
        "drift",
    }


def test_a_missing_reading_takes_no_part():
    record = record_of(1, samples=200)
    task, settings = task_of(record)
    noise = first_noise(task, 0.1)
    y = task.series.y.copy()
    y[80:95] = np.nan
    gap = replace(task, series=replace(task.series, y=y))
    part = predict_readings(gap, settings, noise, KEYS)
    assert part.whole
    assert np.all(part.spreads[80:95] == 0)
    assert np.all(part.columns[80:95] == 0)
    assert np.isfinite(log_likelihood((part,)))
    before = predict_readings(task, settings, noise)
    np.testing.assert_allclose(part.misses[:80], before.misses[:80])


def test_slopes_with_held_gains_are_those_of_differences_where_the_model_is_right():
    record = record_of(2, noise=1e-4)
    task, settings = task_of(record)
    noise = first_noise(task, 1e-4)
    part = predict_readings(task, settings, noise, KEYS)
    for j, key in enumerate(KEYS):
        step = 1e-5 * TRUTH[key]
        ends = [
            predict_readings(task.with_values({key: TRUTH[key] + s}), settings, noise).misses
            for s in (-step, step)
        ]
        expected = (ends[0] - ends[1]) / (2 * step)
        size = np.abs(expected[50:]).max()
        np.testing.assert_allclose(part.slopes[50:, :, j], expected[50:], atol=0.03 * size)


@pytest.mark.parametrize("effect", [CubicStiffness(), Gain()])
def test_signatures_are_the_slopes_of_the_compiled_effect(effect):
    """What an absent effect adds to rates and readings, against its column of the Jacobians."""
    record = record_of(3, samples=300)
    task, settings = task_of(record, (effect,), {k: 0.0 for k, _ in amplitudes(effect)})
    part = predict_readings(task, settings, first_noise(task, 0.1), keep=True)
    along = along_of(task, part)
    rates, readings = signatures(along, effect, {})
    (key, _), *_ = amplitudes(effect)
    at = task.keys.index(key)
    n, p = len(task.states), len(task.keys)
    for k in range(0, 300, 50):
        b, d = np.zeros((n, p)), np.zeros((1, p))
        x, u = part.expected[k, :n].copy(), along.inputs[k].copy()
        task.compiled.rate(x, u, task.values, np.empty(n), np.zeros((n, n)), b)
        task.compiled.output(x, u, task.values, np.empty(1), np.zeros((1, n)), d)
        np.testing.assert_allclose(rates[k, :, 0], b[:, at], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(readings[k, :, 0], d[:, at], rtol=1e-9, atol=1e-12)


def amplitudes(effect):
    port = Oscillator().place(effect)
    known = {p.name for p in effect.amplitudes()}
    return [(k, p) for k, p in effect.keys(port) if p.name in known]


def along_of(task, part):
    class Bare:
        problem = type("Problem", (), {"model": task.model})

    return predicted_motion(Bare, task, part)


def test_scores_of_effects_that_are_not_there_are_chi2():
    """With a random force the filter follows the readings: what scores see must not hold them.

    The fall of the sum of squares by a candidate's step is chi2 with its independent directions;
    the largest of n tries (at n times of a late sensor) is larger by up to 2 log n.
    """
    registry, falls, late = load_registry(), {}, ("delay", "sensor_lag")
    for seed in range(3):
        seed_of = seed_model(Oscillator(), values=TRUTH)
        begun = Likelihood().begin(
            pose_problem(registry, seed_of, (shaken(seed, 0.1),), None), silent
        )
        fit = fit_by_likelihood(begun.assembly, begun.fit_state)
        ranked = rank_candidates(begun.assembly, fit, fit.estimate.noise, None).ranked
        for one in (r for r in ranked if r.score.rank):
            label, searched = one.variant.original.label, one.variant.searched
            if searched == 1 or label in late:
                fall = (one.score.gain - 2 * np.log(searched)) / one.score.rank
                falls.setdefault(label, []).append(fall)
    assert {"gain", "delay", "sensor_lag", "cubic_stiffness"} <= set(falls)
    chance = {k: chi2.sf(max(np.sum(v), 0.0), len(v)) for k, v in falls.items()}
    assert {k: p for k, p in chance.items() if p < 0.05 / len(chance)} == {}


def test_those_that_a_final_leaves_behind_run_their_own(monkeypatch):
    """One after the other by worth, as long as it is above its price; each effect once."""
    monkeypatch.setattr(candidates, "_continue_rival", lambda base, rival, masks, steps: rival)
    monkeypatch.setattr(candidates, "_free_rival_shapes", lambda base, rival, masks: rival)
    monkeypatch.setattr(candidates, "_restart_rival_noise", lambda base, rival, masks: rival)
    monkeypatch.setattr(candidates, "_try_other_shapes", lambda study, base, rival, masks: rival)

    def rival(label, worth):
        ranked = SimpleNamespace(score=SimpleNamespace(gain=worth))
        fit = SimpleNamespace(estimate=SimpleNamespace(finite=True))
        return SimpleNamespace(label=label, worth=worth, ranked=ranked, fit=fit)

    base = SimpleNamespace(estimate=SimpleNamespace(prepared=()))
    runners = [rival("a", 157.0), rival("a", 98.0), rival("b", 90.0), rival("c", 80.0)]
    run = candidates.Race(None, base, None, silent, [*runners, rival("d", -3.0)])
    assert [(w.label, len(left)) for w, left in run.winners()] == [
        ("a", 2), ("a", 1), ("b", 2), ("c", 1),
    ]  # fmt: skip
    assert [r.label for r in run.tried] == ["a", "a", "b", "c", "d"]
    beside = candidates.Race(None, base, None, silent, [*runners, rival("d", -3.0)])
    left = beside.against_model(400.0, ("d",))
    assert [(r.label, r.worth) for r in left.runners] == [("a", 157.0), ("d", -3.0)]


def test_own_states_follow_the_motion_as_the_compiled_effect_has_them():
    """A resonance driven by x = sin: its steady state is the transfer function's."""
    dt, count = 1e-3, 8000
    time = dt * np.arange(count)
    turn, natural, ratio = 2 * np.pi * 2.0, 2 * np.pi * 5.0, 0.1
    states = np.column_stack([np.sin(turn * time), turn * np.cos(turn * time)])
    inputs = np.column_stack([np.zeros(count), time])
    along = SystemMotion(
        Oscillator(), states, inputs, np.zeros((count, 2)), states[:, :1], {"mass": 1.0}
    )
    effect = HiddenMode()
    shapes = {"natural_frequency": np.array([5.0, 7.0]), "damping_ratio": np.full(2, ratio)}
    found = arrange_own_states(effect, 1, own_states_along(along, dt, effect, shapes)[0])
    s = 1j * turn
    through = (2 * ratio * natural * s + natural**2) / (s**2 + 2 * ratio * natural * s + natural**2)
    expected = np.imag(through * np.exp(s * time))
    second = np.sin(turn * time) - found["deflection"][0]
    np.testing.assert_allclose(second[-1000:], expected[-1000:], atol=1e-5)


def test_own_states_that_forget_within_a_sample_are_followed_in_parts_of_it():
    """A slip of a fiftieth of the motion, ten samples a period, against steps fifty times finer.

    One that runs away leaves those beside it alone.
    """
    effect, fine = BoucWen(), 50
    shapes = {"length": np.array([0.02, 0.02, 0.3]), "asymmetry": np.array([-9.0, 0.0, 0.5]),
              "exponent": np.ones(3)}  # fmt: skip

    def slips(dt):
        time = np.arange(0.0, 3.0, dt)
        turn = 2 * np.pi
        states = np.column_stack([np.sin(turn * time), turn * np.cos(turn * time)])
        inputs = np.column_stack([0.0 * time, time])
        along = SystemMotion(Oscillator(), states, inputs, 0 * states, states[:, :1], {"mass": 1.0})
        return own_states_along(along, dt, effect, shapes)[:, :, 0]

    coarse, exact = slips(0.1), slips(0.1 / fine)[:, ::fine]
    size = np.array([0.02, 0.3])[:, None]
    assert np.max(np.abs(coarse[1:] - exact[1:, : coarse.shape[1]]) / size) < 0.05


def test_estimates_scatter_as_their_standard_errors_say():
    """Pooled squared t of 40 records is 1; the size of the noise is told."""
    squares, sizes = [], []
    for seed in range(40):
        record = record_of(seed, samples=1000)
        task, settings = task_of(record, values={"linear_stiffness.stiffness": 440.0})
        found = maximise_likelihood(((task, settings),), KEYS, first_noise(task, 0.1))
        assert found.converged
        squares += [((found.values[k] - TRUTH[k]) / found.errors[k]) ** 2 for k in KEYS]
        sizes.append(found.noise.values["white.x"] / (0.05 * np.std(record.truth["x"])))
    assert 0.7 < np.mean(squares) < 1.35
    assert abs(np.mean(sizes) - 1) < 0.01


def test_a_value_that_begins_beyond_a_bound_is_not_held_there():
    """Held, it would be put back at every step, and nothing else could move either."""
    task, settings = task_of(record_of(3, samples=1000), values={"linear_stiffness.stiffness": 440})
    noise = first_noise(task, 0.1)
    free = maximise_likelihood(((task, settings),), KEYS, noise)
    beyond = dict.fromkeys(KEYS, (-np.inf, np.inf)) | {"linear_damping.damping": (5.0, np.inf)}
    assert task.values[task.keys.index("linear_damping.damping")] < 5.0
    found = maximise_likelihood(((task, settings),), KEYS, noise, beyond)
    assert found.values == pytest.approx(free.values, rel=1e-6)
    within = beyond | {"linear_damping.damping": (0.0, 0.5 * TRUTH["linear_damping.damping"])}
    held = task.with_values({"linear_damping.damping": 0.1})
    found = maximise_likelihood(((held, settings),), KEYS, noise, within)
    assert found.values["linear_damping.damping"] == 0.5 * TRUTH["linear_damping.damping"]


def test_integration_steps_are_as_short_as_the_record_can_tell():
    """Hardly any noise: the stiffness is off by less than its error, and by far more without."""
    import spiral

    truth = {**TRUTH, "linear_stiffness.stiffness": 4000.0}
    record = replace(record_of(11, 4000, 1e-4, values=truth), noise={})
    found = spiral.compare(record, "oscillator", values=truth).model.estimates()
    stiffness = found["linear_stiffness"]["stiffness"]
    assert abs(stiffness.estimate - 4000.0) < 3 * stiffness.se
    task, settings = task_of(record, values=truth, substeps=1)
    coarse = maximise_likelihood(((task, settings),), KEYS, first_noise(task, 1e-4))
    miss = abs(coarse.values["linear_stiffness.stiffness"] - 4000.0)
    assert miss > 5 * stiffness.se


def test_a_hidden_friction_is_named_and_measured():
    """The whole loop: the effect, its size within its error, white noise left."""
    import spiral

    truth = {"coulomb_friction.level": 1.5, "coulomb_friction.width": 0.02}
    records = [record_of(s, 1500, 0.02, (CoulombFriction(),), truth) for s in (7, 8)]
    run = spiral.discover(
        replace(records[0], noise={}), "oscillator", test=replace(records[1], noise={}),
        values=TRUTH, strategy="likelihood",
    )  # fmt: skip
    assert run.missing == ("coulomb_friction",)
    level = run.model.estimates()["coulomb_friction"]["level"]
    assert abs(level.estimate - 1.5) < 3 * level.se
    assert run.rounds[-1].comparison.random == {}
    assert run.rounds[-1].comparison.test_error < 1.1 * run.rounds[-1].comparison.noise_floor


def test_nothing_is_named_where_nothing_is_missing():
    import spiral

    records = [replace(record_of(s, 1200, 0.02), noise={}) for s in (9, 10)]
    run = spiral.discover(
        records[0], "oscillator", test=records[1], values=TRUTH, strategy="likelihood"
    )
    assert run.verdict == "nothing_missing"
    assert "white noise" in run.summary


def test_a_corner_that_was_held_takes_its_most_likely_width():
    """A gap rounded wider than its candidate's corner would bias gap and stiffness by 5 errors."""
    truth = {"clearance.stiffness": 2000.0, "clearance.gap": 0.08, "clearance.width": 0.02}
    record = record_of(4, 1500, 0.01, (Clearance(),), truth)
    model = seed_model(Oscillator(), values=TRUTH)
    problem = pose_problem(load_registry(None), model, (record,), None, candidates=("clearance",))
    begun = Likelihood().begin(problem, silent)
    settled = Likelihood().admit(begun.assembly, begun.fit_state, "clearance", silent)
    found = settled.comparison.model
    label = next(k.rsplit(".", 1)[0] for k in found.errors if k.startswith("clearance"))
    names = {k: k.replace("clearance", label) for k in truth}
    errors = [(found.values[n] - truth[k]) / found.errors[n] for k, n in names.items()]
    assert np.all(np.abs(errors) < 3.5)


def test_a_hidden_state_that_begins_far_off_is_found():
    """An epidemic: those who are ill are counted, a tenth at most; 0.97 may still fall ill."""
    truth = {"system.b": 0.4, "system.s": 0.25, "system.g": 0.143}
    b, s, g = truth.values()

    def rates(_, x):
        return [-b * x[0] * x[2], b * x[0] * x[2] - s * x[1], s * x[1] - g * x[2]]

    time, begin = 0.12 * np.arange(1000), [0.97, 0.004, 0.004]
    ill = solve_ivp(rates, (0, time[-1]), begin, t_eval=time, rtol=1e-9, atol=1e-12).y[2]
    counted = ill + 0.01 * ill.std() * np.random.default_rng(3).normal(size=time.size)
    model = spiral.system(
        lambda t, x, u, p: [
            -p.b * x.S * x.I, p.b * x.S * x.I - p.s * x.E, p.s * x.E - p.g * x.I,
        ],
        states={"S": "", "E": "", "I": ""}, observed=["I"],
        parameters={k: {"unit": "1/s", "lower": 0.0} for k in "bsg"},
    )  # fmt: skip
    record = make_record(model, "counts", time, {"I": counted}, {})
    guess = {k: f * v for (k, v), f in zip(truth.items(), (1.15, 0.9, 1.1), strict=True)}
    seed = seed_model(model, values=guess)
    problem = pose_problem(load_registry(None), seed, (record,), (record,), candidates=())
    begun = Likelihood().begin(problem, silent)
    found = begun.comparison.model
    errors = [(found.values[k] - v) / found.errors[k] for k, v in truth.items()]
    assert np.all(np.abs(errors) < 3.5)
    assert begun.fit_state.starts[0][0] == pytest.approx(begin[0], rel=0.05)
