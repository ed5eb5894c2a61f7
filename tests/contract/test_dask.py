"""The same sweep on a Dask cluster: a real scheduler and workers, each a process of its own."""

import json
import os

import pytest

from spiral.cli import main
from spiral.io.registry import load_registry
from spiral.io.sweeps.sweep import run_sweep
from tests.dask_cluster import dask_cluster
from tests.sweep_jobs import RECORD, echo, lost, plan_of, without_clock

pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a scheduler with two workers that run elsewhere."""
    with dask_cluster(tmp_path_factory.mktemp("cluster"), workers=2) as found:
        yield found


def run_json(capsys, *words):
    code = main([*words, "--json", "-"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_sweep_on_dask_equals_the_serial_one(capsys, tmp_path, monkeypatch, cluster):
    """Also relative files: a worker in another folder sees those of the one who asked."""
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", *RECORD, "--out", "made.csv"]) == 0
    capsys.readouterr()
    words = ["compare", "system=oscillator", "record=csv", "record.path=made.csv",
             "record.time=time", "holdout=0.2,0.3,0.4", "-m"]  # fmt: skip
    code, serial = run_json(capsys, *words, "n_jobs=1")
    assert code == 0
    options = ["sweep.backend=dask", f"sweep.address={cluster[0]}"]
    code, on_dask = run_json(capsys, *words, *options)
    assert code == 0
    assert [without_clock(r["result"]) for r in on_dask["runs"]] == [
        without_clock(r["result"]) for r in serial["runs"]
    ]
    assert len({r["result"]["test_error"] for r in on_dask["runs"]}) == 3


def test_jobs_run_in_the_workers_and_a_killed_one_is_a_row(tmp_path, monkeypatch, cluster):
    monkeypatch.chdir(tmp_path)
    options = ["out=killed", "sweep.backend=dask", f"sweep.address={cluster[0]}"]
    sweep = run_sweep(echo, plan_of(load_registry(), *options))
    assert [row.exit for row in sweep.rows] == [0, 1, 0, 0]
    assert "out of memory" in sweep.rows[1].result["error"]["given"]
    processes = {row.result["process"] for row in sweep.rows if not row.exit}
    assert os.getpid() not in processes


@pytest.mark.slow
def test_a_scheduler_that_goes_away_keeps_the_rows(tmp_path, monkeypatch, cluster):
    monkeypatch.chdir(tmp_path)
    address, running = cluster
    registry, fixed = load_registry(), f"fixed={running[0].pid}"
    options = ["n_jobs=1", "sweep.backend=dask", f"sweep.address={address}"]
    sweep = run_sweep(lost, plan_of(registry, fixed, *options))
    assert sweep.exit == 2
    assert "went away" in sweep.error["given"]
    assert len(sweep.rows) == 2
    here = run_sweep(lambda *_: (0, {}), plan_of(registry, fixed, "n_jobs=1"))
    assert (here.taken_up, here.exit) == (2, 0)
