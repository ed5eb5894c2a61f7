"""A Dask cluster for tests: a scheduler and workers, each a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

ROOT = str(Path(__file__).parents[1])


@contextmanager
def dask_cluster(place, workers):
    """The address of a scheduler with workers that run elsewhere, and the processes to end."""
    local = {k: v for k, v in os.environ.items() if k != "SPIRAL_PLUGINS"}
    failures = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    environment = {**local, **failures, "PYTHONPATH": ROOT}
    file = place / "scheduler.json"
    module = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file]
    running = [_start([*module, *options], place, environment)]
    try:
        until = time.monotonic() + 60
        while not (file.exists() and file.read_text()):
            assert time.monotonic() < until
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1",
                  "--no-dashboard", "--local-directory", place, "--host", "127.0.0.1"]  # fmt: skip
        running.append(_start([*worker, "--nworkers", str(workers)], place, environment))
        yield address, running
    finally:
        for process in running:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait(30)


def _start(command, place, environment):
    with open(place / "log", "a") as log:
        return subprocess.Popen(
            command, cwd=place, env=environment, stdout=log, stderr=log, start_new_session=True
        )
