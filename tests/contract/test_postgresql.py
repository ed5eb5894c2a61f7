"""A real PostgreSQL and a real ``mlflow server`` in front of it: none of 20 runs is lost or mixed.

By 8 processes, the server killed in between; by 4 Dask workers, of which one is killed.

make test-slow PYTEST=tests/contract/test_postgresql.py
"""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from spiral.commands.perform import perform_sweep_job
from spiral.io.registry import load_registry
from spiral.io.storage import FILE, run_ids
from spiral.io.sweeps.jobs import plan_sweep
from spiral.io.sweeps.sweep import run_sweep
from spiral.io.sweeps.tracker import SweepTracker
from spiral.io.tracking.store import Tracking, open_store
from spiral.io.tracking.track import MARK, track
from tests.dask_cluster import dask_cluster
from tests.sweep_jobs import RECORD, value_of

FOUND = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
RUNS, PROCESSES = 20, 8
pytest.importorskip("psycopg", reason="needs the extra postgres")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not FOUND, reason="needs Debian's postgresql")]


@pytest.fixture(autouse=True)
def untracked():
    """These runs are tracked for real."""


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@pytest.fixture
def database():
    """The address of a database in a cluster of its own, in a folder of its own."""
    # Not below pytest's own folder, which is for one user, and PostgreSQL refuses to run as root.
    place = Path(tempfile.mkdtemp(prefix="spiral-postgresql-"))
    password, data = place / "password", place / "data"
    password.write_text("hush")
    user = []
    if os.geteuid() == 0:
        if shutil.which("runuser") is None:
            pytest.skip("needs runuser, or another user than root")
        user = ["runuser", "-u", "postgres", "--"]
        shutil.chown(place, "postgres")
        shutil.chown(password, "postgres")
    programs, port = FOUND[-1].parent, free_port()
    made = ["-D", str(data), "-U", "me", "--auth=scram-sha-256", f"--pwfile={password}"]
    subprocess.run([*user, str(programs / "initdb"), *made], check=True, capture_output=True)
    listen = f"-p {port} -k {place} -c listen_addresses=127.0.0.1"
    control = [*user, str(programs / "pg_ctl"), "-D", str(data), "-w", "-l", str(place / "log")]
    subprocess.run([*control, "-o", listen, "start"], check=True, stdout=subprocess.DEVNULL)
    try:
        yield f"postgresql+psycopg://me:hush@127.0.0.1:{port}/postgres"
    finally:
        subprocess.run([*control, "-m", "immediate", "stop"], check=False, capture_output=True)
        shutil.rmtree(place, ignore_errors=True)


class Server:
    """``mlflow server`` on a port of its own."""

    def __init__(self, store, folder):
        self.port = free_port()
        self.address = f"http://127.0.0.1:{self.port}"
        self._command = [
            sys.executable, "-m", "mlflow", "server", "--backend-store-uri", store,
            "--artifacts-destination", str(folder), "--host", "127.0.0.1",
            "--port", str(self.port), "--workers", "1",
        ]  # fmt: skip
        self._log, self._process = folder.with_suffix(".log"), None

    def start(self):
        with self._log.open("ab") as log:
            told = {"stdout": log, "stderr": subprocess.STDOUT}
            self._process = subprocess.Popen(self._command, start_new_session=True, **told)
        until = time.monotonic() + 180
        while time.monotonic() < until:
            with contextlib.suppress(OSError):
                urllib.request.urlopen(f"{self.address}/health", timeout=2).close()
                return
            time.sleep(0.3)
        raise AssertionError("mlflow server did not start")

    def kill(self):
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


@pytest.fixture
def server(database, tmp_path):
    found = Server(database, tmp_path / "artifacts")
    found.start()
    yield found
    found.kill()


def one(out, seed, uri):
    """A run by a process of its own, told to the server; what became of the telling."""
    words = (*RECORD, f"record.seed={seed}", f"out={out}", "curves=false")
    code, result = perform_sweep_job("compare", (), words, None)
    assert code == 0
    return track(Tracking(uri=uri, model=False), out, (result["run_id"],)).failure


