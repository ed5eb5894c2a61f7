"""What a person sees: tables and sentences on standard output, progress on standard error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from spiral.types.formatting import number, percent, probability
from spiral.view.terminal.findings import not_separable, unknown
from spiral.view.terminal.parts import (
    Screen,
    about,
    command,
    heading,
    next_steps,
    parameter_table,
    ruled,
    warn_unconverged,
)
from spiral.view.terminal.shell import spoken

if TYPE_CHECKING:
    from spiral.io.request import Outcome
    from spiral.types.run import Comparison, Diagnosis, Round, Run, Suggestion

_WIDE, _MEDIUM = 110, 88


def show(verb: str, outcome: Outcome) -> None:
    """Print an outcome on standard output."""
    console = Screen(highlight=False)
    drawn = (_discover, _compare, _diagnose, _add, _simulate)
    {f.__name__.removeprefix("_"): f for f in drawn}[verb](console, outcome)


def _discover(console: Console, outcome: Outcome) -> None:
    run: Run = outcome.parts["run"]
    about(console, outcome)
    heading(console, "Rounds")
    console.print(_rounds(run, console.width))
    refused = run.verdict == "not_identifiable"
    if not refused:  # values that the record does not determine would mislead
        _model(console, run)
        details = run.rounds[-1].details if run.rounds else {}
        not_separable(console, details.get("not_separable", {}))
        unknown(console, run.unknown)
    heading(console, "Verdict")
    console.print(Text(f"{run.summary} {run.advice}"))
    if not refused:
        next_steps(console, *_after_discover(run, outcome.parts["config"]))


def _rounds(run: Run, width: int) -> Table:
    columns = ["round", "added", "fit error", "test error", "chi2/dof"]
    if width >= _MEDIUM:
        columns += ["whiteness p", "s"]
    if width >= _WIDE:
        columns[4:4] = ["noise floor"]
        columns[-2:-2] = ["horizon"]
    table = ruled(*columns, right=[c for c in columns if c != "added"])
    for item, c in ((r, r.comparison) for r in run.rounds):
        cells = {
            "round": str(item.number),
            "added": _added(item),
            "fit error": percent(c.fit_error),
            "test error": percent(c.test_error),
            "noise floor": percent(c.noise_floor),
            "chi2/dof": number(c.chi2_per_dof),
            "horizon": str(c.horizon),
            "whiteness p": probability(c.whiteness_p),
            "s": f"{item.seconds:.1f}",
        }
        table.add_row(*(cells[name] for name in columns))
    if width < _WIDE and run.rounds:
        table.caption = f"noise floor {percent(run.final.noise_floor)}"
        table.caption_justify = "left"
    return table


def _added(item: Round) -> Text:
    text = Text()
    if not item.admitted:
        text.append("the seed" if item.number == 0 else "nothing")
    for index, label in enumerate(item.admitted):
        text.append("\n" if index else "")
        text.append(label, style="bold green")
        text.append(" (second order)" if item.second_order else "", style="dim")
        text.append(f"\n{item.meaning}" if item.meaning and index == 0 else "", style="dim")
        aliases = item.aliases.get(label, ())
        if aliases:
            text.append(f"\ncannot be told from: {', '.join(aliases)}", style="yellow")
    for label in item.retired:
        text.append(f"\nlet go {label}: superfluous beside it", style="dim")
    for label, reason in item.rejected.items():
        text.append(f"\nrefused {label}: {reason}", style="dim")
    return text


def _model(console: Console, run: Run) -> None:
    from spiral.io.export.equation import equation

    heading(console, "Model")
    console.print(Text(equation(run.model)), soft_wrap=True)
    console.print()
    console.print(parameter_table(run.model))


def _after_discover(run: Run, config: dict[str, Any]) -> list[tuple[str, str]]:
    given = _taken_up(run, config)
    found = [x for r in run.rounds for x in r.admitted if x in run.model.labels]
    commands = [
        (f"spiral diagnose {given}", "what is left, and what comes closest to explaining it")
    ]
    if found:
        without = f"spiral compare {given} 'without=[{found[-1]}]'"
        commands.append((without, f"what {found[-1]} is worth"))
    learned = (run.unknown or {}).get("effect")
    if learned and learned not in run.model.labels:
        commands.insert(0, (f"spiral add {learned} {given}", "admit this curve as an effect"))
    commands.append((f"spiral compare {given}", "the final model against the test record"))
    alike = [(k, *v) for r in run.rounds for k, v in r.aliases.items() if v and k in found]
    if alike:
        names = " ".join(alike[0])
        commands.append((f"spiral plan {names} {given}", "which test would tell them apart"))
    return commands


def _taken_up(run: Run, config: dict[str, Any]) -> str:
    """The overrides that start from a saved run."""
    system = run.model.system
    file = getattr(system, system.program) if system.program else ""
    named = f" system.{system.program}={file}" if file else ""
    return f"run={run.run_id}{named}" + (f" out={config['out']}" if config["out"] != "runs" else "")


def _errors(comparisons: dict[str, Comparison]) -> Table:
    """One column for each comparison."""
    table = ruled("", *comparisons, right=list(comparisons))
    rows: dict[str, Callable[[Comparison], str]] = {
        "fit error": lambda c: percent(c.fit_error),
        "test error": lambda c: percent(c.test_error),
        "noise floor": lambda c: percent(c.noise_floor),
    }
    first = next(iter(comparisons.values()))
    for name in first.channels:
        unit = first.model.system.unit_of(name)
        rows[f"test rmse {name} ({unit})"] = lambda c, n=name: number(c.channels[n].rmse)
    rows["chi2/dof"] = lambda c: number(c.chi2_per_dof)
    rows["whiteness p"] = lambda c: probability(c.whiteness_p)
    rows["horizon"] = lambda c: f"{c.horizon} samples"
    for label, cell in rows.items():
        table.add_row(label, *(cell(c) for c in comparisons.values()))
    return table


def _compare(console: Console, outcome: Outcome) -> None:
    comparison: Comparison = outcome.parts["comparison"]
    about(console, outcome, numbers=True)
    heading(console, "Comparison")
    console.print(_errors({"model": comparison}))
    console.print()
    console.print(parameter_table(comparison.model))
    known = {n for r in outcome.parts["problem"].records for n in r.remarks}
    for note in dict.fromkeys(n for n in comparison.notes if n not in known):
        console.print(Text(note[:1].upper() + note[1:]))
    warn_unconverged(console, outcome)
    request = outcome.parts["request"]
    diagnose = (command("diagnose", request), "where it fails, and what may be missing")
    next_steps(console, diagnose, (command("discover", request), "find and add what is missing"))


def _add(console: Console, outcome: Outcome) -> None:
    parts = outcome.parts
    about(console, outcome)
    heading(console, f"Before and after adding {', '.join(parts['request'].names)}")
    console.print(_errors({"before": parts["before"], "after": parts["after"]}))
    _model(console, parts["run"])
    warn_unconverged(console, outcome)
    given = _taken_up(parts["run"], parts["config"])
    another = (f"spiral add EFFECT {given}", "add another effect to this model")
    next_steps(console, (f"spiral diagnose {given}", "what is still missing"), another)


def _diagnose(console: Console, outcome: Outcome) -> None:
    diagnosis: Diagnosis = outcome.parts["diagnosis"]
    about(console, outcome)
    heading(console, diagnosis.summary)
    if diagnosis.where.sentence:
        console.print(Text(diagnosis.where.sentence))
    if diagnosis.suggestions:
        heading(console, "What may be missing, best first")
        console.print(_suggestions(diagnosis.suggestions))
    not_separable(console, diagnosis.not_separable)
    unknown(console, diagnosis.unknown)
    if diagnosis.advice:
        console.print()
        console.print(Text(diagnosis.advice))
    request = outcome.parts["request"]
    if diagnosis.suggestions and diagnosis.verdict == "effect_missing":
        best = diagnosis.suggestions[0].effect
        next_steps(console, (command("add", request, [best]), f"add {best}, before and after"))
    elif diagnosis.unknown:
        best = diagnosis.unknown["effect"]
        next_steps(console, (command("add", request, [best]), "admit this curve as an effect"))


def _suggestions(found: Sequence[Suggestion]) -> Table:
    columns = ["", "effect", "explains", "p", "test error with it"]
    if all(item.test_error_after is None for item in found):
        columns.pop()
    table = ruled(*columns, right=[c for c in columns if c != "effect"])
    for rank, item in enumerate(found, 1):
        text = Text(item.effect, style="bold green" if rank == 1 else "bold")
        text.append(f"\n{item.meaning}", style="dim not bold")
        if item.aliases:
            words = f"\ncannot be told from: {', '.join(item.aliases)}"
            text.append(words, style="yellow not bold")
        numbers = [percent(item.explains), probability(item.p_value)]
        numbers += [percent(item.test_error_after)] if len(columns) == 5 else []
        table.add_row(str(rank), text, *numbers)
    return table


def _simulate(console: Console, outcome: Outcome) -> None:
    for written in outcome.parts["written"]:
        units = ", ".join(f"{k} in {u or '1'}" for k, u in written.units.items())
        console.print(Text(f"{written.file}: {written.rows} rows; {units}"), soft_wrap=True)
    back = spoken("spiral", "discover", *outcome.result["read_back"])
    next_steps(console, (back, "read it back and find what its model is made of"))
