"""The damping of each stretch of the swing, as if it were viscous, against two laws of friction.

python -m experiments.multiarm_pendulum.stretches [--picture FILE.png]

By equivalent linearisation a swing of rate amplitude V in which c v + F sign v + d |v| v acts loses
as much energy in a turn as under the damping

    c_eq(V) = c + 4 F / (pi V) + 8 d V / (3 pi).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from experiments.measured import photographed, problem_of
from spiral.inference.compare import compare
from spiral.inference.problem import Problem
from spiral.types.model import Model

PRESET = "multiarm_pendulum"
FRICTION = ("effect=[coulomb_friction,quadratic_damping]", "values={coulomb_friction.width: 0.05}")


@dataclass(frozen=True)
class Stretch:
    """Viscous damping (1/s) and gravity (1/s^2) of one stretch, and its rate amplitude (rad/s)."""

    rate: float
    damping: float
    gravity: float


def equivalent(model: Model, rate: np.ndarray) -> np.ndarray:
    """c_eq(V) of a fitted model with both frictions."""
    viscous, dry, drag = (
        model.values[k]
        for k in ("linear_damping.damping", "coulomb_friction.level", "quadratic_damping.damping")
    )
    return viscous + 4 * dry / (np.pi * rate) + 8 * drag * rate / (3 * np.pi)


def stretches(problem: Problem) -> list[Stretch]:
    """The seed fitted to every record, and to every test record, alone."""
    found = []
    for record in (*problem.records, *problem.test):
        values = compare(replace(problem, records=(record,), test=())).model.values
        angle, dt = record.channels["theta"], record.dt
        rate = np.abs(np.gradient(angle, dt))
        turns = [float(part.max()) for part in np.array_split(rate, 8)]
        gravity, damping = values["gravity_torque.torque"], values["linear_damping.damping"]
        found.append(Stretch(float(np.mean(turns)), damping, gravity))
    return found


def drawn(found: list[Stretch], fitted: int, model: Model, target: Path) -> None:
    """Damping of the stretches over their rate, and c_eq of the friction fitted to the first."""
    from plotly import graph_objects as go

    line = np.linspace(2.0, 11.5, 200)
    figure = go.Figure()
    figure.add_trace(
        go.Scatter(
            x=line, y=equivalent(model, line), line={"color": "#c1272d", "width": 2},
            name="dry friction, drag and viscous damping, fitted to four stretches",
        )
    )  # fmt: skip
    groups = (("stretches that were fitted", found[:fitted], "circle"),
              ("stretches of the test", found[fitted:], "circle-open"))  # fmt: skip
    for name, part, symbol in groups:
        marker = {"color": "black", "size": 10, "symbol": symbol, "line": {"width": 2}}
        x, y = [s.rate for s in part], [s.damping for s in part]
        figure.add_trace(go.Scatter(x=x, y=y, mode="markers", marker=marker, name=name))
    figure.update_layout(
        template="simple_white", width=800, height=400, margin={"t": 20, "r": 20},
        xaxis_title="amplitude of the rate (rad/s)", yaxis_title="damping, as if viscous (1/s)",
        yaxis_rangemode="tozero", xaxis_range=[1.8, 11.7], legend={"x": 0.3, "y": 0.98},
    )  # fmt: skip
    photographed(figure, target)


def main(words: list[str] | None = None) -> None:
    """Print a table, and draw where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(words)
    problem = problem_of(PRESET)
    found = stretches(problem)
    fitted = compare(problem_of(PRESET, FRICTION))
    print("rate amplitude (rad/s)  damping (1/s)  two laws (1/s)  gravity (1/s^2)")
    for each in found:
        two = float(equivalent(fitted.model, np.array(each.rate)))
        print(f"{each.rate:22.2f} {each.damping:14.4f} {two:15.4f} {each.gravity:16.3f}")
    if given.picture is not None:
        drawn(found, len(problem.records), fitted.model, given.picture)


if __name__ == "__main__":
    main()
