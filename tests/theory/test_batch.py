"""Many simulations at once against one after the other, exact solutions, and their slopes."""

import importlib

import numpy as np
import pytest
from scipy.linalg import expm

import spiral
from spiral.engine.kernel import advance_windows
from spiral.engine.series import stage_inputs
from spiral.inference.simulate import SUBSTEPS, integrate, with_defaults
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError, PluginError
from spiral.types.model import seed_model
from spiral.types.record import make_record
from tests.scenes import effect, registry

SAMPLES, RATE, COUNT = 200, 500.0, 4
TIME = np.arange(SAMPLES) / RATE
OSCILLATOR = {
    "system.mass": 1.0, "linear_stiffness.stiffness": 4e3, "linear_damping.damping": 4.0,
}  # fmt: skip
BOUC_WEN = {"bouc_wen.stiffness": 1e3, "bouc_wen.length": 1e-4, "bouc_wen.asymmetry": 0.2,
            "bouc_wen.exponent": 1.5}  # fmt: skip
PLANAR = {
    "linear_stiffness.stiffness_x": 1e4, "linear_stiffness.stiffness_y": 1.2e4,
    "linear_damping.damping_x": 5.0, "linear_damping.damping_y": 3.0, "unbalance.moment": 1e-5,
}  # fmt: skip
TANKS = {"pump.gain": 5.0, "outlets.upper": 6.0, "outlets.lower": 5.5, "outlets.width": 1e-3}
LINEAR = spiral.system(
    ["x' = v", "v' = (F - c*v - k*x - k3*x**3)/m"], states={"x": "m", "v": "m/s"},
    inputs={"F": {"unit": "N", "interpolation": "linear"}}, observed=["x"],
    parameters={"m": "2 kg", "c": "3 N*s/m", "k": "400 N/m", "k3": "1e4 N/m^3"},
)  # fmt: skip


def noise(seed=0, scale=1.0, count=COUNT):
    return scale * np.random.default_rng(seed).normal(size=(count, SAMPLES))


def speeds():
    return np.linspace(250, 150, SAMPLES) * np.linspace(0.9, 1.1, COUNT)[:, None]


CASES = {
    "oscillator": ("oscillator", (), OSCILLATOR, {"force": noise()}, {}),
    "memory": ("oscillator", ("bouc_wen",), OSCILLATOR | BOUC_WEN, {"force": noise(1)}, {}),
    "lag of a sensor": (
        "oscillator", ("sensor_lag",),
        OSCILLATOR | {"sensor_lag.time": 0.01, "sensor_lag.scale": 0.01},
        {"force": noise(2)}, {"x": np.array([1e-3, 2e-3, -1e-3, 0.0])},
    ),
    "planar rotor": ("planar_rotor", (), PLANAR, {"speed": speeds()}, {"x": 1e-4}),
    "tilting rotor": ("tilting_rotor", (), {}, {"speed": speeds(), "phase": noise(3)}, {}),
    "held": ("cascaded_tanks", (), TANKS, {"pump": 3 + noise(4)}, {"upper": 1.0, "lower": 2.0}),
    "linear": (LINEAR, (), {}, {"F": noise(5)}, {"v": np.arange(4.0)}),
}  # fmt: skip


def model_of(case):
    system, effects, values, _, _ = CASES[case]
    made = registry().make("system", system) if isinstance(system, str) else system
    added = tuple(effect(name) for name in effects)
    return with_defaults(seed_model(made, added, values=values))


def number(values, k):
    """A number of simulation k."""
    return float(np.broadcast_to(values, COUNT)[k])


@pytest.fixture(scope="module")
def jax():
    return pytest.importorskip("jax", reason="JAX is not installed (the extra gpu)")


def batch_of(case, **changed):
    system, effects, values, inputs, start = CASES[case]
    given = {"inputs": inputs, "values": values, "start": start, "effects": effects, **changed}
    return spiral.simulate_batch(system, SAMPLES / RATE, RATE, **given)


@pytest.mark.parametrize("case", CASES)
def test_each_is_the_single_simulation(jax, case):
    """States and readings to 1e-10 of the largest."""
    _, _, _, inputs, start = CASES[case]
    batch = batch_of(case)
    assert batch.simulations == COUNT
    assert not batch.diverged.any()
    for k in range(COUNT):
        own = {name: v[k] for name, v in inputs.items()}
        first = {name: number(v, k) for name, v in start.items()}
        states, readings = integrate(model_of(case), batch.time, own, first)
        mine = np.stack([v[k] for v in batch.states.values()], axis=-1)
        scale = np.abs(states).max(axis=0)
        assert np.all(np.abs(mine - states) <= 1e-10 * scale)
        assert np.all(np.abs(batch.readings[k] - readings) <= 1e-10 * np.abs(readings).max(axis=0))


