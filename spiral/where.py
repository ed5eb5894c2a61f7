"""Where a model fails: the channel, times, speeds, frequencies and amplitudes it shows in."""

from __future__ import annotations

import numpy as np

from spiral.assembly import Assembly
from spiral.record import Array, Record
from spiral.run import Where
from spiral.shooting.growth import Stage
from spiral.shooting.sensitivities import residuals

_MOST = 0.8  # share of the excess energy that a range holds
_BINS = 40
_NARROW = 0.7  # a range over this share of what was seen says nothing and is left out


def where(assembly: Assembly, stage: Stage) -> Where:
    """The smallest ranges that hold 80 % of the residual energy in excess of noise.

    Residuals are those of the stage's windows, in units of their noise.
    """
    left = residuals(assembly.study, stage.layouts, stage.fitted.point)
    names = assembly.problem.model.system.observed
    energy = np.array([sum(float(np.sum(r[:, j] ** 2)) for r in left) for j in range(len(names))])
    counted = np.array(
        [sum(int(np.count_nonzero(r[:, j])) for r in left) for j in range(len(names))]
    )
    worst = int(np.argmax(energy / np.maximum(counted, 1)))
    if energy[worst] / max(counted[worst], 1) < 1.1:
        return Where(names[worst], "The residual is at the level of the noise everywhere.")
    seen = [np.any(r != 0, axis=1) for r in left]
    record = int(
        np.argmax([np.mean(np.sum(r[s] ** 2, axis=1)) for r, s in zip(left, seen, strict=True)])
    )
    series = assembly.study.series[record]
    excess = np.where(seen[record], np.sum(left[record] ** 2, axis=1) - len(names), 0.0)
    rec = series.record
    time = _range(rec.time, excess)
    speed = _range(rec.inputs["speed"], excess) if "speed" in rec.inputs else None
    amplitude = _range(_envelope(series.y), excess)
    frequency = _frequency(left[record], rec.dt)
    order = _order(frequency, speed, rec)
    both = len(names) > 1 and energy.min() > 0.3 * energy.max()
    channel = names[worst]
    said = "all channels" if both else f"channel {channel}"
    return Where(channel, _sentence(said, time, speed, frequency, order, amplitude, rec, assembly),
                 time, frequency, speed, order, amplitude)  # fmt: skip


def _range(values: Array, excess: Array, bins: int = _BINS) -> tuple[float, float] | None:
    """The shortest range of ``values`` that holds most of the excess; none where it is wide."""
    low, high = float(np.min(values)), float(np.max(values))
    if not high > low:
        return None
    edges = np.linspace(low, high, bins + 1)
    held, _ = np.histogram(values, edges, weights=excess)
    held = np.maximum(held, 0.0)
    total = held.sum()
    if total <= 0:
        return None
    cumulative = np.concatenate([[0.0], np.cumsum(held)]) / total
    best: tuple[int, int] | None = None
    for first in range(bins):
        last = int(np.searchsorted(cumulative, cumulative[first] + _MOST - 1e-12))
        if last <= bins and (best is None or last - first < best[1] - best[0]):
            best = (first, last)
    if best is None or best[1] - best[0] > _NARROW * bins:
        return None
    return float(edges[best[0]]), float(edges[best[1]])


def _envelope(y: Array) -> Array:
    """Size of the motion: the largest |y| within a period of its main frequency."""
    from scipy.ndimage import maximum_filter1d

    moving = y - y.mean(axis=0)
    spectrum = np.abs(np.fft.rfft(moving[:, 0] * np.hanning(len(moving))))
    main = int(np.argmax(spectrum[1:])) + 1
    return maximum_filter1d(np.linalg.norm(moving, axis=1), max(3, len(moving) // main))


def _frequency(left: Array, dt: float) -> tuple[float, float] | None:
    from scipy.signal import welch

    frequencies, power = welch(left, 1.0 / dt, nperseg=min(len(left), 1024), axis=0)
    total = power.sum(axis=1)
    return _range(frequencies, total - np.median(total), len(frequencies))


def _order(
    frequency: tuple[float, float] | None, speed: tuple[float, float] | None, record: Record
) -> tuple[float, float] | None:
    """Frequency over the speed at which the residual lives."""
    if frequency is None or "speed" not in record.inputs:
        return None
    turns = np.abs(np.array(speed if speed is not None else record.inputs["speed"])) / (2 * np.pi)
    middle = float(np.mean(turns))
    if middle <= 0:
        return None
    return frequency[0] / middle, frequency[1] / middle


def _sentence(said, time, speed, frequency, order, amplitude, record, assembly) -> str:
    parts = []
    if time is not None:
        parts.append(f"from {time[0]:.3g} to {time[1]:.3g} s")
    if speed is not None:
        rpm = sorted(abs(s) * 30 / np.pi for s in speed)
        parts.append(f"between {rpm[0]:.0f} and {rpm[1]:.0f} rpm")
    if frequency is not None:
        parts.append(f"at {frequency[0]:.3g} to {frequency[1]:.3g} Hz")
    if order is not None and order[1] - order[0] < 1.5:
        parts.append(f"near order {np.mean(order):.1f}")
    if amplitude is not None:
        unit = assembly.problem.model.system.states[0].unit
        parts.append(f"at amplitudes of {amplitude[0]:.3g} to {amplitude[1]:.3g} {unit}")
    if not parts:
        return f"The model fails throughout the record, in {said}."
    return f"The model fails {', '.join(parts)}, in {said}."
