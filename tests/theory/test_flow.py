"""Machine code of a model's flow and of the filter's algebra against what they are defined by."""

from dataclasses import replace

import numba as nb
import numpy as np
import pytest
from spiral_plugins.effects.inputs import InputDelay
from spiral_plugins.effects.restoring import CubicStiffness
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.pendulum import Pendulum
from spiral_plugins.systems.planar_rotor import PlanarRotor
from spiral_plugins.systems.tilting_rotor import TiltingRotor

import spiral
from spiral.engine.filter.algebra import compiled_algebra
from spiral.engine.filter.kernel import slope_workspace
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood import predict
from spiral.engine.likelihood.noise import NoiseTerm, first_noise, size_limits
from spiral.engine.likelihood.predict import predict_readings, vary_noise
from spiral.engine.likelihood.transition import compressed_rows, entries_in
from spiral.physics.compile import compile_model
from spiral.physics.flow import compile_flow
from spiral.physics.lanes import padded_width
from spiral.physics.linearity import jacobian_names
from spiral.physics.trace import trace
from spiral.types.model import seed_model
from tests.scenes import SEED_TRUTH, planar_record
from tests.swept_oscillator import record_of, task_of

STEP = 1e-3


@nb.njit
def advance(flow, x, u, stride, substeps, step, p, s, work, first):
    flow(x, u, 0, stride, substeps, step, p, s, work, first)


@nb.njit
def matmul(product, a, b, c, rows, inner):
    product(a, b, c, rows, inner)


@nb.njit
def take_in(absorb, x, m, c, d, j, r, miss, gain, work):
    return absorb(x, m, c, d, j, r, miss, gain, work)


def runge_kutta(rate, x, u, step, p):
    """Classical Runge-Kutta, written a second time."""

    def f(at, state):
        out = np.zeros(len(x))
        rate(np.ascontiguousarray(state), np.ascontiguousarray(u[at]), p, out)
        return out

    a = f(0, x)
    b = f(1, x + step / 2 * a)
    c = f(1, x + step / 2 * b)
    d = f(2, x + step * c)
    return x + step / 6 * (a + 2 * b + 2 * c + d)


def questions(system, by, substeps=3, stride=2):
    traced = trace(system, system.seed)
    rng = np.random.default_rng(4)
    x, p = rng.uniform(0.1, 1, len(traced.x)), rng.uniform(0.5, 2, len(traced.p))
    u = rng.uniform(-1, 1, (substeps * stride + 1, len(traced.u)))
    return traced, tuple(traced.keys[i] for i in by), x, u, p, substeps


@pytest.mark.parametrize("system", [PlanarRotor(), Pendulum()], ids=["planar_rotor", "pendulum"])
@pytest.mark.parametrize("by", [(), (1,), (2, 0, 1)])
def test_a_flow_is_runge_kutta_and_its_slopes_are_differences_of_it(system, by):
    traced, names, x, u, p, substeps = questions(system, by)
    n = len(x)
    value = compile_model(traced).rate_value

    def reached(x, p):
        for i in range(substeps):
            x = runge_kutta(value, x, u[2 * i :], STEP, p)
        return x

    s, work = slope_workspace(n, n + len(by))
    s[:, :n] = np.eye(n)
    got = x.copy()
    advance(compile_flow(traced, names).advance, got, u, 2, substeps, STEP, p, s, work, 0)
    np.testing.assert_allclose(got, reached(x, p), rtol=1e-13)
    for column in range(n + len(by)):
        moved = [np.array(x), np.array(p)]
        which, at = (0, column) if column < n else (1, by[column - n])
        h = 1e-5
        moved[which][at] += h
        plus = reached(*moved)
        moved[which][at] -= 2 * h
        slope = (plus - reached(*moved)) / (2 * h)
        np.testing.assert_allclose(s[:, column], slope, rtol=1e-6, atol=1e-8)
    assert not s[:, n + len(by) :].any()


