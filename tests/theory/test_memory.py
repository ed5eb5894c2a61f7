"""Effects with states of their own: systems written out, found from records, not invented."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp
from spiral_plugins.effects import memory
from spiral_plugins.effects.dissipative import LinearDamping
from spiral_plugins.effects.restoring import LinearStiffness
from spiral_plugins.sources.simulation import Simulation
from spiral_plugins.strategies.likelihood import Likelihood
from spiral_plugins.strategies.shooting import Shooting
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator

from experiments.hidden_effects.cases import record_of
from experiments.hidden_effects.strengths import SCENES
from spiral.engine.growth import first_starts, layouts_for
from spiral.engine.start import first_values, prepare_balance
from spiral.inference.discover import add, discover
from spiral.inference.evidence.assembly import assemble, initial_values
from spiral.inference.evidence.comparison import last_stage, prepare_study
from spiral.inference.evidence.enlarge import make_variant, reassemble, transfer_fit_state
from spiral.inference.evidence.fit_state import half_masks, initial_fit_state
from spiral.inference.evidence.spectrum import local_maxima
from spiral.inference.problem import Problem, Settings
from spiral.inference.simulate import integrate
from spiral.inference.strategies.shooting.resonances import scan_effects, widen_study
from spiral.inference.suggest import propose_on_windows
from spiral.physics.trace import trace
from spiral.types.effect import FlowEffect, StateFlow
from spiral.types.model import Model, seed_model
from spiral.types.parameter import Input, Parameter, State
from spiral.types.port import At, Port
from spiral.types.system import MechanicalSystem, System
from spiral.types.units import check_units
from tests.scenes import admitted, effect, planar_problem, planar_record

BASE = {"system.mass": 1.0, "linear_stiffness.stiffness": 4e4, "linear_damping.damping": 20.0}
MODE = {"mass": 0.1, "natural_frequency": 22.0, "damping_ratio": 0.03}
LAG = {"stiffness": 8e3, "time_constant": 0.008}
HIDDEN = {"hidden_mode": MODE, "lag": LAG}


def _values(name, values=None):
    return {f"{name}.{k}": v for k, v in (values or HIDDEN[name]).items()}


def _problem(name="", seed=0, duration=6.0, values=None, **settings):
    """An oscillator under noise of 5 to 60 Hz, with 2 % noise; nothing hidden without a name."""
    source = Simulation(
        system=Oscillator(),
        effects=(effect(name),) if name else (),
        values={**BASE, **(_values(name, values) if name else {})},
        inputs={"force": {"noise": 1.0, "band": [5, 60]}},
        duration=duration,
        rate=1000.0,
        noise_level=0.02,
        seed=seed,
    )
    record, test = (s.load(Oscillator())[0] for s in (source, source.as_test()))
    return planar_problem(record, test, seed_model(Oscillator()), **settings)


class TwoMasses(MechanicalSystem):
    """M q'' = force - K q - C q': a second mass on a spring and a damper of the first."""

    coordinates = (State("x", "m"), State("z", "m"))
    observed = ("x",)
    inputs = (Input("force", "N", "band_limited"),)
    injections = (State("x", "N"), State("z", "N"))
    parameters = (Parameter("mass", "kg", lower=0.0), Parameter("second", "kg", lower=0.0))
    ports = (
        Port("base", ("x",), lambda q, p: [q.x], "m", "N"),
        Port("coupling", ("x",), lambda q, p: [q.z - q.x], "m", "N"),
    )
    seed = (
        LinearStiffness(), LinearDamping(),
        LinearStiffness(port="coupling"), LinearDamping(port="coupling"),
    )  # fmt: skip

    def mass(self, q, p):
        """The masses, in kg."""
        return [[p.mass, 0], [0, p.second]]

    def force(self, q, v, u, p):
        """The force on the first mass, in N."""
        return [u.force, 0]


