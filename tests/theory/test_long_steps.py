"""Long steps: the linear part exactly, what is stiff implicitly, slopes those of the map."""

import numba as nb
import numpy as np
import pytest
from scipy.linalg import expm

import spiral.engine.filter.long_steps as long_steps_module
from spiral.engine.filter.kernel import slope_workspace
from spiral.engine.filter.long_steps import long_steps
from spiral.engine.filter.long_steps_kernel import advance_long, long_step_room
from spiral.engine.likelihood import predict
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.series import prepare_series
from spiral.physics.flow import compile_flow
from spiral.physics.linear_part import linear_part
from spiral.physics.trace import trace
from spiral.types.record import make_record
from tests.scenes import registry
from tests.theory.test_alike_transitions import task_with

CHAIN = """
equations:
  - M*a'' = F - k*a - c*a' - k*(a - b) - G*(a - b)^3
  - N*b'' = -k*(b - a) - c*b' - L*tanh(b'/W)
states: {a: m, b: m}
inputs: {F: {unit: N, interpolation: linear}}
parameters: {M: 1 kg, N: 0.01 kg, k: 400 N/m, c: 0.5 N*s/m, G: 3e4 N/m^3, L: 0 N, W: 1e-3 m/s}
free: [k, c, G, L, W]
observed: [a]
"""
DT, SAMPLES = 0.02, 80
VALUES = {"k": 400.0, "c": 0.5, "G": 3e4, "L": 0.0, "W": 1e-3}


@nb.njit(cache=False)
def run_long(rest, sources, long, x, inputs, substeps, values, both, f, room, xs, fs):
    """All samples by long steps; how many were not solved."""
    failed = 0
    for k in range(len(xs)):
        if not advance_long(rest, sources, long, x, inputs, k, substeps, values, both, f, room):
            failed += 1
        xs[k], fs[k] = x, f
    return failed


@nb.njit(cache=False)
def run_flow(flow, x, inputs, substeps, step, values, f, work, xs, fs):
    """The same by Runge-Kutta steps."""
    for k in range(len(xs)):
        f[:] = 0.0
        for i in range(f.shape[0]):
            f[i, i] = 1.0
        flow(x, inputs, 3 * k * substeps, 3, substeps, step, values, f, work, 0)
        xs[k], fs[k] = x, f


class Scene:
    """A model with an input, and its motion by both methods."""

    def __init__(self, driven=True, **values):
        self.system = registry().make("system", "equations", {"text": CHAIN})
        self.traced = trace(self.system, ())
        self.n, self.start = len(self.traced.x), np.array([1e-3, 0.0, 0.0, 0.0])
        given = {f"system.{k}": v for k, v in (VALUES | values).items()}
        known = {f"system.{p.name}": p.start for p in self.system.parameters}
        self.values = np.array([given.get(k, known.get(k)) for k in self.traced.keys], dtype=float)
        self.by = tuple(f"system.{k}" for k in VALUES)
        self.both = np.array([self.traced.keys.index(k) for k in self.by], dtype=np.int64)
        time = DT * np.arange(SAMPLES + 1)
        force = np.sin(7 * time) + 0.5 * np.cos(23 * time)
        force = force if driven else np.zeros(len(time))
        self.record = make_record(self.system, "r", time, {"a": time}, {"F": force})

    def inputs(self, substeps):
        return prepare_series(self.system, self.record, substeps).inputs

    def by_long_steps(self, count, substeps=8, values=None, start=None):
        part = linear_part(self.traced, self.by)
        values = self.values if values is None else values
        inputs = self.inputs(substeps)
        steps = long_steps(part, part.matrix(self.n, inputs[0], values), DT, count)
        f, _ = slope_workspace(self.n, self.n + len(self.by))
        rest, sources, long = steps.fields
        room = long_step_room(long, self.n, f.shape[1], inputs.shape[1], len(values), len(self.by))
        xs, fs = np.zeros((SAMPLES, self.n)), np.zeros((SAMPLES, *f.shape))
        begun = (self.start if start is None else start).copy()
        failed = run_long(rest, sources, long, begun, inputs, substeps, values, self.both, f,
                          room, xs, fs)  # fmt: skip
        assert failed == 0
        return xs, fs[:, :, : self.n + len(self.by)]

    def by_short_steps(self, substeps):
        flow, inputs = compile_flow(self.traced, self.by), self.inputs(substeps)
        f, work = slope_workspace(self.n, self.n + len(self.by))
        xs, fs = np.zeros((SAMPLES, self.n)), np.zeros((SAMPLES, *f.shape))
        run_flow(flow.advance, self.start.copy(), inputs, substeps, DT / substeps, self.values, f,
                 work, xs, fs)  # fmt: skip
        return xs, fs[:, :, : self.n + len(self.by)]