@pytest.mark.parametrize("by", [(), (1,), (2, 0, 1)])
def test_slopes_by_parameters_alone_are_the_last_columns_of_all(by):
    traced, names, x, u, p, substeps = questions(Pendulum(), by)
    n, flow = len(x), compile_flow(traced, names).advance
    runs = []
    for first, columns in ((0, n + len(by)), (n, len(by))):
        s, work = slope_workspace(n, columns)
        s[:, : n - first] = np.eye(n)[:, : n - first]
        at = x.copy()
        advance(flow, at, u, 2, substeps, STEP, p, s, work, first)
        runs.append((at, s[:, n - first : columns]))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


def test_called_twice_a_flow_has_forgotten_the_call_before():
    traced, names, x, u, p, substeps = questions(PlanarRotor(), (0,))
    flow = compile_flow(traced, names).advance
    runs, (s, work) = [], slope_workspace(len(x), len(x) + 1)
    for _ in range(2):
        s[:] = np.eye(*s.shape)
        at = x.copy()
        advance(flow, at, u, 2, substeps, STEP, p, s, work, 0)
        runs.append((at, s.copy()))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


@pytest.mark.parametrize("width", [1, 3, 4, 11, 12, 13, 25, 40])
def test_products_of_any_size(width):
    rng = np.random.default_rng(width)
    wide = padded_width(width)
    a, b = np.zeros((wide, wide)), np.zeros((wide, padded_width(width + 2)))
    a[:width, :width] = rng.normal(size=(width, width))
    b[:width, : width + 2] = rng.normal(size=(width, width + 2))
    c = np.full(b.shape, np.nan)
    matmul(compiled_algebra().product, a, b, c, width, width)
    np.testing.assert_allclose(c, a @ b, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("width", [1, 4, 7, 12, 13, 25, 40])
def test_the_lower_half_of_a_symmetric_product(width):
    rng = np.random.default_rng(width)
    wide, inner = padded_width(width), width + 3
    a, b = np.zeros((wide, inner)), np.zeros((inner, wide))
    a[:width] = rng.normal(size=(width, inner))
    b[:, :width] = a[:width].T
    c = np.full((wide, wide + 4), np.nan)
    matmul(compiled_algebra().lower, a, b, c, width, inner)
    lower = np.tril_indices(width)
    np.testing.assert_allclose(c[lower], (a @ b)[lower], rtol=1e-12, atol=1e-12)
    assert np.isnan(c[:, wide:]).all()


@nb.njit
def multiply_sparse(sparse, values, columns, ends, b, c, first):
    sparse(values, columns, ends, b, c, first)


@pytest.mark.parametrize("size", [0, 1, 5, 12])
@pytest.mark.parametrize("width", [1, 13, 32])
def test_a_product_with_a_sparse_matrix(size, width):
    """Rows before the first are left alone; a row without entries gives zeros."""
    rng, first, wide = np.random.default_rng(size), 3, padded_width(width)
    a = rng.normal(size=(size, size)) * (rng.random((size, size)) < 0.4)
    a[: size // 3] = 0.0
    columns, ends = compressed_rows(a)
    values = entries_in(a, columns, ends)
    assert len(values) == np.count_nonzero(a)
    b, c = rng.normal(size=(first + size, wide)), np.full((first + size, wide), np.nan)
    multiply_sparse(compiled_algebra().sparse, values, columns, ends, b, c, first)
    np.testing.assert_allclose(c[first:], a @ b[first:], rtol=1e-12, atol=1e-12)
    assert np.isnan(c[:first]).all()


@pytest.mark.parametrize("size", [1, 4, 7, 13])
def test_a_measurement_is_taken_in_as_joseph_says(size):
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size))
    p, c, r, miss = root @ root.T, rng.normal(size=size), 1e-6, 0.3
    wide, width = padded_width(size), 6
    slopes, told = rng.normal(size=(size, width)), rng.normal(size=width)
    mean, m, rows, d = (np.zeros(n) for n in (wide, (wide, wide + 8), (2, wide), (2, 8)))
    m[:size, :size], m[:size, wide : wide + width] = p, slopes
    rows[1, :size], d[1, :width] = c, told
    gain = np.zeros(wide)
    s = take_in(
        compiled_algebra().absorb, mean, m, rows, d, 1, r, miss, gain, np.zeros(2 * m.shape[1])
    )
    cov = m[:, :wide]
    k = p @ c / (c @ p @ c + r)
    left = np.eye(size) - np.outer(k, c)
    wanted = left @ p @ left.T + r * np.outer(k, k)
    assert s == pytest.approx(c @ p @ c + r, rel=1e-12)
    np.testing.assert_allclose(gain[:size], k, rtol=1e-10)
    np.testing.assert_allclose(mean[:size], k * miss, rtol=1e-10)
    np.testing.assert_allclose(cov[:size, :size], wanted, atol=1e-9 * np.abs(p).max())
    np.testing.assert_array_equal(cov, cov.T)
    assert np.linalg.eigvalsh(cov[:size, :size]).min() > -1e-9 * np.abs(p).max()
    told = c @ slopes + told
    np.testing.assert_allclose(d[1, :width], told, rtol=1e-10)
    np.testing.assert_allclose(
        m[:size, wide : wide + width], slopes - np.outer(k, told), rtol=1e-9, atol=1e-9
    )
    assert not m[size:].any()


