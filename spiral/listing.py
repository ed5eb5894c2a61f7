"""What a person sees of plugins: the list, the checks of one, the files of a new one."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from spiral.terminal import _heading, _next, _table, _warn_unconverged

if TYPE_CHECKING:
    from spiral.testing import Check
    from spiral.verbs import Outcome

VERBS = ("plugins", "check", "new")


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Console(highlight=False)
    {"plugins": _plugins, "check": _check, "new": _new}[verb](console, outcome)


def _plugins(console: Console, outcome: Outcome) -> None:
    entries = outcome.parts["entries"]
    for kind in dict.fromkeys(e.kind for e in entries):
        _heading(console, f"{kind}" + (" (record=, test=)" if kind == "source" else ""))
        table = _table("name", "meaning", "from")
        for entry in (e for e in entries if e.kind == kind):
            origin = entry.origin if entry.origin == "local" else f"{entry.origin} {entry.version}"
            table.add_row(Text(entry.name, style="bold"), Text(entry.plugin.meaning()), origin)
        console.print(table)
    for entry in (e for e in entries if e.name in outcome.parts["asked"]):
        _fields(console, entry.plugin)
    for failure in outcome.parts["failures"]:
        console.print(Text(f"not usable: {failure.name} in {failure.file}", style="bold red"))
        console.print(Text(f"    {failure.message}"))


def _fields(console: Console, plugin: type) -> None:
    """A plugin's fields with their defaults and meanings."""
    from spiral.fields import defaults_of, field_meanings

    fields = {k: v for k, v in defaults_of(plugin).items() if k != "variant"}
    if not fields:
        return
    console.print()
    meanings = field_meanings(plugin)
    table = _table("field", "default", "meaning")
    for name, default in fields.items():
        shown = "" if default is None else str(default)
        table.add_row(Text(name, style="bold"), Text(shown), Text(meanings.get(name, "")))
    console.print(table)


def _check(console: Console, outcome: Outcome) -> None:
    for entry, checks in outcome.parts["checked"]:
        for on in dict.fromkeys(c.on for c in checks):
            _heading(console, f"{entry.kind} {on}")
            console.print(_results([c for c in checks if c.on == on]))
        passed = sum(c.passed for c in checks)
        style = "bold green" if passed == len(checks) else "bold red"
        console.print()
        console.print(Text(f"{entry.name}: {passed} of {len(checks)} checks passed", style))
    _warn_unconverged(console, outcome)


def _results(checks: list[Check]) -> Table:
    table = _table("check", "", "seen")
    for check in checks:
        seen = Text(check.seen)
        if not check.passed and check.try_:
            seen.append(f"\ntry: {check.try_}", style="yellow")
        mark = Text("passed", "green") if check.passed else Text("failed", "bold red")
        table.add_row(check.name, mark, seen)
    return table


def _new(console: Console, outcome: Outcome) -> None:
    parts = outcome.parts
    for file in parts["files"]:
        console.print(Text(f"written: {file}"), soft_wrap=True)
    if parts["similar"]:
        console.print(Text(f"similar plugins: {', '.join(parts['similar'])}", style="dim"))
    where = f" --plugins {shlex.quote(parts['plugins'])}" if parts["plugins"] else ""
    _next(
        console,
        (f"spiral check {parts['name']}{where}", "after each change of the first file"),
        (f"pytest {shlex.quote(str(parts['files'][1]))}", "its own test"),
    )
