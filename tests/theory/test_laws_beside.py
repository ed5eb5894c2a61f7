"""Laws that are tried beside what was admitted, where a random force carries the model."""

import numpy as np
import pytest

import spiral
from spiral.types.record import make_record

DT = 5.0


def _steps(rng, samples, low, high, fewest, most):
    values = []
    while len(values) < samples:
        values += [rng.uniform(low, high)] * int(rng.integers(fewest, most))
    return np.array(values[:samples])


def _slow(rng, samples, time):
    keep = np.exp(-DT / time)
    noise = [rng.normal()]
    for _ in range(samples - 1):
        noise.append(keep * noise[-1] + np.sqrt(1 - keep**2) * rng.normal())
    return np.array(noise)


def cryostat():
    """A cold stage, a strap that no sensor sees, and a sample with a heater."""
    return spiral.system(
        ["C1*T1' = G12*(T2 - T1) - kq*s*(T1 - Tb) + Gw*(Ta - T1)",
         "C2*T2' = G23*(T3 - T2) - G12*(T2 - T1)", "C3*T3' = P - G23*(T3 - T2)"],
        states={"T1": "K", "T2": {"unit": "K", "like": "T1"}, "T3": "K"},
        inputs={"P": {"unit": "W", "interpolation": "zero_order"},
                "s": {"unit": "1", "interpolation": "zero_order"}},
        parameters={"C1": "400 J/K", "C2": "200 J/K", "Tb": "25 K", "Gw": "0.01 W/K", "Ta": "293 K",
                    "G12": {"value": 1.7, "unit": "W/K", "lower": 0},
                    "G23": {"value": 0.72, "unit": "W/K", "lower": 0},
                    "kq": {"value": 0.66, "unit": "W/K", "lower": 0},
                    "C3": {"value": 135, "unit": "J/K", "lower": 0}},
        free=["G12", "G23", "kq", "C3"], observed=["T1", "T3"],
    )  # fmt: skip


def measured(seed, samples):
    """3 W leak into the strap, and the sample's heat capacity is 45 J/K + 1.75 J/K^2 T."""
    rng = np.random.default_rng(seed)
    heat = _steps(rng, samples, 0, 30, 12, 240)
    drive = _steps(rng, samples, 0.3, 1, 40, 400)
    a, b, c, seen = 50.0, 60.0, 70.0, []
    for k in range(samples):
        seen.append((a, c))
        for _ in range(50):
            q, w = 1.5 * (b - a), 0.8 * (c - b)
            rates = ((q - 0.6 * drive[k] * (a - 25) + 0.01 * (293 - a)) / 400,
                     (w - q + 3.0) / 200, (heat[k] - w) / (45 + 1.75 * c))  # fmt: skip
            a, b, c = (x + DT / 50 * r for x, r in zip((a, b, c), rates, strict=True))
    read = np.array(seen)
    for column in read.T:
        size = 0.007 * column.std()
        column += size * rng.normal(size=samples) + size * _slow(rng, samples, 60.0)
    given = {"T1": read[:, 0], "T3": read[:, 1]}
    return make_record(cryostat(), f"r{seed}", DT * np.arange(samples), given,
                       {"P": heat, "s": drive})  # fmt: skip


@pytest.mark.slow
def test_a_leak_and_a_heat_capacity_that_grows_are_both_named():
    """With the leak alone what is missed is white, beside a force that carries a free run."""
    run = spiral.discover(measured(1, 4000), cryostat(), test=measured(2, 2000))
    assert run.missing[0] == "constant_flow@T2"
    assert any(m.endswith("_change@C3-T3") for m in run.missing)
    last = run.rounds[-1].comparison
    assert last.test_error < 1.15 * last.noise_floor
    leak = run.model.estimates()["constant_flow@T2"]["flow"]
    assert abs(leak.estimate - 0.015) < 3 * leak.se
