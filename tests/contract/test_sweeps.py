"""Sweeps are durable: rows are kept as jobs end, and the next start takes them up."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from spiral.cli import main
from spiral.io.registry import load_registry
from spiral.io.sweeps.sweep import run_sweep
from tests.marks import others_slow
from tests.sweep_jobs import RECORD, echo, plan_of


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SPIRAL_PLUGINS", raising=False)
    return tmp_path


@pytest.fixture(scope="module")
def registry():
    return load_registry(local=False)


def interrupted_after(count):
    """A hook that stops the sweep from outside after some rows."""
    told = []

    def on_row(sweep, index, row):
        told.append(index)
        if len(told) == count:
            os.kill(os.getpid(), signal.SIGTERM)

    return on_row


def values(sweep):
    return [row.result.get("value") for row in sweep.rows]


def test_a_stopped_sweep_is_taken_up_and_a_done_one_starts_anew(registry, place):
    plan = plan_of(registry, "out=a", "n_jobs=1")
    first = run_sweep(echo, plan, on_row=interrupted_after(2))
    assert (first.exit, values(first)) == (143, ["0.2", "0.3"])
    told, messages = [], []
    other = plan_of(registry, "out=a", "n_jobs=2")  # where jobs run does not matter
    second = run_sweep(echo, other, messages.append, on_row=lambda s, i, row: told.append(i))
    assert messages[0] == f"taking up sweep {first.sweep_id}: 2 of 4 runs are there"
    assert (second.sweep_id, second.exit, second.taken_up) == (first.sweep_id, 0, 2)
    assert values(second) == ["0.2", "0.3", "0.4", "0.5"]
    assert sorted(told) == [1, 2, 3]  # the call for 1 never came back
    summary = json.loads((place / second.folder / "summary.json").read_text())
    assert [row["result"]["value"] for row in summary["runs"]] == values(second)
    third = run_sweep(echo, plan)
    assert third.sweep_id != first.sweep_id
    assert third.taken_up == 0


def test_resume_false_and_changed_input_start_anew(registry):
    Path("a.csv").write_text("t,a\n")
    words = ("record=csv", "record.path=a.csv", "out=a", "n_jobs=1")
    first = run_sweep(echo, plan_of(registry, *words), on_row=interrupted_after(1))
    fresh = plan_of(registry, *words, "sweep.resume=false")
    assert fresh.fingerprint == plan_of(registry, *words).fingerprint
    again = run_sweep(echo, fresh, on_row=interrupted_after(1))
    assert again.sweep_id != first.sweep_id
    Path("a.csv").write_text("t,a,f\n")
    changed = plan_of(registry, *words)
    assert changed.fingerprint != fresh.fingerprint
    assert run_sweep(echo, changed).taken_up == 0


def test_two_starts_at_once_do_not_share_a_folder(registry):
    inner = []

    def on_row(sweep, index, row):
        if not inner:
            inner.append(None)
            inner[0] = run_sweep(echo, plan_of(registry, "out=a", "n_jobs=1"))

    outer = run_sweep(echo, plan_of(registry, "out=a", "n_jobs=1"), on_row=on_row)
    assert inner[0].sweep_id != outer.sweep_id
    assert values(inner[0]) == values(outer) == ["0.2", "0.3", "0.4", "0.5"]


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_a_failed_job_is_a_row_and_is_tried_again(registry, n_jobs):
    sweep = run_sweep(echo, plan_of(registry, "out=broken", f"n_jobs={n_jobs}"))
    assert [row.exit for row in sweep.rows] == [0, 1, 0, 0]
    assert "a defect" in sweep.rows[1].result["error"]["given"]


def test_a_killed_process_costs_its_own_job_only(registry):
    sweep = run_sweep(echo, plan_of(registry, "out=killed", "n_jobs=2"))
    assert [row.exit for row in sweep.rows] == [0, 1, 0, 0]
    assert "out of memory" in sweep.rows[1].result["error"]["given"]
    once = run_sweep(echo, plan_of(registry, "out=once", "n_jobs=2"))
    assert values(once) == ["0.2", "0.3", "0.4", "0.5"]


def test_a_hook_that_fails_costs_no_row(registry):
    messages = []

    def on_row(sweep, index, row):
        raise OSError("database is locked")

    sweep = run_sweep(echo, plan_of(registry, "out=a", "n_jobs=1"), messages.append, on_row=on_row)
    assert values(sweep) == ["0.2", "0.3", "0.4", "0.5"]
    assert sum("database is locked" in m for m in messages) == 4


def test_the_hook_knows_sweep_job_and_run(registry):
    told = []
    sweep = run_sweep(
        echo,
        plan_of(registry, "out=a", "n_jobs=2"),
        on_row=lambda sweep_id, index, row: told.append((sweep_id, index, row.run_id, os.getpid())),
    )
    expected = [(sweep.sweep_id, i, f"run-0.{i + 2}", os.getpid()) for i in range(4)]
    assert sorted(told) == expected


def test_a_full_disk_is_said_and_loses_nothing_written(registry, monkeypatch):
    import errno

    import spiral.io.sweeps.ledger

    first = run_sweep(echo, plan_of(registry, "out=a", "n_jobs=1"), on_row=interrupted_after(1))
    whole = spiral.io.sweeps.ledger.write_whole

    def full(file, text):
        if "00002" in file.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        whole(file, text)

    with monkeypatch.context() as patch:
        patch.setattr(spiral.io.sweeps.ledger, "write_whole", full)
        stopped = run_sweep(echo, plan_of(registry, "out=a", "n_jobs=1"))
    assert stopped.exit == 2
    assert "No space left" in stopped.error["given"]
    assert values(stopped) == ["0.2", "0.3", "0.4"]  # the third is shown, though not kept
    done = run_sweep(echo, plan_of(registry, "out=a", "n_jobs=1"))
    assert (done.sweep_id, done.taken_up, done.exit) == (first.sweep_id, 2, 0)


PROGRAM = """
import signal; signal.signal(signal.SIGINT, signal.default_int_handler)
import sys
from spiral.io.registry import load_registry
from spiral.io.sweeps.sweep import run_sweep
from tests.sweep_jobs import echo, plan_of
def on_row(sweep, index, row):
    print("row", row.result["process"], flush=True)
