"""A hidden state that moves no faster than a limit."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.effects.losses import SlewLimit

import spiral
from spiral.types.port import At
from spiral.types.record import make_record

LIMIT = 0.6  # 1/s


def vane(seed, limit):
    """What a vane moves is measured; its servo, which follows a command in steps, is not."""
    time, rng = np.arange(3000) * 0.02, np.random.default_rng(seed)
    asked = np.repeat(rng.uniform(-0.5, 0.5, 60), 50)

    def rate(t, s):
        x, v, b = s
        servo = (asked[min(int(t / 0.02 + 1e-9), 2999)] - b) / 0.3
        return [v, 20.0 * b - 1.5 * v - 9.0 * x, np.clip(servo, -limit, limit)]

    run = solve_ivp(rate, time[[0, -1]], [0.0] * 3, t_eval=time, rtol=1e-7, max_step=0.01)
    x = run.y[0] + 0.01 * run.y[0].std() * rng.normal(size=3000)
    system = spiral.system(
        ["x'' + c*x' + k*x = a*b", "tau*b' = u - b"],
        states={"x": "rad", "b": "rad"}, inputs={"u": "rad"}, observed=["x"],
        parameters={"c": (1.3, "1/s"), "k": (8.0, "1/s^2"), "a": (18.0, "1/s^2"),
                    "tau": (0.36, "s")}, free=["c", "k", "a", "tau"],
    )  # fmt: skip
    return make_record(system, "vane", time, {"x": x}, {"u": asked}), system


OFFERED = ["slew_limit@b", "linear_loss@b", "hidden_store@b", "actuator_lag", "input_saturation"]


def test_a_limit_is_the_rate_below_and_the_limit_beyond():
    effect, p = SlewLimit(), SimpleNamespace(share=1.0, rate=2.0)
    own = np.array([-6.0, -1.4, 0.2, 1.4, 2.8, 40.0])
    (flow,) = effect.flow(At((own,), (own,), SimpleNamespace()), None, p)
    np.testing.assert_allclose(own + flow, np.clip(own, -2.0, 2.0), rtol=0.011)


def test_the_limit_of_a_hidden_servo_is_named_and_measured():
    run = spiral.discover(*vane(0, LIMIT), candidates=OFFERED)
    assert run.missing == ("slew_limit@b",)
    found = run.model.estimates()["slew_limit@b"]
    assert found["rate"].estimate == pytest.approx(LIMIT, rel=0.03)
    last = run.rounds[-1].comparison
    assert last.test_error < 1.15 * last.noise_floor


def test_a_servo_without_a_limit_lacks_nothing():
    assert spiral.discover(*vane(1, np.inf), candidates=OFFERED).missing == ()