def test_a_hidden_mode_is_a_second_mass_on_a_spring_and_a_damper():
    """The same motion as the system of two masses written out, to rounding."""
    turn = 2 * np.pi * MODE["natural_frequency"]
    m = MODE["mass"]
    two = seed_model(
        TwoMasses(),
        values={
            **BASE,
            "system.second": m,
            "linear_stiffness@coupling.stiffness": m * turn**2,
            "linear_damping@coupling.damping": 2 * MODE["damping_ratio"] * turn * m,
        },
    )
    one = seed_model(
        Oscillator(), (effect("hidden_mode"),), values={**BASE, **_values("hidden_mode")}
    )
    time = 1e-3 * np.arange(2000)
    force = {"force": np.random.default_rng(0).normal(size=2000)}
    (written, _), (found, _) = (integrate(m, time, force, substeps=4) for m in (two, one))
    np.testing.assert_allclose(found[:, 0], written[:, 0], atol=1e-12 * np.abs(written).max())
    second = found[:, 0] - found[:, 2]
    np.testing.assert_allclose(second, written[:, 1], atol=1e-12 * np.abs(written).max())


class Decay(System):
    """A level that stays as it is: x' = u."""

    states = (State("level", "K"),)
    observed = ("level",)
    inputs = (Input("flow", "K/s"),)
    parameters = ()
    injections = (State("level", "K/s"),)

    def rate(self, x, u, p, injected):
        """The flow into it."""
        return {"level": u.flow + injected["level"]}


WITH_MEMORY = [c for c in vars(memory).values() if getattr(c, "states", ()) and c.parameters]


@pytest.mark.parametrize("kind", WITH_MEMORY, ids=lambda c: c.plugin_name())
def test_what_has_memory_exerts_nothing_on_a_machine_that_rests_anywhere(kind):
    """The zero of a sensor is arbitrary: own states begin in balance where the machine is."""
    flow = issubclass(kind, StateFlow)
    system = Decay() if flow else Oscillator()
    model = seed_model(system, (kind(port="level" if flow else ""),))
    model = replace(model, values={key: 0.5 * (key[:6] != "linear") for key, _ in model.pairs})
    name = system.states[0].name
    at, inputs = {name: 290.0}, {i.name: np.zeros(500) for i in system.inputs}
    states, _ = integrate(model, 1e-2 * np.arange(500), inputs, at, substeps=4)
    np.testing.assert_allclose(states[:, 0], 290.0, rtol=1e-12)


def test_a_lag_under_a_steady_shake_has_the_textbook_stiffness():
    """k i w T / (1 + i w T) of a Maxwell element, in the amplitude of a forced oscillation."""
    model = seed_model(Oscillator(), (effect("lag"),), values={**BASE, **_values("lag")})
    time, turn = 1e-3 * np.arange(8001), 2 * np.pi * 15.0
    _, y = integrate(model, time, {"force": np.sin(turn * time)}, substeps=4)
    late = 1j * turn * LAG["time_constant"]
    stiff = 4e4 - turn**2 + 20j * turn + LAG["stiffness"] * late / (1 + late)
    expected = np.imag(np.exp(1j * turn * time) / stiff)
    np.testing.assert_allclose(y[-2000:, 0], expected[-2000:], atol=2e-4 * np.abs(expected).max())


LENGTH, ASYMMETRY = 2e-3, 0.5


def slipped(path, duration, asymmetry=ASYMMETRY, exponent=1.0):
    """z along a path x(s), s from 0 to 1, run through in so many seconds."""
    traced = trace(Oscillator(), (effect("bouc_wen"),))
    names = {"bouc_wen.length": LENGTH, "bouc_wen.asymmetry": asymmetry,
             "bouc_wen.exponent": exponent}  # fmt: skip
    place = traced.states.index("bouc_wen.slip")
    known = {p: names[k] for k, p in zip(traced.keys, traced.p, strict=True) if k in names}
    rate = sp.lambdify([*traced.x], traced.rate[place].subs(known))

    def slope(t, z):
        s, h = t / duration, 1e-6
        v = (path(s + h) - path(s - h)) / (2 * h * duration)
        return [rate(path(s), v, z[0])]

    times = np.linspace(0, duration, 400)
    return solve_ivp(slope, (0, duration), [0.0], t_eval=times, rtol=1e-9, atol=1e-12).y[0]


@pytest.mark.parametrize("asymmetry", [0.0, ASYMMETRY])
def test_hysteresis_on_a_way_without_return_saturates_as_written(asymmetry):
    """z = L / (1 + r) (1 - exp(-(1 + r) x / L)); Dahl's friction with r = 0."""
    z = slipped(lambda s: 4 * LENGTH * s, 1.0, asymmetry)
    x = np.linspace(0, 4 * LENGTH, 400)
    wanted = LENGTH / (1 + asymmetry) * (1 - np.exp(-(1 + asymmetry) * x / LENGTH))
    np.testing.assert_allclose(z, wanted, atol=1e-6 * LENGTH)