plan = plan_of(load_registry(local=False), "out=slow", "n_jobs=2")
sweep = run_sweep(echo, plan, lambda m: print(m, flush=True), on_row=on_row)
print(len(sweep.rows), flush=True)
sys.exit(sweep.exit)
"""


@pytest.fixture
def under_way():
    """A sweep in a process of its own with one row done and two jobs that would take a minute."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", PROGRAM]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout.readline().startswith("row")
    yield process
    process.kill()
    process.wait()


@pytest.mark.parametrize(
    ("sent", "code"), others_slow([(signal.SIGINT, 130), (signal.SIGTERM, 143)], 1)
)
def test_a_signal_ends_the_workers_and_keeps_what_is_done(under_way, sent, code):
    workers = _children(under_way.pid)
    under_way.send_signal(sent)
    out, _ = under_way.communicate(timeout=30)
    assert under_way.returncode == code
    assert "stopped: 1 of 4 runs are kept, 2 under way are not" in out
    assert out.splitlines()[-1] == "1"
    assert workers
    assert _gone(workers)


def test_kill_of_the_parent_keeps_what_is_done_and_leaves_no_worker(under_way, place):
    workers = _children(under_way.pid)
    under_way.kill()
    assert workers
    assert _gone(workers)
    (folder,) = (place / "slow" / "sweeps").iterdir()
    (row,) = (folder / "rows").glob("*.json")
    assert json.loads(row.read_text())["result"]["value"] == "0.2"


def _gone(workers, seconds=10):
    until = time.monotonic() + seconds
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        if time.monotonic() > until:
            return False
        time.sleep(0.05)
    return True


def _children(parent):
    listing = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(parent)], capture_output=True, text=True, check=True
    )
    return [int(word) for word in listing.stdout.split()]


BAD = [
    (["sweep.backend=slurm"], "loky"),
    (["sweep.backend=dask"], "dask scheduler"),
    (["sweep.backend=dask", "sweep.address=tcp://127.0.0.1:1", "sweep.timeout=0.5"], "dask"),
    (["n_jobs=0"], "-1"),
    (["n_jobs=two"], "n_jobs"),
    (["sweep.adress=a"], "'address'"),
]


@pytest.mark.parametrize(("words", "hint"), BAD, ids=[b[0][-1] for b in BAD])
def test_bad_settings_are_told_before_anything_runs(capsys, place, words, hint):
    assert main(["compare", *RECORD, "record.seed=1,2", "-m", *words]) == 2
    told = capsys.readouterr()
    assert "given:" in told.err
    assert hint in told.err
    assert "Traceback" not in told.err
    assert not list(place.glob("runs/sweeps/*"))
