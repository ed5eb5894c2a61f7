"""The two machines that imperfections are tried on, their equations by hand.

oscillator: a mass of 1 kg at 3.2 Hz under band-limited force, 40 s at 100 Hz; what may be hidden is
a cubic spring. rotor: the planar rotor of the paper (per unit mass) in a run-down from 40 Hz, 10 s
at 400 Hz; what may be hidden is the gyroscopic coupling. Both effects make about a fifth of the
response.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, band_limited, run_of
from experiments.studies.trajectory import Rate, Values

Array = np.ndarray
DRIFT = "imperfection.stiffness_drift"
"""Relative growth of every stiffness over the record; its length is ``LENGTH``."""
LENGTH = "imperfection.duration"


@dataclass(frozen=True)
class Scene:
    """A machine and its test: ``rate`` by hand, with a random force ``u.push`` (axes,) on it.

    ``resonance`` in rad/s is the time scale of imperfections; ``measured`` are the inputs that a
    record holds. States are positions, then rates.
    """

    system: str
    rate: Rate
    values: Mapping[str, float]
    hidden: Mapping[str, float]
    excite: Callable[[np.random.Generator, float], dict[str, Signal]]
    duration: float
    samples_per_s: float
    resonance: float
    axes: int
    measured: tuple[str, ...]

    def time(self) -> Array:
        """Sample times in s."""
        return np.arange(round(self.duration * self.samples_per_s)) / self.samples_per_s


def oscillator(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """m x'' = F + push - k (1 + drift t / T) x - c x' - k3 x^3."""
    q, v = x
    stiffness = c["linear_stiffness.stiffness"] * _grown(u, c)
    force = u.force + u.push[0] - stiffness * q - c["linear_damping.damping"] * v
    force -= c["cubic_stiffness.stiffness"] * q * q * q
    return np.array([v, force / c["system.mass"]])


def rotor(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """q'' = -K (1 + drift t / T) q - C q' + unbalance - g W (y', -x') + push, per unit mass."""
    first, second, first_rate, second_rate = x
    angle, square = u.phase + c["system.phase_origin"], u.speed * u.speed
    cosine, sine = np.cos(angle), np.sin(angle)
    grown, turning = _grown(u, c), c["gyroscopic.coefficient"] * u.speed
    moment = c["unbalance.moment"]
    along_x = moment * (square * cosine + u.speed_rate * sine) + u.push[0]
    along_y = moment * (square * sine - u.speed_rate * cosine) + u.push[1]
    along_x -= c["linear_stiffness.stiffness_x"] * grown * first
    along_y -= c["linear_stiffness.stiffness_y"] * grown * second
    along_x -= c["linear_damping.damping_x"] * first_rate + turning * second_rate
    along_y -= c["linear_damping.damping_y"] * second_rate - turning * first_rate
    return np.array([first_rate, second_rate, along_x, along_y])


def _grown(u: SimpleNamespace, c: Values) -> float:
    drift = c[DRIFT]
    return 1.0 + drift * u.time / c[LENGTH] if drift else 1.0


def _shaken(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"force": band_limited(rng, 8.0, (0.3, 10.0), duration)}


def _run_down(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return run_of(40.0, 0.0, duration)


SCENES = {
    "oscillator": Scene(
        "oscillator", oscillator,
        {
            "system.mass": 1.0,
            "linear_stiffness.stiffness": 400.0,
            "linear_damping.damping": 2.0,
        },
        {"cubic_stiffness.stiffness": 1.5e3},
        _shaken, duration=40.0, samples_per_s=100.0, resonance=20.0, axes=1, measured=("force",),
    ),
    "rotor": Scene(
        "planar_rotor", rotor,
        {
            "linear_stiffness.stiffness_x": 8085.0,
            "linear_stiffness.stiffness_y": 9672.0,
            "linear_damping.damping_x": 3.5,
            "linear_damping.damping_y": 2.1,
            "unbalance.moment": 1.565e-5,
            "system.phase_origin": 0.4,
        },
        {"gyroscopic.coefficient": 2.4e-2},
        _run_down, duration=10.0, samples_per_s=400.0, resonance=94.0, axes=2,
        measured=("speed", "phase"),
    ),
}  # fmt: skip
