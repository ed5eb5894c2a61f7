"""Where a model fails: the ranges of speed, order, frequency and amplitude, and the state.

The ranges come from the free-run error; the order, and the state that the failure follows, come
from the missing force (``spiral.inference.where.latent``), in which the machine's own resonances do
not appear.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.sensitivities import residuals
from spiral.inference.evidence.assembly import Assembly, active_keys, to_model
from spiral.inference.evidence.free_run import free_run_from_stage
from spiral.inference.where.latent import MissingForce, missing_force
from spiral.inference.where.orders import order_map, time_map
from spiral.inference.where.surface import ForceShape, best_shape, rank_force_shapes
from spiral.types.model import Model
from spiral.types.record import Array, Record
from spiral.types.run import Where
from spiral.types.system import System

_MOST = 0.8  # share of the excess energy that a range holds
_BINS = 40
_NARROW = 0.7  # a range over this share of what was seen says nothing and is left out
_QUIET = 1.1  # mean square over the noise's under which nothing is said
_BOTH = 0.3  # share of the worst channel's energy from which another fails too
_FOLLOWS = 0.25  # share of the missing force that one shape must explain to be named
_LINE_BINS = 4
_LINE = 0.8  # widest range of orders that is one order
_NEAR = 0.3
_SLICE = 1024  # samples of a slice in which a frequency is looked for


@dataclass(frozen=True)
class WorstRecord:
    """The free-run error and the missing force of a model on its worst record.

    ``number`` is that record's; ``error`` (samples, channels) measured minus free run;
    ``excess`` (samples,) its squares over the noise variances, less their expectation under noise
    alone; ``channels`` those that fail; ``missing`` the force, where there is one.
    """

    number: int
    record: Record
    error: Array
    excess: Array
    channels: tuple[str, ...]
    missing: MissingForce | None


def locate_failure(assembly: Assembly, stage: Stage, what: WorstRecord | None = None) -> Where:
    """The smallest ranges that hold 80 % of the error's energy in excess of noise, in one sentence.

    Errors are those of the free run with the stage's values on the worst record; where that run is
    not finite, those of the stage's windows. ``what`` is computed where it is not given.
    """
    names = assembly.problem.model.system.observed
    left = residuals(assembly.study, stage.layouts, stage.fitted.point)
    energy = np.array([sum(float(np.sum(r[:, j] ** 2)) for r in left) for j in range(len(names))])
    counted = sum(int(np.any(r != 0, axis=1).sum()) for r in left)
    worst = int(np.argmax(energy))
    if energy[worst] < _QUIET * max(counted, 1):
        return Where(names[worst], "The residual is at the level of the noise everywhere.")
    return describe_failure(
        assembly, what if what is not None else worst_record_failure(assembly, stage)
    )


def worst_record_failure(
    assembly: Assembly, stage: Stage, wide: Model | None = None
) -> WorstRecord:
    """The free-run error and the missing force on the worst record.

    ``wide``: a model that holds the stage's effects and an unknown force, zero where the stage has
    none of them, so that several models share one compilation.
    """
    left = residuals(assembly.study, stage.layouts, stage.fitted.point)
    study, names = assembly.study, assembly.problem.model.system.observed
    number = int(np.argmax([np.sum(r**2) / max(np.any(r != 0, axis=1).sum(), 1) for r in left]))
    series = study.series[number]
    run = free_run_from_stage(assembly, stage, (0,) * len(study.series))
    error = run.measured[number] - run.predicted[number]
    if not np.isfinite(error).all():
        error = left[number] * series.sigma
    noises = error / series.sigma
    shown = np.any(error != 0, axis=1)
    excess = np.where(shown, np.sum(noises**2, axis=1) - len(names), 0.0)
    energy = np.sum(noises**2, axis=0)
    channels = tuple(n for n, e in zip(names, energy, strict=True) if e > _BOTH * energy.max())
    missing = _missing_force_of_stage(assembly, stage, number, int(np.argmax(excess)), wide)
    return WorstRecord(number, series.record, error, excess, channels, missing)


def _missing_force_of_stage(
    assembly: Assembly, stage: Stage, number: int, first: int, wide: Model | None
) -> MissingForce | None:
    study, values = assembly.study, stage.fitted.point.values
    if not np.isfinite(values).all():
        return None
    model = to_model(assembly, assembly.problem.model.labels, values[number : number + 1], {})
    if wide is not None:
        model = replace(wide, values={**wide.values, **model.values})
    series = study.series[number]
    grid = study.inputs(number, values[number])
    return missing_force(model, series.record, grid, series.substeps, first)


def describe_failure(assembly: Assembly, seen: WorstRecord) -> Where:
    """The ranges in which the model fails, and the sentence that describes them."""
    record, system = seen.record, assembly.problem.model.system
    time = _range_of_excess(record.time, seen.excess)
    speed = (
        _range_of_excess(record.inputs["speed"], seen.excess) if "speed" in record.inputs else None
    )
    energy = dict(zip(system.observed, np.sum(seen.error**2, axis=0), strict=True))
    channel = max(seen.channels, key=lambda name: energy[name])
    amplitude = _range_of_excess(envelope(_channels_in_unit_of(channel, seen, system)), seen.excess)
    order = _failure_order(seen)
    frequency = _failure_frequency(seen.error, record.dt)
    state, share = _state_of_missing_force(assembly, seen)
    ranges = Where(
        channel, "", time, frequency, speed, order, amplitude,
        state.state if state else None, state.power if state else None, share, seen.channels,
    )  # fmt: skip
    return Where(**{**vars(ranges), "sentence": _failure_sentence(ranges, state, seen, system)})


def _channels_in_unit_of(channel: str, seen: WorstRecord, system: System) -> Array:
    """Readings (samples, channels) of one unit, as a motion has one size in no mix of units."""
    unit = system.unit_of(channel)
    alike = [name for name in system.observed if system.unit_of(name) == unit]
    return np.column_stack([seen.record.channels[name] for name in alike])


def _state_of_missing_force(
    assembly: Assembly, seen: WorstRecord
) -> tuple[ForceShape | None, float | None]:
    """The state that the missing force follows, and the share that this explains."""
    if seen.missing is None:
        return None, None
    ranked_shapes = rank_force_shapes(
        seen.missing, active_keys(assembly, assembly.problem.model.labels)
    )
    axes = tuple(a for a in seen.missing.axes if a in seen.channels) or seen.missing.axes
    best = best_shape(ranked_shapes, axes)
    if best is None or best.share < _FOLLOWS:
        return None, None if best is None else best.share
    return best, best.share


def _range_of_excess(values: Array, excess: Array, bins: int = _BINS) -> tuple[float, float] | None:
    """The shortest range of ``values`` that holds most of the excess; none where it is wide."""
    low, high = float(np.min(values)), float(np.max(values))
    if not high > low:
        return None
    edges = np.linspace(low, high, bins + 1)
    held, _ = np.histogram(values, edges, weights=excess)
    best = _shortest_bins(held)
    if best is None or best[1] - best[0] > _NARROW * bins:
        return None
    return float(edges[best[0]]), float(edges[best[1]])


def _shortest_bins(held: Array) -> tuple[int, int] | None:
    """The fewest neighbouring bins, [first, last), that hold most of the energy."""
    held = np.maximum(held, 0.0)
    total = held.sum()
    if total <= 0:
        return None
    cumulative = np.concatenate([[0.0], np.cumsum(held)]) / total
    best: tuple[int, int] | None = None
    for first in range(len(held)):
        last = int(np.searchsorted(cumulative, cumulative[first] + _MOST - 1e-12))
        if last <= len(held) and (best is None or last - first < best[1] - best[0]):
            best = (first, last)
    return best


def _spectral_band(axis: Array, power: Array) -> tuple[float, float] | None:
    """The shortest band of a spectrum that holds most of its power above the floor.

    A line of a few bins is placed at its centre of power, as wide as one bin.
    """
    above = np.maximum(power - np.median(power), 0.0)
    best = _shortest_bins(above)
    if best is None or best[1] - best[0] > _NARROW * len(axis):
        return None
    part, step = slice(*best), float(axis[1] - axis[0])
    if best[1] - best[0] <= _LINE_BINS:
        middle = float(np.sum(axis[part] * above[part]) / np.sum(above[part]))
        return max(middle - step / 2, 0.0), middle + step / 2
    return max(float(axis[best[0]]) - step / 2, 0.0), float(axis[best[1] - 1]) + step / 2


def envelope(y: Array) -> Array:
    """Size of the motion: the largest |y| within a period of its main frequency."""
    from scipy.ndimage import maximum_filter1d

    moving = y - y.mean(axis=0)
    spectrum = np.abs(np.fft.rfft(moving[:, 0] * np.hanning(len(moving))))
    main = int(np.argmax(spectrum[1:])) + 1
    return maximum_filter1d(np.linalg.norm(moving, axis=1), max(3, len(moving) // main))


def _failure_frequency(error: Array, dt: float) -> tuple[float, float] | None:
    spectrogram = time_map(error, dt, min(_SLICE, len(error)))
    return _spectral_band(spectrogram.axis, spectrogram.power.sum(axis=0))


def _failure_order(seen: WorstRecord) -> tuple[float, float] | None:
    """The order of the missing force (of the error where there is none), if it is one line."""
    record = seen.record
    if "phase" not in record.inputs or "speed" not in record.inputs:
        return None
    part = slice(0, record.samples)
    values = seen.error
    if seen.missing is not None:
        part, values = slice(seen.missing.start, seen.missing.stop), seen.missing.force
    spectrogram = order_map(
        values, record.inputs["phase"][part], record.inputs["speed"][part], record.dt
    )
    if spectrogram is None:
        return None
    total = np.sum(spectrogram.power * spectrogram.weight[:, None], axis=0)
    held = _spectral_band(spectrogram.axis, total)
    if (
        held is None
        or held[1] - held[0] > _LINE
        or abs(_nearest_order(held) - np.mean(held)) > _NEAR
    ):
        return None
    return held


def _nearest_order(order: tuple[float, float]) -> int:
    """The integer order nearest to the middle of a range."""
    return round(float(np.mean(order)))


def _failure_sentence(
    ranges: Where, state: ForceShape | None, seen: WorstRecord, system: System
) -> str:
    parts = []
    turning = np.ptp(seen.record.inputs["speed"]) > 0 if "speed" in seen.record.inputs else False
    if ranges.speed_rad_s is not None:
        rpm = sorted(abs(s) * 30 / np.pi for s in ranges.speed_rad_s)
        parts.append(f"between {rpm[0]:.0f} and {rpm[1]:.0f} rpm")
    elif turning:
        parts.append("at all speeds")
    elif ranges.time_s is not None:
        parts.append(f"from {ranges.time_s[0]:.4g} to {ranges.time_s[1]:.4g} s")
    if ranges.order is not None:
        parts.append(f"at order {_nearest_order(ranges.order)}")
    elif ranges.frequency_hz is not None:
        parts.append(_format_frequency(ranges.frequency_hz))
    if state is not None:
        parts.append(_describe_state(state))
    elif ranges.amplitude is not None and ranges.order is None and not turning:
        unit = system.unit_of(ranges.channel or system.observed[0])
        low, high = ranges.amplitude
        parts.append(f"at amplitudes of {low:.3g} to {high:.3g} {unit}")
    elif seen.missing is not None:
        parts.append("following no single state")
    count = len(system.observed)
    several = "in both channels" if count == 2 else "in all channels"
    said = (
        several if len(ranges.channels) == count > 1 else "in " + _format_channels(ranges.channels)
    )
    return f"The model fails {', '.join([*parts, said])}."


def _format_channels(names: tuple[str, ...]) -> str:
    return f"channel {names[0]}" if len(names) == 1 else f"channels {', '.join(names)}"


def _format_frequency(frequency: tuple[float, float]) -> str:
    low, high = frequency
    middle = 0.5 * (low + high)
    if high - low <= 0.1 * middle:
        places = max(0, int(np.ceil(-np.log10(high - low) - 0.3)))
        return f"at {middle:.{places}f} Hz"
    return f"at {low:.3g} to {high:.3g} Hz"


_GROWTH = {1: "in proportion to {}", 2: "growing with {} squared", 3: "growing with {} cubed"}


def _describe_state(state: ForceShape) -> str:
    """In words, how the missing force depends on a state."""
    if state.kind == "angle":
        often = {1: "once", 2: "twice"}.get(state.power, f"{state.power} times")
        return f"following the rotor's angle, {often} per turn"
    if state.kind.startswith("other"):
        what = "displacement" if state.kind == "other position" else "velocity"
        return f"the force on {state.axis} following the {what} {state.state}".replace("_rate", "'")
    if state.even:
        return "growing with displacement squared, to one side"
    if state.power == 0:
        return "following the direction of velocity, whatever its size"
    name = "amplitude" if state.kind == "position" else "velocity"
    name = "displacement" if state.kind == "position" and state.power == 1 else name
    return _GROWTH[state.power].format(name)
