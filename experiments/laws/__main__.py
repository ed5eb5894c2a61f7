"""Whether a law that the catalog does not know is named in closed form.

python -m experiments.laws [--only CASE ...] [--seeds 0 2] [--nulls] [--jobs 1] [--limit 120]
    [--out runs/laws]

Rows are kept as they end (rows.jsonl); the same command takes up those of this code. Odd seeds were
looked at while the laws were made; even ones are the unread half.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from experiments.laws.bench import study
from experiments.laws.truth import CASES, UNLISTED
from experiments.studies.pieces import Job, Row, engine, finish, version
from experiments.studies.rates import number_told, rate, rate_told
from experiments.studies.scoreboard import median

FLOORS = 1.1  # noise floors within which a free run is as good as the truth


def named(row: Row) -> bool:
    """The law named in closed form, and nothing else."""
    return row["outcome"] == "done" and row["alone"]


def alike(row: Row) -> bool:
    """The law, or one law that the record does not tell from it."""
    return row["outcome"] == "done" and row["alike"]


def exact(row: Row) -> bool:
    """Named, and the free run is at its floor."""
    return named(row) and row["floors"] <= FLOORS


def quiet(row: Row) -> bool:
    """Nothing named where nothing is missing."""
    return row["outcome"] == "done" and not row["missing"]


def table(rows: Sequence[Row]) -> str:
    """Rates in Markdown, by case."""
    lines = ["| law | studies | named | or alike | named, within 1.1 floors | nulls | quiet | s |",
             "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for name in ("listed", *CASES):
        listed = name == "listed"
        mine = [r for r in rows if r["law"] == name or (listed and r["law"] not in UNLISTED)]
        there, null = ([r for r in mine if bool(r["share"]) is x] for x in (True, False))
        told = [rate_told(rate(some, f)) if some else "" for some, f in (
            (there, named), (there, alike), (there, exact), (null, quiet))]  # fmt: skip
        seconds = number_told(median(mine, "seconds")) if mine else ""
        lines.append(
            f"| {name} | {len(there)} | {' | '.join(told[:3])} "
            f"| {len(null)} | {told[3]} | {seconds} |"
        )
    return "\n".join(lines)


def main(words: list[str] | None = None) -> None:
    """Run the studies, keep rows and table, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=[*CASES], default=[*CASES])
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 2, 4, 6])
    parser.add_argument("--nulls", action="store_true", help="the same machines without the law")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--limit", type=float, default=120.0, help="processor seconds of a study")
    parser.add_argument("--out", default="runs/laws", help="folder of the results")
    given = parser.parse_args(words)
    folder, made_of = Path(given.out), {"code": engine(), "case": version(Path(__file__).parent)}
    jobs = [
        Job({"law": c, "seed": s, "share": x}, made_of, partial(study, c, s, x))
        for s in given.seeds
        for x in ((1.0, 0.0) if given.nulls else (1.0,))
        for c in given.only
    ]
    found = finish(jobs, folder / "rows.jsonl", given.limit, given.jobs)
    rows = [{**row["key"], **row} for row in found]
    (folder / "summary.md").write_text(table(rows) + "\n")
    print(table(rows))


if __name__ == "__main__":
    main()
