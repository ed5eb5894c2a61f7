"""A sweep on two cores against the same sweep on one, as a ratio in one run.

    python benchmarks/sweep.py [JOBS] [REPEATS]

All are whole commands as a user runs them (``spiral discover experiment=rotor_coastdown`` on 4 s of
it with three candidates, one noise seed for each job), each in a fresh process, one after another;
compiled models are cached by a run before. ``n_jobs=1`` is measured twice: kept to one core, and
free to use both, which it does, since a study shares its windows between threads: more processes
can gain less then. The load of the machine stands beside each figure: a busy one hides the gain.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def sweep(
    jobs: int, n_jobs: int, folder: str, cores: set[int] | None = None
) -> tuple[float, list[dict]]:
    """Wall-clock seconds of a whole command, perhaps kept to some cores, and its rows."""
    command = [
        sys.executable, "-m", "spiral", "discover", "experiment=rotor_coastdown",
        "record.duration=4", "candidates=[cross_stiffness,cubic_stiffness,gyroscopic]",
        f"record.seed=range(0,{jobs})", "-m", f"n_jobs={n_jobs}", "--json", "-",
    ]  # fmt: skip
    clock = time.perf_counter()
    done = subprocess.run(
        command,
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=(lambda: os.sched_setaffinity(0, cores)) if cores else None,
    )
    return time.perf_counter() - clock, json.loads(done.stdout)["runs"]


def same(one: list[dict], other: list[dict]) -> bool:
    """Whether two sweeps found the same, number for number."""

    def found(rows: list[dict]) -> list[object]:
        return [(row["result"]["model"], row["result"]["test"]) for row in rows]

    return found(one) == found(other)


def measured(jobs: int, repeats: int = 1) -> list[dict[str, float]]:
    """Seconds on one core, serially, and in two processes; same results; the load before."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        sweep(1, 1, folder)
        for _ in range(repeats):
            load = os.getloadavg()[0]
            one_core, one = sweep(jobs, 1, folder, {0})
            serial, two = sweep(jobs, 1, folder)
            parallel, three = sweep(jobs, 2, folder)
            equal = same(one, three) and same(two, three)
            rows.append(
                {"one_core": one_core, "serial": serial, "parallel": parallel}
                | {"equal": equal, "load": load}
            )
    return rows


def main() -> None:
    """Print a line for each repeat."""
    jobs, repeats = (int(w) for w in (*sys.argv[1:3], *("8", "1")[len(sys.argv) - 1 :]))
    for row in measured(jobs, repeats):
        one, serial, two = (row[k] for k in ("one_core", "serial", "parallel"))
        print(
            f"{jobs} jobs in two processes {two:.1f} s; on one core {one:.1f} s, "
            f"ratio {one / two:.2f} (>= 1.7); serially with threads on both {serial:.1f} s, "
            f"ratio {serial / two:.2f}; results {'equal' if row['equal'] else 'DIFFER'}; "
            f"load before {row['load']:.1f} on {os.cpu_count()} cores"
        )


if __name__ == "__main__":
    main()
