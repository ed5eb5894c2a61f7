"""Terminal output of verbs on plugins, of ``identify``, and of verbs that write files."""

from __future__ import annotations

import inspect
import re
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from spiral.types.errors import SpiralError
from spiral.types.formatting import number, percent
from spiral.view.terminal.parts import (
    Screen,
    print_heading,
    print_next_steps,
    print_outcome_error,
    print_records,
    request_command,
    ruled_table,
)
from spiral.view.terminal.shell import join_command
from spiral.view.terminal.systems import print_system

if TYPE_CHECKING:
    from spiral.inference.identifiability.identify import Identification
    from spiral.io.request import Outcome
    from spiral.io.testing import Check
    from spiral.types.effect import Effect
    from spiral.types.system import System

VERBS = ("plugins", "check", "new", "identify", "report", "export")


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    drawn = {
        "plugins": _print_plugins,
        "check": _print_checks,
        "new": _print_new_files,
        "identify": _print_identification,
        "report": _print_report,
        "export": _print_export,
    }
    drawn[verb](console, outcome)


def _print_export(console: Console, outcome: Outcome) -> None:
    result = outcome.result
    text = f"{result['file']}: the model of run {result['run']}, {result['bytes'] / 1e3:.1f} kB"
    console.print(Text(text), soft_wrap=True)
    console.print(Text(result["meaning"], "dim"), soft_wrap=True)


def _print_report(console: Console, outcome: Outcome) -> None:
    result = outcome.result
    size = f"{result['bytes'] / 1e6:.1f} MB, {len(result['figures'])} figures"
    console.print(Text(f"{result['file']}: run {result['run']}, {size}"), soft_wrap=True)
    console.print(Text("open it in any browser; it needs no network", "dim"))


def _print_plugins(console: Console, outcome: Outcome) -> None:
    entries = outcome.parts["entries"]
    for kind in dict.fromkeys(e.kind for e in entries):
        print_heading(console, f"{kind}" + (" (record=, test=)" if kind == "source" else ""))
        table, own = ruled_table("name", "meaning", "from"), [e for e in entries if e.kind == kind]
        for entry in own:
            origin = entry.origin if entry.origin == "local" else f"{entry.origin} {entry.version}"
            table.add_row(Text(entry.name, style="bold"), Text(entry.plugin.meaning()), origin)
        console.print(table)
        if kind == "effect" and not {e.name for e in own} & {*outcome.parts["asked"]}:
            _print_laws(console)
    for entry in (e for e in entries if e.name in outcome.parts["asked"]):
        _print_explanation(console, entry.plugin)
        if entry.kind == "effect":
            _print_parameters(console, entry.plugin)
            _print_where_it_acts(console, entry.plugin)
        if entry.kind == "system":
            _print_system(console, entry.plugin)
        _print_fields(console, entry.plugin)
    for file, system in outcome.parts["models"].items():
        print_heading(console, f"{file}: {system.title}")
        print_system(console, system)
    for failure in outcome.parts["failures"]:
        console.print(Text(f"not usable: {failure.name} in {failure.file}", style="bold red"))
        console.print(Text(f"    {failure.message}"))


def _print_laws(console: Console) -> None:
    """What is tried where no effect passes."""
    from spiral.physics.formulas.laws import law_names

    names = ", ".join(law_names())
    console.print(Text(f"where none of them passes, laws in closed form are tried: {names}; then "
                       "parameters that vary, and curves", "dim"))  # fmt: skip


def _print_explanation(console: Console, plugin: type) -> None:
    """What a plugin's docstring says after its meaning."""
    _, _, rest = inspect.cleandoc(plugin.__doc__ or "").partition("\n\n")
    rest, _, _ = rest.partition("Fields\n------")  # they have a table
    for part in filter(str.strip, rest.replace("``", "").split("\n\n")):
        formula = part.startswith(" ")
        console.print()
        console.print(Text(part if formula else " ".join(part.split())))


def _print_parameters(console: Console, plugin: type) -> None:
    """The parameters of an effect: units, bounds, and which are shapes."""
    parameters = getattr(plugin, "parameters", ())
    if not isinstance(parameters, tuple) or not parameters:
        return  # of an effect with fields
    console.print()
    table = ruled_table("parameter", "unit", "least", "most", "")
    for one in parameters:
        bounds = ("" if b is None else number(b) for b in (one.lower, one.upper))
        remarks = [
            "shape: means nothing while the amplitude is zero" if one.role == "shape" else "",
            "one for each axis" if one.per_axis else "",
            "one for each record" if one.scope == "record" else "",
        ]
        told = "; ".join(filter(None, remarks))
        table.add_row(Text(one.name, style="bold"), Text(one.unit or "1"), *bounds, Text(told))
    console.print(table)
    words = set(re.findall("[a-z]+", " ".join(p.unit for p in parameters)))
    if words & {"force", "position", "velocity"}:
        console.print(Text("force, position, velocity: those of the place where it acts", "dim"))


def _print_system(console: Console, plugin: type[System]) -> None:
    """What a system is with the defaults of its fields; nothing where one of them has none."""
    from spiral.types.fields import construct

    try:
        system = construct(plugin, {}, "system")
    except SpiralError:
        return  # a file, a robot or a program is named first
    print_system(console, system)