def test_no_run_is_lost_or_mixed_though_the_server_dies_in_between(server, tmp_path):
    places = [tmp_path / f"out{i}" for i in range(RUNS)]
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
        told = [pool.submit(one, str(p), i, server.address) for i, p in enumerate(places)]
        while sum(f.done() for f in told) < RUNS // 4:
            time.sleep(0.1)
        server.kill()
        time.sleep(5)
        server.start()
        failures = [f.result(timeout=500) for f in told]
    print(f"{sum(f is not None for f in failures)} of {RUNS} were not told at first")
    tracking = Tracking(uri=server.address, model=False)
    for place in places:  # the next start
        assert track(tracking, place).failure is None
    assert known(tracking, [p / name for p in places for name in run_ids(p)]) == RUNS


def known(tracking, folders):
    """How many saved runs the server knows: each once, finished, with the figures of its file."""
    with open_store(tracking, folders[0].parent) as store:
        found = store.client.search_runs([store.experiment], max_results=1000)
    parents = {r.data.tags["spiral.run_id"]: r for r in found if "spiral.run_id" in r.data.tags}
    assert set(parents) == {folder.name for folder in folders}
    assert all(r.info.status == "FINISHED" for r in found)
    for folder in folders:
        saved = json.loads((folder / FILE).read_text())
        told = parents[folder.name]
        assert told.data.metrics["test_error"] == saved["result"]["test_error"]
        assert int(told.data.params["record.seed"]) == saved["config"]["record"]["seed"]
        mark = json.loads((folder / MARK).read_text())
        assert mark["mlflow_run_id"] == told.info.run_id
    children = [r for r in found if "mlflow.parentRunId" in r.data.tags]
    numbers = {r.info.run_id for r in parents.values()}
    assert {r.data.tags["mlflow.parentRunId"] for r in children} <= numbers
    assert len(found) == len(parents) + len(children)
    return len(parents)


def test_no_run_is_lost_or_mixed_though_a_dask_worker_dies(server, tmp_path):
    """The job of the one that dies is done again, alone; the others go on."""
    distributed = pytest.importorskip("distributed")
    seeds = f"record.seed=range(0,{RUNS})"
    with dask_cluster(tmp_path, workers=4) as (address, _):
        where = ("sweep.backend=dask", f"sweep.address={address}", f"out={tmp_path / 'out'}")
        plan = plan_sweep("compare", (), [*RECORD, seeds, *where], None, load_registry(local=False))
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(4, timeout=60)
            processes = set(client.run(os.getpid).values())
        told = SweepTracker(Tracking(uri=server.address, model=False), tmp_path / "out", print)
        rows = []

        def on_row(sweep, number, row):
            rows.append(number)
            if len(rows) == RUNS // 4:
                os.kill(max(processes), signal.SIGKILL)
            told.on_row(sweep, number, row)

        sweep = run_sweep(perform_sweep_job, plan, print, on_row=on_row)
        assert told.finish().failure is None
    assert len(processes) == 4
    assert sweep.exit == 0
    assert [row.exit for row in sweep.rows] == [0] * RUNS
    assert [int(value_of(row.overrides, "record.seed")) for row in sweep.rows] == list(range(RUNS))
    folders = [tmp_path / "out" / name for name in run_ids(tmp_path / "out")]
    assert known(Tracking(uri=server.address, model=False), folders) >= RUNS
    assert {row.run_id for row in sweep.rows} <= {folder.name for folder in folders}


def test_the_database_itself_is_a_store_and_its_password_is_not_shown(database, tmp_path):
    assert one(str(tmp_path / "out"), 0, database) is None
    found = track(Tracking(uri=database, model=False), tmp_path / "out")
    assert "hush" not in f"{found.uri} {found.page}"
    (name,) = run_ids(tmp_path / "out")
    assert "hush" not in (tmp_path / "out" / name / MARK).read_text()
