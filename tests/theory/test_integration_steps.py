"""Integration steps that a motion wants between its samples."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.systems.equations import Equations

import spiral
from spiral.types.record import make_record

MASS, AREA, STIFFNESS, DAMPING, FRICTION, WIDTH = 1.6, 0.0445, 2e5, 400.0, 400.0, 6e-3

_MODEL = """
equations: m*stem'' + c*stem' + k*stem = area*pressure
states: {stem: m}
inputs: {pressure: Pa}
parameters: {m: 1.6 kg, area: 0.0445 m^2, k: 1.8e5 N/m, c: 500 N*s/m}
free: [k, c]
observed: [stem]
"""


def _valve(dt, count, rng):
    """Pressure in steps, the stem's position from a solver for stiff equations."""
    levels = 1e5 + 6e4 * np.sin(np.cumsum(rng.normal(0.0, 0.4, count // 30 + 1)))
    pressure = np.repeat(levels, 30)[:count]
    states = [np.array([AREA * pressure[0] / STIFFNESS, 0.0])]
    for p in pressure[:-1]:

        def rate(t, x, p=p):
            friction = FRICTION * np.tanh(x[1] / WIDTH)
            return [x[1], (AREA * p - STIFFNESS * x[0] - DAMPING * x[1] - friction) / MASS]

        step = solve_ivp(rate, (0, dt), states[-1], method="LSODA", rtol=1e-9, atol=1e-12)
        states.append(step.y[:, -1])
    return pressure, np.array(states)[:, 0]


@pytest.mark.slow
def test_friction_that_is_passed_between_two_samples_leaves_no_random_force():
    """Where it turns, friction decays 80 times in a sample; none of the samples is slow enough.

    Steps that suit the samples alone are too long where it turns. What they do wrong looked like a
    random force, with a width and a level of friction that suit it.
    """
    dt, rng = 0.002, np.random.default_rng(5)
    pressure, stem = _valve(dt, 3000, rng)
    read = stem + 0.01 * stem.std() * rng.normal(size=len(stem))
    system = Equations(text=_MODEL)
    record = make_record(
        system, "valve", dt * np.arange(len(read)), {"stem": read}, {"pressure": pressure},
        hold={"pressure": "zero_order"},
    )  # fmt: skip
    run = spiral.discover(record, system, holdout=0.2, candidates=["coulomb_friction"])
    model, noise = run.model.estimates(), run.rounds[-1].comparison
    result = {k: e for part in model.values() for k, e in part.items()}
    assert (run.verdict, run.missing) == ("effect_missing", ("coulomb_friction",))
    assert noise.disturbed < 0.001
    for name, true in {"k": STIFFNESS, "c": DAMPING, "level": FRICTION, "width": WIDTH}.items():
        assert abs(result[name].estimate - true) < 3.5 * result[name].se, name
