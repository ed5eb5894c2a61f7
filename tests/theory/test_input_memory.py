"""Actuators with a memory: play, and what hangs behind by where it turned."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.effects.inputs import InputHysteresis, InputPlay

import spiral
from experiments.studies.signals import band_limited
from spiral.types.port import At
from spiral.types.record import make_record

WARM = {"share": 1.0, "time_constant": 1e-3}


def driven(effect, values, time, given):
    """What acts, by SciPy: the effect's own equations along a given input."""
    p, names = SimpleNamespace(**values), [s.name for s in effect.states]

    def at(t, own):
        return At((given(t),), (), SimpleNamespace(**dict(zip(names, own, strict=True))))

    def rate(t, own):
        rates = effect.rate(at(t, own), None, p)
        return [rates[n] for n in names]

    begin = [given(time[0]) if n == "followed" else 0.0 for n in names]
    tight = {"method": "LSODA", "rtol": 1e-8, "atol": 1e-9, "max_step": 3 * (time[1] - time[0])}
    run = solve_ivp(rate, time[[0, -1]], begin, t_eval=time, **tight)
    return np.array(
        [effect.drive(at(t, own), None, p) for t, own in zip(time, run.y.T, strict=True)]
    )


@pytest.mark.parametrize("hertz", [0.2, 2.0])
def test_what_hysteresis_holds_back_is_that_of_dahl_whatever_the_speed(hertz):
    """Along a first rise h = L (1 - exp(-u / L)); then a loop of the area 4 L (1 - L tanh(1 / L)).

    The latter for a sine of amplitude one, by integration of both of its branches.
    """
    time = np.linspace(0, 3 / hertz, 3001)
    values = {**WARM, "time_constant": 2e-3 / hertz, "length": 0.5, "asymmetry": 0.0}
    acting = driven(InputHysteresis(), values, time, lambda t: np.sin(2 * np.pi * hertz * t))
    given = np.sin(2 * np.pi * hertz * time)
    held = given - acting
    rise = time < 0.25 / hertz
    np.testing.assert_allclose(held[rise], 0.5 * (1 - np.exp(-given[rise] / 0.5)), atol=2e-3)
    last = time >= 2 / hertz
    area = np.sum(0.5 * (held[last][1:] + held[last][:-1]) * np.diff(given[last]))
    assert area == pytest.approx(4 * 0.5 * (1 - 0.5 * np.tanh(2)), rel=2e-3)


def test_play_follows_beyond_the_gap_and_stays_within():
    time = np.linspace(0, 3.0, 3001)
    values = {**WARM, "gap": 0.3, "width": 1e-4}
    acting = driven(InputPlay(), values, time, lambda t: np.sin(2 * np.pi * t))
    given, expected, z = np.sin(2 * np.pi * time), [], 0.0
    for u in given:  # the play operator: z stays within a gap of u
        z = min(max(z, u - 0.3), u + 0.3)
        expected.append(z)
    np.testing.assert_allclose(acting, expected, atol=0.02)


def stage(seed, hidden):
    """A stage on a spring behind a ceramic that holds back up to 4 um of 60, by SciPy."""
    time = np.arange(4000) * 5e-4
    volts = band_limited(np.random.default_rng(seed), 20.0, (1.0, 40.0), 2.0)

    def rate(t, state):
        x, v, h = state
        step = (volts(t + 1e-6) - volts(t - 1e-6)) / 2e-6
        pull = 4e5 * (5e-7 * volts(t) - hidden * h)
        bent = 1.5e-7 * step - 0.02 * abs(step) * h - 0.01 * step * abs(h)
        return [v, (pull - 60.0 * v - 4e5 * x) / 0.8, bent]

    run = solve_ivp(rate, time[[0, -1]], [0.0] * 3, t_eval=time, method="LSODA", rtol=1e-8,
                    atol=1e-12, max_step=5e-4)  # fmt: skip
    x = run.y[0]
    x = x + 0.01 * x.std() * np.random.default_rng(seed + 9).normal(size=x.size)
    system = spiral.system(
        ["m*x'' + c*x' + k*x = k*d*u"], states={"x": "m"}, inputs={"u": "V"}, observed=["x"],
        parameters={"m": (0.8, "kg"), "c": (50.0, "N*s/m"), "k": (3.6e5, "N/m"),
                    "d": (4.4e-7, "m/V")}, free=["c", "k", "d"],
    )  # fmt: skip
    return make_record(system, "stage", time, {"x": x}, {"u": volts(time)}), system


OFFERED = ["input_hysteresis", "input_play", "actuator_lag", "input_gain", "coulomb_friction"]


def test_a_ceramic_that_hangs_behind_its_voltage_is_named():
    run = spiral.discover(*stage(0, 1.0), candidates=OFFERED)
    assert run.missing == ("input_hysteresis",)
    last = run.rounds[-1].comparison
    assert last.test_error < 1.1 * last.noise_floor
    found = run.model.estimates()["system"]
    assert found["k"].estimate == pytest.approx(4e5, rel=0.01)
    assert found["d"].estimate == pytest.approx(5e-7, rel=0.02)


def test_a_ceramic_that_holds_nothing_back_lacks_nothing():
    assert spiral.discover(*stage(1, 0.0), candidates=OFFERED).missing == ()


def valve(seed, gap, middle=0.0):
    """A level under a valve whose stem has lash, by the play operator and exact steps."""
    rng, count, dt = np.random.default_rng(seed), 4000, 0.05
    asked = middle + band_limited(rng, 0.3, (0.05, 1.0), dt * count)(dt * np.arange(count))
    stem, level, z, x = [], [], middle, 1.2 * middle
    fine = np.interp(np.arange(20 * count) / 20, np.arange(count), asked)
    for k, u in enumerate(fine):
        z = min(max(z, u - gap), u + gap)
        if k % 20 == 0:
            stem.append(z)
            level.append(x)
        x += dt / 20 * (1.2 * z - x) / 0.8
    level = np.array(level)
    level = level + 0.01 * level.std() * rng.normal(size=count)
    system = spiral.system(
        ["T*x' = k*u - x"], states={"x": "m"}, inputs={"u": "1"}, observed=["x"],
        parameters={"T": (0.9, "s"), "k": (1.0, "m")}, free=["T", "k"],
    )  # fmt: skip
    return make_record(system, "valve", dt * np.arange(count), {"x": level}, {"u": asked}), system


def test_the_lash_of_a_valve_is_named_and_measured():
    offered = [*OFFERED[:-1], "input_dead_zone", "linear_loss", "rate_limit"]
    run = spiral.discover(*valve(0, 0.08), candidates=offered)
    assert run.missing == ("input_play",)
    found = run.model.estimates()["input_play"]
    assert found["share"].estimate == pytest.approx(1.0, abs=0.05)
    assert found["gap"].estimate == pytest.approx(0.08, rel=0.05)
    assert spiral.discover(*valve(1, 0.0), candidates=offered).missing == ()


def test_the_lash_of_a_valve_that_moves_far_from_zero_is_named():
    """A gap is tried at shares of how far the input goes to and fro, not of how large it is."""
    offered = [*OFFERED[:-1], "input_dead_zone", "linear_loss", "rate_limit"]
    run = spiral.discover(*valve(2, 0.02, middle=4.0), candidates=offered)
    assert run.missing == ("input_play",)
    found = run.model.estimates()["input_play"]
    begins = found["gap"].estimate - found["width"].estimate
    assert begins == pytest.approx(0.02, rel=0.15)
