"""Effects of whose values a record tells none: a law or one curve over the same state is named."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from spiral_plugins.effects.sensors import SensorLag

import spiral
from spiral.types.record import make_record

DT, SAMPLES, PEAK = 0.1, 2000, 0.08


def _roll(t, x, u, p):
    return {"phi": x.w, "w": (u.M - p.B * x.w - p.C * x.phi) / p.J}


def _question():
    """J phi'' + B phi' + C phi = M + a phi / (1 + (phi / p)^2), which the model does not have."""
    rng = np.random.default_rng(5)
    time = np.arange(SAMPLES) * DT
    tones = [(f, rng.uniform(0, 2 * np.pi)) for f in np.linspace(0.05, 0.35, 12)]

    def moment(t):
        return 22.0 * sum(np.sin(2 * np.pi * f * t + at) for f, at in tones)

    def rate(t, x):
        pull = 150.0 * x[0] / (1 + (x[0] / PEAK) ** 2)
        return [x[1], (moment(t) - 40.0 * x[1] - 300.0 * x[0] + pull) / 200.0]

    ends = (0, time[-1])
    phi = solve_ivp(rate, ends, [0, 0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=DT).y[0]
    seen = phi + 0.01 * phi.std() * rng.normal(size=SAMPLES)
    system = spiral.system(
        _roll, states={"phi": "rad", "w": "rad/s"}, inputs={"M": "N*m"}, observed=["phi"],
        parameters={"J": (200.0, "kg*m^2"), "B": (50.0, "N*m*s/rad"), "C": (250.0, "N*m/rad")},
        free=["B", "C"],
    )  # fmt: skip
    return make_record(system, "roll", time, {"phi": seen}, {"M": moment(time)}), system


@pytest.fixture(scope="module")
def question():
    """A record and its system."""
    return _question()


@pytest.mark.slow
def test_a_name_whose_values_the_record_does_not_tell_gives_way_to_a_curve(question):
    run = spiral.discover(
        *question,
        candidates=["clearance", "cogging"],
        strategy={"name": "likelihood", "laws": False},
    )
    assert run.verdict == "unknown_structure"
    assert run.missing == ()
    assert run.unknown["effect"] == "learned_spring"
    assert run.unknown["undetermined"] == ("clearance",)
    assert "no value of clearance" in run.summary


@pytest.mark.slow
def test_the_law_is_named_where_laws_are_tried(question):
    run = spiral.discover(*question, candidates=["clearance", "cogging"])
    assert run.missing == ("peak_law",)
    width = run.model.estimates()["peak_law"]["l"]
    assert abs(width.estimate - PEAK) < 2 * width.se
    assert width.se < 0.1 * PEAK
    assert "(a spring whose force falls again beyond a displacement" in run.summary


@pytest.mark.parametrize(("time", "scale", "is_delay"), [
    (1.0, 1.0, False), (2.0, 1.0, True), (1.3, 1.0, False), (5.0, None, False),
])  # fmt: skip
def test_a_lag_that_first_goes_the_other_way_is_none(time, scale, is_delay):
    """(1 + (z - T) s) / (1 + z s) has its zero on the right of the imaginary axis for T > z."""
    fitted = {"time_x": time} if scale is None else {"time_x": time, "scale": scale}
    assert bool(SensorLag().contradiction(fitted)) == is_delay