def test_hysteresis_of_exponent_two_bends_over_as_a_hyperbolic_tangent():
    """z' = v (1 - (z / L)^2), but for the rounding near zero: z = L tanh(x / L)."""
    z = slipped(lambda s: 4 * LENGTH * s, 1.0, 0.0, 2.0)
    np.testing.assert_allclose(z, LENGTH * np.tanh(np.linspace(0, 4, 400)), atol=2e-4 * LENGTH)


@pytest.mark.parametrize("v", [-0.3, -0.02, 0.004, 0.1])
def test_bristles_that_slide_are_dry_friction_that_falls_with_speed(v):
    """At rest z' is zero where |z| = g(v), and F is that of Coulomb's and Stribeck's friction."""
    k, length, rise, speed = 5e4, 2e-3, 0.4, 0.05
    z = np.sign(v) * length * (1 + rise * np.exp(-((v / speed) ** 2)))
    shapes = {"length": length, "rise": rise, "speed": speed}
    p = SimpleNamespace(stiffness=(k,), damping=(30.0,), **shapes)
    at = At((0.0,), (v,), SimpleNamespace(bristle=(z,)))
    bristles = effect("lugre")
    np.testing.assert_allclose(bristles.rate(at, None, p)["bristle"], 0.0, atol=1e-15)
    sharp = SimpleNamespace(level=(k * length,), width=1e-9)
    fallen = SimpleNamespace(level=(k * length * rise,), width=1e-9, speed=speed)
    dry = effect("coulomb_friction").force(at, None, sharp)[0]
    dry += effect("stribeck_friction").force(at, None, fallen)[0]
    np.testing.assert_allclose(bristles.force(at, None, p), dry)


def test_sliders_in_parallel_slide_one_after_the_other_and_are_stiff_on_return():
    """On a way without return the mean of min(x, limit), its corners rounded; then slope k."""
    sliders, p = effect("iwan"), SimpleNamespace(stiffness=2.0, length=LENGTH)
    z, dx, forces = [0.0] * 5, LENGTH / 400, []
    way = [1.0] * 1000 + [-1.0] * 40
    for v in way:
        own = SimpleNamespace(**{f"slip{i}": x for i, x in enumerate(z)})
        at = At((0.0,), (v,), own)
        z = [x + dx * r for x, r in zip(z, sliders.rate(at, None, p).values(), strict=True)]
        forces.append(-sliders.force(at, None, p)[0])
    x = dx * np.arange(1000)
    limits = LENGTH * np.array([1, 3, 5, 7, 9]) / 5
    wanted = 2.0 * np.minimum(x[:, None], limits).mean(axis=1)
    np.testing.assert_allclose(forces[:1000], wanted, atol=0.05 * 2.0 * LENGTH)
    np.testing.assert_allclose(np.diff(forces[1001:]), -2.0 * dx)


def test_hysteresis_does_not_know_how_fast_it_is_run_through():
    def there_and_back(s):
        return 3 * LENGTH * np.sin(2 * np.pi * s)

    slow, fast = (slipped(there_and_back, seconds) for seconds in (10.0, 0.1))
    np.testing.assert_allclose(slow, fast, atol=1e-5 * LENGTH)
    assert np.ptp(slow[:200]) > 0.5 * LENGTH


@pytest.mark.slow
@pytest.mark.parametrize(
    ("asymmetry", "exponent"),
    [
        (0.0, 1.0),
        *(pytest.param(a, n, marks=pytest.mark.slow) for a, n in ((-1.3, 1.0), (0.5, 2.5))),
    ],
)
def test_hysteresis_is_named_first_and_alone(asymmetry, exponent):
    """Dahl's friction, a loop that stiffens, and one that bends sharply, by the default."""
    values = {"stiffness": 2e4, "length": 4e-4, "asymmetry": asymmetry, "exponent": exponent}
    run = discover(replace(_problem("bouc_wen", values=values), strategy=Likelihood()))
    assert admitted(run) == ["bouc_wen"]
    estimate = run.model.estimates()["bouc_wen"]["stiffness"]
    assert abs(estimate.estimate - 2e4) < 3 * estimate.se
    assert run.final.test_error < 1.1 * run.final.noise_floor