def test_linear_part_and_rest_are_the_rates():
    """A x + r = f at states, inputs and values drawn at random; r of three states."""
    scene, rng = Scene(), np.random.default_rng(0)
    part = linear_part(scene.traced, scene.by)
    names = [scene.traced.states[i] for i in part.moving]
    assert names == ["a", "b", "b_rate"]
    assert part.names == {"system.M", "system.N", "system.k", "system.c"}
    for _ in range(5):
        x, u = rng.normal(size=4), rng.normal(size=scene.inputs(1).shape[1])
        values = scene.values * np.exp(rng.normal(size=len(scene.values)))
        rest, rates, slopes = np.zeros(4), np.zeros(4), np.zeros((4, 4))
        part.rest(x, u, values, rest, slopes, np.zeros((4, len(values))))
        part.sources(x, u, values, rates, np.zeros((4, 4)), np.zeros((4, len(values))))
        linear = part.matrix(4, u, values)
        assert linear @ x + rest == pytest.approx(rates, rel=1e-12)
        assert not slopes[:, 2].any()


def test_of_many_states_there_is_no_rest():
    """Where seven states stand in what is not linear, nothing is solved."""
    names = "abcdefg"
    equations = [f"{n}' = -({' + '.join(names)})^3" for n in names]
    text = (
        f"equations: {equations}\nstates: {{{', '.join(f'{n}: 1' for n in names)}}}\n"
        f"observed: [a]\nparameters: {{}}\n"
    ).replace("'=", "' =")
    text = text.replace("^3", "^3/T").replace("parameters: {}", "parameters: {T: 1 s}\nfree: [T]")
    made = registry().make("system", "equations", {"text": text})
    assert linear_part(trace(made, ()), ()) is None


def test_a_linear_model_is_exact_in_one_step():
    """With G = L = 0 and no input: x_k = exp(k dt A) x_0, and slopes of the same."""
    scene = Scene(driven=False, G=0.0)
    part = linear_part(scene.traced, scene.by)
    flow = expm(part.matrix(4, scene.inputs(1)[0], scene.values) * DT)
    xs, fs = scene.by_long_steps(1)
    expected = [np.linalg.matrix_power(flow, k + 1) @ scene.start for k in range(SAMPLES)]
    assert xs == pytest.approx(np.array(expected), abs=1e-12 * 1e-3)
    assert fs[:, :, :4] == pytest.approx(np.broadcast_to(flow, (SAMPLES, 4, 4)), abs=1e-10)


def test_order_of_convergence_is_three():
    scene = Scene()
    exact, _ = scene.by_short_steps(1024)
    errors = [np.abs(scene.by_long_steps(c, 64)[0] - exact).max() for c in (2, 16)]
    assert np.log2(errors[0] / errors[1]) / 3 == pytest.approx(3, abs=0.3)