def all_noise(task):
    """A term of every kind."""
    noise = first_noise(task, 0.05)
    sizes = {"x": float(task.series.sigma[0])}
    for term, values in (
        (NoiseTerm("band", "x"), {"band.x": sizes["x"], "band.time": 0.01}),
        (NoiseTerm("drift", "x"), {"drift.x": sizes["x"]}),
        (NoiseTerm("gust", "observed"), {"gust.observed": 0.05, "gust.time": 0.1}),
    ):
        noise = noise.with_terms((term,), values)
    return noise


@pytest.mark.parametrize(("effects", "values", "share"), [
    ((), {}, 1e-9),
    ((CubicStiffness(),), {"cubic_stiffness.stiffness": 400.0}, 0.1),
])  # fmt: skip
def test_other_noise_along_one_motion(effects, values, share):
    """The same as a filter run anew: exactly for a linear model, nearly so for another."""
    task, settings = task_of(record_of(3, effects=effects, values=values), effects, values)
    noise = all_noise(task)
    run = predict_readings(task, settings, noise, keep=True)
    others = [noise.with_values({n: 1.05 * noise.values[n]}) for n in noise.names]
    for other, (misses, spreads) in zip(others, vary_noise(task, settings, noise, others, run),
                                        strict=True):  # fmt: skip
        anew = predict_readings(task, settings, other)
        for mine, theirs, before in ((misses, anew.misses, run.misses),
                                     (spreads, anew.spreads, run.spreads)):  # fmt: skip
            moved = np.linalg.norm(theirs - before)
            assert np.linalg.norm(mine - theirs) <= share * moved


