"""Whether the memory of a missing force is seen where no effect in the catalog has any.

python -m experiments.memory [--only KIND ...] [--noise 0.005 ...] [--seeds 0 1] [--jobs 1]
    [--out runs/memory]

Rows are kept as they end (rows.jsonl); the same command takes up what is there. Of the seeds, the
odd ones were looked at while the test was made; the even ones are the unread half.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config

from experiments.memory.truth import MEMORY, NO_MEMORY, RATE, simulated
from experiments.studies.rates import rate, rate_told
from spiral.io.registry import load_registry
from spiral.types.model import seed_model
from spiral.types.record import make_record
from spiral.types.run import Run

Row = dict[str, Any]
NOISES = (0.005, 0.01, 0.02, 0.05)
SAYS = "What is missing has memory"


def blank() -> list[str]:
    """Labels of all effects of the catalog that fit the machine and have no states of their own."""
    registry = load_registry(None)
    system = registry.make("system", "oscillator")
    present = seed_model(system).labels
    found = registry.candidates(system, everywhere=True)
    return [e.label for e in found if not e.states and e.label not in present]


def asked(kind: str, noise: float, seed: int, candidates: Sequence[str]) -> Run:
    """What is said of a machine of which these are the candidates."""
    import spiral

    system = load_registry(None).make("system", "oscillator")
    found = simulated(kind, noise, seed)
    record, test = (
        make_record(system, name, np.arange(len(y)) / RATE, {"x": y}, {"force": u})
        for name, y, u in zip(("record", "test"), found.reading, found.force, strict=True)
    )
    return spiral.discover(record, system, test=test, candidates=candidates)


def study(kind: str, noise: float, seed: int) -> Row:
    """One study with a catalog that has no effect with memory; ``seconds`` of one processor."""
    clock = time.process_time()
    run = asked(kind, noise, seed, blank())
    memory = run.memory or {}
    return {
        "kind": kind, "noise": noise, "seed": seed, "verdict": run.verdict,
        "says": SAYS in run.summary, "missing": list(run.missing),
        "admitted": [x for r in run.rounds for x in r.admitted], "summary": run.summary,
        **{k: memory.get(k) for k in ("size", "share", "log_ratio", "p_value")},
        "told": memory.get("kind"), "seconds": time.process_time() - clock,
    }  # fmt: skip


def right(row: Row) -> bool:
    """``unknown_structure`` in words of memory where there is memory; no such words elsewhere."""
    if row["kind"] in MEMORY:
        return row["verdict"] == "unknown_structure" and row["says"]
    return not row["says"]


def table(rows: Sequence[Row]) -> str:
    """Rates in Markdown: by kind, by noise, both halves of the seeds."""
    lines = ["| | studies | right (Wilson 95 %) | s |", "|---|---|---|---|"]

    def line(name: str, some: Sequence[Row]) -> None:
        if some:
            told, seconds = rate_told(rate(some, right)), np.median([r["seconds"] for r in some])
            lines.append(f"| {name} | {len(some)} | {told} | {seconds:.0f} |")

    for title, kinds in (("memory", MEMORY), ("no memory", NO_MEMORY)):
        mine = [r for r in rows if r["kind"] in kinds]
        line(f"**{title}**", mine)
        line(f"{title}, unread half", [r for r in mine if r["seed"] % 2 == 0])
        for noise in NOISES:
            line(f"{title}, noise {100 * noise:g} %", [r for r in mine if r["noise"] == noise])
        for kind in kinds:
            line(f"`{kind}`", [r for r in mine if r["kind"] == kind])
    return "\n".join(lines)


def rows_of(jobs: list[tuple[str, float, int]], file: Path, workers: int) -> list[Row]:
    """Rows of all studies; those that an earlier start left are taken, the others computed."""
    kept = [json.loads(x) for x in file.read_text().splitlines()] if file.exists() else []
    rows = [r for r in kept if (r["kind"], r["noise"], r["seed"]) in jobs]
    known = {(r["kind"], r["noise"], r["seed"]) for r in rows}
    left = [j for j in jobs if j not in known]
    with file.open("a") as out, parallel_config("loky", inner_max_num_threads=1):
        running = Parallel(n_jobs=workers, return_as="generator_unordered")(
            delayed(study)(*job) for job in left
        )
        for number, row in enumerate(running, 1):
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            print(f"{number} of {len(left)}", file=sys.stderr)
    return rows


def main(words: list[str] | None = None) -> None:
    """Run the studies, keep rows and table, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    every = [*MEMORY, *NO_MEMORY]
    parser.add_argument("--only", nargs="*", choices=every, default=every)
    parser.add_argument("--noise", nargs="*", type=float, default=list(NOISES))
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1])
    parser.add_argument("--jobs", type=int, default=1, help="processes; -1: every processor")
    parser.add_argument("--out", default="runs/memory", help="folder of the results")
    given = parser.parse_args(words)
    folder = Path(given.out)
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [(k, n, s) for s in given.seeds for n in given.noise for k in given.only]
    rows = rows_of(jobs, folder / "rows.jsonl", given.jobs)
    (folder / "summary.md").write_text(table(rows) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
