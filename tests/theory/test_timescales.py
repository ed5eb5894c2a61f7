"""A record whose time does not meet the model's."""

import numpy as np
import pytest
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.engine.filter.task import prepare_task
from spiral.inference.likelihood.timescales import time_scale_sentences
from spiral.types.model import seed_model
from spiral.types.record import make_record

VALUES = {"system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 2.0}


def sentences(dt):
    """Those of an oscillator of 20 rad/s with 400 samples so far apart."""
    rng = np.random.default_rng(1)
    record = make_record(
        Oscillator(), "r", dt * np.arange(400), {"x": rng.normal(size=400)},
        {"force": rng.normal(size=400)},
    )  # fmt: skip
    model = seed_model(Oscillator(), values=VALUES)
    return time_scale_sentences(prepare_task(model, record, substeps=1), VALUES)


@pytest.mark.parametrize(("dt", "word"), [(2.0, "is over within one sample (2 s)"),
                                          (2e-6, "hardly begins in this record")])  # fmt: skip
def test_milliseconds_and_seconds_are_told_apart(dt, word):
    (said,) = sentences(dt)
    assert word in said
    assert said.endswith("?")


@pytest.mark.parametrize("dt", [2e-4, 2e-3, 2e-2, 0.2])
def test_a_record_that_shows_the_motion_is_not_doubted(dt):
    assert sentences(dt) == ()


def test_no_candidate_is_tried_on_a_record_whose_time_is_not_the_models():
    said = []
    rng = np.random.default_rng(4)
    time, force = 5.0 * np.arange(200), rng.normal(size=200)  # ms taken for s
    record = make_record(Oscillator(), "ms", time, {"x": rng.normal(size=200)}, {"force": force})
    run = spiral.discover(record, Oscillator(), values=VALUES, progress=said.append)
    assert run.verdict == "unknown_structure"
    assert "is the record's time in s?" in run.summary
    assert not any("scoring candidates" in line for line in said)