def test_slopes_are_those_of_the_map():
    """By states, and by parameters of the rest: central differences of the map of one sample."""
    scene = Scene(L=0.3, W=0.05)
    _, fs = scene.by_long_steps(4)
    for j in range(4):
        step = 1e-7 * np.eye(4)[j]
        ahead, behind = (
            scene.by_long_steps(4, start=scene.start + s * step)[0][0] for s in (1, -1)
        )
        assert fs[0][:, j] == pytest.approx((ahead - behind) / 2e-7, rel=1e-5, abs=1e-6)
    for name in ("G", "L", "W"):
        slope, differences = parameter_slope(scene, name, 4)
        assert slope == pytest.approx(differences, abs=1e-4 * np.abs(differences).max())


def parameter_slope(scene, name, count):
    """Slopes of the first sample by a parameter: those that are made, and central differences."""
    column = scene.by.index(f"system.{name}")
    at = scene.both[column]
    step = 1e-5 * scene.values[at] * np.eye(len(scene.values))[at]
    up, down = (scene.by_long_steps(count, values=scene.values + s * step)[0][0] for s in (1, -1))
    return scene.by_long_steps(count)[1][0][:, 4 + column], (up - down) / (2 * step[at])


@pytest.mark.parametrize("name", ["k", "c"])
def test_slopes_by_parameters_of_the_linear_part_converge(name):
    """A line through two points stands for what such a parameter makes of the motion."""
    scene, errors = Scene(L=0.3, W=0.05), []
    for count in (4, 16):
        slope, differences = parameter_slope(scene, name, count)
        errors.append(np.abs(slope - differences).max() / np.abs(differences).max())
    assert errors[0] < 0.05
    assert errors[1] < errors[0] / 16


def test_stiff_friction_takes_few_steps():
    """A light mass comes to rest in 1e-5 s: Runge-Kutta steps are as short, long ones are not."""
    scene = Scene(L=0.5, W=1e-3)
    exact, _ = scene.by_short_steps(4096)
    rms = np.sqrt(np.mean((scene.by_long_steps(8)[0][:, 0] - exact[:, 0]) ** 2))
    assert rms < 1e-3 * exact[:, 0].std()
    short = np.sqrt(np.mean((scene.by_short_steps(24)[0][:, 0] - exact[:, 0]) ** 2))
    assert short > 10 * rms


@pytest.mark.parametrize(
    ("law", "off"), [("cubic_stiffness", 1e-4), ("clearance", 5e-3), ("coulomb_friction", 0.2)]
)
def test_predictions_by_long_steps_are_those_of_many_short_ones(law, off, monkeypatch):
    """Of 18 states: misses, variances and slopes by a spring of the linear part.

    At the corners of a gap and of friction eight steps are as far off as sixteen short ones.
    """
    keys = ("system.k",)
    task, settings = task_with(law, substeps=16)
    noise = first_noise(task, 0.05)
    assert long_steps_module.long_steps_of(task, (), keys).count > 0
    long = predict.predict_readings(task, settings, noise, keys, keep=True)
    monkeypatch.setattr(long_steps_module, "_SHORTEST", 1000)
    task, settings = task_with(law, substeps=128)
    short = predict.predict_readings(task, settings, noise, keys, keep=True)
    for name in ("misses", "spreads", "slopes", "means"):
        expected = getattr(short, name)
        size = np.abs(expected).max()
        np.testing.assert_allclose(getattr(long, name), expected, rtol=0, atol=off * size)
    heights = (predict.log_likelihood((r,)) for r in (long, short))
    assert np.subtract(*heights) == pytest.approx(0, abs=0.5)


def test_inputs_that_move_the_linear_part_leave_short_steps():
    """A spring that the input changes: its matrix is another at every sample."""
    assert linear_part(Scene().traced, ()).names.isdisjoint({"F"})
    text = CHAIN.replace("F - k*a - c*a'", "-k*(1 + F/Q)*a - c*a'")
    text = text.replace("W: 1e-3 m/s}", "W: 1e-3 m/s, Q: 1 N}")
    made = registry().make("system", "equations", {"text": text})
    assert "F" in linear_part(trace(made, ()), ()).names
