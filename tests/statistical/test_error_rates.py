"""Error rates and coverage over 40 seeds (slow: `make test-slow`)."""

import numpy as np
import pytest

from spiral.inference.discover import discover
from tests.scenes import (
    PROJECTION,
    SEED_TRUTH,
    admitted,
    coastdown_problem,
    planar_problem,
    planar_record,
)

SEEDS = range(40)
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def null_runs():
    test = planar_record(1011, phase=1.3)
    return [discover(planar_problem(planar_record(s), test)) for s in SEEDS]


@pytest.fixture(scope="module")
def coastdowns():
    return [discover(coastdown_problem(s)) for s in SEEDS]


def test_nothing_is_invented(null_runs):
    assert sum(r.verdict == "nothing_missing" for r in null_runs) >= 38


def test_intervals_cover(null_runs):
    inside = []
    for run in null_runs:
        table = run.model.estimates()
        for key, truth in {**SEED_TRUTH, "system.phase_origin": 0.4}.items():
            owner, name = key.rsplit(".", 1)
            found = table[owner][name]
            inside.append(abs(found.estimate - truth) < 1.96 * found.se)
    assert 0.90 <= np.mean(inside) <= 0.99


def test_three_effects_and_no_false_one(coastdowns):
    good = 0
    for run in coastdowns:
        names = admitted(run)
        first = names[:3] == ["cross_stiffness", "cubic_stiffness", "gyroscopic"]
        good += first and set(names[3:]) <= {"cross_damping", "speed_stiffness"}
    assert good >= 38


def test_coefficients_over_seeds(coastdowns):
    for key, truth in PROJECTION.items():
        owner, name = key.rsplit(".", 1)
        found = [run.model.estimates()[owner][name].estimate for run in coastdowns]
        share = 0.10 if owner == "gyroscopic" else 0.01
        assert np.max(np.abs(np.array(found) / truth - 1)) < share
