"""What one step from the model's own fit does not show: tried from other fits, and two at once."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

import spiral
from spiral.types.parameter import Parameter

C, K, CUBIC, OFFSET, DT, SAMPLES = 2.0, 900.0, -2e5, 0.3, 0.005, 2500


def _softening(folder, seed):
    """A softening spring shaken around its resonance; its sensor is off by a constant."""
    rng, t = np.random.default_rng(seed), np.arange(SAMPLES) * DT
    band = butter(3, (0.5, 10), "band", fs=1 / DT, output="sos")
    force = sosfiltfilt(band, rng.normal(size=SAMPLES))
    force *= 2.5 / force.std()
    drive = CubicSpline(t, force)

    def rate(s, x):
        return [x[1], drive(s) - C * x[1] - K * x[0] - CUBIC * x[0] ** 3]

    x = solve_ivp(rate, (0, t[-1]), [0, 0], "DOP853", t, rtol=1e-9, atol=1e-12, max_step=DT).y[0]
    seen = x + x.std() * (OFFSET + 0.01 * rng.normal(size=SAMPLES))
    path = folder / "softening.csv"
    table = np.column_stack([t, seen, force])
    np.savetxt(path, table, "%.9g", ",", header="t,s,F", comments="")
    return path, OFFSET * x.std()


def _system():
    def rate(t, x, u, p):
        return [x["v"], (u["F"] - p["c"] * x["v"] - p["k"] * x["s"]) / p["m"]]

    return spiral.system(
        rate, states={"s": "m", "v": "m/s"}, inputs={"F": "N"}, observed=["s"],
        parameters={"m": (1.0, "kg"), "c": (2.3, "N*s/m"), "k": (765.0, "N/m")},
        free=["c", "k"],
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_softening_spring_is_no_hysteresis_and_an_offset_is_no_noise(tmp_path, seed):
    """Alone the spring runs free worse than none, and coloured noise takes the offset."""
    path, offset = _softening(tmp_path, seed)
    system = _system()
    run = spiral.discover(spiral.read(path, system, time="t"), system)
    assert set(run.missing) == {"cubic_stiffness", "offset"}
    found = run.model.estimates()
    spring, zero = found["cubic_stiffness"]["stiffness"], found["offset"]["offset"]
    assert spring.se
    assert abs(spring.estimate - CUBIC) < 4 * spring.se
    assert zero.se
    assert abs(zero.estimate - offset) < 4 * zero.se + 0.01 * offset


@pytest.mark.parametrize(
    ("value", "at"), [(2.0, True), (-1.0, True), (1.0, False), (1.9, False), (0.0, False)]
)
def test_a_shape_at_an_end_of_its_range_is_told_from_its_first_value(value, at):
    assert Parameter("n", lower=-1.0, upper=2.0, start=1.0, role="shape").at_bound(value) is at
    assert not Parameter("w", lower=0.0, role="shape").at_bound(0.0)
    assert not Parameter("n", lower=1.0, upper=10.0, start=1.0, role="shape").at_bound(1.0)
