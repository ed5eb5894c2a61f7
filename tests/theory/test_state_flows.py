"""Flows into any state of first order, wherever it stands, and a delay of an input."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm
from spiral_plugins.effects.inputs import InputDelay
from spiral_plugins.effects.losses import (
    AsymmetricLoss,
    Conversion,
    Exchange,
    LinearLoss,
    OrificeExchange,
)
from spiral_plugins.effects.memory import Jenkins
from spiral_plugins.systems.equations import Equations
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.inference.problem import silent
from spiral.inference.simulate import simulate
from spiral.types.errors import SpiralError
from spiral.types.model import seed_model
from spiral.types.port import At
from spiral.types.record import make_record
from tests.scenes import effect, registry

TANK = """
equations: ["upper' = k*pump - a*upper", "lower' = a*upper - b*lower"]
states: {upper: m, lower: m}
inputs: {pump: {unit: V, interpolation: zero_order}}
parameters: {k: 0.05 m/V/s, a: 0.2 1/s, b: 0.1 1/s}
free: [k, a, b]
observed: [lower]
"""
TRUTH = {"system.k": 0.05, "system.a": 0.2, "system.b": 0.1}


def test_a_flow_stands_at_every_state_and_between_those_of_one_unit():
    labels = {e.label for e in registry().candidates(Equations(text=TANK), everywhere=True)}
    assert {"linear_loss@upper", "linear_loss@lower", "exchange@upper-lower"} <= labels
    assert not {x for x in labels if x.startswith(("radiation_loss", "dry_loss", "mutual_flow"))}
    mechanical = registry().candidates(Oscillator(), everywhere=True)
    assert not {"linear_loss", "exchange"} & {e.plugin_name() for e in mechanical}


def test_a_place_that_is_none_is_told_with_its_neighbours():
    with pytest.raises(SpiralError, match="which flows into a state") as caught:
        Equations(text=TANK).place(LinearLoss(port="uper"))
    assert "upper" in f"{caught.value.expected} {caught.value.try_}"


def test_what_is_exchanged_at_equal_rates_is_neither_made_nor_lost():
    """x_1 + x_2 changes as without the exchange, and the difference by the sum of both rates."""
    at = At((3.0, 1.0), (), SimpleNamespace())
    first, second = Exchange().flow(at, SimpleNamespace(), SimpleNamespace(rate=(0.4, 0.4)))
    assert first + second == 0.0
    assert first - second == pytest.approx(-0.8 * (3.0 - 1.0))


def test_what_turns_from_one_into_the_other_is_neither_made_nor_lost():
    at, rate = At((3.0, 1.0), (), SimpleNamespace()), SimpleNamespace(rate=(0.4, 0.1))
    first, second = Conversion().flow(at, SimpleNamespace(), rate)
    assert (first, second) == pytest.approx((-1.1, 1.1))


def test_an_orifice_lets_through_the_root_of_the_difference():
    """Of four times the difference twice as much flows; what one chamber loses the other gains."""
    rate = SimpleNamespace(rate=(0.4, 0.4), width=0.0)

    def flows(first, second):
        return OrificeExchange().flow(At((first, second), (), SimpleNamespace()), None, rate)

    assert flows(3.0, 1.0)[0] == pytest.approx(-0.4 * np.sqrt(2.0))
    assert flows(9.0, 1.0)[0] == pytest.approx(2 * flows(3.0, 1.0)[0])
    assert flows(1.0, 3.0) == pytest.approx([-x for x in flows(3.0, 1.0)])
    assert sum(flows(9.0, 1.0)) == pytest.approx(0.0)


def test_an_asymmetric_loss_beside_as_large_a_linear_one_flows_one_way():
    rate = SimpleNamespace(rate=0.3)
    for x, due in ((2.0, -1.2), (-2.0, 0.0)):
        at = At((x,), (), SimpleNamespace())
        both = AsymmetricLoss().flow(at, None, rate)[0] + LinearLoss().flow(at, None, rate)[0]
        assert both == pytest.approx(due)


CHAMBERS = """
equations: ["supply' = k*pump - a*supply", "brake' = -b*brake + c*supply"]
states: {supply: bar, brake: bar}
inputs: {pump: {unit: V, interpolation: linear}}
parameters: {k: 2 bar/V/s, a: 0.4 1/s, b: 0.6 1/s, c: 0.2 1/s}
free: [k, a, b, c]
observed: [brake]
"""


@pytest.mark.slow
def test_a_worn_seal_between_two_chambers_is_named():
    """The supply is seen by no sensor; what leaks follows the root of the difference."""
    system = Equations(text=CHAMBERS)
    pump = 3.0 + np.repeat(np.random.default_rng(5).uniform(-2, 2, 60), 50)
    record = spiral.simulate(
        system, duration=150.0, rate=20.0, inputs={"pump": pump},
        effects=["orifice_exchange@supply-brake"],
        values={
            "system.k": 2.0, "system.a": 0.4, "system.b": 0.6, "system.c": 0.2,
            "orifice_exchange@supply-brake.rate_supply": 0.3,
            "orifice_exchange@supply-brake.rate_brake": 1.2,
            "orifice_exchange@supply-brake.width": 0.05,
        },
        noise_level=0.01, seed=1,
    )  # fmt: skip
    run = spiral.discover(
        record, system,
        candidates=["orifice_exchange", "exchange", "root_loss@supply", "quadratic_loss@brake",
                    "saturating_loss@supply", "input_saturation"],
    )  # fmt: skip
    assert run.missing == ("orifice_exchange",)
    assert run.verdict == "effect_missing"


@pytest.mark.slow
def test_waning_immunity_is_named():
    """An epidemic of which the infected alone are counted, and who was immune is so no longer."""
    text = """
    equations: ["S' = -beta*c*S*I", "I' = beta*c*S*I - g*I", "R' = g*I"]
    states: {S: '1', I: '1', R: '1'}
    inputs: {c: {unit: '1', interpolation: zero_order}}
    parameters: {beta: 0.35 1/s, g: 0.11 1/s}
    free: [beta, g]
    observed: [I]
    """
    system = Equations(text=text)
    wane = effect("conversion", port="S-R")
    truth = {"system.beta": 0.3, "system.g": 0.1}
    rates = {"conversion@S-R.rate_S": 0.0, "conversion@S-R.rate_R": 0.02}
    model = seed_model(system, (wane,), values={**truth, **rates})
    time, rng = 0.5 * np.arange(600), np.random.default_rng(3)
    contact = np.repeat(rng.uniform(0.6, 1.4, 20), 30)
    begin = {"S": 0.9, "I": 0.02, "R": 0.08}
    record = simulate(model, time, {"c": contact}, 0.01, rng, begin, substeps=4)
    offered = ["conversion@S-R", "linear_loss@S", "constant_flow@S", "exchange@S-R"]
    run = spiral.discover(record, system, holdout=0.3, candidates=offered)
    assert run.missing == ("conversion@S-R",)
    found = run.model.estimates()["conversion@S-R"]["rate_R"]
    assert abs(found.estimate - 0.02) < 3 * found.se


def filled(seed, *hidden, **values):
    """The lower level for 1000 s under a pump in steps, 1 % noise that nobody declares."""
    model = seed_model(Equations(text=TANK), hidden, values={**TRUTH, **values})
    time = np.arange(1000.0)
    pump = np.repeat(np.random.default_rng(seed).uniform(0.5, 8.0, 50), 20)
    record = simulate(model, time, {"pump": pump}, 0.01, np.random.default_rng(seed), substeps=4)
    return replace(record, noise={})


@pytest.mark.slow
def test_a_loss_of_a_hidden_state_is_named_at_its_place_with_its_rate():
    """An orifice in the upper tank, whose level nobody measures."""
    lost = effect("root_loss@upper")
    values = {"root_loss@upper.rate": 0.08, "root_loss@upper.width": 0.02}
    records = [filled(seed, lost, **values) for seed in (1, 2)]
    wrong = {"system.k": 0.055, "system.a": 0.17, "system.b": 0.11}
    run = spiral.discover(records[0], Equations(text=TANK), test=records[1], values=wrong)
    assert run.missing == ("root_loss@upper",)
    rate = run.model.estimates()["root_loss@upper"]["rate"]
    assert abs(rate.estimate - 0.08) < 3 * rate.se


@pytest.mark.slow
def test_what_runs_over_a_rim_is_named_with_its_threshold():
    """From 1 m on the upper tank loses what nobody catches."""
    values = {"threshold_loss@upper.rate": 0.3, "threshold_loss@upper.threshold": 1.0,
              "threshold_loss@upper.width": 0.0}  # fmt: skip
    records = [filled(seed, effect("threshold_loss@upper"), **values) for seed in (1, 2)]
    wrong = {"system.k": 0.055, "system.a": 0.17, "system.b": 0.11}
    run = spiral.discover(records[0], Equations(text=TANK), test=records[1], values=wrong)
    assert run.missing == ("threshold_loss@upper",)
    known = run.model.estimates()["threshold_loss@upper"]
    assert abs(known["threshold"].estimate - 1.0) < 3 * known["threshold"].se


CELL = """
equations: ["C*v' = i - v/R"]
states: {v: V}
inputs: {i: {unit: A, interpolation: zero_order}}
parameters: {C: 180 F, R: 0.011 ohm}
constants: {S: 0.005 ohm}
free: [C, R]
observed: ["U = v + S*i"]
"""


def test_charge_transfer_is_named_with_its_current_and_its_width():
    """Tafel's law beside a resistor: no cubic, and no threshold, that stand in for it."""
    transfer = effect("exponential_loss@v")
    values = {"system.C": 180.0, "system.R": 0.011, "exponential_loss@v.level": 1.1e-3,
              "exponential_loss@v.width": 0.095}  # fmt: skip
    records = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        time, current = np.arange(0, 600.0, 0.5), np.repeat(rng.uniform(5.0, 60.0, 40), 30)
        model = seed_model(Equations(text=CELL), (transfer,), values=values)
        record = simulate(model, time, {"i": current}, 0.01, rng, substeps=4)
        records.append(replace(record, noise={}))
    run = spiral.discover(
        records[0], Equations(text=CELL), test=records[1],
        values={"system.C": 160.0, "system.R": 0.012},
    )  # fmt: skip
    assert run.missing == ("exponential_loss@v",)
    known = run.model.estimates()["exponential_loss@v"]
    assert abs(known["level"].estimate - 1.1e-3) < 3 * known["level"].se
    assert abs(known["width"].estimate - 0.095) < 3 * known["width"].se


