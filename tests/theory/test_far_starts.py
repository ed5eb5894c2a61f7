"""Machines of first order with a hidden state, begun from values and states that are far off."""

from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp
from scipy.signal import lsim
from spiral_plugins.systems.equations import Equations

import spiral
from spiral.engine.filter.task import motion_scales, prepare_task
from spiral.inference.likelihood.seed_fit import _ends_at_same_values
from spiral.types.model import seed_model
from spiral.types.record import make_record

_SHIP = """
equations:
  - I*phi'' + J*tau'' + c*phi' + K*phi + kt*tau = M
  - J*phi'' + Jt*tau'' + ct*tau' + kt*tau + kt*phi = 0
states: {phi: rad, tau: rad}
inputs: {M: N*m}
parameters:
  I: 2.4 kg*m^2
  J: 0.10 kg*m^2
  Jt: 0.12 kg*m^2
  c: 0.53 N*m*s/rad
  K: 13.0 N*m/rad
  ct: 0.035 N*m*s/rad
  kt: 0.70 N*m/rad
free: [c, K, ct, kt]
observed: [phi]
"""


def _held(rng, count, shortest, longest, low, high):
    """Levels that are held for a while, drawn between two bounds."""
    found, k = np.empty(count), 0
    while k < count:
        n = int(rng.integers(shortest, longest))
        found[k : k + n], k = rng.uniform(low, high), k + n
    return found


def _run(rate, start, inputs, dt):
    """States at the samples, the inputs (samples, m) held between them."""
    states = [np.array(start, float)]
    for u in inputs[:-1]:
        step = solve_ivp(lambda t, x, u=u: rate(x, u), (0, dt), states[-1], rtol=1e-8, atol=1e-10)
        states.append(step.y[:, -1])
    return np.array(states)


def test_a_heat_capacity_does_not_run_away():
    """A heater plate and a specimen that nobody sees, values 15 to 20 % off.

    From there the plate alone explains more at first: the specimen's capacity ran off to 1e151.
    """
    dt, count, rng = 30.0, 1200, np.random.default_rng(1)
    heat = _held(rng, count, 30, 120, 0.0, 60.0)

    def rate(x, u):
        flow = 8.0 * (x[0] - x[1])
        return [(u[0] - flow - 1.5 * (x[0] - 290.0)) / 4000, flow / 3000]

    plate = _run(rate, [295.0, 294.0], heat[:, None], dt)[:, 0]
    read = np.round((plate + 0.3 * rng.normal(size=count)) / 0.1) * 0.1
    system = spiral.system(
        lambda t, x, u, p: [
            (u.heat - p.hA * (x.plate - x.specimen) - p.UA * (x.plate - p.room)) / p.Ch,
            p.hA * (x.plate - x.specimen) / p.Cs,
        ],
        states={"plate": "K", "specimen": {"unit": "K", "like": "plate"}}, inputs={"heat": "W"},
        parameters={"Ch": (4600.0, "J/K"), "Cs": (2550.0, "J/K"), "hA": (9.6, "W/K"),
                    "UA": (1.725, "W/K"), "room": (290.0, "K")},
        observed=["plate"], free=["Ch", "Cs", "hA", "UA"],
    )  # fmt: skip
    record = make_record(
        system, "chamber", dt * np.arange(count), {"plate": read}, {"heat": heat},
        hold={"heat": "zero_order"},
    )  # fmt: skip
    run = spiral.discover(record, system, holdout=0.3, candidates=["linear_loss@specimen"])
    found = run.model.estimates()["system"]
    assert (run.verdict, run.missing) == ("nothing_missing", ())
    for name, true in {"Ch": 4000.0, "Cs": 3000.0, "hA": 8.0, "UA": 1.5}.items():
        assert found[name].estimate == pytest.approx(true, abs=4 * found[name].se)


def test_a_substrate_that_nobody_sees_begins_where_it_was():
    """Cells X on a substrate S: growth mu S / (K + S) is singular at S = -K.

    Begun at S = 0, the test's head led to S = -3, from where the model has no future.
    """
    dt, count = 1800.0, 500

    def rate(x, u):
        growth = 0.4 / 3600 * x[1] / (0.5 + x[1]) * x[0]
        return [growth - u[0] * x[0], u[0] * (u[1] - x[1]) - 2 * growth]

    system = spiral.system(
        lambda t, x, u, p: [
            p.mu * x.S / (p.K + x.S) * x.X - u.D * x.X,
            u.D * (u.feed - x.S) - p.mu * x.S / (p.K + x.S) * x.X / p.gain,
        ],
        states={"X": "g/l", "S": {"unit": "g/l", "like": "X"}},
        inputs={"D": "1/s", "feed": "g/l"},
        parameters={"mu": (0.37 / 3600, "1/s"), "K": (0.62, "g/l"), "gain": (0.45, "")},
        observed=["X"], free=["mu", "K", "gain"],
    )  # fmt: skip
    records = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        given = np.column_stack([_held(rng, count, 8, 40, 0.03, 0.3) / 3600,
                                 _held(rng, count, 15, 70, 4.0, 14.0)])  # fmt: skip
        cells = _run(rate, [3.0, 1.0], given, dt)[:, 0]
        read = cells + 0.01 * cells.std() * rng.normal(size=count)
        records.append(make_record(
            system, f"{seed}", dt * np.arange(count), {"X": read},
            {"D": given[:, 0], "feed": given[:, 1]},
            hold={"D": "zero_order", "feed": "zero_order"},
        ))  # fmt: skip
    found = spiral.compare(records[0], system, test=records[1])
    assert found.test_error < 1.5 * found.noise_floor


