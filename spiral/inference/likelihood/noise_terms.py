"""Noise terms that may be added to a noise model, with the sizes and times to begin with.

Coloured noise of sensors, noise behind a low-pass, a sensor that drifts or rings, a force that
lasts. Which of them a record prefers is for ``noise_selection`` to say.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from spiral.engine.filter.noise import noise_groups
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.noise import NoiseTerm, size_limits
from spiral.inference.likelihood.fitting import LITTLE
from spiral.types.invalid import bridged
from spiral.types.noise import FORCES, Kind

_SHARED = 0.7  # of the size of white noise, that it and a coloured one start with (half of it)
_LARGE, _SMALL = 0.5, 0.1  # of the innovations' rms, that noise of a sensor starts with
_SEGMENT, _SHORT = 512, 32  # samples of a piece of a spectrum, at most and at least
_STANDS_OUT = 4.0  # times the median power from which a line may be one
_GUST, GUST_TIMES = 0.05, (0.003, 0.03)  # sizes of a gust to begin with; times, of the record
_NEXT = 8  # samples over which the most coloured channel is looked for
_NARROW = 0.1  # damping ratio that a line begins with
_OWN_LINE = 0.25  # share of a reading's power at a line (half its amplitude) that is missed there


@dataclass(frozen=True)
class AdditionalNoise:
    """One step of the selection: noise terms added together, with start values of all sizes.

    Where the first of several ``starts`` does not lead above the noise without them, the likeliest
    of the others is where they begin.
    """

    terms: tuple[NoiseTerm, ...]
    starts: tuple[dict[str, float], ...]


def additional_noise_terms(now: MaximumLikelihood) -> Iterator[AdditionalNoise]:
    """The noise terms that may be added next."""
    task, noise = now.prepared[0][0], now.noise
    channels = task.compiled.traced.channels
    if not noise.has_kind("coloured") and not noise.has_kind("band"):
        kinds: tuple[tuple[Kind, float], ...] = (("coloured", 4.0), ("band", 1.0))
        alone = {channels, (_most_coloured_channel(now),)}  # one sensor does not pay for the others
        for (kind, steps), some in itertools.product(kinds, sorted(alone, key=len, reverse=True)):
            terms = tuple(NoiseTerm(kind, c) for c in some)
            time = {f"{kind}.time": steps * task.series.dt}
            starts = tuple(v | time for v in _initial_sensor_noise(now, terms))
            yield AdditionalNoise(terms, starts)
    for term in (NoiseTerm("drift", c) for c in channels):
        if term not in noise.terms:
            yield AdditionalNoise((term,), ({term.size: initial_drift_size(task, term.where)},))
    if not noise.has_kind("gust"):
        terms = tuple(NoiseTerm("gust", g) for g in noise_groups(task))
        for values in initial_gust_sizes(task, terms):
            yield AdditionalNoise(terms, (values,))


def _initial_sensor_noise(
    now: MaximumLikelihood, terms: Sequence[NoiseTerm]
) -> Iterator[dict[str, float]]:
    """Initial sizes of coloured noise of sensors, of the white noise and forces beside it.

    Noise of half the innovations' rms. Where small random forces have taken in what the noise does,
    misses are far larger than white noise: a tenth of their rms too, and beside smaller forces.
    """
    task, noise = now.prepared[0][0], now.noise
    channels = task.compiled.traced.channels
    missed = np.sqrt(np.mean(now.predictions[0].misses ** 2, axis=0))
    rms = {t.where: float(missed[channels.index(t.where)]) for t in terms}

    def sizes(share: float) -> dict[str, float]:
        values = {}
        for term in terms:
            white = f"white.{term.where}"
            least = max(size_limits(task, white)[0], share * rms[term.where])
            size = _SHARED * max(noise.values[white], least)
            values |= {term.size: size, white: size}
        return values

    yield sizes(_LARGE)
    forces = [t.size for t in noise.terms if t.kind in FORCES]
    little = all(noise.values[size] <= LITTLE for size in forces)
    if little and any(noise.values[f"white.{c}"] < _SMALL * size for c, size in rms.items()):
        yield sizes(_SMALL)
        yield sizes(_SMALL) | {size: _SMALL * noise.values[size] for size in forces}


def _most_coloured_channel(now: MaximumLikelihood) -> str:
    """The channel whose misses are correlated most over the next few samples, in squares."""
    whitened = now.predictions[0].whitened
    count = min(_NEXT, len(whitened) // 2)
    lags = [np.sum(whitened[k:] * whitened[:-k], axis=0) ** 2 for k in range(1, count + 1)]
    coloured = np.sum(lags, axis=0) / np.maximum(np.sum(whitened**2, axis=0), 1e-300) ** 2
    return now.prepared[0][0].compiled.traced.channels[int(np.argmax(coloured))]


def initial_drift_size(task: FilterInput, channel: str) -> float:
    """A sensor's drift to begin with: over the record a tenth of what it reads."""
    j, series = task.compiled.traced.channels.index(channel), task.series
    return 0.1 * float(np.std(series.y[:, j])) / float(np.sqrt(series.dt * series.samples))


def initial_gust_sizes(task: FilterInput, terms: Sequence[NoiseTerm]) -> Iterator[dict[str, float]]:
    """Initial sizes of correlated forces with their correlation time, a short and a long one."""
    for share in GUST_TIMES:
        sizes = {t.size: _GUST for t in terms}
        yield sizes | {t.time: initial_correlation_time(task, share) for t in terms}


def vibration_terms(now: MaximumLikelihood) -> Iterator[AdditionalNoise]:
    """A narrow-band noise term for each sensor whose innovations have a clear spectral line.

    At a frequency at which the machine moves, misses are of the model: only a line that is mostly
    missed is the sensor's own.
    """
    from scipy.signal import welch

    if now.noise.has_kind("vibration"):
        return
    task, part = now.prepared[0][0], now.predictions[0]
    length = int(min(_SEGMENT, task.series.samples // 4))
    if length < _SHORT:
        return
    for j, channel in enumerate(task.compiled.traced.channels):
        hertz, power = welch(part.whitened[:, j], 1 / task.series.dt, nperseg=length)
        inner = slice(2, len(power) - 1)
        top = 2 + int(np.argmax(power[inner]))
        if not power[top] > _STANDS_OUT * np.median(power[inner]):
            continue
        read = bridged(task.series.y[:, j], part.spreads[:, j] == 0)
        missed, shown = (
            welch(signal, 1 / task.series.dt, nperseg=length)[1][top]
            for signal in (part.misses[:, j], read)
        )
        if not missed >= _OWN_LINE * shown:
            continue
        term = NoiseTerm("vibration", channel)
        white = now.noise.values[f"white.{channel}"]
        size = max(white, size_limits(task, f"white.{channel}")[0])
        time = 1 / (2 * np.pi * float(hertz[top]))
        start = {term.size: size, term.time: time, term.damping: _NARROW}
        yield AdditionalNoise((term,), (start,))


def initial_correlation_time(task: FilterInput, share: float) -> float:
    """A correlation time to begin with, as a share of the record; three samples at least."""
    return max(share * task.series.dt * task.series.samples, 3 * task.series.dt)
