"""Effects on readings: what they do to the output, and that a sweep tells them from dynamics."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy import stats
from scipy.signal import lsim
from spiral_plugins.strategies.likelihood import Likelihood
from spiral_plugins.systems.cascaded_tanks import CascadedTanks
from spiral_plugins.systems.oscillator import Oscillator
from spiral_plugins.systems.planar_rotor import PlanarRotor

import spiral
from spiral.engine.blocks import GramBlocks
from spiral.engine.score import ScoreTable
from spiral.inference.discover import discover
from spiral.inference.evidence.effective_tests import effective_tests
from spiral.inference.evidence.inseparable import inseparable_part
from spiral.inference.evidence.spectral_lines import strongest_line
from spiral.inference.simulate import integrate
from spiral.math import ramp
from spiral.physics.trace import trace
from spiral.types.effect import ForceEffect
from spiral.types.errors import ConfigError, PluginError
from spiral.types.model import seed_model
from spiral.types.parameter import Parameter, State
from spiral.types.placement import check_effect
from spiral.types.record import make_record
from tests.scenes import SEED_TRUTH, admitted, effect, planar_problem, planar_record, registry

SENSORS = {
    "offset": {"offset_x": 4e-6, "offset_y": -3e-6},
    "gain": {"error_x": 0.05, "error_y": 0.0},
    "axis_rotation": {"angle": 0.05},
    "delay": {"time_x": 2e-4, "time_y": 2e-4},
    "sensor_lag": {"time_x": 2e-4, "time_y": 2e-4},
    "runout": {"cosine": 3e-6, "sine": 2e-6},
    "mains_hum": {
        "cosine_x": 3e-6, "sine_x": 0.0, "cosine_y": 2e-6, "sine_y": 1e-6, "frequency": 49.97
    },
}  # fmt: skip


def _run(name, seed=1, values=None, rounds=1, duration=6.0, **changes):
    given = {f"{name}.{k}": v for k, v in (values or SENSORS[name]).items()}
    record, test = (
        planar_record(s, (effect(name),), given, phase=phase, duration=duration)
        for s, phase in ((seed, 0.4), (seed + 100, 1.3))
    )
    return discover(replace(planar_problem(record, test, max_rounds=rounds), **changes))


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_effect_leaves_the_motion_as_it_is(name):
    bare = trace(PlanarRotor(), ())
    with_it = trace(PlanarRotor(), (effect(name),))
    assert with_it.rate[: len(bare.rate)] == bare.rate
    assert with_it.output != bare.output


def steady(name, late, scale, turn):
    """What a sensor of an oscillator makes of x = exp(i turn t), once settled."""
    traced = trace(Oscillator(), (effect(name),))
    values = {f"{name}.time": late, f"{name}.scale": scale}
    known = {s: values[k] for k, s in zip(traced.keys, traced.p, strict=True) if k in values}
    rates = sp.Matrix(traced.rate).subs(known)
    place, count = traced.states.index("x"), len(Oscillator().states)
    own = list(traced.x[count:])
    within = np.array(rates[count:, 0].jacobian(own), dtype=float)
    driven = np.array(rates[count:, 0].diff(traced.x[place]), dtype=float)
    at = np.linalg.solve(1j * turn * np.eye(len(own)) - within, driven)
    reading = sp.lambdify([traced.x[place], *own], traced.output[0].subs(known))
    return complex(reading(1.0, *at.ravel()))


@pytest.mark.parametrize(
    ("name", "scale", "order"),
    [("delay", 0.1, 5), ("delay", 0.13, 3), ("sensor_lag", 0.13, 2), ("sensor_lag", 0.05, 2)],
)
def test_a_late_sensor_is_right_to_its_order(name, scale, order):
    """Against exp(-i w T) and 1 / (1 + i w T): the slope of the error on the frequency."""
    exact = {"delay": lambda w: np.exp(-0.1j * w), "sensor_lag": lambda w: 1 / (1 + 0.1j * w)}
    errors = [abs(steady(name, 0.1, scale, w) - exact[name](w)) for w in (0.5, 1.0)]
    assert np.log2(errors[1] / errors[0]) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("turn", [0.1, 3.0, 40.0, 1000.0])
def test_a_slow_sensor_of_its_own_time_is_exact_however_slow(turn):
    assert steady("sensor_lag", 0.1, 0.1, turn) == pytest.approx(1 / (1 + 0.1j * turn), abs=1e-12)


def test_a_slow_sensor_begins_at_what_is_there():
    """A level that has rested for long is read as it is from the first sample on."""
    system = CascadedTanks()
    late = effect("sensor_lag")
    traced = trace(system, (late, *seed_model(system).effects))
    assert dict(traced.like)["sensor_lag.level"] == "lower"


def test_a_force_has_no_state_that_begins_at_its_port():
    class Slow(ForceEffect):
        """A force that says so."""

        states = (State("slow", "position", per_axis=True, like="position"),)
        parameters = (Parameter("stiffness", "force/position"),)

        def force(self, at, u, p):
            return [-p.stiffness * s for s in at.own.slow]

        def rate(self, at, u, p):
            return {"slow": list(at.velocity)}

    with pytest.raises(PluginError, match="leave it out"):
        trace(Oscillator(), (Slow(),))


def test_a_hum_follows_the_time_of_the_record():
    values = {f"mains_hum.{k}": v for k, v in SENSORS["mains_hum"].items()}
    still = {**dict.fromkeys(SEED_TRUTH, 0.0), **values}
    model = seed_model(PlanarRotor(), (effect("mains_hum"),), values=still)
    time = 0.001 * np.arange(500)
    _, y = integrate(model, time, {"speed": np.full(500, 10.0), "phase": 10.0 * time})
    angle = 2 * np.pi * 49.97 * time
    np.testing.assert_allclose(y[:, 0], 3e-6 * np.cos(angle), atol=1e-18)
    np.testing.assert_allclose(y[:, 1], 2e-6 * np.cos(angle) + 1e-6 * np.sin(angle), atol=1e-18)


def test_a_sensor_effect_has_no_port():
    with pytest.raises(ConfigError, match="no port"):
        check_effect(PlanarRotor(), replace(effect("offset"), port="disk"))


def test_where_channels_have_several_units_each_unit_has_sensors_of_its_own():
    """A motor's current and two angles: readings of one change, and their slopes with them."""

    def rate(t, x, u, p):
        turn = p["k"] * (x["a"] - x["b"])
        current = (u["e"] - p["r"] * x["i"]) / p["l"]
        return [x["va"], (p["c"] * x["i"] - turn) / p["m"], x["vb"], turn / p["m"], current]

    system = spiral.system(
        rate, states={"a": "rad", "va": "rad/s", "b": "rad", "vb": "rad/s", "i": "A"},
        inputs={"e": "V"}, observed=["a", "i", "b"],
        parameters={"l": (0.5, "H"), "r": (1.0, "ohm"), "k": (2.0, "N*m"), "c": (0.1, "N*m/A"),
                    "m": (0.1, "kg*m^2")},
    )  # fmt: skip
    offered = [e.label for e in registry().candidates(system, everywhere=True)]
    assert {"offset", "offset@i", "gain@i"} <= {*offered}
    # two angles of one shaft are no two axes of one place
    assert not [label for label in offered if label.startswith("axis_rotation")]
    zero = replace(effect("offset"), port="i")
    traced = trace(system, (zero,))
    a, i, b = (traced.x[traced.states.index(n)] for n in ("a", "i", "b"))
    off = dict(zip(traced.keys, traced.p, strict=True))["offset@i.offset"]
    assert traced.output == (a, i + off, b)
    angles = trace(system, (effect("offset"),))
    assert [k for k in angles.keys if "offset" in k] == ["offset.offset_a", "offset.offset_b"]