LOCK = """
equations: ["level' = supply - c*valve*sqrt(level + least)"]
states: {level: m}
inputs: {supply: {unit: m/s}, valve: {unit: "", interpolation: zero_order}}
parameters: {c: 0.05 m^0.5/s}
constants: {least: 0.01 m}
free: [c]
observed: [level]
"""


@pytest.mark.slow
def test_a_leak_beside_a_valve_is_no_lag_of_years():
    """What always flows is what a valve that stays a little open lets through.

    A lag that never ends, or a limit of no speed, would hold the valve's first position.
    """
    time = np.arange(0, 1500.0, 1.5)
    leak = effect("root_loss@level")
    values = {"system.c": 0.05, "root_loss@level.rate": 0.02, "root_loss@level.width": 0.02}
    records = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        valve = np.repeat(rng.choice([0.0, 0.3, 1.0], 50), 20)
        supply = np.repeat(rng.uniform(0.02, 0.06, 25), 40)
        model = seed_model(Equations(text=LOCK), (leak,), values=values)
        given = {"supply": supply, "valve": valve}
        record = simulate(model, time, given, 0.01, rng, substeps=4)
        records.append(replace(record, noise={}))
    run = spiral.discover(
        records[0], Equations(text=LOCK), test=records[1],
        candidates=["actuator_lag@valve", "rate_limit@valve", "input_delay@valve", "root_loss"],
    )  # fmt: skip
    assert run.missing == ("root_loss",)


