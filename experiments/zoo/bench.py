"""The zoo as a bench: its machines and measured sets, their halves, and one study."""

from __future__ import annotations

from experiments.studies.command import Bench
from experiments.studies.pieces import Row
from experiments.studies.scoreboard import board
from experiments.zoo import cases, measured
from experiments.zoo.truth import MACHINES

MEASURED = "measured"


def study(name: str, case: str, seed: int, strategy: str | None) -> Row:
    """One study of the zoo."""
    if case == MEASURED:
        return {"topic": MEASURED, **measured.SETS[name].asked(strategy)}
    return {"topic": MACHINES[name].topic, **cases.question(name, case, seed).asked(strategy)}


def entries() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Machine -> its half and its cases; measured sets whose files are there are a group beside."""
    made = {name: (cases.half(name), m.cases) for name, m in sorted(MACHINES.items())}
    return {**made, **dict.fromkeys(measured.here(), (MEASURED, (MEASURED,)))}


def definition(name: str) -> str:
    """The version of what makes a question."""
    return measured.definition() if name in measured.SETS else cases.definition(name)


def score(rows: list[Row], details: bool) -> str:
    """The scoreboard, and which measured sets are not there."""
    return "\n\n".join(part for part in (board(rows, details), measured.absent()) if part)


BENCH = Bench("zoo", entries, study, definition, score)
