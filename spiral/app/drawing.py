"""Figures of a step, each a JSON file in the step's folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from spiral.inference.discover import Checkpoint
from spiral.inference.problem import Settings
from spiral.inference.rounds import conclude_study
from spiral.io.curves import Curves
from spiral.io.writing import replace_nonfinite, to_json, write_whole
from spiral.physics.couplings import couplings_of

SKETCH = "sketch.json"
"""What couples with what in the step's model, among its figures."""
FIRST = ("free_run", "where", "amplitude")
"""Figures that are drawn before all others."""


def write_turn_figures(
    at: Checkpoint,
    alone: Curves | None,
    both: Curves | None,
    folder: Path,
    part: Callable[[str], bool] = lambda name: True,
) -> list[tuple[str, str, str]]:
    """Write figures of a turn as JSON; returns name, heading, caption of each.

    ``alone`` are the curves of this turn's model; ``both`` with those of the first beside them.
    """
    from spiral.view.report.html import figures

    folder.mkdir(parents=True, exist_ok=True)
    graph = asdict(couplings_of(at.rounds[-1].comparison.model))
    write_whole(folder / SKETCH, to_json(graph))
    run = conclude_study(at, "max_rounds", Settings(), "")
    now_unknown = {"unknown": at.rounds[-1].details.get("unknown"), "noise_floor": None}
    saved = {"result": replace_nonfinite({**run.as_dict(), **now_unknown})}
    names = [n for n in _ORDER if part(n)]
    compared = [n for n in names if n in _COMPARED]
    now = ["before" if n == "free_run" else n for n in names if n not in _COMPARED]
    shown = figures(saved, alone, now) + figures(saved, both or alone, compared)
    figures_by_name = {"free_run" if s.name == "before" else s.name: s for s in shown}
    for name, one in figures_by_name.items():
        write_whole(folder / f"{name}.json", one.figure.to_json())
    heads = {"free_run": "Measured against the model, on the test record"}
    return [
        (n, heads.get(n, figures_by_name[n].heading), figures_by_name[n].caption)
        for n in names
        if n in figures_by_name
    ]


_COMPARED = ("amplitude", "missing_force")
_ORDER = (
    *FIRST, "missing_force", "surface", "unknown", "memory", "evidence", "coefficients", "orbit",
    "bode", "polar", "waterfall", "whirl", "correlation", "hidden", "campbell",
)  # fmt: skip
