"""What a person sees of what could not be told: look-alikes of the model, and unknown shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

_ROWS = 9


def not_separable(console: Console, found: Mapping[str, Sequence[str]]) -> None:
    """Candidates that could not have been found, and what takes them over."""
    if not found:
        return
    words = "; ".join(f"{name} (from {', '.join(found[name])})" for name in found)
    console.print()
    console.print(Text(f"Not separable from the model on this record: {words}.", style="yellow"))


def unknown(console: Console, found: Mapping[str, Any] | None) -> None:
    """The shape of what no effect with a name explains: a sentence, and the curve with its band."""
    if not found:
        return
    console.print()
    console.print(Text("What no effect with a name explains", style="bold"))
    share = f"{100 * found['explains']:.0f} % of what was left"
    console.print(Text(f"{found['sentence']} It explains {share}."))
    for curve in found["curves"]:
        console.print(_curve(curve, found["state_unit"], found["force_unit"]))


def _curve(curve: Mapping[str, Any], state_unit: str, force_unit: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    table.add_column(f"{curve['state']} ({state_unit})", justify="right")
    table.add_column(f"force ({force_unit})", justify="right")
    table.add_column("95 % band", justify="right")
    last = len(curve["at"]) - 1
    for i in (round(last * k / (_ROWS - 1)) for k in range(_ROWS)):
        at, force, band = (curve[k][i] for k in ("at", "force", "band"))
        table.add_row(f"{at:.3g}", f"{force:.3g}", f"± {band:.2g}")
    return table
