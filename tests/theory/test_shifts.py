"""Machines that have no place of their own: common shifts of states."""

import numpy as np
import pytest

import spiral
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.shifts import common_shifts
from spiral.engine.filter.task import prepare_task
from spiral.engine.likelihood.noise import NoiseTerm, first_noise
from spiral.engine.likelihood.predict import predict_readings
from spiral.inference.simulate import integrate
from spiral.physics.compile import compile_model
from spiral.physics.trace import trace
from spiral.types.model import seed_model
from spiral.types.record import make_record

VALUES = {"system.k": 2e5, "system.c": 8e3}


def train(observed):
    """Two wagons behind a tractor; its speed and the first coupling's force are measured."""
    return spiral.system(
        ["m*a'' = F - d*a' - k*(a - b) - c*(a' - b')",
         "n*b'' = k*(a - b) + c*(a' - b') - d*b' - k*(b - e) - c*(b' - e')",
         "n*e'' = k*(b - e) + c*(b' - e') - d*e'"],
        states={"a": "m", "b": "m", "e": "m"}, inputs={"F": "N"},
        parameters={"m": "8000 kg", "n": "1e4 kg", "d": "240 N*s/m", "k": "2e5 N/m",
                    "c": "8e3 N*s/m"},
        free=["k", "c"], observed=observed,
    )  # fmt: skip


BLIND = ["a'", "pull = k*(a - b) + c*(a' - b')"]


def shifts_of(system):
    traced = trace(system, system.seed)
    model = seed_model(system, values={k: v for k, v in VALUES.items() if k in traced.keys})
    values = model.row("truth", "")
    compiled = compile_model(traced)
    return common_shifts(
        compiled, values, np.zeros(len(traced.inputs)), np.ones(len(traced.states))
    )


def test_a_train_whose_place_is_not_measured_may_be_anywhere():
    system = train(BLIND)
    shifts = shifts_of(system)
    at = [[s.name for s in system.states].index(n) for n in "abe"]
    assert len(shifts.anchors) == 1
    assert shifts.anchors[0] in at
    wanted = np.zeros((6, 1))
    wanted[at] = 1.0
    np.testing.assert_allclose(shifts.directions, wanted, atol=1e-12)


@pytest.mark.parametrize("system", [
    train(["a", BLIND[1]]), train(["b", "a'"]),
], ids=["first", "second"])  # fmt: skip
def test_one_whose_place_is_measured_has_one(system):
    assert shifts_of(system).anchors == ()


def test_a_spring_to_the_ground_gives_it_one():
    system = spiral.system(
        ["m*a'' = F - k*(a - b)", "m*b'' = k*(a - b) - g*b"], states={"a": "m", "b": "m"},
        inputs={"F": "N"}, parameters={"m": "1 kg", "k": "3 N/m", "g": "2 N/m"},
        observed=["a'", "b'"],
    )  # fmt: skip
    assert shifts_of(system).anchors == ()


def test_ties_are_the_motion_relative_to_the_anchor():
    shifts = shifts_of(train(BLIND))
    time = np.linspace(0, 10, 200)
    states = np.zeros((200, 6))
    names = [s.name for s in train(BLIND).states]
    for j, n in enumerate("abe"):
        states[:, names.index(n)] = 50 * time + 0.01 * np.sin((j + 1) * time)
    tied = shifts.tied_deviations(states)
    anchor = shifts.anchors[0]
    assert tied[anchor] == 0.0
    for n in "abe":
        if names.index(n) != anchor:
            apart = states[:, names.index(n)] - states[:, anchor]
            assert tied[names.index(n)] == pytest.approx(apart.std())
    assert np.isinf(tied[[i for i, n in enumerate(names) if n not in "abe"]]).all()


def test_a_filter_stays_with_a_train_that_drives_for_kilometres():
    """Also beside a drift of the force's sensor and with no random force."""
    system = train(BLIND)
    time = 0.1 * np.arange(4000)
    rng = np.random.default_rng(3)
    force = np.repeat(rng.uniform(500, 6000, 80), 50)
    model = seed_model(system, values=VALUES)
    _, readings = integrate(model, time, {"F": force})
    drift = np.cumsum(rng.normal(0, 12.0, 4000))
    noisy = {"a_rate": readings[:, 0] + rng.normal(0, 0.02, 4000),
             "pull": readings[:, 1] + drift + rng.normal(0, 20.0, 4000)}  # fmt: skip
    record = make_record(system, "r", time, noisy, {"F": force})
    task, settings = prepare_filter(prepare_task(model, record), ())
    noise = first_noise(task, 0.0).with_terms(
        (NoiseTerm("drift", "pull"),), {"drift.pull": 12.0 / 0.1**0.5}
    )
    noise = noise.with_values({"white.a_rate": 0.02, "white.pull": 20.0})
    run = predict_readings(task, settings, noise)
    assert run.whole
    assert np.mean(run.whitened[100:] ** 2) == pytest.approx(1.0, abs=0.1)


def test_slopes_whose_squares_are_no_numbers_are_slopes():
    """A reading that hardly follows its state, 1e-200 of it, beside a state of its own place."""
    system = spiral.system(
        ["a' = -k*(a - b)", "b' = k*(a - b)"], states={"a": "1", "b": "1"}, inputs={},
        parameters={"k": "1 1/s", "e": "1e-200"}, observed=["y = e*a"],
    )  # fmt: skip
    shifts = shifts_of(system)
    assert np.isfinite(shifts.directions).all()
    assert shifts.anchors == ()