def test_a_ramp_is_the_positive_part_outside_its_corner_and_smooth_inside():
    x = np.linspace(-3, 3, 6001)
    found = ramp(x, 0.5)
    outside = np.abs(x) >= 0.5
    np.testing.assert_array_equal(found[outside], np.maximum(x, 0)[outside])
    assert np.max(np.abs(found - np.maximum(x, 0))) == pytest.approx(0.5 / 4)
    slope = np.gradient(found, x)
    assert np.max(np.abs(np.diff(slope))) < 1.1 * 0.001 / (2 * 0.5)  # second derivative 1/(2 w)
    np.testing.assert_array_equal(ramp(x, 0.0), np.maximum(x, 0))


def test_the_strongest_line_is_found_to_a_part_of_the_line_width():
    record = planar_record(1, (effect("mains_hum"),), _values("mains_hum"), duration=6.0)
    found, count = strongest_line((record,), 50.0, 0.004)
    assert found == pytest.approx(49.97, abs=0.25 / 6.0)
    assert count == 4
    assert strongest_line((record,), 500.0, 0.004) is None  # half the sample rate


def _values(name):
    return {f"{name}.{k}": v for k, v in SENSORS[name].items()}


def _null_table(rng, columns, blocks=60, rows=40):
    """A table of columns in white noise, nothing active."""
    shared = rng.normal(size=(blocks, rows, columns.shape[0]))
    design = shared @ columns
    noise = rng.normal(size=(blocks, rows))
    wide = np.concatenate([design, noise[:, :, None]], axis=2)
    gram = np.einsum("bri,brj->bij", wide, wide)
    triangle = np.linalg.qr(wide.reshape(-1, wide.shape[2]), mode="r")
    size = np.linalg.norm(triangle[:, :-1], axis=0)
    rest = float(triangle[:, -1] @ triangle[:, -1])
    return ScoreTable(
        triangle[:, :-1], triangle[:, -1], size, rest, blocks * rows, blocks * rows,
        GramBlocks(gram), np.zeros((0, triangle.shape[1])),
    )  # fmt: skip


