"""How a state acts on another: what comes late on its way, and where such a path is."""

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp

import spiral
from spiral.physics.trace import trace
from spiral.types.effect import StateFlow
from spiral.types.model import seed_model
from spiral.types.port import place_name
from spiral.types.record import make_record

STEP, COUNT, LATE = 2.0, 1500, 14.0
SEED_VALUES = {"V1": 20.0, "V2": 35.0, "h": 0.1}


def vessels(observed=("hot", "cold"), values=(22.0, 31.0, 0.12)):
    """Two stirred vessels that water flows through; its builder forgot the pipe between them."""

    def rhs(t, x, u, p):
        return [
            (u.flow * (u.inlet - x.hot) + u.heat / p.c) / p.V1,
            (u.flow * (x.hot - x.cold) - p.h * (x.cold - u.inlet)) / p.V2,
        ]

    v1, v2, h = values
    return spiral.system(
        rhs, states={"hot": "K", "cold": "K"},
        inputs={"flow": "kg/s", "inlet": "K", "heat": "W"},
        parameters={"V1": (v1, "kg"), "V2": (v2, "kg"), "h": (h, "kg/s"), "c": (4180.0, "J/kg/K")},
        observed=list(observed), free=["V1", "V2", "h"],
    )  # fmt: skip


def flown(system, late=0.0, mixed=0.0, noise=0.02, seed=0):
    """A record of the vessels, by SciPy: the first alone, then the second from what arrives."""
    rng, time = np.random.default_rng(seed), STEP * np.arange(COUNT)
    flow = np.repeat(rng.uniform(0.6, 1.6, COUNT // 30), 30)
    heat = np.repeat(rng.uniform(0, 60e3, COUNT // 25), 25)
    inlet = 285 + np.sin(time / 300)

    def held(values, t):
        return values[np.clip(np.floor(t / STEP + 1e-9).astype(int), 0, COUNT - 1)]

    v1, v2, h = SEED_VALUES.values()

    def integrate(rate, first):
        states, rows = [np.array(first)], []
        for k in range(COUNT - 1):
            ends = (time[k], time[k + 1])
            run = solve_ivp(rate, ends, states[-1], args=(k,), rtol=1e-9, atol=1e-9,
                            dense_output=True, method="DOP853")  # fmt: skip
            states.append(run.y[:, -1])
            rows.append(run.sol)
        return np.array(states), rows

    hot, pieces = integrate(
        lambda t, x, k: [(flow[k] * (inlet[k] - x[0]) + heat[k] / 4180) / v1], [290.0]
    )

    def arrived(t):
        at = t - late
        return 290.0 if at <= 0 else pieces[min(int(at / STEP), COUNT - 2)](at)[0]

    def second(t, x, k):
        seen = x[1] if mixed else arrived(t)
        own = [(arrived(t) - x[1]) / mixed] if mixed else [0.0]
        return [(flow[k] * (seen - x[0]) - h * (x[0] - inlet[k])) / v2, *own]

    cold, _ = integrate(second, [290.0, 290.0])
    clean = {"hot": hot[:, 0], "cold": cold[:, 0]}
    channels = {n: clean[n] + noise * rng.normal(size=COUNT) for n in system.observed}
    inputs = {"flow": flow, "inlet": inlet, "heat": heat}
    return make_record(system, "vessels", time, channels, inputs, hold="zero_order")


def test_paths_are_those_that_the_equations_give_one_state_to_another():
    assert [place_name(p) for p in vessels().by_driver["path"]] == ["cold-hot"]


class Replaced(StateFlow):
    """The driver of a path is replaced by half of it."""

    driver = "path"
    parameters = ()

    def flow(self, at, u, p):
        """f(v / 2) - f(v)."""
        return [at.along_path(at.position[0] / 2)]


def test_another_value_of_the_driver_takes_its_place_there_and_nowhere_else():
    system = vessels()
    alone = trace(system, seed_model(system).effects)
    changed = trace(system, (*seed_model(system).effects, Replaced(port="cold-hot")))
    hot = alone.x[alone.states.index("hot")]
    expected = [alone.rate[0], alone.rate[1].subs(hot, hot / 2)]
    pairs = zip(changed.rate, expected, strict=True)
    assert all(sp.simplify(a - b) == 0 for a, b in pairs)


@pytest.mark.parametrize(
    ("kind", "made"), [("path_delay", {"late": LATE}), ("path_lag", {"mixed": LATE})]
)
def test_what_comes_late_is_found_with_its_time(kind, made):
    system = vessels()
    run = spiral.discover(flown(system, **made), system, holdout=0.3)
    assert run.missing == (f"{kind}@cold-hot",)
    value = run.model.values[f"{kind}@cold-hot.time"]
    error = run.model.errors[f"{kind}@cold-hot.time"]
    assert value == pytest.approx(LATE, abs=3 * error)
    assert error < 0.05 * LATE