def test_values_differ_between_simulations(jax):
    """Seeds or draws of parameters: one input, other masses and springs."""
    rng = np.random.default_rng(6)
    own = {k: v * rng.uniform(0.8, 1.2, COUNT) for k, v in OSCILLATOR.items()}
    batch = batch_of("oscillator", inputs={"force": noise()[0]}, values=own)
    for k in range(COUNT):
        model = seed_model(registry().make("system", "oscillator"),
                           values={name: float(v[k]) for name, v in own.items()})  # fmt: skip
        _, readings = integrate(model, TIME, {"force": noise()[0]})
        np.testing.assert_allclose(
            batch.readings[k], readings, rtol=0, atol=1e-10 * np.abs(readings).max()
        )


def test_a_free_vibration_is_the_matrix_exponential(jax):
    """x(t) = exp(A t) x0: the error of the step, (h w)^5 / 120 of each, and no more."""
    zero, stiffness = np.zeros(SAMPLES), np.array([1e3, 4e3, 9e3])
    batch = batch_of(
        "oscillator", inputs={"force": zero}, start={"x": 1.0, "x_rate": np.array([0.0, 3.0, 9.0])},
        values=OSCILLATOR | {"linear_stiffness.stiffness": stiffness},
    )  # fmt: skip
    for k, w2 in enumerate(stiffness):
        step = expm(np.array([[0.0, 1.0], [-w2, -4.0]]) / RATE)
        exact = [np.array([1.0, (0.0, 3.0, 9.0)[k]])]
        for _ in range(SAMPLES - 1):
            exact.append(step @ exact[-1])
        h = np.sqrt(w2) / RATE / SUBSTEPS
        bound = 2 * SAMPLES * SUBSTEPS * h**5 / 120
        assert np.abs(batch.channels["x"][k] - np.array(exact)[:, 0]).max() < bound


@pytest.mark.parametrize("case", ["oscillator", "memory", "planar rotor", "held", "linear"])
def test_slopes_are_those_of_the_sensitivities(jax, case):
    """d y / d(x0, p) of the compiled integrator, all columns, to 1e-9 of each column's largest."""
    model, (_, _, _, inputs, start) = model_of(case), CASES[case]
    traced = trace(model.system, model.effects)
    keys = (*(s.name for s in model.system.states), *traced.keys)
    batch = batch_of(case, slopes=keys)
    assert batch.jacobian.shape == (COUNT, SAMPLES, len(traced.channels), len(keys))
    wanted = native_slopes(model, {n: v[2] for n, v in inputs.items()},
                           {n: number(v, 2) for n, v in start.items()})  # fmt: skip
    n = len(traced.states)
    columns = [traced.states.index(k) if k in traced.states else n + traced.keys.index(k)
               for k in keys]  # fmt: skip
    for j, column in enumerate(columns):
        scale = np.abs(wanted[..., column]).max()
        np.testing.assert_allclose(
            batch.jacobian[2][..., j], wanted[..., column], rtol=0, atol=1e-9 * scale + 1e-300
        )
    np.testing.assert_array_equal(batch.slopes[keys[0]], batch.jacobian[..., 0])


def native_slopes(model, inputs, start):
    """(samples, channels, states + parameters) by the compiled integrator."""
    compiled = compile_model(trace(model.system, model.effects))
    traced, row = compiled.traced, model.row("model", "{}")
    channels, n, m = len(traced.channels), len(traced.states), len(traced.keys)
    quiet = np.random.default_rng(0).normal(size=(channels, SAMPLES))
    readings = dict(zip(traced.channels, quiet, strict=True))
    record = make_record(model.system, "one", TIME, readings, inputs)
    x, s = np.zeros((1, n)), np.zeros((1, n, n + m))
    for name, value in start.items():
        x[0, traced.states.index(name)] = value
    s[:, :, :n] = np.eye(n)
    rows = np.empty((1, SAMPLES * channels, n + m + 1))
    steps = (SAMPLES - 1) * 2 * SUBSTEPS + 1
    assert advance_windows(
        compiled.rate, compiled.output, x, s, np.zeros(1, dtype=np.int64), SAMPLES, row,
        np.arange(m), np.array([-1, m]), np.zeros(steps, dtype=np.int64), np.zeros((steps, 0)),
        stage_inputs(model.system, record, SUBSTEPS), SUBSTEPS, record.dt,
        np.zeros((SAMPLES, channels)), np.ones((SAMPLES, channels)), rows,
    )  # fmt: skip
    return rows[0, :, :-1].reshape(SAMPLES, channels, n + m)


def test_the_order_of_simulations_does_not_matter(jax):
    """Nor does which others are there."""
    order = np.array([2, 0, 3, 1])
    forces = noise(7)
    batch = batch_of("memory", inputs={"force": forces})
    turned = batch_of("memory", inputs={"force": forces[order]})
    np.testing.assert_allclose(turned.readings, batch.readings[order], rtol=1e-12, atol=1e-18)
    alone = batch_of("memory", inputs={"force": forces[2]})
    assert alone.simulations == 1
    np.testing.assert_allclose(alone.readings[0], batch.readings[2], rtol=1e-12, atol=1e-18)


