"""Terminal output of discover, compare, diagnose, add and simulate: tables and sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from spiral.inference.disturbances import (
    random_forces,
    random_sentence,
    record_sentence,
    what_acts,
)
from spiral.inference.nearness import next_sample_error
from spiral.types.formatting import capitalised, number, percent, probability
from spiral.view.terminal.findings import print_not_separable, print_unknown_shape
from spiral.view.terminal.parts import (
    Screen,
    parameter_table,
    print_heading,
    print_next_steps,
    print_outcome_error,
    print_points,
    print_records,
    request_command,
    ruled_table,
)
from spiral.view.terminal.shell import join_command

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
    print_records(console, outcome)
    print_heading(console, "Rounds")
    console.print(_round_table(run, console.width))
    for line in _left_out_lines(run):
        console.print(Text(line, style="dim"))
    refused = run.verdict == "not_identifiable"
    if not refused:  # values that the record does not determine would mislead
        _print_model(console, run)
        details = run.rounds[-1].details if run.rounds else {}
        print_not_separable(console, details.get("not_separable", {}))
        print_unknown_shape(console, run.unknown)
    print_heading(console, "Verdict")
    print_points(console, f"{run.summary} {run.advice}")
    if not refused:
        print_next_steps(console, *_commands_after_discover(run, outcome.parts["config"]))


def _round_table(run: Run, width: int) -> Table:
    columns = ["round", "added", "fit error", "test error", "chi2/dof"]
    if width >= _MEDIUM:
        columns += ["whiteness p", "s"]
    if width >= _WIDE:
        columns[4:4] = ["noise floor"]
        columns[-2:-2] = ["horizon"]
    table = ruled_table(*columns, right=[c for c in columns if c != "added"])
    for item, c in ((r, r.comparison) for r in run.rounds):
        cells = {
            "round": str(item.number),
            "added": _admission_text(item),
            "fit error": percent(c.fit_error),
            "test error": percent(c.test_error),
            "noise floor": percent(c.floor),
            "chi2/dof": number(c.chi2_per_dof),
            "horizon": str(c.horizon),
            "whiteness p": probability(c.whiteness_p),
            "s": f"{item.seconds:.1f}",
        }
        table.add_row(*(cells[name] for name in columns))
    if width < _WIDE and run.rounds:
        table.caption = f"noise floor {percent(run.final.floor)}"
        table.caption_justify = "left"
    return table


def _admission_text(item: Round) -> Text:
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
        text.append(f"\nremoved {label}: superfluous beside later findings", style="dim")
    named = {alias for label in item.admitted for alias in item.aliases.get(label, ())}
    for label, reason in item.rejected.items():
        if item.left_out.get(label) != reason and label not in named:
            text.append(f"\nrefused {label}: {reason}", style="dim")
    return text


def _left_out_lines(run: Run) -> list[str]:
    """Candidates that no round could ask the records about, by reason, each once."""
    reasons = {k: v for r in run.rounds for k, v in r.left_out.items()}
    labels: dict[str, list[str]] = {}
    for label, reason in reasons.items():
        labels.setdefault(reason.partition(": ")[0], []).append(label)
    return [f"left out: {', '.join(found)}: {reason}" for reason, found in labels.items()]


def _print_model(console: Console, run: Run) -> None:
    from spiral.io.export.equation import equation_text

    print_heading(console, "Model")
    console.print(Text(equation_text(run.model)), soft_wrap=True)
    console.print()
    console.print(parameter_table(run.model))


def _commands_after_discover(run: Run, config: dict[str, Any]) -> list[tuple[str, str]]:
    given = _run_overrides(run, config)
    admitted = [x for r in run.rounds for x in r.admitted if x in run.model.labels]
    commands = [
        (f"spiral diagnose {given}", "what is left, and what comes closest to explaining it")
    ]
    if admitted:
        without = f"spiral compare {given} 'without=[{admitted[-1]}]'"
        commands.append((without, f"how much {admitted[-1]} improves the model"))
    learned = (run.unknown or {}).get("effect")
    if learned and learned not in run.model.labels:
        commands.insert(0, (f"spiral add {learned} {given}", "admit this curve as an effect"))
    commands.append((f"spiral compare {given}", "the final model against the test record"))
    alike = [(k, *v) for r in run.rounds for k, v in r.aliases.items() if v and k in admitted]
    if alike:
        names = " ".join(alike[0])
        commands.append((f"spiral plan {names} {given}", "which test would tell them apart"))
    return commands


def _run_overrides(run: Run, config: dict[str, Any]) -> str:
    """The overrides that start from a saved run."""
    system = run.model.system
    file = getattr(system, system.program) if system.program else ""
    named = f" system.{system.program}={file}" if file else ""
    return f"run={run.run_id}{named}" + (f" out={config['out']}" if config["out"] != "runs" else "")


def _comparison_table(comparisons: dict[str, Comparison]) -> Table:
    """One column for each comparison."""
    table = ruled_table("", *comparisons, right=list(comparisons))
    rows: dict[str, Callable[[Comparison], str]] = {
        "fit error": lambda c: percent(c.fit_error),
        "test error": lambda c: percent(c.test_error),
        "noise floor": lambda c: percent(c.floor),
    }
    first = next(iter(comparisons.values()))
    if next_sample_error(first) is not None:
        rows["one sample ahead"] = lambda c: percent(next_sample_error(c))
    for name in first.channels:
        unit = first.model.system.unit_of(name)
        rows[f"test rmse {name} ({unit})"] = lambda c, n=name: number(c.channels[n].rmse)
    if any(c.traces for c in comparisons.values()):  # errors are over the deviation from there on
        rows["test scored from"] = lambda c: f"sample {c.traces.settled}" if c.traces else "-"
    rows["chi2/dof"] = lambda c: number(c.chi2_per_dof)
    rows["whiteness p"] = lambda c: probability(c.whiteness_p)
    rows["horizon"] = lambda c: f"{c.horizon} samples"
    for label, cell in rows.items():
        table.add_row(label, *(cell(c) for c in comparisons.values()))
    return table


def _compare(console: Console, outcome: Outcome) -> None:
    comparison: Comparison = outcome.parts["comparison"]
    print_records(console, outcome, numbers=True)
    print_heading(console, "Comparison")
    console.print(_comparison_table({"model": comparison}))
    console.print()
    console.print(parameter_table(comparison.model))
    known = {n for r in outcome.parts["problem"].records for n in r.remarks}
    for note in dict.fromkeys(n for n in comparison.notes if n not in known):
        console.print(Text(capitalised(note)))
    for said in filter(None, (random_sentence(comparison), record_sentence(comparison))):
        console.print(Text(said))
    if random_forces(comparison):
        acting = what_acts(comparison.model)
        console.print(Text(
            f"Whether such a {acting} acts, or stands for what the model lacks, spiral discover "
            "tells.", "dim",
        ))  # fmt: skip
    if not isfinite(comparison.test_error) and "error" not in outcome.result:
        console.print(Text("A free run leaves all bounds, as of a machine that its controller "
                           "holds: one sample ahead the model is told", "dim"))  # fmt: skip
    print_outcome_error(console, outcome)
    request = outcome.parts["request"]
    diagnose = (request_command("diagnose", request), "where it fails, and what may be missing")
    print_next_steps(
        console, diagnose, (request_command("discover", request), "find and add what is missing")
    )


def _add(console: Console, outcome: Outcome) -> None:
    parts = outcome.parts
    print_records(console, outcome)
    print_heading(console, f"Before and after adding {', '.join(parts['request'].names)}")
    console.print(_comparison_table({"before": parts["before"], "after": parts["after"]}))
    _print_model(console, parts["run"])
    print_outcome_error(console, outcome)
    given = _run_overrides(parts["run"], parts["config"])
    another = (f"spiral add EFFECT {given}", "add another effect to this model")
    print_next_steps(console, (f"spiral diagnose {given}", "what is still missing"), another)


def _diagnose(console: Console, outcome: Outcome) -> None:
    diagnosis: Diagnosis = outcome.parts["diagnosis"]
    print_records(console, outcome)
    print_heading(console, diagnosis.summary)
    if diagnosis.where.sentence:
        console.print(Text(diagnosis.where.sentence))
    if diagnosis.suggestions:
        print_heading(console, "What may be missing, best first")
        console.print(_suggestion_table(diagnosis.suggestions))
    print_not_separable(console, diagnosis.not_separable)
    print_unknown_shape(console, diagnosis.unknown)
    if diagnosis.advice:
        console.print()
        console.print(Text(diagnosis.advice))
    request = outcome.parts["request"]
    if diagnosis.suggestions and diagnosis.verdict == "effect_missing":
        best = diagnosis.suggestions[0].effect
        print_next_steps(
            console, (request_command("add", request, [best]), f"add {best}, before and after")
        )
    elif diagnosis.unknown:
        best = diagnosis.unknown["effect"]
        print_next_steps(
            console, (request_command("add", request, [best]), "admit this curve as an effect")
        )


def _suggestion_table(suggestions: Sequence[Suggestion]) -> Table:
    columns = ["", "effect", "explains", "p", "test error with it"]
    if all(item.test_error_after is None for item in suggestions):
        columns.pop()
    table = ruled_table(*columns, right=[c for c in columns if c != "effect"])
    for rank, item in enumerate(suggestions, 1):
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
    back = join_command("spiral", "discover", *outcome.result["read_back"])
    print_next_steps(console, (back, "read it back and find what its model is made of"))
