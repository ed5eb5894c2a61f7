"""Losses to surroundings that an input has: a room that loses heat to the outdoors."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import spiral
from spiral.io.registry import load_registry
from spiral.physics.trace import trace
from spiral.types.errors import ConfigError
from spiral.types.placement import at_every_place
from spiral.types.port import place_name
from spiral.types.record import make_record

REGISTRY = load_registry()
DT, COUNT = 300.0, 700
AIR, WALL, DIRECT, INNER, OUTER, DRAUGHT = 1.2e6, 1.5e7, 45.0, 220.0, 60.0, 3.0


def room():
    def rhs(t, x, u, p):
        inner = p.Gw * (x.T - x.W)
        return [
            (u.heater - p.Ga * (x.T - u.outside) - inner) / p.Ca,
            (inner - p.Go * (x.W - u.outside)) / p.Cw,
        ]

    return spiral.system(
        rhs, states={"T": "K", "W": "K"}, inputs={"heater": "W", "outside": "K"}, observed=["T"],
        parameters={"Ca": (1.1e6, "J/K"), "Cw": (WALL, "J/K"), "Ga": (55, "W/K"),
                    "Gw": (190, "W/K"), "Go": (70, "W/K")},
        free=["Ca", "Ga", "Gw", "Go"],
    )  # fmt: skip


def measured(draught, seed=1):
    """A record of air at 295 K or so, by SciPy; inputs held between samples."""
    rng, time = np.random.default_rng(seed), DT * np.arange(COUNT)
    heater = np.repeat(rng.uniform(0, 5000, COUNT // 20), 20)
    outside = 278 + 6 * np.sin(2 * np.pi * time / 86400) + 3 * np.sin(time / 9000)
    states = [np.array([293.0, 291.0])]
    for u, out in zip(heater[:-1], outside[:-1], strict=True):

        def rate(t, x, u=u, out=out):
            d = x[0] - out
            inner = INNER * (x[0] - x[1])
            lost = DIRECT * d + draught * d * abs(d)
            return [(u - lost - inner) / AIR, (inner - OUTER * (x[1] - out)) / WALL]

        states.append(solve_ivp(rate, (0, DT), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    air = np.array(states)[:, 0] + 0.03 * rng.normal(size=COUNT)
    inputs = {"heater": heater, "outside": outside}
    return make_record(room(), "room", time, {"T": air}, inputs, hold="zero_order")


def test_losses_have_places_against_inputs_of_their_unit():
    system = room()
    places = [e.port for e in at_every_place(system, REGISTRY.make("effect", "quadratic_loss"))]
    assert places == ["T", "W", "T-outside", "W-outside"]
    assert [e.port for e in at_every_place(system, REGISTRY.make("effect", "constant_flow"))] == [
        "T", "W",
    ]  # fmt: skip
    loss = REGISTRY.make("effect", "quadratic_loss", {"port": "W-outside"})
    port = system.place(loss)
    assert (port.axes, port.against, place_name(port)) == (("W",), "outside", "W-outside")
    with pytest.raises(ConfigError, match="one of T, W"):
        system.place(REGISTRY.make("effect", "constant_flow", {"port": "T-outside"}))


def test_a_draught_is_named_with_its_size():
    record = measured(DRAUGHT)
    run = spiral.discover(
        record, room(), holdout=0.3,
        candidates=["quadratic_loss@T", "quadratic_loss@T-outside", "quadratic_loss@W-outside",
                    "cubic_loss@T-outside"],
    )  # fmt: skip
    assert run.missing == ("quadratic_loss@T-outside",)
    values, errors = run.model.values, run.model.errors
    key = "quadratic_loss@T-outside.rate"
    assert abs(values[key] - DRAUGHT / AIR) < 3 * errors[key]
    assert abs(values["system.Ga"] - DIRECT) < 3 * errors["system.Ga"]


def test_without_a_draught_nothing_is_missing():
    run = spiral.discover(measured(0.0, seed=2), room(), holdout=0.3)
    assert run.missing == ()
    assert run.verdict == "nothing_missing"


def collector():
    return spiral.system(
        ["C*T' = A*G - U*(T - Ta)"], states={"T": "K"}, inputs={"G": "W/m^2", "Ta": "K"},
        parameters={"C": "60 kJ/K", "A": "4 m^2", "U": "9 W/K"}, free=["A", "U"], observed=["T"],
    )  # fmt: skip


def test_radiation_counts_from_a_measured_temperature_alone():
    """-r (T^4 - Ta^4) beside what is there already, only where there are two temperatures."""
    effect = REGISTRY.make("effect", "radiation_exchange")
    assert [e.port for e in at_every_place(collector(), effect)] == ["T-Ta"]
    bare, with_it = (trace(collector(), e) for e in ((), (replace(effect, port="T-Ta"),)))
    (x,), u, p = with_it.x, dict(zip(with_it.inputs, with_it.u, strict=True)), with_it.p
    known = dict(zip(with_it.keys, p, strict=True))
    rate, zero = (known[f"radiation_exchange@T-Ta.{n}"] for n in ("rate", "zero"))
    added = with_it.rate[0] - bare.rate[0]
    assert sp.expand(added + rate * ((x + zero) ** 4 - (u["Ta"] + zero) ** 4)) == 0


def test_radiation_to_a_sky_that_changes_is_named_with_its_size():
    rng, time = np.random.default_rng(4), 60.0 * np.arange(900)
    sun = np.repeat(rng.uniform(0, 900, 60), 15)
    air = 280 + 12 * np.sin(time / 7000) + 4 * np.sin(time / 1900)
    states = [np.array([300.0])]
    for g, a in zip(sun[:-1], air[:-1], strict=True):

        def rate(_, x, g=g, a=a):
            return (4.6 * g - 6.5 * (x - a) - 9e-8 * (x**4 - a**4)) / 6e4

        states.append(solve_ivp(rate, (0, 60), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    reading = np.array(states)[:, 0]
    reading = reading + 0.005 * reading.std() * rng.normal(size=900)
    inputs = {"G": sun, "Ta": air}
    record = make_record(collector(), "sky", time, {"T": reading}, inputs, hold="zero_order")
    run = spiral.discover(
        record, collector(), holdout=0.3,
        candidates=["radiation_exchange", "radiation_loss", "quadratic_loss", "cubic_loss"],
    )  # fmt: skip
    assert run.missing == ("radiation_exchange@T-Ta",)
    key = "radiation_exchange@T-Ta.rate"
    assert abs(run.model.values[key] - 9e-8 / 6e4) < 3 * run.model.errors[key]


def furnace():
    return spiral.system(
        ["Ce*Te' = P - h*(Te - Tw) - g*(Te - To)", "Cw*Tw' = h*(Te - Tw)"],
        states={"Te": "K", "Tw": "K"}, inputs={"P": "W", "To": "K"},
        parameters={"Ce": "45 kJ/K", "Cw": "110 kJ/K", "h": "17 W/K", "g": "6 W/K"},
        free=["h", "g"], observed=["Te"],
    )  # fmt: skip


@pytest.mark.slow
def test_radiation_between_a_muffle_and_its_ware_is_named_with_its_size():
    """One emissivity times area, 6.8e-9 W/K^4; the ware's temperature has no sensor."""
    rng, time, true = np.random.default_rng(5), 40.0 * np.arange(1500), 6.8e-9
    power = np.repeat(rng.uniform(0, 12e3, 50), 30)
    outside = 293 + 5 * np.sin(time / 9000)
    states = [np.array([500.0, 480.0])]
    for w, o in zip(power[:-1], outside[:-1], strict=True):

        def rate(_, x, w=w, o=o):
            through = 14.0 * (x[0] - x[1]) + true * (x[0] ** 4 - x[1] ** 4)
            return [(w - through - 7.0 * (x[0] - o)) / 45e3, through / 110e3]

        states.append(solve_ivp(rate, (0, 40.0), states[-1], rtol=1e-9, atol=1e-9).y[:, -1])
    read = np.array(states)[:, 0] + rng.normal(size=1500)
    inputs = {"P": power, "To": outside}
    record = make_record(furnace(), "furnace", time, {"Te": read}, inputs, hold="zero_order")
    run = spiral.discover(record, furnace(), holdout=0.3)
    assert run.missing == ("mutual_radiation@Te-Tw",)
    key = "mutual_radiation@Te-Tw.rate_Te"
    assert run.model.values[key] == pytest.approx(true / 45e3, abs=3 * run.model.errors[key])
