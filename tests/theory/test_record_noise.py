"""Records whose sensors are not equally noisy are weighted each by its own noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import spiral
from spiral.types.record import make_record

STEP, QUIET, LOUD = 0.02, 0.002, 0.012


def lung():
    return spiral.system(
        ["R*V' = P - E*V", "S*W' = P - F*W"], states={"V": "L", "W": "L"}, inputs={"P": "kPa"},
        parameters={"E": "2.6 kPa/L", "R": "0.8 kPa*s/L", "F": "5 kPa/L", "S": "17 kPa*s/L"},
        free=["E", "R", "S"], observed=["T = V + W"],
    )  # fmt: skip


def record(seed, height, noise, count=600):
    """A pressure step after a third of the record, on a lung with E = 2.1, R = 0.95, S = 14."""
    time = STEP * np.arange(count)
    pressure = np.where(np.arange(count) < count // 3, 0.3, height)
    states = [np.array([0.3 / 2.1, 0.3 / 5])]
    for p in pressure[:-1]:

        def rate(_, x, p=p):
            return [(p - 2.1 * x[0]) / 0.95, (p - 5 * x[1]) / 14]

        states.append(solve_ivp(rate, (0, STEP), states[-1], rtol=1e-9, atol=1e-12).y[:, -1])
    total = np.sum(states, axis=1) + noise * np.random.default_rng(seed).normal(size=count)
    inputs = {"P": pressure}
    return make_record(lung(), f"{seed}", time, {"T": total}, inputs, hold="zero_order")


def test_each_record_is_weighted_by_its_own_noise():
    """With one noise for both, a random flow of a fifth of the machine's own would make it up."""
    both = (record(1, 0.8, QUIET), record(2, 2.0, LOUD))
    run = spiral.discover(both, lung(), test=record(3, 1.4, 0.006), candidates=["cubic_loss"])
    assert run.verdict == "nothing_missing"
    said = next(d for d in run.final.departures if "differs between the records" in d)
    sizes = [float(word.strip("(,")) for word in said.split() if word.strip("(,")[:1] == "0"]
    assert sizes == pytest.approx([QUIET, LOUD], rel=0.1)
    assert run.final.random == {}
    assert run.final.noise_floor == pytest.approx(run.final.test_error, rel=0.15)
    for key, value in (("system.E", 2.1), ("system.R", 0.95), ("system.S", 14.0)):
        assert abs(run.model.values[key] - value) < 3.5 * run.model.errors[key]


def test_records_that_are_equally_noisy_have_one_noise():
    both = (record(1, 0.8, QUIET), record(2, 2.0, QUIET))
    told = spiral.compare(both, lung(), test=record(3, 1.4, QUIET))
    assert not any("differs between the records" in d for d in told.departures)
