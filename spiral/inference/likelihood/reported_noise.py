"""Noise beside white noise as it is told: its sizes, what slow noise of a sensor does, offsets.

A sensor that drifts, or whose noise lasts longer than a tenth of a record, has few independent
values in it. What counts of such noise is its course z over the records, which the filter has:

    size             max |z| of a drift, which begins at zero; else the deviation of z
    in a free run    max |z| of a drift, else (mean of z^2)^(1/2): a constant is part of its error
    offset           mean of z, where it is more than twice the deviation of z from it
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm, state_offsets
from spiral.engine.likelihood.predict import predict_readings
from spiral.inference.evidence.free_run import FreeRun
from spiral.types.formatting import number, percent
from spiral.types.noise import COLOURED, FORCES, STATIONARY
from spiral.types.record import Array
from spiral.types.system import System

_TOLD = 0.5  # standard error of the logarithm of a size up to which the size is reported
_TOLD_WITH_TIME = 1.0  # the same beside a correlation time: a slow force has few values in a record
_LASTING = 0.1  # of a record: longest correlation time of noise with many independent values
_COUNTS = 0.005  # share from which what acts at random counts
_STEADY = 2.0  # mean of slow noise over its deviation from which it is an offset


@dataclass(frozen=True)
class ReportedNoise:
    """Noise of an estimate beside white noise, as it is told."""

    estimate: MaximumLikelihood

    def sizes(self, disturbed: float, floor: float) -> tuple[dict[str, float], dict[str, float]]:
        """Sizes of noise that matters and is determined, by name; its correlation times.

        A force matters by its share of the machine's own, or by what forces make of a free run
        (``disturbed``), as such and beside what sensors' noise makes of it (``floor``).
        """
        noise, spread, length = self.estimate.noise, self._spreads, _seconds(self.estimate)
        sizes, times, gone = {}, {}, self.excursions
        for term in (t for t in noise.terms if _is_determined(self.estimate, t)):
            size = noise.values[term.size]
            if term.kind == "drift":
                size = max(size * np.sqrt(length), gone[term.size])
            elif term.size in gone:
                size = gone[term.size]
            pushes = term.kind in FORCES
            share = size if pushes else size / spread[term.where]
            most = max(share, disturbed) if pushes else share
            if most >= _COUNTS or (pushes and disturbed > floor):
                sizes[term.size] = float(share)
                if term.time:
                    times[term.size] = float(noise.values[term.time])
        return sizes, times

    def sensor_deviation(self, channel: str) -> float:
        """Deviation of a sensor's noise: white, coloured, and slow noise as far as it goes."""
        sizes = [f"{kind}.{channel}" for kind in STATIONARY]
        known, gone = self.estimate.noise.values, self.excursions
        return float(np.hypot.reduce([min(known.get(s, 0.0), gone.get(s, np.inf)) for s in sizes]))

    def error_in_free_run(self, run: FreeRun) -> float:
        """Error of the test's free run by slow noise of sensors, rms over channels.

        As large as in the fitted records: what a sensor's zero does in the test is not known
        before.
        """
        channels = self.estimate.prepared[0][0].compiled.traced.channels
        told = self._told_courses()
        far = [(t.where, max(_size_in_free_run(t, z) for z in courses)) for t, courses in told]
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = [z / run.deviations()[channels.index(where)] for where, z in far]
        return float(np.sqrt(sum(v**2 for v in shares) / len(channels)))

    def offsets(self, system: System) -> tuple[str, ...]:
        """A sentence for each sensor whose slow noise hardly moves, so that it is an offset."""
        said = []
        for term, courses in self._told_courses():
            where = term.where
            means = np.array([z.mean() for z in courses])
            value = float(means.mean())
            still = all(abs(z.mean()) > _STEADY * z.std() for z in courses)
            if not still or abs(means.sum()) < np.abs(means).sum():  # another sign elsewhere
                continue
            if (share := abs(value) / self._spreads[where]) >= _COUNTS:
                much = "more" if value > 0 else "less"
                said.append(
                    f"sensor {where} reads {number(abs(value), 2)} {system.unit_of(where)} {much} "
                    f"than the model all along, {percent(share)} of its motion: like an offset"
                )
        return tuple(said)

    @cached_property
    def _spreads(self) -> dict[str, float]:
        """Deviation of each channel in the first record."""
        task = self.estimate.prepared[0][0]
        spreads = np.std(task.series.y, axis=0)
        return {n: float(s) for n, s in zip(task.compiled.traced.channels, spreads, strict=True)}

    @cached_property
    def _courses(self) -> dict[str, list[Array]]:
        """z of slow noise over each record, by the name of its size."""
        return _slow_noise_courses(self.estimate)

    def _told_courses(self) -> list[tuple[NoiseTerm, list[Array]]]:
        """Slow noise of sensors of a size that the records tell, and its course over each."""
        slow = _slow_noise(self.estimate.noise, _seconds(self.estimate))
        told = {s: t for s, t in slow.items() if _is_determined(self.estimate, t)}
        return [(told[s], z) for s, z in self._courses.items() if s in told]

    @cached_property
    def excursions(self) -> dict[str, float]:
        """How far slow noise of a sensor goes, by the name of its size.

        A drift from where it was at first: one that drifts steadily goes further than one that
        wanders by as much from sample to sample. What lasts longer than a tenth of a record from
        its mean, as the reading's own deviation is: the size is that of many such records, and a
        zero is part of it.
        """
        kinds = {t.size: t.kind for t in self.estimate.noise.terms}
        excursions: dict[str, float] = {}
        for size, courses in self._courses.items():
            drifts = kinds[size] == "drift"
            far = (np.abs(z).max(initial=0.0) if drifts else z.std() for z in courses)
            excursions[size] = float(max(far))
        return excursions


def _is_determined(estimate: MaximumLikelihood, term: NoiseTerm) -> bool:
    """Whether noise beside white noise has a size that the records tell."""
    error = estimate.noise_errors.get(term.size, np.inf)
    return term.kind != "white" and error < (_TOLD_WITH_TIME if term.time else _TOLD)


def _size_in_free_run(term: NoiseTerm, course: Array) -> float:
    """Error of a free run by slow noise: as far as a drift goes, else from zero on average."""
    far = np.abs(course).max(initial=0.0) if term.kind == "drift" else np.sqrt(np.mean(course**2))
    return float(far)


def _seconds(estimate: MaximumLikelihood) -> float:
    """Length of the first record."""
    series = estimate.prepared[0][0].series
    return series.dt * series.samples


def _slow_noise(noise: NoiseModel, length: float) -> dict[str, NoiseTerm]:
    """Noise of sensors with few independent values in a record of ``length`` s, by its size."""
    return {
        t.size: t for t in noise.terms
        if t.kind == "drift"
        or (t.kind in COLOURED and noise.values.get(t.time, 0.0) > _LASTING * length)
    }  # fmt: skip


def _slow_noise_courses(estimate: MaximumLikelihood) -> dict[str, list[Array]]:
    """z of slow noise over each record, by the name of its size."""
    courses: dict[str, list[Array]] = {}
    for task, settings in estimate.prepared:
        noise = estimate.noise
        slow = _slow_noise(noise, task.series.dt * task.series.samples)
        if not slow:
            continue
        run = predict_readings(task, settings, noise, keep=True)
        first = len(task.states) + len(settings.tracked)
        for size, place in state_offsets(task, noise).items():
            if size in slow:
                courses.setdefault(size, []).append(run.means[: run.done, first + place])
    return courses
