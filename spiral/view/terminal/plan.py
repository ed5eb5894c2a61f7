"""What a person sees of planned tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from spiral.types.formatting import number, percent
from spiral.view.terminal.parts import Screen, heading, next_steps, ruled
from spiral.view.terminal.shell import spoken

if TYPE_CHECKING:
    from spiral.inference.plan import Outlook, Plan
    from spiral.io.request import Outcome, Request

VERBS = ("plan",)


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    found: Plan = outcome.parts["plan"]
    names = " and ".join(e.label for e in found.wanted.effects)
    unit = f" in {found.unit}" if found.unit else ""
    question = f"Tests that tell {names} apart" if names else ""
    heading(console, question or f"Tests for {found.wanted.parameter}{unit}")
    console.print(_tests(found, outcome.parts["shown"]))
    hidden = len(found.tests) - outcome.parts["shown"]
    if hidden > 0:
        console.print(Text(f"and {hidden} more, plan.shown={len(found.tests)} shows them", "dim"))
    for note in found.notes:
        console.print(Text(note, "yellow"))
    console.print()
    console.print(Text(found.advice), soft_wrap=True)
    if found.suffices:
        words = outcome.result["tests"][0]["overrides"]
        command = _simulated(outcome.parts["request"], words)
        next_steps(console, (command, "try it before it is run"))


def _tests(found: Plan, shown: int) -> Table:
    apart = bool(found.wanted.effects)
    last = ["tells apart", "angle", "rise of chi2"] if apart else ["standard error"]
    table = ruled("", "test", *last, right=["", *last])
    table.add_row("", Text("the record at hand", "dim"), *_cells(found.now, apart))
    for rank, outlook in enumerate(found.tests[:shown], 1):
        enough = rank <= found.suffices
        words = Text(outlook.test.words, "bold green" if enough and rank == 1 else "")
        if outlook.failure:
            words.append(f"\n{outlook.failure}", style="yellow")
        table.add_row(str(rank), words, *_cells(outlook, apart))
    return table


def _cells(outlook: Outlook, apart: bool) -> list[str]:
    if outlook.failure:
        return ["-"] * (3 if apart else 1)
    if not apart:
        return [number(outlook.error, 3)]
    worst = min(outlook.pairs, key=lambda p: p.noncentrality, default=None)
    if worst is None:
        return ["-"] * 3
    share = percent(outlook.probability)
    return [share, f"{worst.angle:.1f} deg", number(worst.noncentrality, 3)]


def _simulated(request: Request, words: list[str]) -> str:
    """The command that simulates a planned test."""
    own = [w for w in request.overrides if not w.startswith(("plan.", "record.", "record="))]
    if not any(w.startswith("run=") for w in own):
        own = [w for w in request.overrides if not w.startswith("plan.")]
    return spoken("spiral", "simulate", *own, *words, "--out", "planned.csv")
