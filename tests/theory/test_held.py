"""Where a record cannot tell a model's own parameters apart, one is held and the search goes on."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral

MASS, C, K, CUBIC, DT, SAMPLES = 2.0, 1.0, 800.0, 6e4, 0.004, 2500
GIVEN = 2.4  # kg: what the model says of the mass


def _records(folder, cubic):
    """Two free decays: the mass, the damping and every spring have one scale in common."""
    t, found = np.arange(SAMPLES) * DT, []

    def rate(s, x):
        return [x[1], -(C * x[1] + K * x[0] + cubic * x[0] ** 3) / MASS]

    for i, start in enumerate((0.1, -0.07)):
        x = solve_ivp(rate, (0, t[-1]), [start, 0], "DOP853", t, rtol=1e-10, atol=1e-12).y[0]
        seen = x + 2e-4 * np.random.default_rng(i).normal(size=SAMPLES)
        path = folder / f"decay_{i}.csv"
        table = np.column_stack([t, seen, 0 * t])
        np.savetxt(path, table, "%.9g", ",", header="t,x,force", comments="")
        found.append(path)
    return found


def _study(folder, system, cubic, **choices):
    fitted, unseen = (spiral.read(p, system, time="t") for p in _records(folder, cubic))
    return spiral.discover(fitted, system, test=unseen, **choices)


def _function():
    def rate(t, x, u, p):
        return [x["v"], -(p["c"] * x["v"] + p["k"] * x["x"]) / p["m"]]

    return spiral.system(
        rate, states={"x": "m", "v": "m/s"}, observed=["x"],
        parameters={"m": (GIVEN, "kg"), "c": (1.3, "N*s/m"), "k": (850.0, "N/m")},
        free=["m", "c", "k"],
    )  # fmt: skip


def test_a_spring_is_found_though_only_ratios_to_the_mass_are_told(tmp_path):
    """What no decay tells is the one scale of mass, damping and springs; it keeps a given value."""
    run = _study(tmp_path, _function(), CUBIC)
    assert run.missing == ("cubic_stiffness",)
    (held,) = run.rounds[0].details["tied"]["parameters"]
    assert f"{held} keeps the value that it was given" in run.summary
    found = run.model.estimates()
    spring, scale = found["cubic_stiffness"]["stiffness"], found["system"]["m"].estimate / MASS
    assert spring.se
    assert abs(spring.estimate - CUBIC * scale) < 4 * spring.se < 0.08 * CUBIC * scale


def test_nothing_is_invented_and_what_is_not_told_is_said(tmp_path):
    run = _study(tmp_path, _function(), 0.0)
    assert (run.verdict, run.missing) == ("nothing_missing", ())
    assert set(run.alias_groups[0]) == {"system.m", "system.c", "system.k"}
    assert "keeps the value that it was given" in run.summary


@pytest.mark.slow
def test_parameters_without_given_values_are_held_at_fitted_ones(tmp_path):
    """Of two springs in parallel only the sum is told; what is missing is still the question."""

    def rate(t, x, u, p):
        force = u["force"] - p["c"] * x["v"] - (p["inner"] + p["outer"]) * x["x"]
        return [x["v"], force / p["m"]]

    system = spiral.system(
        rate, states={"x": "m", "v": "m/s"}, observed=["x"], inputs={"force": "N"},
        parameters={"m": (MASS, "kg"), "c": "N*s/m", "inner": "N/m", "outer": "N/m"},
    )  # fmt: skip
    run = _study(tmp_path, system, CUBIC)
    assert run.missing == ("cubic_stiffness",)
    found = run.model.estimates()
    assert found["system"]["inner"].estimate + found["system"]["outer"].estimate == pytest.approx(
        K, rel=0.01
    )
    null = _study(tmp_path, system, 0.0)
    assert null.verdict == "nothing_missing"
    ((held, value),) = null.rounds[0].details["tied"]["fitted"].items()
    assert f"{held} was not given: {held} = " in null.summary
    assert value == null.model.estimates()["system"][held.removeprefix("system.")].estimate


def test_effects_tied_to_one_another_are_refused_where_nothing_else_is_found(tmp_path):
    """The same decay of a model put together of effects: a candidate may be a sum of them."""
    run = _study(
        tmp_path, "oscillator", 0.0, values={"system.mass": GIVEN}, free=["system.mass"]
    )  # fmt: skip
    assert run.verdict == run.stopped == "not_identifiable"
    assert set(run.alias_groups[0]) == {"system", "linear_stiffness", "linear_damping"}
    assert not run.missing
    assert "keeps the value that it was given" in run.summary
