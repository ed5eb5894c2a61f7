"""What a person sees of plugins (a list, checks, files of a new one), ``identify`` and files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from spiral.types.formatting import number, percent
from spiral.view.terminal.parts import (
    Screen,
    about,
    command,
    heading,
    next_steps,
    ruled,
    warn_unconverged,
)
from spiral.view.terminal.shell import spoken

if TYPE_CHECKING:
    from spiral.inference.identifiability.identify import Identification
    from spiral.io.request import Outcome
    from spiral.io.testing import Check

VERBS = ("plugins", "check", "new", "identify", "report", "export")


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    drawn = {"plugins": _plugins, "check": _check, "new": _new, "identify": _identify,
             "report": _report, "export": _export}  # fmt: skip
    drawn[verb](console, outcome)


def _export(console: Console, outcome: Outcome) -> None:
    found = outcome.result
    text = f"{found['file']}: the model of run {found['run']}, {found['bytes'] / 1e3:.1f} kB"
    console.print(Text(text), soft_wrap=True)
    console.print(Text(found["meaning"], "dim"), soft_wrap=True)


def _report(console: Console, outcome: Outcome) -> None:
    found = outcome.result
    size = f"{found['bytes'] / 1e6:.1f} MB, {len(found['figures'])} figures"
    console.print(Text(f"{found['file']}: run {found['run']}, {size}"), soft_wrap=True)
    console.print(Text("open it in any browser; it needs no network", "dim"))


def _plugins(console: Console, outcome: Outcome) -> None:
    entries = outcome.parts["entries"]
    for kind in dict.fromkeys(e.kind for e in entries):
        heading(console, f"{kind}" + (" (record=, test=)" if kind == "source" else ""))
        table = ruled("name", "meaning", "from")
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
    from spiral.types.fields import defaults_of, field_meanings

    fields = {k: v for k, v in defaults_of(plugin).items() if k != "variant"}
    if not fields:
        return
    console.print()
    meanings = field_meanings(plugin)
    table = ruled("field", "default", "meaning")
    for name, default in fields.items():
        shown = "" if default is None else str(default)
        table.add_row(Text(name, style="bold"), Text(shown), Text(meanings.get(name, "")))
    console.print(table)


def _check(console: Console, outcome: Outcome) -> None:
    for entry, checks in outcome.parts["checked"]:
        for on in dict.fromkeys(c.on for c in checks):
            heading(console, f"{entry.kind} {on}")
            console.print(_results([c for c in checks if c.on == on]))
        passed = sum(c.passed for c in checks)
        style = "bold green" if passed == len(checks) else "bold red"
        console.print()
        console.print(Text(f"{entry.name}: {passed} of {len(checks)} checks passed", style))
    warn_unconverged(console, outcome)


def _results(checks: list[Check]) -> Table:
    table = ruled("check", "", "seen")
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
    where = ["--plugins", parts["plugins"]] if parts["plugins"] else []
    next_steps(
        console,
        (spoken("spiral", "check", parts["name"], *where), "after each change of the first file"),
        (spoken("pytest", str(parts["files"][1])), "its own test"),
    )


def _identify(console: Console, outcome: Outcome) -> None:
    found: Identification = outcome.parts["found"]
    about(console, outcome)
    apart = found.verdict == "identifiable"
    heading(
        console,
        "The terms can be told apart."
        if apart
        else "This record cannot tell all terms apart, however long it is.",
    )
    console.print(_figures(found))
    if found.left_out:
        console.print()
        for effect, reason in found.left_out.items():
            console.print(Text(f"left out {effect}: {reason}", style="dim"))
    if found.aliases:
        heading(console, "Not told apart")
        for group in found.aliases:
            console.print(Text(f"  {', '.join(group)}", style="yellow"))
    console.print()
    console.print(Text(found.advice), soft_wrap=True)
    if apart:
        request = outcome.parts["request"]
        next_steps(console, (command("discover", request), "find and add what is missing"))


def _figures(found: Identification) -> Table:
    table = ruled("", "", "meaning", right=[""])
    rich = found.found
    rows = {
        "rank": (f"{rich.rank} of {rich.columns}", "terms whose signatures are independent"),
        "mu": (number(rich.mu), "smallest eigenvalue of the normalised Gram matrix"),
        "condition": (number(rich.condition), "largest over smallest eigenvalue"),
        "coherence": (number(rich.coherence), "largest cosine of two signatures"),
        "eps_0": (percent(found.epsilon), "of the acceleration is outside the terms"),
        "SNR": (number(found.snr), f"needed: {number(found.snr_min)}"),
        "samples": (str(rich.samples), f"needed: {number(found.samples_needed)}"),
        "bias": (percent(found.bias_bound), "at most, of the acceleration's rms (Theorem 1)"),
        "spread": (percent(found.spread_bound), "at most, rms over noises (Theorem 1)"),
    }
    for name, (value, meaning) in rows.items():
        table.add_row(name, value, meaning)
    return table
