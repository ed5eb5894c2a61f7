"""How well a fitted model predicts records that it has not seen, at several horizons.

An extended Kalman filter runs over each test record, the model's parameters held:

    x^(t | t) = x^(t | t - 1) + K_t (y(t) - h(x^(t | t - 1))),
    y^(t + h | t) = h(phi_h(x^(t | t))),

phi_h being the model's flow over a time h under the record's inputs, without measurements. So each
prediction starts from a state that only the past of the test record determines. The measurement
noise is the record's; the process noise, which says how far the filter may leave the model, is the
most likely one on a stretch of the fitted records, so that the test record tunes nothing. What
belongs to a record (the phase origin) begins as the settling part of the test record has it and is
tracked from there on.

Three horizons (``types.horizon`` defines the errors): one sample; a tenth of a second, or ten
samples where that is less than two; and the free run, which starts once and measures no more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.extended import FilterSettings, filtered, tracked_indices
from spiral.engine.filter.noise import intensity, sampled
from spiral.engine.filter.setup import chosen_levels, prepared
from spiral.engine.filter.task import Task, task_with
from spiral.engine.kernel import trajectories
from spiral.engine.series import Series
from spiral.inference.evidence.assembly import ORIGIN, Assembly, nuisance_keys
from spiral.inference.evidence.judge import FreeRun
from spiral.types.horizon import Horizon
from spiral.types.model import Model
from spiral.types.record import Array, Record

AHEAD = 0.1  # s
_FEWEST, _LEAST = 10, 2  # samples ahead where AHEAD is less than so many
_LONGEST = 0.1  # share of the scored samples that the middle horizon may span
_BLOCKS = 20
_STARTS, _COVER = 1000, 4  # most predictions from a record, and how often they cover it
_TUNED = 4096  # most samples on which the process noise is tuned
_DOUBT = np.pi / 8  # rad, of a phase origin that the settling part has told


@dataclass(frozen=True)
class Disturbed:
    """What a filter is told beside the model, all of it from the fitted records.

    ``intensity`` (n,) of the white process noise, state^2 / s; ``covariance`` (n, n) of the states
    before the first sample; ``tracked`` parameters that belong to a record.
    """

    intensity: Array
    covariance: Array
    tracked: tuple[str, ...]


Forecaster = Callable[[int, Task, int, int], tuple[Array, Array]]
"""(record, task, first sample, samples ahead) -> what predictions miss, as from ``forecast``."""


def unseen(
    fitted: Assembly, test: Assembly, model: Model, labels: tuple[str, ...], values: Array,
    run: FreeRun,
) -> tuple[Horizon, ...]:  # fmt: skip
    """Errors at every horizon on the test records.

    Parameters
    ----------
    fitted, test : one compiled study, with the fitted records and with the test records.
    model : the fitted model. labels : its effects by their compiled labels.
    values : (records, parameters) of the fitted records.
    run : the free run over the test records, with each record's own values.
    """
    disturbed = process_noise(fitted, model, labels, values)

    def forecaster(record: int, task: Task, first: int, steps: int) -> tuple[Array, Array]:
        return forecast(task, disturbed, first, steps)

    return at_horizons(test, model, run, forecaster)


def at_horizons(
    test: Assembly, model: Model, run: FreeRun, forecaster: Forecaster
) -> tuple[Horizon, ...]:
    """Errors of a free run, and of what a filter forecasts, on the records of a study."""
    seconds = _seconds(test, run)
    misses: dict[str, list[Array]] = {"one_sample": [], "ahead": [], "free_run": []}
    free = run.misses()
    for r, series in enumerate(test.study.series):
        first, steps = run.settled[r], round(seconds / series.dt)
        task = task_for(test, model, run.values[r], series.record, series.substeps)
        one, ahead = forecaster(r, task, first, steps)
        misses["one_sample"].append(_told(one, series, first))
        misses["ahead"].append(ahead)
        misses["free_run"].append(_told(free[r], series, first))
    dt = test.study.series[0].dt
    reach = {"one_sample": dt, "ahead": seconds, "free_run": None}
    scale, names = run.deviations(), model.system.observed
    return tuple(
        Horizon(
            name,
            None if (far := reach[name]) is None else round(far / dt),
            far,
            dict(zip(names, _squares(found, scale), strict=True)),
        )
        for name, found in misses.items()
        if name != "ahead" or seconds > dt
    )


def _told(misses: Array, series: Series, first: int) -> Array:
    """Misses from a sample on: zero where nothing was measured, the others larger by as much."""
    if series.seen is None:
        return misses
    seen = series.seen[first:]
    return np.where(seen, misses, 0.0) / np.sqrt(np.maximum(seen.mean(axis=0), 1e-9))


def process_noise(
    fitted: Assembly, model: Model, labels: tuple[str, ...], values: Array
) -> Disturbed:
    """The most likely process noise of a model on the part of its records that moves most."""
    known = dict(model.pairs)
    tracked = tuple(k for k in nuisance_keys(fitted, labels) if k in known)
    r, start, stop = liveliest(fitted.study.series)
    series = fitted.study.series[r]
    record = series.record.part(start, stop, series.record.name)
    record = replace(record, noise=series.record.sigma())
    task = task_for(fitted, model, values[r], record, series.substeps)
    task, settings = prepared(task, tracked, doubts(tracked))
    levels = chosen_levels(task, settings, None)
    return Disturbed(intensity(task, levels), settings.covariance, tracked)


def task_for(
    assembly: Assembly, model: Model, row: Array, record: Record, substeps: int,
    like: Task | None = None,
) -> Task:  # fmt: skip
    """A record for the filter, by functions that are compiled already; scales of ``like``."""
    compiled = assembly.study.compiled
    own = np.ascontiguousarray(row[: len(compiled.traced.keys)], dtype=float).copy()
    return task_with(model, compiled, own, record, substeps=substeps, like=like)


def forecast(task: Task, disturbed: Disturbed, first: int, steps: int) -> tuple[Array, Array]:
    """What predictions miss, from sample ``first`` on.

    Returns (samples, channels) one sample ahead and (starts, channels) ``steps`` ahead, of starts
    spread evenly; infinite where the filter or a prediction runs away.
    """
    task, settings = prepared(task, disturbed.tracked, doubts(disturbed.tracked))
    settings = replace(
        settings,
        covariance=disturbed.covariance,
        process=sampled(task, disturbed.intensity),
    )
    found = filtered(task, settings)
    if found.done < task.series.samples:
        lost = np.full((task.series.samples - first, task.series.y.shape[1]), np.inf)
        return lost, lost
    return found.innovations[first:], ahead_of(task, settings, found.means, first, steps)


def ahead_of(task: Task, settings: FilterSettings, means: Array, first: int, steps: int) -> Array:
    """(starts, channels) y(t + h) - h(phi_h(x^(t | t)))."""
    series, n = task.series, len(task.states)
    last = series.samples - 1 - steps
    count = min(_STARTS, max(_COVER * (last - first) // max(steps, 1), 1))
    starts = np.unique(np.linspace(first, max(last, first), count).astype(np.int64))
    tracked = tracked_indices(task, settings.tracked)
    row, length = task.values[None, :].copy(), np.array([steps + 1])
    states, readings = np.empty((series.samples, n)), np.empty_like(series.y)
    misses = np.full((len(starts), series.y.shape[1]), np.inf)
    for i, start in enumerate(starts):
        row[0, tracked] = means[start, n : n + len(tracked)]
        ok = trajectories(
            task.compiled.rate_value, task.compiled.output_value,
            np.ascontiguousarray(means[start : start + 1, :n]), starts[i : i + 1], length,
            row, task.inputs, series.substeps, series.dt, states, readings,
        )  # fmt: skip
        if ok:
            misses[i] = series.y[start + steps] - readings[start + steps]
    return misses


def doubts(tracked: tuple[str, ...]) -> dict[str, float]:
    """First standard deviation of a phase origin that the record has told already."""
    return {ORIGIN: _DOUBT} if ORIGIN in tracked else {}


def _seconds(test: Assembly, run: FreeRun) -> float:
    """The middle horizon: AHEAD, or ten samples, or a tenth of a short record; whole samples."""
    series = test.study.series
    dt = max(s.dt for s in series)
    samples = AHEAD / dt if AHEAD / dt >= _LEAST else _FEWEST
    scored = min(
        (s.samples - n) * s.dt / dt for s, n in zip(series, run.settled, strict=True)
    )  # fmt: skip
    return dt * max(round(min(samples, _LONGEST * scored)), 1)


def liveliest(records: Sequence[Series]) -> tuple[int, int, int]:
    """Record, first and last sample of the stretch whose channels move most, over their noise."""
    best, most = (0, 0, 0), -1.0
    for r, series in enumerate(records):
        length = min(series.samples, _TUNED)
        for start in {*range(0, series.samples - length, length // 2), series.samples - length}:
            part = series.y[start : start + length] / series.sigma
            energy = float(np.sum(np.var(part, axis=0)))
            if energy > most:
                best, most = (r, start, start + length), energy
    return best


def _squares(misses: list[Array], scale: Array) -> list[tuple[float, ...]]:
    """m_jb of every channel: blocks of time, shared by records according to their samples."""
    total = sum(len(m) for m in misses)
    parts: list[Array] = []
    for miss in misses:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            square = np.nan_to_num((miss / scale) ** 2, nan=np.inf, posinf=np.inf)
        pieces = min(max(round(_BLOCKS * len(miss) / max(total, 1)), 1), max(len(miss), 1))
        parts += np.array_split(square, pieces)
    weight = len(parts) / max(total, 1)
    sums = np.array([weight * p.sum(axis=0) for p in parts])
    return [tuple(float(v) for v in column) for column in sums.T]
