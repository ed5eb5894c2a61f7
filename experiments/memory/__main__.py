"""Whether the memory of a missing force is seen where no effect in the catalog has any.

python -m experiments.memory [--only KIND ...] [--noise 0.005 ...] [--seeds 0 1] [--jobs 1]
    [--limit 120] [--out runs/memory]

Rows are kept as they end (rows.jsonl); the same command takes up those of this code. Of the seeds,
the odd ones were looked at while the test was made; the even ones are the unread half.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from experiments.memory.bench import study
from experiments.memory.truth import BOTH, MEMORY, NO_MEMORY
from experiments.studies.pieces import Job, Row, engine, finish, version
from experiments.studies.rates import number_told, rate, rate_told
from experiments.studies.scoreboard import median

NOISES = (0.005, 0.01, 0.02, 0.05)


def right(row: Row) -> bool:
    """``unknown_structure`` in words of memory where there is memory; no such words elsewhere.

    Where a cubic spring is missing too it is named, alone, beside the words.
    """
    if row["outcome"] != "done":
        return False
    if row["kind"] in MEMORY:
        return row["verdict"] == "unknown_structure" and row["says"]
    if row["kind"] in BOTH:
        return row["says"] and row["missing"] == ["cubic_stiffness"]
    return not row["says"]


def table(rows: Sequence[Row]) -> str:
    """Rates in Markdown: by kind, by noise, both halves of the seeds."""
    lines = ["| | studies | right (Wilson 95 %) | s |", "|---|---|---|---|"]

    def line(name: str, some: Sequence[Row]) -> None:
        if some:
            told, seconds = rate_told(rate(some, right)), median(some, "seconds")
            lines.append(f"| {name} | {len(some)} | {told} | {number_told(seconds)} |")

    for title, kinds in (("memory", MEMORY), ("both", BOTH), ("no memory", NO_MEMORY)):
        mine = [r for r in rows if r["kind"] in kinds]
        line(f"**{title}**", mine)
        line(f"{title}, unread half", [r for r in mine if r["seed"] % 2 == 0])
        for noise in NOISES:
            line(f"{title}, noise {100 * noise:g} %", [r for r in mine if r["noise"] == noise])
        for kind in kinds:
            line(f"`{kind}`", [r for r in mine if r["kind"] == kind])
    return "\n".join(lines)


def jobs_of(kinds: Sequence[str], noises: Sequence[float], seeds: Sequence[int]) -> list[Job]:
    """One study of each kind, noise and seed."""
    made_of = {"code": engine(), "case": version(Path(__file__).parent)}
    return [
        Job({"kind": k, "noise": n, "seed": s}, made_of, partial(study, k, n, s))
        for s in seeds
        for n in noises
        for k in kinds
    ]


def main(words: list[str] | None = None) -> None:
    """Run the studies, keep rows and table, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    every = [*MEMORY, *BOTH, *NO_MEMORY]
    parser.add_argument("--only", nargs="*", choices=every, default=every)
    parser.add_argument("--noise", nargs="*", type=float, default=list(NOISES))
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1])
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--limit", type=float, default=120.0, help="processor seconds of a study")
    parser.add_argument("--out", default="runs/memory", help="folder of the results")
    given = parser.parse_args(words)
    folder = Path(given.out)
    jobs = jobs_of(given.only, given.noise, given.seeds)
    rows = [
        {**row["key"], **row}
        for row in finish(jobs, folder / "rows.jsonl", given.limit, given.jobs)
    ]
    (folder / "summary.md").write_text(table(rows) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
