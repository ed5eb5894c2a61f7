"""Imperfections as a bench: one study, and the table with a line for each row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from experiments.imperfections.cases import NULL, cases, definition, question
from experiments.imperfections.rows import ROWS
from experiments.imperfections.scenes import SCENES
from experiments.studies.command import Bench
from experiments.studies.pieces import Row
from experiments.studies.rates import number_told, rate, rate_told
from experiments.studies.scoreboard import first, halves, invented, said, shown, table

HEAD = ("machine", "imperfection", "studies", "95 % intervals that hold", "floor / truth",
        "hidden first", "invented", "named in words", "s", "said, with an effect hidden",
        "said, with none")  # fmt: skip


def study(name: str, case: str, seed: int, strategy: str | None) -> Row:
    """One study; ``named`` says whether the sentence has a word for the imperfection."""
    row = question(name, case, seed).asked(strategy)
    words = ROWS[case.removesuffix(NULL)].words
    text = f"{row['summary']} {row['advice']}".lower()
    return {**row, "named": any(w in text for w in words) if words else None}


def entries() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Machine -> both halves (by seed), and every row twice."""
    return {name: ("", cases()) for name in SCENES}


def by_row(rows: Sequence[Row]) -> str:
    """The table: coverage, floor, ranks and inventions of each row, over its seeds."""
    lines = []
    for system in dict.fromkeys(r["key"]["system"] for r in rows):
        for name in ROWS:
            mine = [r for r in rows if r["key"]["system"] == system]
            mine = [r for r in mine if r["key"]["case"].removesuffix(NULL) == name]
            if mine:
                lines.append([system, name, *_line(mine)])
    return table(HEAD, lines)


def _line(rows: Sequence[Row]) -> list[str]:
    done = [r for r in rows if r["outcome"] == "done"]
    hidden = [r for r in rows if not r["key"]["case"].endswith(NULL)]
    nulls = [r for r in rows if r["key"]["case"].endswith(NULL)]
    held = [x for r in done for x in r["inside"].values()]
    floors = [r["floor"] / r["true_floor"] for r in done if r.get("true_floor")]
    named = [r["named"] for r in done if r.get("named") is not None]
    seconds = [r["seconds"] for r in done]
    return [
        str(len(rows)),
        rate_told(rate(held, bool)) + f", n = {len(held)}",
        number_told(float(np.median(floors)) if floors else None),
        f"{sum(map(first, hidden))}/{len(hidden)}",
        f"{sum(map(invented, done))}/{len(done)}",
        f"{sum(named)}/{len(named)}" if named else "-",
        number_told(float(np.median(seconds)) if seconds else None),
        "; ".join(dict.fromkeys(map(said, hidden))),
        "; ".join(dict.fromkeys(map(said, nulls))),
    ]


def score(rows: list[Row], details: bool) -> str:
    """Rates of each half, and the table of the half that may be shown."""
    parts = [halves(rows)]
    if seen := shown(rows, details):
        parts.append(by_row(seen))
    return "\n\n".join(parts)


BENCH = Bench("imperfections", entries, study, definition, score)
