"""What a parameter multiplies: read from equations, followed by it, and named."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.evidence.scales import largest_port_motion, shape_scale, states_along_records
from spiral.inference.problem import silent
from spiral.types.model import seed_model
from spiral.types.placement import fits
from spiral.types.record import make_record
from spiral.types.units import short_form
from tests.scenes import registry

BUOY = """
equations:
  - M*z'' = -B*(z' - wave') - K*(z - wave) - Fm
  - Fm' = km*z' - Fm/tm
states: {z: m, Fm: N}
inputs: {wave: m}
parameters: {M: 6000 kg, B: 1700 N*s/m, K: 28000 N/m, km: 6000 N/m, tm: 7 s}
free: [M, B]
observed: [z]
"""
PUMP = """
equations:
  - tau*th'' + th' = Kv*V
  - C*p' = D*th' - p/R
states: {th: rad, p: kPa}
inputs: {V: {unit: V, interpolation: zero_order}}
parameters:
  tau: 0.12 s
  Kv: 1.1 rad/(V*s)
  C: 0.12 mL/kPa
  D: 0.4 mL/rad
  R: 5 kPa*s/mL
free: [tau, Kv, D, R]
observed: [th, p]
"""


def system_of(text):
    return registry().make("system", "equations", {"text": text})


def test_what_a_parameter_multiplies_is_read_from_the_equations():
    """Not what two coordinates, two levels, or a level and an input make: effects act there."""
    system = system_of(BUOY)
    assert system.arguments == {
        "B_argument": ("B", "wave' - z'"), "K_argument": ("K", "wave - z"),
    }  # fmt: skip
    units = {a.name: short_form(a.unit) for a in system.auxiliaries}
    assert units == {"B_argument": "m/s", "K_argument": "m"}
    ports = {p.name for p in system.varied}
    assert "parameter B with B_argument" in ports
    assert "parameter M with B_argument" not in ports


LEVELS = """
equations: ["ROW", "C*b' = g*(a - b) - k*b"]
states: {a: K, b: K}
inputs: {q: W, T: K}
parameters: {C: 10 J/K, g: 2 W/K, k: 1 W/K}
free: [g, k]
observed: [a]
"""


@pytest.mark.parametrize(
    "row",
    [
        "C*a' = q - g*(a - b)",  # two levels
        "C*a' = q - g*(a - T)",  # a level and an input: b has another, but they differ
        "C*a' = q - g*(a - 2*b + T)",  # another one than in the second equation
        "C*a' = q - k*(a - T) + (q - g*b + g*T)/k*k",  # g is to be found
    ],
)
def test_of_other_sums_there_is_none(row):
    system = system_of(LEVELS.replace("ROW", row))
    assert not {"g_argument", "k_argument"} & {*system.arguments}


def test_an_angle_is_no_number():
    """What repeats in a turn follows angles alone."""
    made = registry().make
    change = made("effect", "periodic_change", {"port": "D-th"})
    assert fits(system_of(PUMP), change)
    assert not fits(system_of(PUMP.replace("th: rad", "th: 1").replace("rad", "1")), change)
    assert not fits(system_of(PUMP), made("effect", "periodic_change", {"port": "D-p"}))


def buoy_record(system, drag, seed=0, samples=1500, dt=0.2):
    """A sea of six waves; B v + drag |v| v acts."""
    rng = np.random.default_rng(seed)
    time = np.arange(samples) * dt
    size, speed, phase = rng.uniform(0.1, 0.5, 6), rng.uniform(0.4, 1.6, 6), rng.uniform(0, 6, 6)

    def wave(t):
        return float(size @ np.sin(speed * t + phase))

    def rate(t):
        return float((size * speed) @ np.cos(speed * t + phase))

    def rates(t, s):
        z, v, force = s
        slip = v - rate(t)
        pull = -1500 * slip - drag * abs(slip) * slip - 28000 * (z - wave(t)) - force
        return [v, pull / 6000, 6000 * v - force / 7]

    moved = solve_ivp(rates, (0, time[-1]), [0, 0, 0], t_eval=time, rtol=1e-8, atol=1e-9).y[0]
    seen = moved + 0.01 * moved.std() * rng.normal(size=samples)
    record = {"wave": np.array([wave(t) for t in time])}
    return make_record(system, "sea", time, {"z": seen}, record)


def test_a_change_with_the_size_is_tried_where_both_signs_occur():
    system = system_of(BUOY)
    record = buoy_record(system, 0.0, samples=300)
    along = states_along_records(seed_model(system, values=system.defaults), (record,))
    largest = largest_port_motion(system, (record,), along)
    change = registry().make("effect", "magnitude_change", {"port": "B-B_argument"})
    unit = next(p for p in change.parameters if p.name == "unit")
    port = system.place(change)
    assert shape_scale(unit, largest, port) == largest[f"{port.name}.position"] > 0
    one_sided = largest | {f"{port.name}.less": 0.1 * largest[f"{port.name}.position"]}
    assert shape_scale(unit, one_sided, port) == 0


def test_a_drag_on_the_water_that_moves_is_named():
    """B v + b |v| v of v = z' - wave', which is no state."""
    system = system_of(BUOY)
    run = spiral.discover(buoy_record(system, 2500.0), system, progress=silent)
    assert run.missing == ("magnitude_change@B-B_argument",)
    assert "B is no constant: it follows wave' - z'" in run.summary


def test_what_a_pump_delivers_repeats_with_its_angle():
    """D (1 + 0.3 cos(2 th)): beside coloured noise of a sensor the record seems explained."""
    system, rng = system_of(PUMP), np.random.default_rng(3)
    volts = np.repeat(rng.uniform(-5, 5, 60), 30)
    time = np.arange(len(volts)) * 0.05

    def rates(t, s, u):
        delivered = 0.36 * (1 + 0.3 * np.cos(2 * s[0])) * s[1]
        return [s[1], (1.15 * u - s[1]) / 0.12, (delivered - s[2] / 6) / 0.12]

    states, x = [], np.zeros(3)
    for u in volts:
        states.append(x)
        x = solve_ivp(rates, (0, 0.05), x, args=(u,), rtol=1e-8, atol=1e-10).y[:, -1]
    seen = np.array(states)[:, [0, 2]]
    seen = seen + 0.02 * seen.std(axis=0) * rng.normal(size=seen.shape)
    record = make_record(system, "pump", time, {"th": seen[:, 0], "p": seen[:, 1]}, {"V": volts})
    run = spiral.discover(record, system, progress=silent)
    assert run.missing == ("periodic_change@D-th",)
    assert run.model.values["periodic_change@D-th.count"] == pytest.approx(2, rel=0.01)