_BRAKE = """
equations:
  - C*T' + h*(T - W) = P
  - D*W' + h*(W - T) + g*(W - air) = 0
states: {T: K, W: {unit: K, start: 450}}
inputs: {P: {unit: W, interpolation: linear}, air: {unit: K, interpolation: linear}}
parameters: {C: 3000 J/K, D: 9000 J/K, h: 40 W/K, g: 25 W/K}
free: [h, g]
observed: [T]
"""


def test_a_hidden_state_begins_at_the_number_given(tmp_path):
    """A pad that was warm before the record began: in a simulation, in words, and in a fit."""
    file = tmp_path / "brake.yaml"
    file.write_text(_BRAKE)
    brake, t = spiral.system(file), 2.0 * np.arange(700)
    assert ("W", "K", "hidden, begins at 450") in brake.quantities()
    power = 4e3 * (np.sin(t / 60) + np.sin(t / 23) > 0.4)
    inputs = {"P": power, "air": np.full(t.size, 293.0)}
    said = {"inputs": inputs, "noise_level": 0.003}
    cold = spiral.simulate(brake, 1400.0, 0.5, start={"T": 300.0, "W": 300.0}, **said)
    record = spiral.simulate(brake, 1400.0, 0.5, start={"T": 300.0}, **said)
    assert record.channels["T"][100] > 1.02 * cold.channels["T"][100]
    compared = spiral.compare(record, brake)
    assert compared.fit_error < 1.2 * compared.noise_floor
    found = compared.model.estimates()["system"]
    for name, true in {"h": 40.0, "g": 25.0}.items():
        assert found[name].estimate == pytest.approx(true, abs=4 * found[name].se)


def test_a_culture_that_nobody_has_sown_tells_no_scale():
    """Begun from zero it stays there; what is hidden moves from where it is declared to begin."""
    system = spiral.system(
        ["X' = (mu*(1 - Q0/maximum(Q, Ql)) - D)*X", "Q' = rho - mu*(1 - Q0/maximum(Q, Ql))*Q"],
        states={"X": "g/L", "Q": {"unit": "1", "start": 0.06}},
        inputs={"D": "1/s"}, observed=["X"],
        parameters={"mu": (2e-5, "1/s"), "Q0": (0.02, "1"), "Ql": (1e-3, "1"),
                    "rho": (2e-7, "1/s")},
    )  # fmt: skip
    time = 300.0 * np.arange(800)
    record = make_record(
        system, "culture", time, {"X": 1 + 0.1 * np.sin(2e-5 * time)},
        {"D": np.full(800, 4e-6)},
    )  # fmt: skip
    task = prepare_task(seed_model(system), record)
    assert task.scales[1] == pytest.approx(0.01, rel=0.9)
    _, scales, rates = motion_scales(np.column_stack([np.sin(time), np.full(800, 0.1 + 0.2)]), 1.0)
    assert scales[1] == pytest.approx(0.09)
    assert rates[1] > 0


def test_an_epidemic_moves_as_from_where_it_is_declared_to_begin():
    """From nobody ill it grows from what is brought in, a thousandfold smaller over the record."""
    b, a, g = 4.2e-6, 3.5e-6, 2.1e-6
    system = spiral.system(
        ["S' = -b*S*I", "E' = b*S*I + m - a*E", "I' = a*E - g*I"],
        states={"S": {"unit": "1", "start": 0.9}, "E": {"unit": "1", "start": 1e-3},
                "I": {"unit": "1", "start": 1e-3}},
        inputs={"m": "1/s"}, observed=["load = s*I"],
        parameters={"b": (b, "1/s"), "a": (a, "1/s"), "g": (g, "1/s"), "s": (1e6, "1")},
    )  # fmt: skip

    def rate(x, u):
        s, e, i = x
        return [-b * s * i, b * s * i + u - a * e, a * e - g * i]

    imported = np.full(300, 1e-13)
    moved = _run(rate, [0.9, 1e-3, 1e-3], imported, 86400.0)
    record = make_record(
        system, "town", 86400.0 * np.arange(300), {"load": 1e6 * moved[:, 2]}, {"m": imported}
    )
    task = prepare_task(seed_model(system), record)
    assert task.scales[1:] == pytest.approx(moved[:, 1:].std(axis=0), rel=0.5)


