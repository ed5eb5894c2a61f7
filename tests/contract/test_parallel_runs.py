"""Eight runs at once, again and again: none lost, none mixed up, the same as one after another."""

import json
from pathlib import Path

import pytest

from spiral.commands.perform import perform_sweep_job
from spiral.io.registry import load_registry
from spiral.io.sweeps.jobs import plan_sweep
from spiral.io.sweeps.sweep import run_sweep
from spiral.io.sweeps.tracker import SweepTracker
from spiral.io.tracking.store import Tracking, open_store
from tests.sweep_jobs import RECORD, without_clock

SEEDS = range(8)
REPEATS = 20


TRACKING = Tracking(model=False)


@pytest.fixture(autouse=True)
def untracked():
    """These runs are tracked for real."""


def swept(registry, out, n_jobs, told):
    """The sweep, told to a database that is made by its first row."""
    words = [*RECORD, f"record.seed=range(0,{len(SEEDS)})", "candidates=[cubic_stiffness]"]
    plan = plan_sweep("discover", (), [*words, f"out={out}", f"n_jobs={n_jobs}"], None, registry)
    tracker = SweepTracker(TRACKING, out, lambda message: None)

    def on_row(*row):
        told.append(row)
        tracker.on_row(*row)

    sweep = run_sweep(perform_sweep_job, plan, on_row=on_row)
    assert tracker.finish().failure is None
    return sweep


def in_mlflow(out, sweep):
    """Seed -> (saved run, test error, rounds) of every study that MLflow knows."""
    with open_store(TRACKING, out) as store:
        found = store.client.search_runs([store.experiment], max_results=1000)
        parents = {r.info.run_id: r for r in found if "spiral.run_id" in r.data.tags}
        rounds = [r.data.tags.get("mlflow.parentRunId") for r in found]
        assert {r.data.tags["spiral.sweep"] for r in parents.values()} == {sweep.sweep_id}
        assert all(r.info.status == "FINISHED" for r in found)
        assert len(found) == len(parents) + sum(rounds.count(p) for p in parents)
    return {
        int(r.data.params["record.seed"]): (
            r.data.tags["spiral.run_id"], r.data.metrics["test_error"], rounds.count(number)
        )
        for number, r in parents.items()
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("n_jobs", [2, 8])
def test_no_run_is_lost_or_mixed_up(tmp_path, monkeypatch, n_jobs):
    monkeypatch.chdir(tmp_path)
    registry = load_registry(local=False)
    serial = swept(registry, "serial", 1, [])
    assert serial.exit == 0
    expected = [without_clock(row.result) for row in serial.rows]
    assert len({json.dumps(result) for result in expected}) == len(SEEDS)
    seen = {row.run_id for row in serial.rows}
    for repeat in range(REPEATS):
        told = []
        sweep = swept(registry, f"repeat-{repeat}", n_jobs, told)
        assert [without_clock(row.result) for row in sweep.rows] == expected
        files = Path(f"repeat-{repeat}").glob("*/run.json")
        saved = {file.parent.name: json.loads(file.read_text()) for file in files}
        assert {row.run_id for row in sweep.rows} == set(saved)
        assert len(saved) == len(SEEDS)
        assert not seen & set(saved)
        seen |= set(saved)
        for seed, row in zip(SEEDS, sweep.rows, strict=True):
            assert saved[row.run_id]["config"]["record"]["seed"] == seed
            assert without_clock(saved[row.run_id]["result"]) == expected[seed]
        assert sorted((i, row.run_id) for _, i, row in told) == [
            (i, row.run_id) for i, row in enumerate(sweep.rows)
        ]
        assert in_mlflow(f"repeat-{repeat}", sweep) == {
            seed: (row.run_id, row.result["rounds"][-1]["test_error"], len(row.result["rounds"]))
            for seed, row in zip(SEEDS, sweep.rows, strict=True)
        }