def test_a_simulation_that_runs_away_is_a_result(jax):
    """A negative damper: that one is NaN from there on, its neighbours are what they were."""
    damping = np.array([4.0, -3e3])
    batch = batch_of(
        "oscillator", inputs={"force": noise()[0]},
        values=OSCILLATOR | {"linear_damping.damping": damping},
    )  # fmt: skip
    assert batch.diverged.tolist() == [False, True]
    assert "1 of which ran away" in repr(batch)
    assert np.isnan(batch.channels["x"][1, -1])
    assert np.isfinite(batch.channels["x"][1, 0])
    quiet = batch_of("oscillator", inputs={"force": noise()[0]})
    np.testing.assert_allclose(batch.channels["x"][0], quiet.channels["x"][0], rtol=1e-12)


def test_double_precision_is_left_on_for_nobody_else(jax):
    batch = batch_of("oscillator")
    assert batch.channels["x"].dtype == np.float64
    assert jax.numpy.ones(1).dtype == np.float32
    assert batch.device.startswith(jax.devices()[0].platform)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"inputs": {"forc": noise()}}, ["input 'forc'", "force"]),
        ({"inputs": {}}, ["inputs none", "force", "'oscillator'"]),
        ({"inputs": {"force": noise().T}}, ["(200, 4)", "(simulations, 200)", "transpose"]),
        ({"inputs": {"force": np.where(noise() > 2.5, np.nan, noise())}},
         ["input 'force' with", "finite"]),
        ({"values": {"system.mas": 1.0}}, ["value of 'system.mas'", "did you mean"]),
        ({"values": OSCILLATOR | {"system.mass": np.ones(3)}},
         ["input 'force' of 4 simulations", "'system.mass' of 3"]),
        ({"values": {"system.mass": np.ones((4, 1))}}, ["shape (4, 1)", "(simulations,)"]),
        ({"values": {"system.mass": 1.0}}, ["no value for", "values="]),
        ({"start": {"y": 1.0}}, ["initial state 'y'", "x, x_rate"]),
        ({"slopes": ["mass"]}, ["slopes by 'mass'", "system.mass"]),
        ({"device": "gpu:7"}, ["device 'gpu:7'", "cpu:0", "jax[cuda12]"]),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said(jax, changed, said):
    with pytest.raises(ConfigError) as caught:
        batch_of("oscillator", **changed)
    for words in said:
        assert words in str(caught.value)


def test_a_function_that_is_called_has_no_batch(jax):
    def stop(t, x, u, p):
        return [x.v, u.F - (p.k * x.x if x.x > 0 else 0.0)]

    with pytest.warns(UserWarning, match="compiled code"):
        system = spiral.system(stop, {"x": "m", "v": "m/s"}, {"F": "N"}, {"k": (2.0, "N/(kg*m)")},
                               ["x"])  # fmt: skip
    with pytest.raises(PluginError, match=r"in a batch: a program that is called"):
        spiral.simulate_batch(system, SAMPLES / RATE, RATE, inputs={"F": noise()})


def test_without_jax_the_extra_is_named(monkeypatch):
    def absent(name, *rest):
        if name.partition(".")[0] == "jax":
            raise ImportError(name)
        return imported(name, *rest)

    imported = importlib.import_module
    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(ConfigError, match=r"spiral-po\[gpu\](.|\n)*spiral\.simulate"):
        batch_of("oscillator")


def test_bootstrap_standard_errors_cover(jax):
    """Gauss-Newton on all records at once: estimates spread as the information matrix says.

    d y / d p from the batch, one step from the truth (the model is as good as linear within its
    errors): the spread of 400 estimates is the standard error to 4 standard deviations of a spread.
    """
    keys, level, count = list(OSCILLATOR)[1:], 2e-5, 400
    batch = batch_of("oscillator", inputs={"force": noise()[0]}, slopes=keys)
    rng = np.random.default_rng(8)
    misses = rng.normal(0.0, level, (count, SAMPLES))
    columns = batch.jacobian[0, :, 0, :]
    steps = np.linalg.lstsq(columns, misses.T, rcond=None)[0].T
    start = np.array([OSCILLATOR[k] for k in keys])
    values = OSCILLATOR | {k: start[j] + steps[:, j] for j, k in enumerate(keys)}
    again = batch_of("oscillator", inputs={"force": noise()[0]}, values=values)
    left = batch.channels["x"] + misses - again.channels["x"]
    chi2 = (left**2).sum() / level**2
    free = count * (SAMPLES - len(keys))
    assert abs(chi2 - free) < 4 * np.sqrt(2 * free)
    errors = level * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    assert np.all(np.abs(steps.std(axis=0) / errors - 1) < 4 / np.sqrt(2 * count))
