"""A measured record by its preset: the free run on the test record, round by round, and a picture.

python -m experiments.measured PRESET [overrides ...] [--skip 5] [--picture FILE.png]

Scored is the test record from sample ``skip`` on, as benchmarks do, next to what ``spiral`` scores
(all after ``test.settle``). Only the initial state is taken from the test record, from its first
``test.settle`` seconds.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spiral.inference.compare import predict
from spiral.inference.discover import discover
from spiral.inference.evidence.free_run import FreeRun
from spiral.inference.problem import Problem
from spiral.io.config import build_problem, compose
from spiral.io.registry import load_registry
from spiral.types.run import Run


@dataclass(frozen=True)
class Scored:
    """One round: what it admitted, its free run, and rms errors in the channel's unit.

    ``all`` counts every sample, ``benchmark`` those from ``skip`` on, ``settled`` those that
    ``spiral`` scores.
    """

    admitted: tuple[str, ...]
    free: FreeRun
    all: float
    benchmark: float
    settled: float


def problem_of(preset: str, overrides: tuple[str, ...] = ()) -> Problem:
    """The study that a preset asks for."""
    registry = load_registry(None)
    return build_problem(compose([f"experiment={preset}", *overrides], registry), registry)


def scored(problem: Problem, run: Run, skip: int = 0) -> list[Scored]:
    """The model of every round on the first test record."""
    found = []
    for each in run.rounds:
        free = predict(each.comparison.model, problem.test, problem.settle)
        miss = free.predicted[0][:, 0] - free.measured[0][:, 0]
        rms = [float(np.sqrt(np.mean(miss[s:] ** 2))) for s in (0, skip, free.settled[0])]
        found.append(Scored(each.admitted, free, *rms))
    return found


def drawn(problem: Problem, rounds: list[Scored], target: Path) -> None:
    """Measured, seed and final model on the test record, and what is left, as a PNG."""
    from plotly import graph_objects as go
    from plotly.subplots import make_subplots

    record, name = problem.test[0], problem.model.system.observed[0]
    unit = problem.model.system.unit_of(name)
    figure = make_subplots(
        rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.65, 0.35]
    )
    measured = rounds[0].free.measured[0][:, 0]
    shown = [("measured", measured, "black")]
    shown += [("the seed", rounds[0].free.predicted[0][:, 0], "#bbbbbb")]
    shown += [("with the effects found", rounds[-1].free.predicted[0][:, 0], "#c1272d")]
    for label, values, colour in shown:
        line = {"color": colour, "width": 1.6}
        figure.add_trace(go.Scatter(x=record.time, y=values, name=label, line=line), 1, 1)
        if label != "measured":
            miss = go.Scatter(x=record.time, y=values - measured, line=line, showlegend=False)
            figure.add_trace(miss, 2, 1)
    figure.update_layout(
        template="simple_white", width=1000, height=560, margin={"t": 20, "r": 20},
        legend={"orientation": "h", "y": 1.06},
    )  # fmt: skip
    figure.update_yaxes(title_text=f"{name} ({unit})", row=1, col=1)
    figure.update_yaxes(title_text=f"model - measured ({unit})", row=2, col=1)
    figure.update_xaxes(title_text="time (s)", row=2, col=1)
    photographed(figure, target)


def photographed(figure: Any, target: Path) -> None:
    """A figure of its own width and height as a PNG, with a little air."""
    from spiral.view.report.pictures import write_png

    page = figure.to_html(include_plotlyjs=True, config={"displayModeBar": False})
    write_png(page, target, figure.layout.width + 20, figure.layout.height + 20)


def main(words: list[str] | None = None) -> list[Scored]:
    """Run the study, print a table, and draw where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("preset")
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--skip", type=int, default=0, help="samples that a benchmark leaves out")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(words)
    problem = problem_of(given.preset, tuple(given.overrides))
    rounds = scored(problem, discover(problem), given.skip)
    print(f"{'added':<22} {'all':>10} {f'from {given.skip}':>10} {'settled':>10}")
    for each in rounds:
        label = ", ".join(each.admitted) or "(the seed)"
        print(f"{label:<22} {each.all:10.4g} {each.benchmark:10.4g} {each.settled:10.4g}")
    if given.picture is not None:
        drawn(problem, rounds, given.picture)
    return rounds


if __name__ == "__main__":
    main()
