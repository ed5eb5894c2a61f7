"""How well a fitted model predicts records that it has not seen, at several horizons.

An extended Kalman filter runs over each test record, the model's parameters held:

    x^(t | t) = x^(t | t - 1) + K_t (y(t) - h(x^(t | t - 1))),
    y^(t + h | t) = h(phi_h(x^(t | t))),

phi_h being the model's flow over a time h under the record's inputs, without measurements (what is
known at t of noise of the sensors that has a memory, as a drift has, is added). So each
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

from spiral.engine.filter.extended import FilterSettings, filter_record, tracked_indices
from spiral.engine.filter.noise import noise_intensity, sampled_covariance
from spiral.engine.filter.setup import choose_levels, prepare_filter
from spiral.engine.filter.task import FilterInput, build_task
from spiral.engine.kernel import trajectories
from spiral.engine.series import Series
from spiral.engine.study import ORIGIN
from spiral.inference.evidence.assembly import Assembly, nuisance_keys
from spiral.inference.evidence.free_run import FreeRun
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
class FilterNoise:
    """What a filter is told beside the model, all of it from the fitted records.

    ``intensity`` (n,) of the white process noise, state^2 / s; ``covariance`` (n, n) of the states
    before the first sample; ``tracked`` parameters that belong to a record.
    """

    intensity: Array
    covariance: Array
    tracked: tuple[str, ...]


Forecaster = Callable[[int, FilterInput, int, int], tuple[Array, Array]]
"""(record, task, first sample, samples ahead) -> what predictions miss, as ``forecast_misses``."""


def errors_on_unseen_records(
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

    def forecaster(record: int, task: FilterInput, first: int, steps: int) -> tuple[Array, Array]:
        return forecast_misses(task, disturbed, first, steps)

    return errors_at_horizons(test, model, run, forecaster)


def errors_at_horizons(
    test: Assembly, model: Model, run: FreeRun, forecaster: Forecaster
) -> tuple[Horizon, ...]:
    """Errors of a free run, and of what a filter forecasts, on the records of a study."""
    seconds = _middle_horizon(test, run)
    misses: dict[str, list[Array]] = {"one_sample": [], "ahead": [], "free_run": []}
    free = run.misses()
    for r, series in enumerate(test.study.series):
        first, steps = run.settled[r], round(seconds / series.dt)
        task = filter_task(test, model, run.values[r], series.record, series.substeps)
        one, ahead = forecaster(r, task, first, steps)
        misses["one_sample"].append(_scored_misses(one, series, first))
        misses["ahead"].append(ahead)
        misses["free_run"].append(_scored_misses(free[r], series, first))
    dt = test.study.series[0].dt
    reach = {"one_sample": dt, "ahead": seconds, "free_run": None}
    scale, names = run.deviations(), model.system.observed
    return tuple(
        Horizon(
            name,
            None if (far := reach[name]) is None else round(far / dt),
            far,
            dict(zip(names, _block_mean_squares(channel_misses, scale), strict=True)),
        )
        for name, channel_misses in misses.items()
        if name != "ahead" or seconds > dt
    )


def _scored_misses(misses: Array, series: Series, first: int) -> Array:
    """Misses from a sample on, 0 where nothing was measured; scaled so that their rms is kept."""
    if series.seen is None:
        return misses
    seen = series.seen[first:]
    with np.errstate(over="ignore"):  # a free run that runs away
        return np.where(seen, misses, 0.0) / np.sqrt(np.maximum(seen.mean(axis=0), 1e-9))


def process_noise(
    fitted: Assembly, model: Model, labels: tuple[str, ...], values: Array
) -> FilterNoise:
    """The most likely process noise of a model on the part of its records that moves most."""
    known = dict(model.pairs)
    tracked = tuple(k for k in nuisance_keys(fitted, labels) if k in known)
    r, start, stop = liveliest_stretch(fitted.study.series)
    series = fitted.study.series[r]
    record = series.record.stretch(start, stop)
    task = filter_task(fitted, model, values[r], record, series.substeps)
    task, settings = prepare_filter(task, tracked, tracked_deviations(tracked))
    levels = choose_levels(task, settings, None)
    return FilterNoise(noise_intensity(task, levels), settings.covariance, tracked)


def filter_task(
    assembly: Assembly, model: Model, row: Array, record: Record, substeps: int,
    like: FilterInput | None = None,
) -> FilterInput:  # fmt: skip
    """A record's filter task, from functions already compiled; its scales are those of ``like``."""
    compiled = assembly.study.compiled
    own = np.ascontiguousarray(row[: len(compiled.traced.keys)], dtype=float).copy()
    return build_task(model, compiled, own, record, substeps=substeps, like=like)


def forecast_misses(
    task: FilterInput, disturbed: FilterNoise, first: int, steps: int
) -> tuple[Array, Array]:
    """What predictions miss, from sample ``first`` on.

    Returns (samples, channels) one sample ahead and (starts, channels) ``steps`` ahead, of starts
    spread evenly; infinite where the filter or a prediction runs away.
    """
    task, settings = prepare_filter(task, disturbed.tracked, tracked_deviations(disturbed.tracked))
    settings = replace(
        settings,
        covariance=disturbed.covariance,
        process=sampled_covariance(task, disturbed.intensity),
    )
    filter_pass = filter_record(task, settings)
    if filter_pass.done < task.series.samples:
        lost = np.full((task.series.samples - first, task.series.y.shape[1]), np.inf)
        return lost, lost
    return filter_pass.innovations[first:], misses_ahead(
        task, settings, filter_pass.means, first, steps
    )


def misses_ahead(
    task: FilterInput, settings: FilterSettings, means: Array, first: int, steps: int,
    remembered: Array | None = None,
) -> Array:  # fmt: skip
    """(starts, channels) y(t + h) - h(phi_h(x^(t | t))) - R z^(t | t).

    ``remembered`` : R (channels, noise states), what noise of the sensors that is known at a start
    still adds to readings so much later; nothing where left out.
    """
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
            if remembered is not None:
                misses[i] -= remembered @ means[start, n + len(tracked) :]
    return misses


def tracked_deviations(tracked: tuple[str, ...]) -> dict[str, float]:
    """First standard deviation of a phase origin that the settling part has determined."""
    return {ORIGIN: _DOUBT} if ORIGIN in tracked else {}


def _middle_horizon(test: Assembly, run: FreeRun) -> float:
    """The middle horizon: AHEAD, or ten samples, or a tenth of a short record; whole samples."""
    series = test.study.series
    dt = max(s.dt for s in series)
    samples = AHEAD / dt if AHEAD / dt >= _LEAST else _FEWEST
    scored = min(
        (s.samples - n) * s.dt / dt for s, n in zip(series, run.settled, strict=True)
    )  # fmt: skip
    return dt * max(round(min(samples, _LONGEST * scored)), 1)


def liveliest_stretch(records: Sequence[Series]) -> tuple[int, int, int]:
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


def _block_mean_squares(misses: list[Array], scale: Array) -> list[tuple[float, ...]]:
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