def acting(effect, frequency, p):
    """What acts of a unit input at i w, from the effect's own equations (rad/s)."""

    names = [state.name for state in effect.states]

    def placed(given, own):
        return At((given,), (), SimpleNamespace(**dict(zip(names, own, strict=True))))

    def rates(given, own):
        return np.array(list(effect.rate(placed(given, own), SimpleNamespace(), p).values()))

    size = len(names)
    matrix = np.column_stack([rates(0.0, column) for column in np.eye(size)])
    own = np.linalg.solve(1j * frequency * np.eye(size) - matrix, rates(1.0, np.zeros(size)))
    return effect.drive(placed(1.0, own), SimpleNamespace(), p)


@pytest.mark.parametrize(("scale", "order"), [(0.1, 5), (0.13, 3)])
def test_a_delay_is_right_to_its_order(scale, order):
    """Against exp(-i w T): the slope of the log error on the log frequency."""
    p = SimpleNamespace(time=0.1, scale=scale)
    errors = [abs(acting(InputDelay(), w, p) - np.exp(-0.1j * w)) for w in (1.0, 2.0)]
    assert np.log2(errors[1] / errors[0]) == pytest.approx(order, abs=0.1)


def test_a_slider_loses_four_times_its_force_and_slip_in_a_cycle():
    """k L (4 A - 4 L) for an amplitude A beyond L, whose corner is rounded to both sides alike."""
    p = SimpleNamespace(stiffness=100.0, length=0.01)
    time = np.linspace(0.0, 4 * np.pi, 80_001)
    velocity = 0.05 * np.cos(time)
    slip, forces = 0.0, []
    for v in velocity:
        at = At((0.0,), (v,), SimpleNamespace(slip=slip))
        forces.append(Jenkins().force(at, None, p)[0])
        slip += float(Jenkins().rate(at, None, p)["slip"]) * (time[1] - time[0])
    second = slice(40_000, None)  # settled
    lost = -np.trapezoid(np.array(forces)[second] * velocity[second], time[second])
    assert lost == pytest.approx(100.0 * 0.01 * 4 * (0.05 - 0.01), rel=0.05)


