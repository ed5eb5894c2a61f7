"""The forty cases as a bench: twenty for development, twenty for the report."""

from __future__ import annotations

from experiments.structures import cases
from experiments.structures.kinds import KINDS
from experiments.studies.command import FIRST_SEED, Bench
from experiments.studies.pieces import Row
from experiments.studies.scoreboard import board

EACH = 10
"""Cases of a structure in a half."""


def study(name: str, case: str, seed: int, strategy: str | None) -> Row:
    """One case: what was hidden, how strong, what the study says, the reduction's error."""
    half = int(seed >= FIRST_SEED["report"])
    asked, drawn = cases.question(name, int(case) + EACH * half, half)
    row = asked.asked(strategy)
    return {"share": drawn.share, "reduction": asked.system.report, **row}


def entries() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Structure -> its cases, in both halves."""
    return {name: ("", tuple(map(str, range(EACH)))) for name in KINDS}


def definition(_: str) -> str:
    """The version of what makes a question."""
    return cases.definition()


def score(rows: list[Row], details: bool) -> str:
    """The scoreboard, and the errors of the reductions."""
    errors = dict.fromkeys(r["reduction"] for r in rows if r.get("reduction"))
    return "\n\n".join([board(rows, details), *errors])


BENCH = Bench("structures", entries, study, definition, score)
