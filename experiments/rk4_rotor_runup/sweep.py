"""A run-up through a resonance: as the response to steady speeds, and as the sweep that it was.

python -m experiments.rk4_rotor_runup.sweep [--picture FILE.png]

Both have one mode, x'' + c x' + k x = U W^2 cos t. Read as a Bode plot, the slow vector of the
first order is the response to steady speed,

    z = U W^2 / (k - W^2 + i c W);

``spiral`` fits the run-up itself, in which the mode rings on at its own frequency and beats with
the unbalance: maxima where (W - w)^2 / (2 W') = 2 pi n + a constant, w the natural frequency.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from spiral_plugins.systems.planar_rotor import PlanarRotor

from experiments.measured import photographed, problem_of
from spiral.inference.compare import compare, predict
from spiral.inference.problem import Problem
from spiral.inference.simulate import simulate
from spiral.types.model import seed_model
from spiral.types.record import Record

PRESET = "rk4_rotor_runup"
WHOLE = "test=order_table"  # the whole run-up is fitted; nothing is kept apart
RPM = 30 / np.pi


@dataclass(frozen=True)
class Reading:
    """One way to read the run-up: its mode, and the slow vector (samples,) in um that it gives."""

    name: str
    critical: float  # rpm
    damping_ratio: float
    unbalance: float  # um
    slow: np.ndarray


def slow_vector(record: Record, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(x + i y) exp(-i t), (samples,): amplitude and phase of the first order."""
    return (x + 1j * y) * np.exp(-1j * record.inputs["phase"])


def measured(record: Record) -> np.ndarray:
    """The slow vector of the table."""
    return slow_vector(record, record.channels["x"], record.channels["y"])


def steady(record: Record) -> Reading:
    """The Bode plot's way: k, c and the vector U of the response to steady speeds."""
    from scipy.optimize import least_squares

    speed, target = record.inputs["speed"], measured(record)
    peak = speed[np.argmax(np.abs(target))]

    def response(p: np.ndarray) -> np.ndarray:
        own, ratio = p[0] * peak, p[1]
        moment = p[2] + 1j * p[3]
        return moment * speed**2 / (own**2 - speed**2 + 2j * ratio * own * speed)

    def left(p: np.ndarray) -> np.ndarray:
        miss = response(p) - target
        return np.concatenate((miss.real, miss.imag))

    p = least_squares(left, np.array([1.0, 0.04, 1.0, 0.0])).x
    size = float(np.hypot(p[2], p[3]))
    return Reading("steady speeds", p[0] * peak * RPM, abs(p[1]), size, response(p))


def swept(problem: Problem, name: str) -> Reading:
    """The model of the study, fitted to the run-up, and its free run."""
    model = compare(problem).model
    free = predict(model, problem.test, float(np.ptp(problem.test[0].time)))
    own = float(np.sqrt(model.values["linear_stiffness.stiffness_x"]))
    ratio = model.values["linear_damping.damping_x"] / (2 * own)
    x, y = free.predicted[0].T
    slow = slow_vector(problem.test[0], x, y)
    return Reading(name, own * RPM, ratio, abs(model.values["unbalance.moment"]), slow)


def mode(record: Record, rpm: float, ratio: float) -> np.ndarray:
    """The slow vector (samples,) of one mode that runs up under an unbalance of 1 um."""
    own = rpm / RPM
    damping, speed = 2 * ratio * own, record.inputs["speed"][0]
    values = {"system.phase_origin": 0.0, "unbalance.moment": 1.0}
    for axis in "xy":
        values[f"linear_stiffness.stiffness_{axis}"] = own**2
        values[f"linear_damping.damping_{axis}"] = damping
    still = speed**2 / (own**2 - speed**2 + 1j * damping * speed)
    at = still * np.exp(1j * record.inputs["phase"][0])
    start = {"x": at.real, "y": at.imag, "x_rate": -speed * at.imag, "y_rate": speed * at.real}
    model = seed_model(PlanarRotor(position_unit="um"), values=values)
    run = simulate(model, record.time, dict(record.inputs), start=start, substeps=24)
    return slow_vector(record, run.channels["x"], run.channels["y"])


