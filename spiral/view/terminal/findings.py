"""Terminal output: candidates that look like the model's own effects, and learned curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

_ROWS = 9


def print_not_separable(console: Console, look_alikes: Mapping[str, Sequence[str]]) -> None:
    """Print candidates that could not have been found, and the effects that look like them."""
    if not look_alikes:
        return
    words = "; ".join(f"{name} (from {', '.join(look_alikes[name])})" for name in look_alikes)
    console.print()
    console.print(Text(f"Not separable from the model on this record: {words}.", style="yellow"))


def print_unknown_shape(console: Console, shape: Mapping[str, Any] | None) -> None:
    """Print the learned curve of a force that no effect explains: a sentence, and its band."""
    if not shape:
        return
    console.print()
    console.print(Text("What no effect with a name explains", style="bold"))
    share = f"{100 * shape['explains']:.0f} % of what was left"
    console.print(Text(f"{shape['sentence']} It explains {share}."))
    for curve in shape["curves"]:
        console.print(_curve_table(curve, shape))


def _curve_table(curve: Mapping[str, Any], shape: Mapping[str, Any]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for name, unit in (
        (curve["state"], shape["state_unit"]),
        (shape.get("quantity", "force"), shape["force_unit"] or "share"),
    ):
        table.add_column(f"{name} ({unit})", justify="right")
    table.add_column("95 % band", justify="right")
    last = len(curve["at"]) - 1
    for i in (round(last * k / (_ROWS - 1)) for k in range(_ROWS)):
        at, force, band = (curve[k][i] for k in ("at", "force", "band"))
        table.add_row(f"{at:.3g}", f"{force:.3g}", f"± {band:.2g}")
    return table
