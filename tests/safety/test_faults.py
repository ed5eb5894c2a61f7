"""Faults to survive: nothing lost but the round under way, nothing corrupt, the same answer after.

make test-slow PYTEST=tests/safety/test_faults.py
"""

import json
import os
import queue
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from spiral.app.processes import Process
from spiral.app.serve import lock_folder
from spiral.app.study import load_study, new_study, turn_folder
from spiral.io.checkpoint import FILE as CHECKPOINT
from spiral.io.checkpoint import FOLDER
from spiral.io.storage import FILE, run_ids
from spiral.io.tracking.store import Tracking, open_store
from spiral.io.tracking.track import MARK
from spiral.types.errors import ConfigError, InputError
from tests.sweep_jobs import RECORD, without_clock

SPIRAL = [sys.executable, "-m", "spiral"]
STUDY = (*RECORD, "candidates=[cubic_stiffness,quadratic_damping]", "holdout=0.3")
KILLS = 10
FINAL = ("done", "failed")
ROUNDS = (
    "experiment=rotor_coastdown", "record.duration=2", "settings.max_rounds=3",
    "candidates=[cross_stiffness,cubic_stiffness,gyroscopic]", "tracking.model=false",
)  # fmt: skip
SWEPT = ("compare", *RECORD, "holdout=0.2,0.3,0.4,0.5", "n_jobs=2", "tracking.model=false", "-m")


def spiral(place, *words, **more):
    return subprocess.run(
        [*SPIRAL, *words], cwd=place, capture_output=True, text=True, check=False, **more
    )


def sound(folder):
    """Every saved run reads, and none is half there."""
    for name in run_ids(folder):
        assert json.loads((folder / name / FILE).read_text())["run_id"] == name
    return True


@pytest.mark.slow
def test_the_pages_worker_killed_at_random_moments_costs_its_step_alone(tmp_path):
    told = queue.Queue()
    process = Process("fits", tmp_path, lambda order, kind, data: told.put((kind, data)))
    study = new_study(tmp_path, "a study", STUDY)
    order = {"do": "start", "study": study.ident, "serial": 0, "plugins": None,
             "overrides": list(STUDY)}  # fmt: skip

    def ended(seconds=600.0):
        end = time.monotonic() + seconds
        while (event := told.get(timeout=max(end - time.monotonic(), 0)))[0] not in FINAL:
            pass
        return event

    try:
        began = time.monotonic()
        process.give(order)
        assert ended()[0] == "done"
        seconds, chance, kills = time.monotonic() - began, random.Random(3), 0
        while kills < KILLS:
            process.give(order)
            began = time.monotonic()
            try:
                assert ended(chance.uniform(0.05, 1.0) * seconds)[0] == "done"
            except queue.Empty:  # it is at work
                worker = process._process
                os.kill(worker.pid, signal.SIGKILL)
                kind, data = ended()
                worker.join(10)
                assert kind == "failed"
                assert "ended in the middle" in data["given"]
                kills += 1
            else:  # faster than at first: sooner, next time
                seconds = time.monotonic() - began
        process.give(order)
        assert ended()[0] == "done"
    finally:
        process.close()
    assert load_study(tmp_path, study.ident).title == "a study"
    assert not list(turn_folder(tmp_path, study.ident, 0).rglob("*.tmp"))


def answer(done, place):
    """The result of a command, less clocks and names of runs and sweeps."""
    assert done.returncode == 0, done.stderr
    result = without_clock(json.loads((place / "result.json").read_text()))
    return {k: v for k, v in result.items() if k != "sweep"}


def told_once(folder):
    """MLflow knows every saved run, once, and as finished."""
    runs = run_ids(folder)
    with open_store(Tracking(model=False), folder) as store:
        found = store.client.search_runs([store.experiment], max_results=1000)
    parents = [r.data.tags["spiral.run_id"] for r in found if "spiral.run_id" in r.data.tags]
    assert sorted(parents) == sorted(runs)
    assert all(r.info.status == "FINISHED" for r in found)
    assert all((folder / name / MARK).is_file() for name in runs)
    return True


