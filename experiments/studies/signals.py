"""Inputs as an engineer would choose them: functions of time, known between samples as well.

A simulation evaluates a signal where its integrator asks, a record holds its samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Array = np.ndarray
Signal = Callable[[Array], Array]
"""(samples,) or scalar time in s -> the input there."""


@dataclass(frozen=True)
class Multisine:
    """u(t) = mean + r(t) sum_k a_k cos(w_k t + phi_k): band-limited noise that is known exactly.

    ``r`` rises from zero and falls to zero over a share ``rise`` of the record, as a test begins
    and ends: the record then starts from rest, and no interpolation suffers at its ends.
    """

    frequencies: Array
    amplitudes: Array
    phases: Array
    duration: float
    mean: float = 0.0
    rise: float = 0.03

    def __call__(self, time: Array) -> Array:
        """The input at these times."""
        waves = np.cos(np.multiply.outer(time, self.frequencies) + self.phases) @ self.amplitudes
        return self.mean + waves * _rise(time, self.duration, self.rise)


def band_limited(
    rng: np.random.Generator,
    rms: float,
    band: tuple[float, float],
    duration: float,
    mean: float = 0.0,
    lines: int = 40,
) -> Multisine:
    """Noise of this rms in a band in Hz: lines at random frequencies with random phases."""
    edges = np.linspace(*band, lines + 1)
    hertz = rng.uniform(edges[:-1], edges[1:])
    sizes = np.full(lines, rms * np.sqrt(2.0 / lines))
    phases = rng.uniform(0.0, 2 * np.pi, lines)
    return Multisine(2 * np.pi * hertz, sizes, phases, duration, mean)


@dataclass(frozen=True)
class Sweep:
    """u(t) = mean + a r(t) sin(2 pi (f0 t + (f1 - f0) t^2 / (2 T))): a linear sweep, f in Hz."""

    amplitude: float
    first: float
    last: float
    duration: float
    mean: float = 0.0
    rise: float = 0.03

    def __call__(self, time: Array) -> Array:
        """The input at these times."""
        turns = self.first * time + (self.last - self.first) * time**2 / (2 * self.duration)
        risen = self.amplitude * _rise(time, self.duration, self.rise)
        return self.mean + risen * np.sin(2 * np.pi * turns)


@dataclass(frozen=True)
class Steps:
    """Levels, each held for ``hold`` seconds: a programme of steps."""

    levels: Array
    hold: float

    def __call__(self, time: Array) -> Array:
        """The level at these times; a step belongs to the sample at which it comes."""
        place = np.floor(np.asarray(time) / self.hold + 1e-9).astype(int)
        return self.levels[np.clip(place, 0, len(self.levels) - 1)]


def steps(rng: np.random.Generator, low: float, high: float, hold: float, duration: float) -> Steps:
    """Random levels between two limits; the first and every fifth in the middle."""
    levels = rng.uniform(low, high, int(np.ceil(duration / hold)) + 1)
    levels[::5] = 0.5 * (low + high)
    return Steps(levels, hold)


@dataclass(frozen=True)
class Polynomial:
    """u(t) = c0 + c1 t + c2 t^2 + ...: the speed of a run-up, and its phase."""

    coefficients: tuple[float, ...]

    def __call__(self, time: Array) -> Array:
        """The input at these times."""
        return np.polynomial.polynomial.polyval(time, self.coefficients)


def run_of(first: float, last: float, duration: float) -> dict[str, Signal]:
    """Speed (rad/s) that changes evenly between two frequencies (Hz), its rate and its phase."""
    start, slope = 2 * np.pi * first, 2 * np.pi * (last - first) / duration
    return {
        "speed": Polynomial((start, slope)),
        "speed_rate": Polynomial((slope,)),
        "phase": Polynomial((0.0, start, slope / 2)),
    }


def _rise(time: Array, duration: float, share: float) -> Array:
    """0 at both ends, 1 between, along half a cosine."""
    edge = share * duration
    inside = np.clip(np.minimum(time, duration - time) / edge, 0.0, 1.0)
    return 0.5 - 0.5 * np.cos(np.pi * inside)
