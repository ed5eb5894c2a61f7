"""Several records of one machine: angles, sample rates and halves of their own."""

from dataclasses import replace

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.compare import compare
from spiral.inference.discover import discover
from spiral.inference.simulate import simulate
from spiral.types.model import Model, seed_model
from tests.scenes import SEED_TRUTH, effect, planar_problem, planar_record


@pytest.mark.parametrize("measured", [(False, True), (False, False), (True, True)])
def test_every_record_finds_its_own_angle(measured):
    phases = (0.4, 0.4 if all(measured) else 0.4 + np.pi)
    records = tuple(
        planar_record(s, phase=p, duration=6.0, with_phase=m)
        for s, p, m in zip((1, 2), phases, measured, strict=True)
    )
    problem = replace(
        planar_problem(records[0], planar_record(101, phase=2.0, duration=6.0)), records=records
    )
    found = compare(problem)
    assert found.chi2_per_dof == pytest.approx(1.0, abs=0.04)
    moment = found.model.estimates()["unbalance"]["moment"].estimate
    assert abs(moment) == pytest.approx(SEED_TRUTH["unbalance.moment"], rel=0.01)
    assert found.test_error <= 1.1 * found.noise_floor


def _oscillation(rate: float, seed: int):
    base = seed_model(Oscillator())
    truth = {
        "system.mass": 1.0,
        "linear_stiffness.stiffness": 40_000.0,
        "linear_damping.damping": 4.0,
    }
    fine = np.arange((8 * 2000) + 1) / 2000.0
    force = np.sin(2 * np.pi * (10 + 3 * fine) * fine)
    rng = np.random.default_rng(seed)
    record = simulate(Model(base.system, base.effects, truth), fine, {"force": force}, 0.02, rng)
    step = int(2000 / rate)
    return replace(
        record,
        time=record.time[::step],
        channels={k: v[::step] for k, v in record.channels.items()},
        inputs={k: v[::step] for k, v in record.inputs.items()},
    )


def test_a_test_record_may_be_sampled_more_slowly():
    base = seed_model(Oscillator())
    found = compare(planar_problem(_oscillation(2000, 1), _oscillation(250, 2), base))
    assert found.test_error <= 1.1 * found.noise_floor


def test_a_model_without_anything_to_fit_is_still_answered():
    base = Model(Oscillator(), (), {"system.mass": 1.0}, fixed=("system.mass",))
    problem = planar_problem(_oscillation(500, 1), _oscillation(500, 2), base)
    problem = replace(problem, candidates=(effect("linear_stiffness"), effect("linear_damping")))
    run = discover(problem)
    assert run.rounds[1].admitted == ("linear_stiffness",)
