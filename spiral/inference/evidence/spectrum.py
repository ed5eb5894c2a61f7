"""Frequencies at which effects with states of their own are tried, and their other shapes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from spiral.engine.series import Series
from spiral.types.effect import Effect
from spiral.types.parameter import Parameter
from spiral.types.record import Array

_RESONANT, _RELAXING = 1.1, 1.5  # ratio of neighbouring frequencies
_COUNTS = 256  # numbers of repetitions that are tried at most
_LOWEST, _HIGHEST = 4.0, 0.1  # band: periods in the record; share of the sample rate


def frequency_band(samples: int, dt: float) -> tuple[float, float]:
    """Hz that a record can show: from four periods in it to a tenth of its rate."""
    return _LOWEST / (samples * dt), _HIGHEST / dt


def shortest_time_constant(dt: float) -> float:
    """Shortest time constant 1 / (2 pi f) in s, f the highest frequency that ``dt`` can show."""
    return float(dt / (2 * np.pi * _HIGHEST))


def trial_frequencies(effect: Effect, series: Series) -> Array:
    """Frequencies of an effect's spectrum, Hz, over the band that a record can show."""
    low, high = frequency_band(series.samples, series.dt)
    count = max(int(np.ceil(np.log(high / low) / np.log(frequency_ratio(effect)))), 1) + 1
    return np.geomspace(low, high, count)


def frequency_ratio(effect: Effect) -> float:
    """Ratio of neighbouring frequencies at which an effect is tried.

    A mode is as narrow as its damping is small. What relaxes in a time T, 1 / (1 + i w T), is not:
    two whose times differ by a factor of 1.2 are alike to 0.99 (their correlation over white noise,
    2 sqrt(ab) / (a + b), is 0.996).
    """
    modes = any(p.spectrum and p.unit != "s" for p in _shapes(effect))
    return _RESONANT if modes else _RELAXING


def _shapes(effect: Effect) -> list[Parameter]:
    return [p for p in effect.parameters if p.role == "shape"]


def _grid_values(parameter: Parameter) -> tuple[float, ...]:
    return parameter.grid or (parameter.start or 1.0,)


def frequency_shapes(effect: Effect, frequency: float) -> dict[str, float]:
    """The spectral shapes of an effect at a frequency: f in Hz, a time 1 / (2 pi f) in s."""
    late = float(1.0 / (2 * np.pi * frequency))
    hertz = float(frequency)
    return {p.name: late if p.unit == "s" else hertz for p in _shapes(effect) if p.spectrum}


def other_shapes(effect: Effect) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Shapes that are no frequency: their middle values, and all combinations to try."""
    shapes = [p for p in _shapes(effect) if not p.spectrum]
    usual = {p.name: _grid_values(p)[len(_grid_values(p)) // 2] for p in shapes}
    grids = itertools.product(*(_grid_values(p) for p in shapes))
    return usual, [dict(zip(usual, values, strict=True)) for values in grids]


def trial_counts(positions: Sequence[Array], beyond: float) -> tuple[Array, float]:
    """How often an effect may repeat for one unit of a position along records, and their distance.

    Two such waves, over a range of R, differ from one another where their numbers do by pi / R;
    where a record goes round more than twice they are whole numbers. From ``beyond`` on, or from
    one wave over R, as far as half of the steps from sample to sample see a quarter of a wave, and
    ``_COUNTS`` numbers at most.
    """
    reach = max(float(np.ptp(q)) for q in positions)
    moves = np.abs(np.concatenate([np.diff(q) for q in positions]))
    moves = moves[moves > 0]
    if not len(moves) or not np.isfinite(reach):
        return np.zeros(0), 0.0
    step = 1.0 if reach > 4 * np.pi else np.pi / reach
    first = max(np.floor(beyond) + step, 2 * np.pi / reach)
    last = min(np.pi / (2 * float(np.median(moves))), first + (_COUNTS - 1) * step)
    return np.arange(first, last, step), step


def local_maxima(share: Array) -> list[int]:
    """Positions of the local maxima, the largest first; the ends count."""
    padded = np.concatenate([[-np.inf], share, [-np.inf]])
    at = np.flatnonzero((padded[1:-1] > padded[:-2]) & (padded[1:-1] >= padded[2:]))
    return [int(i) for i in at[np.argsort(-share[at], kind="stable")]]
