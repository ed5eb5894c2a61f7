"""Named parts of equations are variables that a parameter may follow, as states and inputs are."""

import numpy as np
import pytest
import sympy as sp
import yaml
from scipy.integrate import solve_ivp
from spiral_plugins.effects.varying import InverseQuadraticChange, LinearChange

import spiral
from spiral.inference.evidence.scales import largest_port_motion
from spiral.physics.signatures import SystemMotion, signatures
from spiral.physics.trace import trace
from spiral.types.parameter import State
from spiral.types.placement import at_every_place
from spiral.types.record import make_record

MOTOR = yaml.safe_load("""
equations: ["L*i' = V - e", "m*x'' + c*x' + k*x = f"]
let: {e: R*i + b*x', f: b*i + loss, loss: d*x'^2, again: x, push: m*x'' + V*i*s}
states: {x: m, i: A}
inputs: {V: V}
parameters: {L: 1 H, R: 2 ohm, b: 3 N/A, m: 1 kg, c: 1 N*s/m, k: 9 N/m, d: 2 N*s^2/m^2, s: 1 N/W}
observed: [i, x]
""")
POND = yaml.safe_load("""
equations: ["X' = (growth - D)*X"]
let: {light: I*(1 - exp(-a*X))/(a*X), growth: mu*light/(K + light)}
states: {X: {unit: g/L, start: 0.3}}
inputs: {I: {unit: umol, interpolation: zero_order}, D: {unit: 1/s, interpolation: zero_order}}
parameters: {mu: 0.3 1/s, K: 90 umol, a: 2 L/g}
free: [mu, K]
observed: [X]
""")
HELD, STEP = 20, 0.5  # samples, s


def light_of(X, I):  # noqa: E741
    return I * (1 - np.exp(-2 * X)) / (2 * X)


def pond_record(system, strength, seed, count=1200):
    """Growth mu L / (K + L) / (1 + s L^2) under light and dilution that change every 10 s."""
    rng = np.random.default_rng(seed)
    light, dilution = (
        np.repeat(rng.uniform(low, high, count // HELD), HELD)
        for low, high in ((60, 900), (0.02, 0.12))
    )
    X, now = np.zeros(count), np.array([0.3])
    for k in range(count):
        X[k] = now[0]

        def rate(_, x, k=k):
            seen = light_of(x, light[k])
            growth = 0.28 * seen / (100 + seen) / (1 + strength * seen**2)
            return (growth - dilution[k]) * x

        now = solve_ivp(rate, (0, STEP), now, rtol=1e-8, atol=1e-10).y[:, -1]
    seen = X + 0.01 * X.std() * rng.normal(size=count)
    time = np.arange(count) * STEP
    return make_record(system, f"seed {seed}", time, {"X": seen}, {"I": light, "D": dilution})


def test_what_is_named_of_two_variables_is_a_variable_with_its_unit():
    system = spiral.system(MOTOR)
    assert system.auxiliaries == (State("e", "V"), State("f", "N"))
    followed = {p.against for p in system.varied}
    assert followed == {"x", "x_rate", "i", "V", "time", "e", "f"}
    assert spiral.system(POND).auxiliaries == (State("light", "umol"), State("growth", "1/s"))


def test_the_traced_model_is_the_system_with_the_parameter_times_the_factor():
    system = spiral.system(MOTOR)
    plain, varied = trace(system, ()), trace(system, (LinearChange(port="R-f"),))
    at = dict(zip(varied.keys, varied.p, strict=True))
    x = dict(zip(varied.states, varied.x, strict=True))
    named = at["system.b"] * x["i"] + at["system.d"] * x["x_rate"] ** 2
    beyond = named - at["linear_change@R-f.reference"]
    acting = at["system.R"] * (1 + at["linear_change@R-f.slope"] * beyond)
    swap = {s: at[k] for k, s in zip(plain.keys, plain.p, strict=True)} | {
        plain.p[plain.keys.index("system.R")]: acting
    }
    for before, after in zip(plain.rate, varied.rate, strict=True):
        assert sp.simplify(sp.sympify(before).subs(swap, simultaneous=True) - after) == 0


def test_the_slope_along_a_motion_is_the_derivative_of_the_traced_model():
    system, rng = spiral.system(POND), np.random.default_rng(1)
    states, inputs = rng.uniform(0.2, 2.0, (7, 1)), rng.uniform(0.1, 3.0, (7, 3))
    values = {"mu": 0.3, "K": 90.0, "a": 2.0}
    effect = LinearChange(port="mu-light")
    traced = trace(system, (effect,))
    rows = [[*x, *u, *values.values(), 0.0, 0.0] for x, u in zip(states, inputs, strict=True)]

    def along(key, scale=1.0):
        symbol = traced.p[traced.keys.index(key)]
        slopes = sp.lambdify(
            [*traced.x, *traced.u, *traced.p], [sp.diff(r, symbol) for r in traced.rate], "numpy"
        )
        return np.array([slopes(*row) for row in rows]) * scale

    own = {"system.mu": (along("system.mu", 0.3), np.zeros((7, 1)))}
    motion = SystemMotion(
        system, states, inputs, along("system.mu"), states, values, by_parameter=own
    )
    pushes, _ = signatures(motion, effect, {})
    np.testing.assert_allclose(pushes[:, :, 0], along(f"{effect.label}.slope"), rtol=1e-6)


def test_its_largest_value_is_that_of_the_formula_along_the_records():
    system = spiral.system(POND)
    record = pond_record(system, 0.0, 0, 600)
    states = record.channels["X"][:, None]
    largest = largest_port_motion(system, (record,), (states,))
    expected = light_of(states[:, 0], record.inputs["I"]).max()
    shown = largest["parameter mu with light.position"]
    assert shown == pytest.approx(expected, rel=0.3)  # inputs that jump are means there


def study(strength, places=(), samples=600):
    """Growth that light inhibits, or does not; ``places`` are parameters that may change."""
    system = spiral.system(POND)
    offered = [e for e in at_every_place(system, InverseQuadraticChange())
               if not places or system.place(e).axes[0] in places]  # fmt: skip
    train, test = (pond_record(system, strength, seed, samples) for seed in (3, 4))
    return spiral.discover(
        train, system, test=test, values={"system.mu": 0.25, "system.K": 80.0}, candidates=offered
    )


def test_growth_that_light_inhibits_is_named():
    run = study(4e-6, places=("mu",))
    (label,) = (e.label for e in run.model.effects)
    assert label == "inverse_quadratic_change@mu-light"
    curvature = run.model.estimates()[label]["curvature"]
    assert curvature.estimate == pytest.approx(4e-6, abs=3 * curvature.se)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strength", "expected"), [(4e-6, ["inverse_quadratic_change@mu-light"]), (0.0, [])]
)
def test_among_all_places_it_alone_is_named_and_nothing_where_nothing_is_missing(
    strength, expected
):
    assert [e.label for e in study(strength, samples=1200).model.effects] == expected