def test_a_state_begins_like_another_or_at_a_number():
    with pytest.raises(spiral.SpiralError, match="one of the two"):
        spiral.system(_brake_that(like="T"))
    with pytest.raises(spiral.SpiralError, match="a number in the state's unit"):
        spiral.system(_brake_that(start="warm"))


def _brake_that(**begins):
    return yaml.safe_load(_BRAKE) | {
        "states": {"T": "K", "W": {"unit": "K", "start": 450} | begins}
    }


def test_an_absorber_is_not_lost_beside_a_sensor_that_drifts(tmp_path):
    """A ship and the tank in its hull that nobody sees; the inclinometer drifts.

    While the drift is no part of the noise the tank comes to rest to explain it, and stays there.
    """
    dt, count, rng = 0.05, 1500, np.random.default_rng(1)
    t = dt * np.arange(count)
    tones = np.geomspace(0.12, 1.0, 24) * (1 + 0.05 * rng.uniform(-1, 1, 24))
    moment = np.sin(2 * np.pi * np.outer(t, tones) + rng.uniform(0, 2 * np.pi, 24)).sum(axis=1)
    moment *= 1.2 / moment.std()
    mass = np.array([[2.4, 0.10], [0.10, 0.12]])
    stiff, damped = np.array([[14.0, 0.75], [0.75, 0.75]]), np.diag([0.45, 0.03])
    rates = -np.linalg.solve(mass, np.hstack([stiff, damped]))
    slopes = np.vstack([np.eye(4)[2:], rates])
    drive = np.r_[0.0, 0.0, np.linalg.solve(mass, [1.0, 0.0])][:, None]
    _, roll, _ = lsim((slopes, drive, [[1.0, 0, 0, 0]], [[0.0]]), moment, t)
    wander = np.sin(2 * np.pi * 0.8 * t / t[-1] + 2.0) + 0.8 * t / t[-1]
    read = roll + roll.std() * (0.015 * rng.normal(size=count) + 0.04 * wander)
    file = tmp_path / "ship.yaml"
    file.write_text(_SHIP)
    system = spiral.system(file)
    record = make_record(system, "basin", t, {"phi": read}, {"M": moment})
    found = spiral.compare(record, system, holdout=0.3).model.estimates()["system"]
    for name, true in {"c": 0.45, "K": 14.0, "ct": 0.03, "kt": 0.75}.items():
        assert found[name].estimate == pytest.approx(true, abs=4 * found[name].se)
    assert found["kt"].estimate == pytest.approx(0.75, rel=0.05)


_CELL = """
equations:
  - z' = I/Q
  - w' = b*I - a*w
states: {z: "1", w: V}
inputs: {I: {unit: A, interpolation: zero_order}}
constants: {E0: 3.3 V, E1: 0.7 V, E3: 0.2 V, R: 0.03 ohm}
parameters: {Q: 9000 A*s, a: 0.03 1/s, b: 0.0017 V/A/s}
free: [a, b]
observed: ["U = E0 + E1*z + E3*z^3 + w + R*I"]
"""


def test_a_charge_that_only_adds_up_begins_where_it_was():
    """Half charged, 40 times as far from empty as it moves; else the overvoltage kept for ever."""
    count, dt, rng = 1500, 1.0, np.random.default_rng(7)
    current = _held(rng, count, 10, 40, -4.0, 4.0)
    states = _run(lambda x, u: [u[0] / 9000, 0.0015 * u[0] - 0.025 * x[1]], [0.5, 0.0],
                  current[:, None], dt)  # fmt: skip
    z, w = states.T
    volts = 3.3 + 0.7 * z + 0.2 * z**3 + w + 0.03 * current
    volts = volts + 0.01 * np.std(volts) * rng.normal(size=count)
    system = Equations(text=_CELL)
    record = make_record(system, "cell", np.arange(count) * dt, {"U": volts}, {"I": current})
    run = spiral.discover(record, system, candidates=["linear_loss"])
    assert run.verdict == "nothing_missing", run.summary
    told = run.model.estimates()["system"]
    for name, true in (("a", 0.025), ("b", 0.0015)):
        assert abs(told[name].estimate - true) < 3 * told[name].se


def test_a_value_without_a_finite_error_does_not_tell_two_fits_apart():
    """One that ran away to 1e159 has an infinite error: LAPACK never came back from it."""
    key_values = {"far": 2e159, "near": 1.0}

    def fit(**values):
        inverse = np.array([[np.inf, -np.inf, np.inf], [0.0, 0.1, 0.02], [0.0, 0.0, 1.0]])
        prepared = ((SimpleNamespace(series=SimpleNamespace(y=np.zeros((500, 1)))), None),)
        at = SimpleNamespace(
            finite=True, values=key_values | values, prepared=prepared,
            regression=SimpleNamespace(inverse=inverse),
        )  # fmt: skip
        return SimpleNamespace(estimate=at)

    assert _ends_at_same_values(fit(far=1e3), fit())
    assert not _ends_at_same_values(fit(near=9.0), fit())
    assert not _ends_at_same_values(fit(near=np.inf), fit())