def _print_where_it_acts(console: Console, plugin: type[Effect]) -> None:
    """What an effect needs of its place, and what it looks like."""
    from spiral.types.effect import InputEffect, ParameterEffect, SensorEffect, StateFlow

    kinds = {
        SensorEffect: "on sensors", InputEffect: "on an input",
        ParameterEffect: "on a parameter and what it follows, PARAMETER-VARIABLE",
        StateFlow: "on states of first order",
    }  # fmt: skip
    if issubclass(plugin, StateFlow) and plugin.driver:
        kinds[StateFlow] = (
            "on a state and another one that acts on it, STATE-OTHER"
            if plugin.driver == "path"
            else f"on a state to which the {plugin.driver} has no path, STATE-VARIABLE"
        )
    if issubclass(plugin, ParameterEffect) and plugin.steady:
        kinds[ParameterEffect] = "on a known parameter"
    if issubclass(plugin, SensorEffect) and plugin.driver:
        kinds[SensorEffect] = "on a sensor and what else it may follow, CHANNEL-VARIABLE"
    where = next((told for kind, told in kinds.items() if issubclass(plugin, kind)), "at a port")
    several = plugin.axes is not None and plugin.axes > 1
    together = ", two together" if issubclass(plugin, StateFlow) else f" of {plugin.axes} axes"
    axes = together if several else ""
    units = getattr(plugin, "units", ())
    first = f"acts {where}{axes}" + (f" in {', '.join(units)}" if units else "")
    if issubclass(plugin, StateFlow) and plugin.differences:
        also = "with" if plugin.differences == "only" else "or on"
        first += f", {also} what a state has more than an input or a state of its unit"
    named = (
        ("needs the inputs {}", plugin.inputs), ("needs the channels {}", plugin.channels),
        ("in the limits of its shapes it is {}", plugin.special),
        ("does what {} does elsewhere", plugin.twins),
    )  # fmt: skip
    told = [words.format(" or ".join(names)) for words, names in named if names]
    console.print()
    console.print(Text("; ".join([first, *told])))


def _print_fields(console: Console, plugin: type) -> None:
    """A plugin's fields with their defaults and meanings."""
    from spiral.types.fields import defaults_of, field_meanings

    fields = {k: v for k, v in defaults_of(plugin).items() if k != "variant"}
    if not fields:
        return
    console.print()
    meanings = field_meanings(plugin)
    table = ruled_table("field", "default", "meaning")
    for name, default in fields.items():
        shown = "" if default is None else str(default)
        table.add_row(Text(name, style="bold"), Text(shown), Text(meanings.get(name, "")))
    console.print(table)


def _print_checks(console: Console, outcome: Outcome) -> None:
    for entry, checks in outcome.parts["checked"]:
        for on in dict.fromkeys(c.on for c in checks):
            print_heading(console, f"{entry.kind} {on}")
            console.print(_check_table([c for c in checks if c.on == on]))
        passed = sum(c.passed for c in checks)
        style = "bold green" if passed == len(checks) else "bold red"
        console.print()
        console.print(Text(f"{entry.name}: {passed} of {len(checks)} checks passed", style))
    print_outcome_error(console, outcome)


def _check_table(checks: list[Check]) -> Table:
    table = ruled_table("check", "", "seen")
    for check in checks:
        seen = Text(check.seen)
        if not check.passed and check.try_:
            seen.append(f"\ntry: {check.try_}", style="yellow")
        mark = Text("passed", "green") if check.passed else Text("failed", "bold red")
        table.add_row(check.name, mark, seen)
    return table


def _print_new_files(console: Console, outcome: Outcome) -> None:
    parts = outcome.parts
    for file in parts["files"]:
        console.print(Text(f"written: {file}"), soft_wrap=True)
    if parts["similar"]:
        console.print(Text(f"similar plugins: {', '.join(parts['similar'])}", style="dim"))
    where = ["--plugins", parts["plugins"]] if parts["plugins"] else []
    print_next_steps(
        console,
        (
            join_command("spiral", "check", parts["name"], *where),
            "after each change of the first file",
        ),
        (join_command("pytest", str(parts["files"][1])), "its own test"),
    )


def _print_identification(console: Console, outcome: Outcome) -> None:
    identification: Identification = outcome.parts["found"]
    print_records(console, outcome)
    apart = identification.verdict == "identifiable"
    print_heading(
        console,
        "The terms can be told apart."
        if apart
        else "This record cannot tell all terms apart, however long it is.",
    )
    console.print(_identification_table(identification))
    if identification.left_out:
        console.print()
        for effect, reason in identification.left_out.items():
            console.print(Text(f"left out {effect}: {reason}", style="dim"))
    if identification.aliases:
        print_heading(console, "Not told apart")
        for group in identification.aliases:
            console.print(Text(f"  {', '.join(group)}", style="yellow"))
    console.print()
    console.print(Text(identification.advice), soft_wrap=True)
    if apart:
        request = outcome.parts["request"]
        print_next_steps(
            console, (request_command("discover", request), "find and add what is missing")
        )


def _identification_table(identification: Identification) -> Table:
    table = ruled_table("", "", "meaning", right=[""])
    rich = identification.richness
    rows = {
        "rank": (f"{rich.rank} of {rich.columns}", "terms whose signatures are independent"),
        "mu": (number(rich.mu), "smallest eigenvalue of the normalised Gram matrix"),
        "condition": (number(rich.condition), "largest over smallest eigenvalue"),
        "coherence": (number(rich.coherence), "largest cosine of two signatures"),
        "eps_0": (percent(identification.epsilon), "of the acceleration is outside the terms"),
        "SNR": (number(identification.snr), f"needed: {number(identification.snr_min)}"),
        "samples": (str(rich.samples), f"needed: {number(identification.samples_needed)}"),
        "bias": (
            percent(identification.bias_bound),
            "at most, of the acceleration's rms (Theorem 1)",
        ),
        "spread": (percent(identification.spread_bound), "at most, rms over noises (Theorem 1)"),
    }
    for name, (value, meaning) in rows.items():
        table.add_row(name, value, meaning)
    return table
