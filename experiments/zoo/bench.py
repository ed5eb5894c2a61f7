"""The zoo as a bench: its machines, their halves, and one study."""

from __future__ import annotations

from experiments.studies.command import Bench
from experiments.studies.pieces import Row
from experiments.studies.scoreboard import board
from experiments.zoo.cases import definition, half, question
from experiments.zoo.truth import MACHINES


def study(name: str, case: str, seed: int, strategy: str | None) -> Row:
    """One study of the zoo."""
    return {"topic": MACHINES[name].topic, **question(name, case, seed).asked(strategy)}


def entries() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Machine -> its half and its cases."""
    return {name: (half(name), machine.cases) for name, machine in sorted(MACHINES.items())}


BENCH = Bench("zoo", "", entries, study, definition, board)