def test_hysteresis_added_by_hand_is_that_of_the_loop_and_runs_free_on_its_record():
    """Its shapes are free too; steps of integration are as fine as its fast relaxation asks."""
    values = {"stiffness": 2e4, "length": 3e-5, "asymmetry": 0.5}
    problem = replace(_problem("bouc_wen", values=values, duration=4.0), strategy=Likelihood())
    _, after, _ = add(problem, (effect("bouc_wen"),))
    estimates = after.model.estimates()["bouc_wen"]
    for name, value in values.items():
        assert abs(estimates[name].estimate - value) < 4 * estimates[name].se
    assert after.fit_error < 1.1 * after.noise_floor
    assert after.test_error < 1.1 * after.noise_floor


def test_states_of_an_effect_are_driven_by_the_motion_of_its_port():
    """While the amplitude is zero nothing else tells them; the truth is a long simulation's."""
    problem = _problem(duration=4.0)
    base = assemble(problem)
    study = reassemble(base, (), (make_variant(effect("hidden_mode"), "1", MODE),))
    layouts = layouts_for(study.study, 512, (None,))
    values = initial_fit_state(base, problem.model.labels)
    starts = first_starts(study.study, layouts, transfer_fit_state(values, base, study).values)[0]
    model = seed_model(
        Oscillator(), (effect("hidden_mode"),), values={**BASE, **_values("hidden_mode", MODE),
                                                        "hidden_mode.mass": 0.0}
    )  # fmt: skip
    record = problem.records[0]
    first = {k: float(v[0]) for k, v in record.truth.items()}
    states, _ = integrate(model, record.time, dict(record.inputs), first, substeps=4)
    truth = states[layouts[0].starts]
    for at in (2, 3):
        assert np.std(starts[2:, at] - truth[2:, at]) < 0.05 * np.std(truth[2:, at])


def test_first_values_do_not_depend_on_states_that_effects_bring():
    """A study that goes on with a resonance may begin anew from the seed (a curve's does)."""
    problem = _problem(duration=4.0)
    base = assemble(problem)
    study = reassemble(base, (), (make_variant(effect("hidden_mode"), "1", MODE),))
    seed = trace(Oscillator(), problem.model.effects)
    unknown = tuple(k for k, p in problem.model.pairs if p.start is None)
    found = []
    for each in (base, study):
        equations = prepare_balance(each.study, seed, unknown)
        values = first_values(each.study, equations, initial_values(each), 11)
        found.append([values[0, each.study.index(k)] for k in unknown])
    assert len(unknown) == 3
    assert found[0] == found[1]
    assert initial_fit_state(study, problem.model.labels).labels == problem.model.labels


def test_peaks_are_the_local_maxima_the_largest_first():
    assert local_maxima(np.array([3.0, 1.0, 2.0, 5.0, 5.0, 0.0, 1.0])) == [3, 0, 6]
    assert local_maxima(np.zeros(1)) == [0]


@pytest.mark.parametrize("name", HIDDEN)
def test_the_residual_has_its_peak_where_the_hidden_frequency_is(name):
    assembly, fit_state = prepare_study(_problem(name))
    stage = last_stage(assembly, fit_state, half_masks(assembly)[0])
    fit_state = replace(fit_state, values=stage.fitted.point.values)
    scan = scan_effects(assembly, fit_state, stage, (effect(name),))[0]
    true = MODE["natural_frequency"] if name == "hidden_mode" else 1 / (2 * np.pi * 0.008)
    found = scan.frequency[np.argmax(scan.share)]
    assert abs(np.log(found / true)) < (0.1 if name == "hidden_mode" else 0.7)
    assert scan.share.max() > (0.5 if name == "hidden_mode" else 0.3)
    assert all(v.searched * len(scan.variants) >= 0.8 * len(scan.frequency) for v in scan.variants)


@pytest.mark.slow
@pytest.mark.parametrize("name", HIDDEN)
def test_it_is_found_first_and_adding_it_is_enough(name):
    run = discover(_problem(name, max_rounds=2))
    assert run.rounds[1].admitted == (name,)
    assert admitted(run) == [name]
    last = run.rounds[-1].comparison
    assert last.test_error < 1.2 * last.noise_floor
    _covered(run.model, name, HIDDEN[name])


