"""How often an effect repeats with an angle, looked for beyond its grid."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.inference.evidence.spectrum import trial_counts
from spiral.inference.problem import silent
from spiral.types.record import make_record
from tests.scenes import registry

AXIS = """
equations: ["J*q'' = T - b*q'"]
states: {q: rad}
inputs: {T: {unit: N*m, interpolation: zero_order}}
parameters: {J: 900 kg*m^2, b: 5000 N*m*s/rad}
free: [J, b]
observed: [q]
"""


def test_trials_are_as_far_apart_as_the_angle_tells():
    """pi / R over a range R below two turns; whole numbers beyond; none where samples are rare."""
    slow = [np.linspace(0, 1.5, 3000)]
    counts, step = trial_counts(slow, 24.0)
    assert step == pytest.approx(np.pi / 1.5)
    assert counts[0] == pytest.approx(24 + step)
    assert len(counts) == 256
    assert np.diff(counts) == pytest.approx(step)
    round_and_round = [np.linspace(0, 40, 8000), np.linspace(0, 10, 100)]
    counts, step = trial_counts(round_and_round, 24.0)
    assert step == 1
    assert counts[0] == 25
    assert counts[-1] < np.pi / 2 / 0.005
    assert not len(trial_counts([np.linspace(0, 300, 1000)], 24.0)[0])
    assert not len(trial_counts([np.zeros(100)], 24.0)[0])


def test_a_worm_that_passes_often_is_named_with_its_number():
    """60 N m cos(41.3 q), over an angle of a radian or so."""
    system, rng = registry().make("system", "equations", {"text": AXIS}), np.random.default_rng(1)
    time, x, states = 0.1 * np.arange(1500), np.zeros(2), []
    torque = np.repeat(np.clip(np.cumsum(rng.normal(size=75)) * 150, -500, 500), 20)
    for u in torque:
        states.append(x[0])
        x = solve_ivp(
            lambda t, s, u=u: [s[1], (u - 5200 * s[1] + 60 * np.cos(41.3 * s[0])) / 950],
            (0, 0.1), x, rtol=1e-8, atol=1e-10,
        ).y[:, -1]  # fmt: skip
    angle = np.array(states)
    seen = angle + 0.002 * angle.std() * rng.normal(size=1500)
    record = make_record(system, "axis", time, {"q": seen}, {"T": torque})
    run = spiral.discover(record, system, progress=silent)
    assert run.missing == ("cogging",)
    told = run.model.estimates()["cogging"]
    assert told["count"].estimate == pytest.approx(41.3, abs=0.1)
    assert told["cosine"].estimate == pytest.approx(60, rel=0.05)
