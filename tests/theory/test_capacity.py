"""The capacity of a state of first order: what flows into it is divided by."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.types.record import make_record

CHAMBER = {
    "states": {"x": "m", "p": {"unit": "Pa", "start": 3e5}},
    "inputs": {"F": "N", "mdot": "kg/s"},
    "constants": {"RT": "84100 J/kg"},
    "parameters": {"m": "4 kg", "k": "3e4 N/m", "A": "1e-3 m^2", "V": "1e-4 m^3", "pa": "1e5 Pa"},
    "observed": ["x", "p"],
}
PISTON = "m*x'' + k*x = A*(p - pa) + F"


def capacities(equation, **given):
    whole = {**CHAMBER, "equations": [PISTON, equation], **given}
    return dict(spiral.system(whole).form.capacities)


@pytest.mark.parametrize("equation", [
    "p' = (RT*mdot - p*A*x')/(V + A*x)",
    "(V + A*x)*p' = RT*mdot - p*A*x'",
])  # fmt: skip
def test_a_chamber_that_a_piston_widens_has_its_volume(equation):
    assert capacities(equation) == {"p": "(A*x + V)/V"}


@pytest.mark.parametrize("equation", [
    "p' = RT*mdot/V - p*A*x'/V",  # no change
    "p' = RT*mdot/V - p*A*x'/(V + A*x)",  # not of all terms
    "p' = -p*A*x'/(V + A*x)",  # one law, not several flows
    "p' = (RT*mdot - p*A*x'/(1 + A*x/V))/V",  # within one term
])  # fmt: skip
def test_what_only_one_term_is_divided_by_is_no_capacity(equation):
    assert capacities(equation) == {}


def test_a_tank_that_widens_has_its_surface_over_that_where_it_begins():
    tank = spiral.system(
        ["(a0 + a1*h)*h' = q - c*h"],
        states={"h": {"unit": "m", "start": 2.0}}, inputs={"q": "m^3/s"}, observed=["h"],
        parameters={"a0": (1.0, "m^2"), "a1": (0.5, "m"), "c": (0.1, "m^2/s")},
    )  # fmt: skip
    (formula,) = dict(tank.form.capacities).values()
    assert formula == "(a0 + a1*h)/(a0 + 2.0*a1)"


def leaking(seed, leak):
    """Two chambers beside a piston that a force moves, with a leak between them, by SciPy."""
    time, rng = np.arange(2500) * 2e-3, np.random.default_rng(seed)
    waves = 2 * np.pi * rng.uniform(0.5, 6.0, (3, 8)), rng.uniform(0, 6.28, (3, 8))

    def given(t):
        signs = np.sin(np.multiply.outer(t, waves[0]) + waves[1]).sum(axis=-1)
        return signs * np.array([20.0, 3e-4, 3e-4])

    def rate(t, s):
        x, v, pa, pb = s
        force, ma, mb = given(t)
        flow = leak * (pa - pb)
        return [
            v,
            (1e-3 * (pa - pb) + force - 90.0 * v - 3e3 * x) / 4.0,
            (84100 * (ma - flow) - pa * 1e-3 * v) / (1e-4 + 1e-3 * x),
            (84100 * (mb + flow) + pb * 1e-3 * v) / (2e-4 - 1e-3 * x),
        ]

    run = solve_ivp(rate, time[[0, -1]], [0, 0, 3e5, 3e5], t_eval=time, method="LSODA",
                    rtol=1e-8, atol=1e-8, max_step=2e-3)  # fmt: skip
    read = {n: row + 0.005 * row.std() * rng.normal(size=row.size)
            for n, row in zip(("x", "pA", "pB"), run.y[[0, 2, 3]], strict=True)}  # fmt: skip
    u = dict(zip(("F", "mA", "mB"), given(time).T, strict=True))
    system = spiral.system(
        [
            "m*x'' + c*x' + k*x = A*(pA - pB) + F",
            "pA' = (RT*mA - pA*A*x')/(VA + A*x)",
            "pB' = (RT*mB + pB*A*x')/(VB - A*x)",
        ],
        states={"x": "m", "pA": "Pa", "pB": "Pa"},
        inputs={"F": "N", "mA": "kg/s", "mB": "kg/s"}, observed=["x", "pA", "pB"],
        parameters={"m": (4.0, "kg"), "c": (80.0, "N*s/m"), "k": (2.7e3, "N/m"),
                    "A": (1e-3, "m^2"), "VA": (1.1e-4, "m^3"), "VB": (1.8e-4, "m^3"),
                    "RT": (84100.0, "J/kg")},
        free=["c", "k", "VA", "VB"],
    )  # fmt: skip
    return make_record(system, "cylinder", time, read, u), system


@pytest.mark.slow
def test_a_leak_past_a_piston_is_one_flow_over_two_volumes():
    """Rates at rest are the same mass flow over either volume; nothing else is missing."""
    run = spiral.discover(
        *leaking(0, 3e-9),
        candidates=["exchange@pA-pB", "orifice_exchange@pA-pB", "cubic_stiffness", "linear_loss"],
    )
    assert run.missing == ("exchange@pA-pB",)
    found = run.model.estimates()["exchange@pA-pB"]
    for side, volume in {"pA": 1e-4, "pB": 2e-4}.items():
        rate = found[f"rate_{side}"]
        assert rate.estimate == pytest.approx(84100 * 3e-9 / volume, abs=4 * rate.se)
    last = run.rounds[-1].comparison
    assert last.test_error < 1.1 * last.noise_floor