def _covered(model: Model, name, truth):
    for key, value in _values(name, truth).items():
        assert abs(model.values[key] - value) < 4 * model.errors[key], key


ROTOR = {
    "hidden_mode": {
        "mass_x": 0.05, "mass_y": 0.05, "natural_frequency": 24.0, "damping_ratio": 0.03
    },
    "lag": {"stiffness_x": 3000.0, "stiffness_y": 3000.0, "time_constant": 0.01},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", ROTOR)
def test_it_is_found_first_on_a_rotor(name):
    values = _values(name, ROTOR[name])
    record, test = (
        planar_record(s, (effect(name),), values, phase=p) for s, p in ((1, 0.4), (101, 1.3))
    )
    run = discover(planar_problem(record, test, max_rounds=2))
    assert admitted(run) == [name]
    last = run.rounds[-1].comparison
    assert last.test_error < 1.2 * last.noise_floor
    _covered(run.model, name, ROTOR[name])


@pytest.mark.slow
def test_nothing_is_invented():
    """Null records, the residual resolved and scored though no round would call for it."""
    for seed in range(3):
        problem = _problem(seed=seed, duration=6.0)
        assert not _looked(problem)


def _looked(problem):
    """What a round that looks for resonances admits, whatever its residual."""
    assembly, fit_state = prepare_study(problem)
    masks = half_masks(assembly)
    stage = last_stage(assembly, fit_state, masks[0])
    fit_state = replace(fit_state, values=stage.fitted.point.values)
    wide, _ = widen_study(assembly, fit_state, stage, assembly.later)
    found = propose_on_windows(
        Shooting(), wide, transfer_fit_state(fit_state, assembly, wide), masks, 1
    )
    return () if found.admitted is None else found.admitted.variant.label


class InflowLag(FlowEffect):
    """A pump whose flow follows its voltage late: x1' = ... - k (u - z), T z' = u - z."""

    channels = ("upper",)
    inputs = ("pump",)
    states = (State("lagged", "V"),)
    parameters = (
        Parameter("gain", "1/s", lower=0.0),
        Parameter("time_constant", "s", lower=0.0, role="shape", start=10.0, spectrum=True),
    )

    def flow(self, x, u, p):
        return {"upper": -p.gain * (u.pump - x.own.lagged)}

    def rate(self, at, u, p):
        return {"lagged": (u.pump - at.own.lagged) / p.time_constant}


def test_a_flow_has_states_of_its_own_too():
    check_units(CascadedTanks(), InflowLag())
    traced = trace(CascadedTanks(), (InflowLag(),))
    at = {**dict(zip(traced.keys, traced.p, strict=True)), "pump": traced.u[0], "z": traced.x[2]}
    late = at["pump"] - at["z"]
    assert traced.states[2] == "inflow_lag.lagged"
    assert traced.rate[0] == -at["inflow_lag.gain"] * late
    assert traced.rate[2] == late / at["inflow_lag.time_constant"]


@pytest.mark.slow
def test_a_late_pump_is_found():
    """A pump that is late by 40 s, all of it: k is the pump's own gain.

    By the default strategy; windows do not converge beside a delay that has states of its own too.
    """
    scene, system = SCENES["cascaded_tanks"], CascadedTanks()
    true = {**scene.truth, "inflow_lag.gain": 0.04, "inflow_lag.time_constant": 40.0}
    hidden = Model(system, (*system.seed, InflowLag()), true)
    record, test = (record_of(scene, hidden, s, 0.0, 0.02, s) for s in (1, 2))
    others = (effect("linear_loss"), effect("overflow"), effect("delay"))
    found = Problem(
        seed_model(system), (record,), (test,), candidates=(*others, InflowLag()),
        settings=Settings(max_rounds=1), strategy=Likelihood(),
    )  # fmt: skip
    run = discover(found)
    assert admitted(run) == ["inflow_lag"]
    last = run.rounds[-1].comparison
    assert last.test_error < 1.2 * last.noise_floor
    _covered(run.model, "inflow_lag", {"gain": 0.04, "time_constant": 40.0})


def test_add_lays_the_shapes_by_itself():
    before, after, run = add(_problem("hidden_mode"), (effect("hidden_mode"),))
    assert after.test_error < 1.2 * after.noise_floor < before.test_error
    _covered(run.model, "hidden_mode", MODE)
