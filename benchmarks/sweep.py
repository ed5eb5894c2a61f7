"""A sweep on two cores against the same sweep serially, as a ratio in one run.

    python benchmarks/sweep.py [JOBS] [REPEATS]

Both are whole commands as a user runs them (``spiral discover experiment=rotor_coastdown``, one
noise seed for each job), each in a fresh process, taking turns; compiled models are cached by a
run before. The load of the machine stands beside each figure: a busy machine hides the gain.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def sweep(jobs: int, n_jobs: int, folder: str) -> tuple[float, list[dict]]:
    """Wall-clock seconds of a whole command, and its rows."""
    command = [
        sys.executable, "-m", "spiral", "discover", "experiment=rotor_coastdown",
        f"record.seed=range(0,{jobs})", "-m", f"n_jobs={n_jobs}", "--json", "-",
    ]  # fmt: skip
    clock = time.perf_counter()
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return time.perf_counter() - clock, json.loads(done.stdout)["runs"]


def same(one: list[dict], other: list[dict]) -> bool:
    """Whether two sweeps found the same, number for number."""

    def found(rows: list[dict]) -> list[object]:
        return [(row["result"]["model"], row["result"]["test"]) for row in rows]

    return found(one) == found(other)


def measured(jobs: int, repeats: int = 1) -> list[tuple[float, float, bool, float]]:
    """Serial s, two-core s, same results, and the load before, for each repeat."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        sweep(1, 1, folder)
        for _ in range(repeats):
            load = os.getloadavg()[0]
            serial, one = sweep(jobs, 1, folder)
            parallel, other = sweep(jobs, 2, folder)
            rows.append((serial, parallel, same(one, other), load))
    return rows


def main() -> None:
    """Print a line for each repeat."""
    jobs, repeats = (int(w) for w in (*sys.argv[1:3], *("6", "1")[len(sys.argv) - 1 :]))
    for serial, parallel, equal, load in measured(jobs, repeats):
        print(
            f"{jobs} jobs: serial {serial:.1f} s, two cores {parallel:.1f} s, "
            f"ratio {serial / parallel:.2f} (>= 1.7), results {'equal' if equal else 'DIFFER'}, "
            f"load before {load:.1f} on {os.cpu_count()} cores"
        )


if __name__ == "__main__":
    main()
