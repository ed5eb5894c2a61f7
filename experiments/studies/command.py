"""The command line that benches of studies share: ``run`` in pieces, ``score`` what is there."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from experiments.studies.pieces import Job, Row, engine, finish, kept

HALVES = ("tune", "report")
FIRST_SEED = {"tune": 0, "report": 1000}
"""Seeds of the halves: development sees the first, the other is for reports."""
DEFAULT = "default"
"""What a row calls the strategy where the user names none."""


@dataclass(frozen=True)
class Bench:
    """A bench of studies.

    Parameters
    ----------
    name : of the experiment; its folder of results is ``runs/NAME``.
    entries : system -> (half, cases); a half of its own (``measured``), or empty for both halves.
    study : (system, case, seed, strategy) -> what came of it; run in a process of its own.
    definition : system -> the version of what makes its records and its question.
    score : (rows, whether cases of the report half may be shown) -> the scoreboard in Markdown.
    """

    name: str
    entries: Callable[[], Mapping[str, tuple[str, tuple[str, ...]]]]
    study: Callable[[str, str, int, str | None], Row]
    definition: Callable[[str], str]
    score: Callable[[list[Row], bool], str]

    @property
    def halves(self) -> tuple[str, ...]:
        """The halves, and groups beside them."""
        others = sorted({h for h, _ in self.entries().values()} - {*HALVES, ""})
        return (*HALVES, *others)


def main(bench: Bench, about: str, words: list[str] | None = None) -> str:
    """Run or score; returns the scoreboard. ``about`` is what ``--help`` says."""
    given = _parsed(bench, about, words)
    file = Path(given.out or f"runs/{bench.name}") / "rows.jsonl"
    if given.verb == "run":
        finish(jobs_of(bench, given), file, given.limit, given.jobs)
    rows = [
        r
        for r in chosen(kept(file), given.code)
        if r["key"]["strategy"] == (given.strategy or DEFAULT)
        and given.half in ("all", r["key"]["half"])
    ]
    board = bench.score(rows, given.details)
    print(board)
    if given.markdown:
        Path(given.markdown).write_text(board + "\n", encoding="utf-8")
    return board


def jobs_of(bench: Bench, given: argparse.Namespace) -> list[Job]:
    """The studies that are asked for, those of one seed before those of the next."""
    code, commit = engine(), _commit()
    halves = bench.halves if given.half == "all" else (given.half,)
    found: list[tuple[int, Job]] = []
    for system, (own, cases) in bench.entries().items():
        made_of = {"code": code, "case": bench.definition(system)}
        for half in halves:
            seeds = range(given.seeds) if half in HALVES else range(1)
            if own not in ("", half) or not _asked(system, given.systems):
                continue
            for case in (c for c in cases if _asked(c, given.cases)):
                for step in seeds:
                    seed = FIRST_SEED.get(half, 0) + step
                    key: dict[str, Any] = {
                        "system": system, "case": case, "seed": seed, "half": half,
                        "strategy": given.strategy or DEFAULT,
                    }  # fmt: skip
                    work = partial(_study, bench.study, system, case, seed, given.strategy, commit)
                    found.append((step, Job(key, made_of, work)))
    return [job for _, job in sorted(found, key=lambda pair: pair[0])]


def _study(
    study: Callable[[str, str, int, str | None], Row],
    system: str,
    case: str,
    seed: int,
    strategy: str | None,
    commit: str,
) -> Row:
    return {"commit": commit, **study(system, case, seed, strategy)}


def _asked(name: str, wanted: list[str] | None) -> bool:
    return not wanted or name in wanted


def chosen(rows: list[Row], code: str | None) -> list[Row]:
    """Rows of one version of the code (the last one's), the newest of each study."""
    if not rows:
        return []
    version = code or rows[-1]["made_of"]["code"]
    newest = {repr(r["key"]): r for r in rows if r["made_of"]["code"].startswith(version)}
    return list(newest.values())


def _commit() -> str:
    """The commit that is checked out, for people; nothing outside a checkout."""
    asked = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return asked.stdout.strip()


def _parsed(bench: Bench, about: str, words: list[str] | None) -> argparse.Namespace:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(
        f"python -m experiments.{bench.name}", description=about, formatter_class=plain
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    run = verbs.add_parser("run", help="do what is left of the studies, then score")
    run.add_argument("--seeds", type=int, default=3, help="of each case")
    run.add_argument("--systems", type=_list, help="NAME,NAME; all when left out")
    run.add_argument("--cases", type=_list, help="NAME,NAME; all when left out")
    run.add_argument("--limit", type=float, default=300.0, help="processor seconds of a study")
    run.add_argument("--jobs", type=int, default=1, help="processes")
    score = verbs.add_parser("score", help="the scoreboard of what is there")
    for verb in (run, score):
        verb.add_argument(
            "--half", choices=(*bench.halves, "all"), default="tune", help="which part"
        )
        verb.add_argument("--strategy", help="the default one when left out")
        verb.add_argument("--out", help="folder of the rows")
        verb.add_argument("--code", help="version of the code; the last one when left out")
        verb.add_argument("--markdown", help="file for the scoreboard")
        verb.add_argument(
            "--details", action="store_true", help="show cases of the report half as well"
        )
    return parser.parse_args(sys.argv[1:] if words is None else words)


def _list(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]