def test_noise_that_does_nothing_in_one_record_is_not_varied_there():
    """Its size is the least for large readings, and more than that in another record."""
    task, settings = task_of(record_of(3))
    noise = all_noise(task)
    size = 0.99 * size_limits(task, "band.x")[0]
    noise = noise.with_values({"band.x": size})
    run = predict_readings(task, settings, noise, keep=True)
    larger = noise.with_values({"band.x": 1.05 * size})
    wider = noise.with_values({"drift.x": 1.05 * noise.values["drift.x"]})
    (still, variances), (moved, _) = vary_noise(task, settings, noise, [larger, wider], run)
    np.testing.assert_allclose(still, run.misses, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(variances, run.spreads, rtol=1e-9)
    assert not np.allclose(moved, run.misses, rtol=1e-6)


def test_slopes_of_the_flow_are_made_anew_where_they_are_not_kept():
    effects, values = (CubicStiffness(),), {"cubic_stiffness.stiffness": 400.0}
    task, settings = task_of(record_of(3, effects=effects, values=values), effects, values)
    noise = all_noise(task)
    run = predict_readings(task, settings, noise, keep=True)
    assert run.flows.shape == (task.series.samples, 2, 2)
    others = [noise.with_values({n: 1.05 * noise.values[n]}) for n in noise.names]
    kept = vary_noise(task, settings, noise, others, run)
    anew = vary_noise(task, settings, noise, others, replace(run, flows=run.flows[:0]))
    np.testing.assert_allclose(kept, anew, rtol=1e-12)


@pytest.mark.parametrize(("effects", "known"), [
    ((), {"system.mass", "linear_stiffness.stiffness", "linear_damping.damping"}),
    ((InputDelay(),), {"system.mass", "linear_stiffness.stiffness", "linear_damping.damping",
                       "input_delay.time", "input_delay.scale"}),
    ((CubicStiffness(),), None),
])  # fmt: skip
def test_rates_that_are_linear_in_the_states_are_known_by_their_form(effects, known):
    traced = trace(Oscillator(), (*Oscillator().seed, *effects))
    named = jacobian_names(traced)
    assert named is None if known is None else named is not None and set(named) <= known
    if known is not None:  # what is said not to matter does not
        slopes = {s for r in traced.rate for x in traced.x for s in r.diff(x).free_symbols}
        assert {k for k, s in zip(traced.keys, traced.p, strict=True) if s in slopes} <= set(named)


def test_a_rate_that_an_input_multiplies_a_state_in_varies_with_it():
    """In brackets with others a coefficient is of no form that is looked at."""
    assert jacobian_names(trace(TiltingRotor(), TiltingRotor().seed)) is None
    machine = spiral.system(
        ["m*x'' + c*w*x' + k*x = F"], states={"x": "m"}, inputs={"F": "N", "w": "1"},
        parameters={"m": (1.0, "kg"), "c": (1.0, "N*s/m"), "k": (9.0, "N/m")}, observed=["x"],
    )  # fmt: skip
    named = jacobian_names(trace(machine, machine.seed))
    assert named == {"system.m", "system.c", "system.k", "w"}


@pytest.mark.parametrize("tracked", [(), ("system.phase_origin",)])
def test_a_transition_that_stays_the_same_is_made_once(tracked, monkeypatch):
    """Means, slopes, variances: those of a transition made anew at every sample, but for rounding.

    A stationary covariance is no longer followed there (``test_steady_filter``).
    """
    record = planar_record(3, duration=1.0)
    model = seed_model(PlanarRotor(), values={**SEED_TRUTH, "system.phase_origin": 0.3})
    keys = ("linear_stiffness.stiffness_x", "linear_damping.damping_y", "unbalance.moment")
    task, settings = prepare_filter(prepare_task(model, record, substeps=3, every=True), tracked)
    noise = first_noise(task, 0.02)
    other = noise.with_values({n: 1.3 * v for n, v in noise.values.items()})
    runs = []
    for constant in (True, False):
        if not constant:
            monkeypatch.setattr(predict, "_is_transition_constant", lambda *_: False)
        assert predict._is_transition_constant(task, settings) is constant
        run = predict_readings(task, settings, noise, keys, carry=True)
        runs.append((run, *vary_noise(task, settings, noise, [other], run)))
    for mine, whole in zip(runs[0][1], runs[1][1], strict=True):
        np.testing.assert_allclose(mine, whole, atol=1e-11 * np.abs(whole).max())
    for name in ("misses", "spreads", "slopes", "means", "transitions", "gains", "rows"):
        mine, whole = (getattr(r[0], name) for r in runs)
        np.testing.assert_allclose(mine, whole, atol=1e-11 * np.abs(whole).max())


def test_what_nothing_disturbs_is_known_ever_better():
    """P of states without noise underflows to zero; the filter stays with the record."""
    effects, values = (InputDelay(),), {"input_delay.time": 0.004, "input_delay.scale": 0.01}
    task, settings = task_of(record_of(3, effects=effects, values=values), effects, values, 2)
    for scale in (0.006, 0.008, 0.012, 0.017, 0.02):
        here = task.with_values({"input_delay.time": 0.3 * scale, "input_delay.scale": scale})
        assert predict_readings(here, settings, first_noise(task, 0.0)).whole