def test_values_of_a_shape_that_say_the_same_are_one_test_and_independent_ones_many():
    rng = np.random.default_rng(0)
    groups = [(0,), (1,), (2,), (3,)]
    same = _null_table(rng, np.ones((1, 4)) * np.array([1.0, 2.0, -1.0, 3.0]))
    assert effective_tests(same, groups, 0, rng) == pytest.approx(1.0, abs=0.1)
    apart = _null_table(rng, np.eye(4))
    assert effective_tests(apart, groups, 0, rng) == pytest.approx(4.0, abs=0.5)


def test_the_best_of_a_grid_has_its_nominal_error_rate():
    """p-values of the maximum over a grid of likeness 0.9, corrected, are uniform (Davies)."""
    rng = np.random.default_rng(1)
    mixing = np.linalg.cholesky(0.9 ** np.abs(np.subtract.outer(np.arange(6), np.arange(6)))).T
    groups = [(i,) for i in range(6)]
    found = []
    for _ in range(200):
        table = _null_table(rng, mixing, 50, 8)
        z = [float((table.triangle[:, i] @ table.target) / table.norms[i]) for i in range(6)]
        best = int(np.argmax(np.abs(z)))
        m = effective_tests(table, groups, best, rng)
        assert 1.0 < m < 6.0
        found.append(1 - (1 - stats.chi2.sf(z[best] ** 2, 1)) ** m)
    assert stats.kstest(found, "uniform").pvalue > 0.01


def test_a_direction_in_the_span_of_the_model_is_named_and_held():
    rng = np.random.default_rng(2)
    active = rng.normal(size=(50, 3))
    own = rng.normal(size=(50, 2))
    wide = np.column_stack([active, own[:, 0], active[:, 1] - own[:, 0], rng.normal(size=50)])
    found = inseparable_part(np.linalg.qr(wide, mode="r"), 3, (0, 1))
    assert found.with_ == (1,)
    assert found.held == (1,)
    assert not found.whole
    alone = inseparable_part(np.linalg.qr(np.column_stack([active, active @ [1, 2, 0], own[:, 0]]),
                                     mode="r"), 3, (0,))  # fmt: skip
    assert alone.whole
    assert alone.with_ == (0, 1)
    free = inseparable_part(np.linalg.qr(wide, mode="r"), 3, (0,))
    assert free.with_ == ()


@pytest.mark.slow
def test_run_out_is_neither_an_unbalance_nor_a_bow_where_the_speed_sweeps():
    run = _run("runout")
    assert admitted(run) == ["runout"]
    assert run.rounds[1].aliases["runout"] == ()
    assert run.final.test_error <= 1.2 * run.final.noise_floor
    found = run.model.estimates()["runout"]
    for key, truth in SENSORS["runout"].items():
        assert abs(found[key].estimate - truth) < 4.5 * found[key].se