def kept(place):
    """How many rows and checkpoints of unfinished sweeps and studies lie in a folder."""
    sweeps = (s for s in place.glob("runs/sweeps/*") if not (s / "summary.json").exists())
    rows = [row for sweep in sweeps for row in sweep.glob("rows/*.json")]
    return len(rows) + len(list(place.glob(f"runs/{FOLDER}/*/{CHECKPOINT}")))


def killed(place, words, seconds, at_work):
    """Start a command, end it by kill -9 after so long; whether that was before its end.

    ``at_work`` counts from the first row or round that it keeps, not from its start.
    """
    process = subprocess.Popen(
        [*SPIRAL, *words], cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    while at_work and not kept(place) and process.poll() is None:
        time.sleep(0.02)
    time.sleep(seconds)
    early = process.poll() is None
    process.kill()
    process.wait()
    return early


@pytest.mark.slow
@pytest.mark.parametrize("words", [("discover", *ROUNDS), SWEPT], ids=["discover", "sweep"])
def test_a_command_killed_at_random_moments_goes_on_to_the_same_answer(tmp_path, words):
    """Five from its start, five from when it has kept something; the last may be MLflow's turn."""
    words = (*words, "--json", "result.json")
    chance, number, taken_up = random.Random(5), 0, 0
    (tmp_path / "whole").mkdir()
    began = time.monotonic()
    expected = answer(spiral(tmp_path / "whole", *words), tmp_path / "whole")
    seconds = time.monotonic() - began
    while number < KILLS:
        place = tmp_path / str(number)
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        at_work = number % 2 == 1
        moment = chance.uniform(0.0, 0.04) if at_work else chance.uniform(0.1, 1.0)
        if not killed(place, words, moment * seconds, at_work):
            continue  # it had ended before
        number += 1
        assert sound(place / "runs")
        left = kept(place)
        done = spiral(place, *words)
        told = "taking up this study" in done.stderr or "taking up sweep" in done.stderr
        assert told or not left  # a sweep is taken up without a row too
        taken_up += told
        assert answer(done, place) == expected
        assert told_once(place / "runs")
        assert not [p for p in place.rglob("*") if ".tmp" in p.name]
    print(f"{taken_up} of {KILLS} kills left rounds or rows that were taken up")
    assert taken_up


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["discover", "compare"])
def test_files_that_may_grow_no_further_are_one_message(tmp_path, verb):
    """As on a full disk, at every write: no file may be longer than so many bytes."""
    resource = pytest.importorskip("resource")
    before = spiral(tmp_path, verb, *STUDY, "tracking.enabled=false")
    kept = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert before.returncode == 0
    for most in (0, 100, 4096, 16384, 65536):
        done = spiral(
            tmp_path, verb, *STUDY, "record.seed=1", "tracking.enabled=false",
            preexec_fn=lambda most=most: resource.setrlimit(resource.RLIMIT_FSIZE, (most, most)),
        )  # fmt: skip
        assert "Traceback" not in done.stderr
        assert done.returncode in (0, 2)
        if done.returncode:
            assert "File too large" in done.stderr
        assert not [p for p in tmp_path.rglob("*") if ".tmp" in p.name]
        assert all(p.read_bytes() == content for p, content in kept.items())
        assert sound(tmp_path / "runs")


@pytest.fixture
def small_disk(tmp_path):
    """A disk of its own, and a function that makes it so many kB large."""
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("needs root to mount a small disk")
    place = tmp_path / "small"
    place.mkdir()

    def sized(size, more=()):
        options = ",".join((*more, f"size={size}k"))
        return subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)],
                              capture_output=True).returncode == 0  # fmt: skip

    if not sized(4):
        pytest.skip("no small disk can be mounted here")
    yield place, lambda size: sized(size, ("remount",))
    while os.path.ismount(place):  # a remount may have become a mount of its own
        subprocess.run(["umount", "--lazy", str(place)], check=True)


