"""Terminal output of ``spiral plan``: the ranked tests."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.table import Table
from rich.text import Text

from spiral.types.formatting import number, percent
from spiral.view.terminal.parts import Screen, print_heading, print_next_steps, ruled_table
from spiral.view.terminal.shell import join_command

if TYPE_CHECKING:
    from spiral.inference.plan import Plan, TestForecast
    from spiral.io.request import Outcome, Request

VERBS = ("plan",)


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    test_plan: Plan = outcome.parts["plan"]
    names = " and ".join(e.label for e in test_plan.wanted.effects)
    unit = f" in {test_plan.unit}" if test_plan.unit else ""
    question = f"Tests that tell {names} apart" if names else ""
    print_heading(console, question or f"Tests for {test_plan.wanted.parameter}{unit}")
    console.print(_test_table(test_plan, outcome.parts["shown"]))
    hidden = len(test_plan.tests) - outcome.parts["shown"]
    if hidden > 0:
        console.print(
            Text(f"and {hidden} more, plan.shown={len(test_plan.tests)} shows them", "dim")
        )
    for note in test_plan.notes:
        console.print(Text(note, "yellow"))
    console.print()
    console.print(Text(test_plan.advice), soft_wrap=True)
    if test_plan.suffices:
        words = outcome.result["tests"][0]["overrides"]
        command = _simulation_command(outcome.parts["request"], words)
        print_next_steps(console, (command, "try it before it is run"))


def _test_table(test_plan: Plan, shown: int) -> Table:
    apart = bool(test_plan.wanted.effects)
    last = ["tells apart", "angle", "rise of chi2"] if apart else ["standard error"]
    table = ruled_table("", "test", *last, right=["", *last])
    table.add_row("", Text("the record at hand", "dim"), *_outlook_cells(test_plan.now, apart))
    for rank, outlook in enumerate(test_plan.tests[:shown], 1):
        enough = rank <= test_plan.suffices
        words = Text(outlook.test.words, "bold green" if enough and rank == 1 else "")
        if outlook.failure:
            words.append(f"\n{outlook.failure}", style="yellow")
        table.add_row(str(rank), words, *_outlook_cells(outlook, apart))
    return table


def _outlook_cells(outlook: TestForecast, apart: bool) -> list[str]:
    if outlook.failure:
        return ["-"] * (3 if apart else 1)
    if not apart:
        return [number(outlook.error, 3)]
    worst = min(outlook.pairs, key=lambda p: p.noncentrality, default=None)
    if worst is None:
        return ["-"] * 3
    share = percent(outlook.probability)
    return [share, f"{worst.angle:.1f} deg", number(worst.noncentrality, 3)]


def _simulation_command(request: Request, words: list[str]) -> str:
    """The command that simulates a planned test."""
    own = [w for w in request.overrides if not w.startswith(("plan.", "record.", "record="))]
    if not any(w.startswith("run=") for w in own):
        own = [w for w in request.overrides if not w.startswith("plan.")]
    return join_command("spiral", "simulate", *own, *words, "--out", "planned.csv")
