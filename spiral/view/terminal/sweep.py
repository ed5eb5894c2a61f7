"""What a person sees of a sweep: how far it is, and one table in the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.progress import BarColumn, Progress, TextColumn
from rich.text import Text

from spiral.types.formatting import number, percent
from spiral.view.terminal.parts import Screen, Tell, heading, ruled

if TYPE_CHECKING:
    from spiral.io.sweeps.sweep import Row, Status, Sweep

_WIDE = 100
_HEADINGS = {"verdict": "outcome", "hidden states": "hidden states (static map)"}
_LONGEST, _LONGEST_ERROR = 60, 200
Watch = Callable[["Status"], None]


@contextmanager
def progress() -> Iterator[tuple[Tell, Watch]]:
    """A bar on standard error; lines of a log off a terminal."""
    console = Screen(stderr=True, highlight=False)

    def tell(message: str) -> None:
        console.print(message, style="dim", soft_wrap=True, markup=False)

    if not console.is_terminal:
        yield tell, lambda status: tell(_sentence(status))
        return
    columns = (TextColumn("runs"), BarColumn(bar_width=24), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting")

        def watch(status: Status) -> None:
            words = _sentence(status).removeprefix("runs: ")
            bar.update(task, description=words, completed=status.done, total=status.total)

        yield tell, watch


def duration(seconds: float) -> str:
    """Seconds as people say them: ``42 s``, ``3 min 05 s``, ``2 h 10 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def _sentence(status: Status) -> str:
    words = [f"runs: {status.done} of {status.total} done"]
    if status.failed:
        words.append(f"{status.failed} failed")
    words.append(duration(status.seconds))
    if status.remaining and status.done < status.total:
        words.append(f"about {duration(status.remaining)} to go")
    return ", ".join(words)


def show(sweep: Sweep) -> None:
    """The table of a sweep on standard output."""
    console = Screen(highlight=False)
    if sweep.rows:
        swept, common = columns_of([row.overrides for row in sweep.rows])
        heading(console, "Runs")
        for text in (t for t in common if not t.startswith(("n_jobs=", "sweep."))):
            console.print(Text(f"  {text}", "dim"), soft_wrap=True)
        console.print(_runs(sweep.rows, swept, console.width))
    done, total = len(sweep.rows), len(sweep.jobs)
    failed = sum(row.exit != 0 for row in sweep.rows)
    words = [f"{done} of {total} runs done"]
    words += [f"{sweep.taken_up} of them before"] if sweep.taken_up else []
    words += [f"{failed} failed or refused"] if failed else []
    console.print()
    console.print(Text(f"{', '.join(words)}; {duration(sweep.seconds)}"))
    console.print(Text(f"rows in {sweep.folder}", "dim"), soft_wrap=True)
    for word in ("given", "expected", "try") if sweep.error else ():
        console.print(Text(f"{word + ':':<10}{sweep.error[word]}", style="yellow"))  # type: ignore[index]


def columns_of(jobs: Sequence[tuple[str, ...]]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Keys whose values differ between jobs, in order; overrides that all jobs share."""
    common = [t for t in dict.fromkeys(jobs[0]) if all(t in job for job in jobs)]
    if len(jobs) == 1:
        return (), tuple(common)
    keys = dict.fromkeys(_parted(t)[0] for job in jobs for t in job if t not in common)
    return tuple(keys), tuple(common)


def _parted(text: str) -> tuple[str, str]:
    key, _, value = text.partition("=")
    return key, value


def _runs(rows: Sequence[Row], swept: Sequence[str], width: int) -> Any:
    kept = ["verdict", "effects", "test error", "hidden states", "s", "exit"]
    cells = [_cells(row) for row in rows]
    shown = [name for name in kept if any(cell[name] for cell in cells)]
    if width < _WIDE and "effects" in shown and "verdict" in shown:
        shown.remove("verdict")
        for cell in cells:
            cell["effects"] = cell["effects"] or cell["verdict"]
    headings = [*swept, *(_HEADINGS.get(n, n) for n in shown)]
    table = ruled(*headings, right=("test error", _HEADINGS["hidden states"], "s", "exit"))
    for row, cell in zip(rows, cells, strict=True):
        values = dict(_parted(text) for text in row.overrides)
        table.add_row(
            *(Text(_short(values.get(key, ""))) for key in swept),
            *(Text(cell[name], _style(row, name)) for name in shown),
        )
    return table


def _short(value: str, longest: int = _LONGEST) -> str:
    return value if len(value) <= longest else f"{value[: longest - 3]}..."


def _style(row: Row, name: str) -> str:
    if name == "exit" and row.exit:
        return "yellow" if row.exit == 3 else "bold red"
    return "bold green" if name == "effects" and row.exit == 0 else ""


def _cells(row: Row) -> dict[str, str]:
    result = row.result
    seconds = number(row.seconds, 3) if row.seconds < 1000 else f"{row.seconds:.0f}"
    found = {"verdict": "", "effects": "", "test error": "", "hidden states": ""}
    found |= {"s": seconds, "exit": str(row.exit)}
    error = result.get("error")
    if result.get("rounds"):
        found["verdict"] = result["verdict"]
        found["effects"] = ", ".join(x for r in result["rounds"] for x in r["admitted"])
        found["test error"] = percent(result["rounds"][-1]["test_error"])
    elif "after" in result:
        before = percent(result["before"]["test_error"])
        found["test error"] = f"{before} -> {percent(result['after']['test_error'])}"
    elif "suggestions" in result:
        found["verdict"] = result["verdict"]
        found["effects"] = result["suggestions"][0]["effect"] if result["suggestions"] else ""
        found["test error"] = percent(result["comparison"]["test_error"])
    elif "states" in result:
        found["hidden states"] = _hidden(result)
    elif "rank" in result:
        found["verdict"] = f"{result['verdict']}: rank {result['rank']} of {result['columns']}"
    elif "test_error" in result:
        found["test error"] = percent(result["test_error"])
    if error and not found["verdict"]:
        found["verdict"] = _short(error["given"], _LONGEST_ERROR)
    return found


def _hidden(result: Mapping[str, Any]) -> str:
    """Error of the states that the static map reconstructs as well, with that map's in brackets."""
    static = {k: v["relative"] for k, v in result.get("static_baseline", {}).items()}
    pairs = [(result["states"][k].get("relative"), v) for k, v in static.items()]
    return ", ".join(f"{percent(found)} ({percent(other)})" for found, other in pairs)