def two_axes(record: Record) -> tuple[Reading, str]:
    """A support not equally stiff all round: two modes, and a vector that stays.

    A probe at the angle b to the axes sees cos b exp(-i b) times the first mode and i sin b
    exp(-i b) times the second one, so their vectors are a quarter turn apart.
    """
    from scipy.optimize import least_squares

    target = measured(record)

    def fitted(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parts = [mode(record, p[0], p[1]), mode(record, p[2], p[3]), np.ones(len(target))]
        weights = np.linalg.lstsq(np.column_stack(parts), target, rcond=None)[0]
        return np.column_stack(parts) @ weights, weights

    def left(p: np.ndarray) -> np.ndarray:
        miss = fitted(p)[0] - target
        return np.concatenate((miss.real, miss.imag))

    first = np.array([1590.0, 0.02, 1650.0, 0.02])
    p = least_squares(left, first, x_scale=[10, 5e-3, 10, 5e-3], diff_step=1e-4).x
    slow, weights = fitted(p)
    apart = np.rad2deg(np.angle(weights[1] / weights[0]))
    words = (
        f"second axis {p[2]:.1f} rpm, damping ratio {p[3]:.4f}, {abs(weights[1]):.3f} um at "
        f"{apart:.0f} degrees to the first; {abs(weights[2]):.2f} um at every speed"
    )
    return Reading("two axes, swept", p[0], p[1], abs(weights[0]), slow), words


def beats(record: Record, slow: np.ndarray) -> np.ndarray:
    """Speeds in rpm at which the amplitude has maxima beyond its largest one."""
    from scipy.signal import find_peaks

    found, _ = find_peaks(np.abs(slow), prominence=0.3)
    found = found[found > np.argmax(np.abs(slow))]
    return record.inputs["speed"][found] * RPM


def drawn(record: Record, readings: Sequence[Reading], target: Path) -> None:
    """Amplitude and phase over speed, measured and as each reading has them."""
    from plotly import graph_objects as go
    from plotly.subplots import make_subplots

    rpm, figure = record.inputs["speed"] * RPM, make_subplots(
        rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.62, 0.38]
    )  # fmt: skip
    shown = [("measured", measured(record), "black", 5)]
    shown += [
        (r.name, r.slow, c, 0)
        for r, c in zip(readings, ("#999999", "#2a6fb0", "#c1272d"), strict=True)
    ]
    for name, slow, colour, size in shown:
        style = {"marker": {"color": colour, "size": size}} if size else {"line": {"color": colour}}
        mode, lead = "markers" if size else "lines", np.rad2deg(np.angle(slow))
        lead = np.where(lead > 0, lead - 360, lead)
        figure.add_trace(go.Scatter(x=rpm, y=np.abs(slow), name=name, mode=mode, **style), 1, 1)
        second = go.Scatter(x=rpm, y=lead, mode=mode, showlegend=False, **style)
        figure.add_trace(second, 2, 1)
    figure.update_layout(
        template="simple_white", width=900, height=560, margin={"t": 20, "r": 20},
        legend={"x": 0.62, "y": 0.98},
    )  # fmt: skip
    figure.update_yaxes(title_text="amplitude (µm)", row=1, col=1)
    figure.update_yaxes(title_text="phase (degrees)", dtick=90, range=[-360, 0], row=2, col=1)
    figure.update_xaxes(title_text="speed (rpm)", row=2, col=1)
    photographed(figure, target)


def main(given_words: list[str] | None = None) -> None:
    """Print what each way of reading finds, and draw where asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(given_words)
    problem = problem_of(PRESET, (WHOLE,))
    record = problem.test[0]
    pair, words = two_axes(record)
    target = measured(record)
    readings = [steady(record), swept(problem, "one mode, swept"), pair]
    print("read as            critical (rpm)  damping ratio  unbalance (um)  left (um rms)  beats")
    for r in readings:
        left = float(np.sqrt(np.mean(np.abs(r.slow - target) ** 2)))
        at = " ".join(f"{b:.0f}" for b in beats(record, r.slow)[:8])
        print(f"{r.name:18} {r.critical:14.1f} {r.damping_ratio:14.4f} {r.unbalance:15.3f}"
              f" {left:14.3f}  {at}")  # fmt: skip
    print(words)
    print(f"{'measured':18} {'':45} {'':14}  {' '.join(f'{b:.0f}' for b in beats(record, target))}")
    if given.picture is not None:
        drawn(record, readings, given.picture)


if __name__ == "__main__":
    main()
