"""Short records end in an answer, never in a crash."""

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

from spiral.inference.discover import discover
from spiral.inference.simulate import simulate
from spiral.types.model import Model, seed_model
from tests.scenes import admitted, effect, planar_problem


def _record(samples: int, seed: int):
    base = seed_model(Oscillator())
    truth = {
        "system.mass": 1.0,
        "linear_stiffness.stiffness": 60.0,
        "linear_damping.damping": 0.4,
        "cubic_stiffness.stiffness": 4e4,
    }
    model = Model(base.system, (*base.effects, effect("cubic_stiffness")), truth)
    time = 0.01 * np.arange(samples)
    force = np.sin(2 * np.pi * (1 + 0.5 * time) * time)
    return simulate(model, time, {"force": force}, 0.01, np.random.default_rng(seed))


@pytest.mark.parametrize("samples", [64, 65, 100, 240, 500])
def test_a_short_record_is_answered(samples):
    base = seed_model(Oscillator())
    run = discover(planar_problem(_record(samples, 1), _record(samples, 2), base))
    assert run.verdict in ("effect_missing", "unknown_structure", "not_identifiable")
    if samples >= 240:
        assert admitted(run)[0] == "cubic_stiffness"