def test_a_common_gain_error_is_said_to_be_not_separable_from_the_unbalance():
    """The seed takes it over whole: nothing can be found, and that is what is said."""
    run = _run("gain", values={"error_x": 0.05, "error_y": 0.05})
    assert run.verdict == "nothing_missing"
    assert run.rounds[-1].details["not_separable"]["gain"] == ["unbalance"]
    moment = run.model.estimates()["unbalance"]["moment"].estimate
    assert moment == pytest.approx(1.05 * SEED_TRUTH["unbalance.moment"], rel=0.01)


def test_a_gain_error_of_one_channel_is_found_up_to_the_common_factor():
    run = _run("gain")
    assert admitted(run) == ["gain"]
    assert run.rounds[0].details["held"] == ["gain.error_y"]
    found = run.model.estimates()["gain"]["error_x"]
    assert abs(found.estimate - 0.05) < 4.5 * found.se
    assert "gain.error_y" in run.model.fixed


def test_an_offset_and_a_constant_load_are_one_alias_group():
    """y + b against a force k b: the same reading in a linear machine; the machine goes first."""
    run = _run("offset")
    assert admitted(run) == ["constant_load"]
    assert run.rounds[1].aliases["constant_load"] == ("offset",)


def test_a_hum_of_another_phase_in_each_record_is_one_effect():
    values = _values("mains_hum")
    other = {**values, "mains_hum.cosine_x": -1e-6, "mains_hum.sine_x": 3e-6}
    records = tuple(
        planar_record(s, (effect("mains_hum"),), v, duration=4.0)
        for s, v in ((1, values), (2, other))
    )
    test = planar_record(3, (effect("mains_hum"),), other, phase=1.3, duration=4.0)
    problem = planar_problem(records[0], test, max_rounds=1)
    run = discover(replace(problem, records=records, candidates=(effect("mains_hum"),)))
    assert admitted(run) == ["mains_hum"]
    assert run.final.test_error <= 1.2 * run.final.noise_floor


def test_one_channel_has_no_axes_to_turn_and_no_shaft():
    from spiral.io.registry import load_registry

    candidates = {e.label for e in load_registry(local=False).candidates(Oscillator())}
    assert {"offset", "gain", "delay", "mains_hum"} <= candidates
    assert not {"axis_rotation", "runout"} & candidates


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("name", SENSORS)
def test_every_sensor_effect_is_found_first(name, seed):
    found = {**SENSORS, "sensor_lag": {"time_x": 8e-4, "time_y": 8e-4}}  # one that counts
    run = _run(name, seed, found[name], duration=14.0, strategy=Likelihood())
    label = admitted(run)[0]
    assert name == label or name in run.rounds[1].aliases[label]
    assert run.final.test_error <= 1.2 * run.final.noise_floor


@pytest.mark.slow
def test_several_records_with_a_line_of_the_mains_are_asked_without_harm():
    """Its phase is each record's own, which one amplitude for all cannot hold: it is not named."""
    system = spiral.system(
        ["m*x'' + c*x' + k*x = F"], states={"x": "m"}, inputs={"F": "N"}, observed=["x"],
        free=["c", "k"], parameters={"m": "1 kg", "c": "4 N*s/m", "k": "1800 N/m"},
    )  # fmt: skip

    def record(seed, phase):
        rng, time = np.random.default_rng(seed), np.arange(1200) / 1000
        turns = rng.uniform(0, 2 * np.pi, 15)
        force = np.sin(2 * np.pi * np.outer(np.linspace(2, 30, 15), time) + turns[:, None]).sum(0)
        x = lsim(([1], [1, 4, 2000]), force, time)[1]
        hum = 0.04 * x.std() * np.sin(2 * np.pi * 50 * time + phase)
        noise = 0.01 * x.std() * rng.normal(size=len(time))
        return make_record(system, f"{seed}", time, {"x": x + hum + noise}, {"F": force})

    both = (record(1, 0.3), record(2, 2.0))
    several = spiral.discover(both, system, candidates=["mains_hum", "offset"])
    assert "mains_hum" not in several.missing
    alone = spiral.discover(both[:1], system, candidates=["mains_hum", "offset"])
    assert alone.missing == ("mains_hum",)
    assert abs(several.model.values["system.k"] - 2000) < 3 * several.model.errors["system.k"] + 1
