"""Building blocks of terminal output: progress, headings, tables, commands."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from spiral.io.registry import NO_FOLDER
from spiral.types.formatting import extent, number, percent, plus_minus, sentences
from spiral.types.masking import without_passwords
from spiral.view.terminal.shell import join_command

if TYPE_CHECKING:
    from spiral.io.request import Outcome, Request
    from spiral.types.run import Round

Tell = Callable[[str], None]

_PREVIEWED = 4  # at most so many records have their series shown


class Screen(Console):
    """A console whose reader may close the pipe (``spiral plugins | head``)."""

    def on_broken_pipe(self) -> None:
        """Raise ``BrokenPipeError``, which ends the program in silence."""
        self.quiet = True
        raise BrokenPipeError


@contextmanager
def progress_line() -> Iterator[Tell]:
    """A status line on standard error; log lines where that is no terminal."""
    console = Screen(stderr=True, highlight=False)
    if not console.is_terminal:
        yield lambda message: console.print(message, style="dim", soft_wrap=True, markup=False)
        return
    with console.status("starting") as status:

        def tell(message: str) -> None:
            if message.startswith(("round ", "so far: ")):
                console.print(message, markup=False)
            else:
                status.update(escape(message))

        yield tell


def announce_round(finished_round: Round, tell: Tell) -> None:
    """Announce a round that has just ended, in one line."""
    c = finished_round.comparison
    what = "+ " + ", ".join(finished_round.admitted) if finished_round.admitted else "the seed"
    errors = f"test error {percent(c.test_error)}, chi2/dof {number(c.chi2_per_dof)}"
    tell(f"round {finished_round.number}: {what}: {errors}, {finished_round.seconds:.1f} s")


def print_heading(console: Console, text: str) -> None:
    """Print an empty line, then a heading."""
    console.print()
    console.print(Text(text, style="bold"))


def print_points(console: Console, text: str) -> None:
    """Print a verdict: its first sentence, then the others as a list."""
    (head, under), *others = sentences(text) or [("", ())]
    console.print(Text(head))
    listed = _bulleted(under)
    for point, below in others:
        listed.add_row("-", Text(point))
        if below:
            listed.add_row("", _bulleted(below))
    if listed.row_count:
        console.print(listed)


def _bulleted(lines: Sequence[str]) -> Table:
    """A list with a dash before each line, which wraps behind it."""
    listed = Table.grid(padding=(0, 1))
    listed.add_column(no_wrap=True)
    listed.add_column(overflow="fold")
    for line in lines:
        listed.add_row("-", Text(line))
    return listed


def ruled_table(*columns: str, right: Sequence[str] = ()) -> Table:
    """A table without a frame; numbers, in columns named ``right``, are never wrapped."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for name in columns:
        justify = "right" if name in right else "left"
        table.add_column(name, justify=justify, no_wrap=name in right, overflow="fold")
    return table


def print_records(console: Console, outcome: Outcome, numbers: bool = False) -> None:
    """Print the records and their notes, each once; with ``numbers`` their series too."""
    from spiral.view.terminal.preview import describe_records, quiet_test_warning

    told: set[str] = set()
    descriptions = describe_records(outcome.parts["problem"])
    for shown, record in enumerate(descriptions):
        words = extent(record["samples"], record["rate"])
        console.print(Text(f"{record['part']:<5}{record['name']}: {words}", "dim"))
        for note in (n for n in record["notes"] if n not in told):
            console.print(Text(f"     note: {note}", style="yellow"))
        told.update(record["notes"])
        if numbers and shown < _PREVIEWED:
            console.print(_series_table(record["series"]))
    if warning := quiet_test_warning(descriptions):
        console.print(Text(warning, style="yellow"))


def _series_table(rows: list[dict[str, Any]]) -> Table:
    columns = ["", "lowest", "highest", "deviation", "noise"]
    table = ruled_table(*columns, "unit", right=columns[1:])
    for row in rows:
        name = row["name"] + (" (derived)" if row["kind"] == "derived" else "")
        noise = number(row.get("noise"), 3) + (" declared" if row.get("noise_declared") else "")
        extent = (number(row[c]) for c in columns[1:4])
        table.add_row(name, *extent, noise, row["unit"] or "1")
    return table


def print_next_steps(console: Console, *commands: tuple[str, str]) -> None:
    """Print commands that a person may type next, and what each is for."""
    print_heading(console, "Next")
    for command, meaning in commands:
        console.print(Text(f"  {command}", style="cyan"), soft_wrap=True)
        console.print(Text(f"      {meaning}", style="dim"))


def request_command(verb: str, request: Request, names: Sequence[str] = ()) -> str:
    """A command line with the overrides of a request, quoted for a shell."""
    plugins = plugin_options(request.plugins)
    given = map(without_passwords, request.overrides)
    return join_command("spiral", verb, *names, *given, *plugins)


def plugin_options(folder: str | None) -> list[str]:
    """The options by which a command line names its folder of local plugins, or none."""
    if folder == NO_FOLDER:
        return ["--no-plugins"]
    return [] if folder is None else ["--plugins", folder]


def print_outcome_error(console: Console, outcome: Outcome) -> None:
    """Print the error of an outcome, if it has one."""
    error = outcome.result.get("error")
    if error:
        console.print()
        for word in ("given", "expected", "try"):
            console.print(Text(f"{word + ':':<10}{error[word]}", style="yellow"))


def parameter_table(model: Any) -> Table:
    """Every parameter of a model: estimate with standard error, t, unit.

    Those of the system are in the units of its file, as it was written; what was fitted is told
    below in SI units as well, where these are others.
    """
    table = ruled_table(
        "effect", "parameter", "estimate ± se", "t", "unit", right=["estimate ± se", "t"]
    )
    in_si = []
    for owner, parameters in model.estimates().items():
        written = getattr(model.system, "written_units", {}) if owner == "system" else {}
        for index, (name, estimate) in enumerate(parameters.items()):
            own, size = written.get(name, ("", 1.0))
            value = plus_minus(estimate.estimate / size, _scaled(estimate.se, size))
            t = number(estimate.t, 3) if estimate.t is not None else "given"
            unit = own or estimate.unit or "1"
            table.add_row(owner if index == 0 else "", name, value, t, unit)
            if own and estimate.se is not None:
                si = plus_minus(estimate.estimate, estimate.se)
                in_si.append(f"{name} {si} {estimate.unit or '1'}")
    table.caption_justify = "left"
    table.caption = f"in SI units: {', '.join(in_si)}" if in_si else None
    return table


def _scaled(error: float | None, size: float) -> float | None:
    return None if error is None else error / size
