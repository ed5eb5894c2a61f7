"""Terminal output of a sweep: its progress, and one table at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.progress import BarColumn, Progress, TextColumn
from rich.text import Text

from spiral.types.formatting import number, percent
from spiral.view.terminal.parts import Screen, Tell, print_heading, ruled_table

if TYPE_CHECKING:
    from spiral.io.sweeps.sweep import Status, Sweep, SweepRow

_WIDE = 100
_HEADINGS = {"verdict": "outcome", "hidden states": "hidden states (static map)"}
_LONGEST, _LONGEST_ERROR = 60, 200
Watch = Callable[["Status"], None]


@contextmanager
def sweep_progress_bar() -> Iterator[tuple[Tell, Watch]]:
    """A progress bar on standard error; log lines where that is no terminal."""
    console = Screen(stderr=True, highlight=False)

    def tell(message: str) -> None:
        console.print(message, style="dim", soft_wrap=True, markup=False)

    if not console.is_terminal:
        yield tell, lambda status: tell(_status_sentence(status))
        return
    columns = (TextColumn("runs"), BarColumn(bar_width=24), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting")

        def watch(status: Status) -> None:
            words = _status_sentence(status).removeprefix("runs: ")
            bar.update(task, description=words, completed=status.done, total=status.total)

        yield tell, watch


def format_duration(seconds: float) -> str:
    """Seconds as people say them: ``42 s``, ``3 min 05 s``, ``2 h 10 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def _status_sentence(status: Status) -> str:
    words = [f"runs: {status.done} of {status.total} done"]
    if status.failed:
        words.append(f"{status.failed} failed")
    words.append(format_duration(status.seconds))
    if status.remaining and status.done < status.total:
        words.append(f"about {format_duration(status.remaining)} to go")
    return ", ".join(words)


def show(sweep: Sweep) -> None:
    """The table of a sweep on standard output."""
    console = Screen(highlight=False)
    if sweep.rows:
        swept, common = swept_columns([row.overrides for row in sweep.rows])
        print_heading(console, "Runs")
        for text in (t for t in common if not t.startswith(("n_jobs=", "sweep."))):
            console.print(Text(f"  {text}", "dim"), soft_wrap=True)
        console.print(_run_table(sweep.rows, swept, console.width))
    done, total = len(sweep.rows), len(sweep.jobs)
    failed = sum(row.exit != 0 for row in sweep.rows)
    words = [f"{done} of {total} runs done"]
    words += [f"{sweep.taken_up} of them before"] if sweep.taken_up else []
    words += [f"{failed} failed or refused"] if failed else []
    console.print()
    console.print(Text(f"{', '.join(words)}; {format_duration(sweep.seconds)}"))
    console.print(Text(f"rows in {sweep.folder}", "dim"), soft_wrap=True)
    for word in ("given", "expected", "try") if sweep.error else ():
        console.print(Text(f"{word + ':':<10}{sweep.error[word]}", style="yellow"))  # type: ignore[index]


def swept_columns(jobs: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Keys whose values differ between jobs, in order; overrides that all jobs share."""
    common = [t for t in dict.fromkeys(jobs[0]) if all(t in job for job in jobs)]
    if len(jobs) == 1:
        return (), tuple(common)
    keys = dict.fromkeys(_split_override(t)[0] for job in jobs for t in job if t not in common)
    return tuple(keys), tuple(common)


def _split_override(text: str) -> tuple[str, str]:
    key, _, value = text.partition("=")
    return key, value


def _run_table(rows: Sequence[SweepRow], swept: Sequence[str], width: int) -> Any:
    kept = ["verdict", "effects", "test error", "hidden states", "s", "exit"]
    cells = [_row_cells(row) for row in rows]
    shown = [name for name in kept if any(cell[name] for cell in cells)]
    if width < _WIDE and "effects" in shown and "verdict" in shown:
        shown.remove("verdict")
        for cell in cells:
            cell["effects"] = cell["effects"] or cell["verdict"]
    headings = [*swept, *(_HEADINGS.get(n, n) for n in shown)]
    table = ruled_table(*headings, right=("test error", _HEADINGS["hidden states"], "s", "exit"))
    for row, cell in zip(rows, cells, strict=True):
        values = dict(_split_override(text) for text in row.overrides)
        table.add_row(
            *(Text(_shorten(values.get(key, ""))) for key in swept),
            *(Text(cell[name], _cell_style(row, name)) for name in shown),
        )
    return table


def _shorten(value: str, longest: int = _LONGEST) -> str:
    return value if len(value) <= longest else f"{value[: longest - 3]}..."


def _cell_style(row: SweepRow, name: str) -> str:
    if name == "exit" and row.exit:
        return "yellow" if row.exit == 3 else "bold red"
    return "bold green" if name == "effects" and row.exit == 0 else ""


def _row_cells(row: SweepRow) -> dict[str, str]:
    result = row.result
    seconds = number(row.seconds, 3) if row.seconds < 1000 else f"{row.seconds:.0f}"
    cells = {"verdict": "", "effects": "", "test error": "", "hidden states": ""}
    cells |= {"s": seconds, "exit": str(row.exit)}
    error = result.get("error")
    if result.get("rounds"):
        cells["verdict"] = result["verdict"]
        cells["effects"] = ", ".join(x for r in result["rounds"] for x in r["admitted"])
        cells["test error"] = percent(result["rounds"][-1]["test_error"])
    elif "after" in result:
        before = percent(result["before"]["test_error"])
        cells["test error"] = f"{before} -> {percent(result['after']['test_error'])}"
    elif "suggestions" in result:
        cells["verdict"] = result["verdict"]
        cells["effects"] = result["suggestions"][0]["effect"] if result["suggestions"] else ""
        cells["test error"] = percent(result["comparison"]["test_error"])
    elif "states" in result:
        cells["hidden states"] = _hidden_state_errors(result)
    elif "rank" in result:
        cells["verdict"] = f"{result['verdict']}: rank {result['rank']} of {result['columns']}"
    elif "test_error" in result:
        cells["test error"] = percent(result["test_error"])
    if error and not cells["verdict"]:
        cells["verdict"] = _shorten(error["given"], _LONGEST_ERROR)
    return cells


def _hidden_state_errors(result: Mapping[str, Any]) -> str:
    """Errors of the states that the static map gives too, with that map's errors in brackets."""
    static = {k: v["relative"] for k, v in result.get("static_baseline", {}).items()}
    pairs = [(result["states"][k].get("relative"), v) for k, v in static.items()]
    return ", ".join(f"{percent(error)} ({percent(other)})" for error, other in pairs)