VESSEL = """
equations: ["p' = (Q - g*p)/V"]
states: {p: Pa}
inputs: {Q: {unit: Pa*m^3/s, interpolation: zero_order}}
parameters: {V: 0.06 m^3, g: 0.07 m^3/s}
free: [g]
observed: [p]
"""


def _pumped(seed, store, time, samples=1500, step=0.1):
    """p' = (Q - g p) / V - c (p - z), T z' = p - z: exact for a flow that is held."""
    rng = np.random.default_rng(seed)
    flow = np.repeat(rng.uniform(0.0, 2.0, samples // 25), 25)
    rates = np.zeros((3, 3))
    rates[0] = [-0.08 / 0.06 - store, store, 1 / 0.06]
    rates[1, :2] = [1 / time, -1 / time]
    over, x, seen = expm(rates * step), np.zeros(2), []
    for q in flow:
        seen.append(x[0])
        x = over[:2, :2] @ x + over[:2, 2] * q
    seen = np.array(seen) + 0.01 * np.std(seen) * rng.normal(size=samples)
    clock = np.arange(samples) * step
    return make_record(Equations(text=VESSEL), f"seed {seed}", clock, {"p": seen}, {"Q": flow})


@pytest.mark.slow
def test_walls_that_take_up_gas_are_a_store_with_its_rate_and_time():
    run = spiral.discover(_pumped(1, 0.25, 9.0), Equations(text=VESSEL), progress=silent)
    assert run.missing == ("hidden_store@p",), run.summary
    told = run.model.estimates()
    for name, true in (("rate", 0.25), ("time_constant", 9.0)):
        value = told["hidden_store@p"][name]
        assert abs(value.estimate - true) < 3 * value.se
    assert told["system"]["g"].estimate == pytest.approx(0.08, rel=0.02)


def test_no_store_is_named_where_there_is_none():
    run = spiral.discover(_pumped(2, 0.0, 9.0), Equations(text=VESSEL), progress=silent)
    assert (run.verdict, run.missing) == ("nothing_missing", ()), run.summary


def test_what_has_its_sign_alone_from_a_current_is_a_loss_of_it():
    text = TANK.replace("m/V/s", "A/V/s").replace("upper: m, lower: m", "upper: A, lower: A")
    labels = {e.label for e in registry().candidates(Equations(text=text), everywhere=True)}
    assert {"dry_loss@upper", "dry_loss@lower"} <= labels
