"""Measured records: what is found, and the error on the test record, where the data are there."""

import os
from pathlib import Path

import pytest

from experiments.measured import problem_of, scored
from spiral.discover import discover

DATA = os.environ.get("SPIRAL_DATA")


def needs(file: str):
    return pytest.mark.skipif(
        not DATA or not (Path(DATA or ".") / file).exists(), reason=f"{file} is not in SPIRAL_DATA"
    )


@needs("cascaded_tanks/dataBenchmark.csv")
def test_the_tanks_name_the_overflow_first():
    """One round: the seed near 0.67 V, the overflow on half of the record near 0.54 V."""
    problem = problem_of("cascaded_tanks", ("settings.max_rounds=1",))
    seed, first = scored(problem, discover(problem))
    assert seed.all == pytest.approx(0.67, abs=0.02)
    assert first.admitted == ("overflow",)
    assert first.all < 0.56


@pytest.mark.slow
@needs("cascaded_tanks/dataBenchmark.csv")
def test_the_tanks_are_simulated_to_their_figure():
    """Overflow, the sensor's offset and its limit: at most 0.40 V over the whole test record."""
    problem = problem_of("cascaded_tanks")
    rounds = scored(problem, discover(problem))
    assert [x for r in rounds for x in r.admitted] == ["overflow", "offset", "sensor_saturation"]
    assert rounds[-1].all <= 0.40
