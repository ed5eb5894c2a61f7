"""Independent jobs on several threads give what they give one after the other."""

import threading
import time

import numpy as np
import pytest
from spiral_plugins.effects.restoring import CubicStiffness
from spiral_plugins.systems.oscillator import Oscillator

import spiral
from spiral.engine import threads
from spiral.engine.threads import run_in_threads
from spiral.inference.simulate import simulate
from spiral.types.model import seed_model


@pytest.fixture(autouse=True)
def four_threads(monkeypatch):
    monkeypatch.setattr(threads, "THREADS", 4)


def test_results_keep_the_order_of_their_jobs():
    def late(job: int) -> int:
        time.sleep(0.02 * (3 - job % 4))
        return job * job

    assert run_in_threads(late, range(8)) == [job * job for job in range(8)]


def test_jobs_run_side_by_side():
    together = threading.Barrier(4, timeout=10)  # passed only by four at once
    assert run_in_threads(lambda job: together.wait() >= 0, range(4)) == [True] * 4


def test_jobs_of_a_job_stay_in_its_thread():
    def outer(job: int) -> set[int]:
        return {threading.get_ident(), *run_in_threads(lambda _: threading.get_ident(), range(3))}

    assert all(len(idents) == 1 for idents in run_in_threads(outer, range(4)))


def test_large_jobs_share_two_threads():
    busy, most, lock = [0], [0], threading.Lock()

    def count(_: int) -> None:
        with lock:
            busy[0] += 1
            most[0] = max(most[0], busy[0])
        time.sleep(0.02)
        with lock:
            busy[0] -= 1

    run_in_threads(count, range(8), samples=10**7)
    assert most[0] == 2


def test_an_error_ends_the_rest_and_is_raised():
    done = []

    def fail_first(job: int) -> None:
        if job == 0:
            raise ValueError("the first")
        time.sleep(0.05)
        done.append(job)

    with pytest.raises(ValueError, match="the first"):
        run_in_threads(fail_first, range(100))
    assert len(done) < 20


def test_numpy_treats_an_overflow_as_where_the_jobs_were_given():
    def overflow(_: int) -> str:
        try:
            _ = np.float64(1e300) * np.float64(1e300)
        except FloatingPointError:
            return "raised"
        return "let pass"

    with np.errstate(over="raise"):
        assert run_in_threads(overflow, range(4)) == ["raised"] * 4
    with np.errstate(over="ignore"):
        assert run_in_threads(overflow, range(4)) == ["let pass"] * 4


def test_a_study_is_the_same_on_any_number_of_threads(monkeypatch):
    """Every number but the seconds, of a study that names a cubic spring."""
    system, time = Oscillator(), 0.01 * np.arange(1500)
    values = {
        "system.mass": 1.0, "linear_stiffness.stiffness": 400.0, "linear_damping.damping": 1.0,
        "cubic_stiffness.stiffness": 5e4,
    }  # fmt: skip
    model = seed_model(system, (CubicStiffness(),), values=values)
    force = {"force": 30 * np.sin(2 * np.pi * (1 + 0.15 * time) * time)}
    record = simulate(model, time, force, 0.01, np.random.default_rng(0))

    def answer(count: int) -> dict:
        monkeypatch.setattr(threads, "THREADS", count)
        run = spiral.discover(record, system, candidates=["cubic_stiffness", "clearance", "gain"])
        assert run.missing == ("cubic_stiffness",)
        told = run.as_dict()
        for one in told["rounds"]:
            del one["seconds"]
        return told

    assert answer(4) == answer(1)
