"""Scoreboards in Markdown: rates of a half with Wilson's 95 % intervals, a line for each case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from experiments.studies.rates import Row, number_told, rate, rate_told

NEAR_ONE = (0.9, 1.1)
"""Chi2 of a final model that its noise explains."""
Line = tuple[str, Callable[[Sequence[Row]], str]]


def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join(f"| {' | '.join(_cell(c) for c in row)} |" for row in rows)


def _cell(text: str) -> str:
    return str(text).replace("|", "/").replace("\n", " ")


def median(rows: Sequence[Row], key: str) -> float | None:
    """Median of what rows have, absolute."""
    values = [abs(r[key]) for r in rows if r.get(key) is not None]
    return float(np.median(values)) if values else None


def largest(rows: Sequence[Row], key: str) -> float | None:
    """Largest of what rows have."""
    return max((r[key] for r in rows if r.get(key) is not None), default=None)


def first(row: Row) -> bool:
    """Whether the hidden effect, at its place, came first; a study that did not end has missed."""
    return bool(row.get("first"))


def invented(row: Row) -> bool:
    """Whether something was admitted that is not there."""
    return bool(row.get("invented"))


def near_one(row: Row) -> bool:
    """Whether chi2 of the final model lies between 0.9 and 1.1."""
    return NEAR_ONE[0] <= row["chi2"] <= NEAR_ONE[1]


def rates_of(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """What is reported of hidden and of null studies: name and figure."""
    hidden = [r for r in rows if r["key"]["case"].split()[-1] != "null"]
    nulls = [r for r in rows if r["key"]["case"].split()[-1] == "null"]
    right = [r for r in hidden if first(r)]
    known = [r for r in right if r.get("error_se") is not None]
    ended = [r for r in nulls if r["outcome"] == "done"]
    return [
        ("studies", f"{len(rows)}, {sum(r['outcome'] == 'timeout' for r in rows)} timed out, "
                    f"{sum(r['outcome'] == 'failed' for r in rows)} failed"),
        ("right effect and place first", _counted(hidden, first)),
        ("chi2 0.9 to 1.1 where right", _counted(right, near_one)),
        ("coefficient within 2 se where right", _counted(known, lambda r: abs(r["error_se"]) <= 2)),
        ("coefficient's error, median", number_told(median(known, "error_relative"))),
        ("invented beside what is hidden", _counted(hidden, invented)),
        ("nulls with anything invented", _counted(ended, invented)),
        ("nulls called nothing_missing", _counted(ended, _quiet)),
        ("processor seconds, median and most", f"{number_told(median(rows, 'seconds'))}, "
                                               f"{number_told(largest(rows, 'seconds'))}"),
    ]  # fmt: skip


def _quiet(row: Row) -> bool:
    return row.get("verdict") == "nothing_missing"


def _counted(rows: Sequence[Row], hit: Callable[[Any], bool]) -> str:
    return f"{rate_told(rate(rows, hit))}, n = {len(rows)}"


def halves(rows: Sequence[Row]) -> str:
    """The rates of each half, side by side."""
    names = list(dict.fromkeys(r["key"]["half"] for r in rows))
    parts = {n: rates_of([r for r in rows if r["key"]["half"] == n]) for n in names}
    if not parts:
        return "nothing was run yet"
    labels = [label for label, _ in parts[names[0]]]
    lines = [[label, *(dict(parts[n])[label] for n in names)] for label in labels]
    return table(["", *names], lines)


CASES: tuple[Line, ...] = (
    ("n", lambda rows: str(len(rows))),
    ("first", lambda rows: f"{sum(map(first, rows))}/{len(rows)}"),
    ("invented", lambda rows: f"{sum(map(invented, rows))}"),
    ("chi2", lambda rows: number_told(median(rows, "chi2"))),
    ("error, se", lambda rows: number_told(median(rows, "error_se"))),
    ("error, relative", lambda rows: number_told(median(rows, "error_relative"))),
    ("test error / floor", lambda rows: number_told(_over_floor(rows))),
    ("s", lambda rows: number_told(median(rows, "seconds"))),
    ("said", lambda rows: "; ".join(dict.fromkeys(map(said, rows)))),
)


def _over_floor(rows: Sequence[Row]) -> float | None:
    ratios = [r["after"] / r["floor"] for r in rows if r.get("floor")]
    return float(np.median(ratios)) if ratios else None


def said(row: Row) -> str:
    """What a study ended with: effects and verdict, or why there are none."""
    if row["outcome"] != "done":
        return row.get("error", row["outcome"])[:80]
    return f"{', '.join(row['admitted']) or 'nothing'}: {row['verdict']}"


def by_case(rows: Sequence[Row], lines: Sequence[Line] = CASES) -> str:
    """A line for each system and case."""
    places = sorted({(r["key"]["system"], r["key"]["case"]) for r in rows})
    found = []
    for place in places:
        mine = [r for r in rows if (r["key"]["system"], r["key"]["case"]) == place]
        hidden = next((", ".join(r["hidden"]) for r in mine if r.get("hidden")), "")
        found.append([*place, hidden, *(figure(mine) for _, figure in lines)])
    return table(["system", "case", "hidden", *(name for name, _ in lines)], found)


def shown(rows: Sequence[Row], details: bool) -> list[Row]:
    """Rows whose cases may be looked at: those of the report half only where asked."""
    return [r for r in rows if details or r["key"]["half"] != "report"]


def board(rows: Sequence[Row], details: bool = False) -> str:
    """The scoreboard: rates of each half, and the cases that may be shown."""
    parts = [halves(rows)]
    if seen := shown(rows, details):
        parts.append(by_case(seen))
    return "\n\n".join(parts)