@pytest.mark.slow
def test_a_full_disk_that_grows_is_one_message_each_time_and_ends_in_the_same_answer(
    tmp_path, small_disk
):
    """From the first checkpoint to MLflow's database, each of these sizes ends another write."""
    words = ("discover", *ROUNDS, "--json", "result.json")
    (tmp_path / "whole").mkdir()
    expected = answer(spiral(tmp_path / "whole", *words), tmp_path / "whole")
    place, resize = small_disk
    stopped, untold = [], []
    for size in (4, 16, 64, 256, 1024, 2048, 4096, 262144):
        assert resize(size)
        done = spiral(tmp_path, *words, f"out={place}")
        assert "Traceback" not in done.stderr
        assert not [p for p in place.rglob("*") if ".tmp" in p.name]
        assert sound(place)
        if done.returncode:
            assert done.returncode == 2
            assert done.stderr.count("No space left") == 1
            stopped.append(size)
            continue
        assert answer(done, tmp_path) == expected
        if "not told to MLflow" not in done.stderr:
            break
        untold.append(size)
    print(f"no room for the study at {stopped} kB, none for MLflow at {untold} kB")
    assert stopped
    assert untold
    assert told_once(place)


@pytest.mark.slow
def test_a_database_locked_for_30_s_by_another_program_is_waited_for_or_caught_up(tmp_path):
    words = ("compare", *RECORD, "tracking.model=false")
    assert spiral(tmp_path, *words).returncode == 0
    database = sqlite3.connect(tmp_path / "runs" / "mlflow.db", check_same_thread=False)
    database.execute("BEGIN EXCLUSIVE")
    release = threading.Timer(30.0, database.rollback)
    release.start()
    done = spiral(tmp_path, *words, "record.seed=1")
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    release.join()
    assert spiral(tmp_path, *words, "record.seed=2").returncode == 0
    runs = run_ids(tmp_path / "runs")
    assert len(runs) == 3
    assert all((tmp_path / "runs" / name / MARK).is_file() for name in runs)


@pytest.mark.slow
def test_a_record_that_changes_while_a_study_runs_is_told_apart_by_its_hash(tmp_path):
    rng = np.random.default_rng(0)
    rows = np.column_stack([np.arange(2000) / 500, rng.normal(size=(2000, 2))])

    def write(values):
        header = "t,x,force"
        np.savetxt(tmp_path / "a.csv", values, delimiter=",", header=header, comments="")

    write(rows)
    words = [*SPIRAL, "compare", "system=oscillator", "record=csv", "record.path=a.csv",
             "record.time=t", "record.channels={x: x}", "record.inputs={force: force}",
             "tracking.enabled=false"]  # fmt: skip
    process = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL,
                               stderr=subprocess.PIPE, text=True)  # fmt: skip
    while "compiling" not in (line := process.stderr.readline()):
        assert line, "it ended before it had read the record"
    write(rows * 2)
    assert process.wait() == 0
    assert spiral(tmp_path, *words[len(SPIRAL) :]).returncode == 0
    first, second = (
        json.loads((tmp_path / "runs" / name / FILE).read_text())["data"]["records"][0]["sha256"]
        for name in run_ids(tmp_path / "runs")
    )
    assert first != second


def test_a_second_page_on_one_folder_is_refused(tmp_path):
    with (
        lock_folder(tmp_path),
        pytest.raises(ConfigError, match="a second page"),
        lock_folder(tmp_path),
    ):
        raise AssertionError
    with lock_folder(tmp_path):  # the first has ended
        pass


def test_a_page_on_a_folder_that_cannot_be_made_is_one_message(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="folder of runs"), lock_folder(tmp_path / "file" / "runs"):
        raise AssertionError
