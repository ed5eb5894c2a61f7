"""Tests of a fit's assumptions: drifting parameters, noise that grows, heavy tails; in words.

With e the whitened misses of a fit and X their slopes by parameters:

    a parameter drifts    e = X b + d (t x_j),    t from -1/2 to 1/2 over each record
    noise that grows      e ~ N(0, a + b h^2),    h a reading from its mean, or from zero, over
                                                  its deviation; or its rate of change (jitter)
    heavy tails           e ~ s t_nu,             Student's t with nu degrees of freedom
    a line                one frequency that holds a tenth of the power of e and stands out from
                          those around it, and holds little of any input's

They are reported where twice their gain in log-likelihood is above 20. A drift must also pass by
sums of the misses over blocks, and change its parameter by more than half a percent. The shape of
the noise is judged only where the misses are white, a line only where they are not.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import special

from spiral.engine.filter.noise import driven_states
from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.score import residual_block_samples
from spiral.engine.series import sample_inputs
from spiral.inference.disturbances import what_acts
from spiral.physics.passivity import implausible_signs
from spiral.types.formatting import duration, number, percent, plus_minus
from spiral.types.invalid import reading_step
from spiral.types.label import without_variant
from spiral.types.model import Model
from spiral.types.record import Array

_KNOWN = 3.0  # standard errors from zero from which a parameter is tested for drift
_TOLD = 20.0  # twice the gain in log-likelihood from which a departure is reported
_ALIKE = 9.2  # 2 log 100, of the same, under which two parameters are not told apart
_COUNTS = 0.005  # share of its value that a parameter drifts by
_RATIOS = np.geomspace(0.03, 100.0, 18)  # b / a of noise that grows
_TWO = 4.0  # twice log-likelihood by which noise that grows from zero, not from the mean, is told
_FAR = 10.0  # times a value given, or its inverse, from which a fitted one is far from it
_UNIT = 300.0  # the same, from which a unit may be off by its prefix
_ZERO = 2.0  # standard errors within which a value is not told from zero
_TAILS = np.array([2.1, 2.5, 3.0, 4.0, 6.0, 10.0, 20.0])  # degrees of freedom
_HALF = 0.5  # share of what is missed from which a converter's steps are told
_FEWEST = 64  # samples
_LINE = 0.1  # share of the power of what is missed that a line holds: what counts of an effect
_STANDS_OUT, _AROUND = 30.0, 20  # a line over the median of so many frequencies on either side
_UNDRIVEN = 0.05  # share of an input's power at a line, under which the line is not the input's
_PERIODS = 3  # of a line in a record, at least: slower ones are no line yet


def describe_departures(
    model: Model, estimate: MaximumLikelihood, white: bool, random: Iterable[str]
) -> tuple[str, ...]:
    """Sentences on how the records depart from a model's fit, remarks of its effects first.

    Parameters
    ----------
    white : whether its misses are. random : what acts at random, by name.
    """
    samples = sum(len(p.misses) for p in estimate.predictions)
    if not estimate.finite or samples < _FEWEST:
        return ()
    shapes = _noise_shape_remarks(estimate) if white else _line_remarks(estimate)
    return (
        *_effect_remarks(model, estimate),
        *_noise_weighting_remarks(estimate),
        *_converter_remarks(model, estimate),
        *_noisy_input_remark(estimate, random),
        *_drift_remark(estimate),
        *shapes,
    )


def far_value_sentences(estimate: MaximumLikelihood, given: Mapping[str, float]) -> tuple[str, ...]:
    """Sentences on values that ended more than ``_FAR`` times off those given.

    A fit that lacks something makes up for it with whatever is free: a mass of 1.5 kg became 5 g.
    A value that is not told from zero is no longer needed: the stiffness of a coupling that has
    play belongs to the clearance. Of one that may be as given nothing is said.
    """
    said = []
    for key in estimate.keys:
        value, first = estimate.values[key], given.get(key)
        doubt = _ZERO * estimate.errors.get(key, 0.0)
        if not first or max(abs(value), abs(value - first)) <= doubt:
            continue
        if abs(value) <= doubt:
            said.append(
                f"{without_variant(key)} is zero within its error, where {number(first)} was "
                "given: what else the model holds does its work"
            )
        elif not 1 / _FAR <= value / first <= _FAR:
            prefix = 1 / _UNIT > value / first > 0 or value / first > _UNIT
            unit = ", or a unit is, of it or of a channel" if prefix else ""
            said.append(
                f"{without_variant(key)} ended at {number(value)}, far from the {number(first)} "
                f"that it was given: it may make up for something, or that value is wrong{unit}"
            )
    return tuple(said)


def reversed_sign_sentences(model: Model, given: Mapping[str, float]) -> tuple[str, ...]:
    """Sentences on values that surely ended with the other sign than given, and push or feed.

    A damper that was given as one and feeds energy in makes up for something else; of a machine
    that feeds itself the user gives the sign (``physics.passivity``).
    """
    return tuple(
        f"{without_variant(key)} ended at {number(model.values[key])} where {number(given[key])} "
        f"was given: {said}"
        for key, said in implausible_signs(model).items()
        if given.get(key, 0.0) * model.values[key] < 0
    )


def _effect_remarks(model: Model, estimate: MaximumLikelihood) -> Iterator[str]:
    step, table = estimate.prepared[0][0].series.dt, model.estimates()
    for effect in model.effects:
        values = {k: v.estimate for k, v in table.get(effect.label, {}).items()}
        if values and (said := effect.remark(values, step)):
            yield f"{effect.label}: {said}"


def _noisy_input_remark(estimate: MaximumLikelihood, random: Iterable[str]) -> tuple[str, ...]:
    """A sentence naming inputs whose noise would act on the machine like its random force."""
    task = estimate.prepared[0][0]
    traced = task.compiled.traced
    pushed = [
        driven_states(task, w) for k, _, w in (r.partition(".") for r in random) if k == "force"
    ]
    symbols = {s for rows in pushed for i in rows for s in traced.rate[i].free_symbols}
    given = {i.name for i in task.model.system.inputs}
    columns = zip(traced.inputs, traced.u, strict=True)
    names = [n for n, u in columns if u in symbols and n in given]
    if not names:
        return ()
    many = "inputs" if len(names) > 1 else "input"
    acting = what_acts(task.model)
    return (f"noise in the measured {many} {', '.join(names)} would look like a random {acting}",)


def drifting_parameters(estimate: MaximumLikelihood) -> dict[str, float]:
    """Change over the record, as a share of their values, of parameters that clearly drift."""
    drifts = _clear_drifts(estimate)
    return {k: d.change / abs(estimate.values[k]) for k, d in drifts.items()}


def _clear_drifts(estimate: MaximumLikelihood) -> dict[str, _Drift]:
    """Parameters whose drift is told from none, and counts beside their values."""
    parts, keys, values = estimate.predictions, estimate.keys, estimate.values
    if not keys:
        return {}
    x = np.concatenate([p.columns.reshape(-1, len(keys)) for p in parts])
    e = np.concatenate([p.whitened.ravel() for p in parts])
    if not np.all(np.isfinite(x)):
        return {}
    m = parts[0].misses.shape[1]
    times = [np.repeat(np.linspace(-0.5, 0.5, len(p.misses)), m) for p in parts]
    t, width = np.concatenate(times), residual_block_samples(tuple(p.whitened for p in parts)) * m
    slopes, inverse = t[:, None] * x, least_squares(x, e).inverse
    beyond = slopes - x @ (inverse @ (inverse.T @ (x.T @ slopes)))
    errors = estimate.errors
    drifts = {k: _estimate_drift(e, slopes[:, j], beyond[:, j], width)
             for j, k in enumerate(keys) if abs(values[k]) > _KNOWN * errors[k]}  # fmt: skip
    return {k: d for k, d in drifts.items()
            if d.ratio**2 > _TOLD and abs(d.change) > _COUNTS * abs(values[k])}  # fmt: skip


def _drift_remark(estimate: MaximumLikelihood) -> tuple[str, ...]:
    """A sentence on the parameter that drifts most clearly, and those that look alike."""
    told, values = _clear_drifts(estimate), estimate.values
    if not told:
        return ()
    best = max(told, key=lambda k: told[k].gain)
    alike = [k for k in told if k != best and told[k].gain > told[best].gain - _ALIKE]
    change, ratio = told[best].change, told[best].ratio
    share, error = change / abs(values[best]), change / abs(values[best]) / abs(ratio)
    beside = f" (or {', '.join(map(without_variant, alike))})" if alike else ""
    much = abs(share) > 1  # a zero that wanders, say: its value is no measure of how far
    size = (
        "more than itself"
        if much
        else f"{'+' * (share > 0)}{plus_minus(100 * share, 100 * abs(error))} %"
    )
    return (
        f"as if {without_variant(best)}{beside} changed by {size} over the record: with time, "
        "or with something else that changes, such as temperature, wear, speed or amplitude",
    )


@dataclass(frozen=True)
class _Drift:
    """Change of a parameter over a record, twice its gain, and change over its error by blocks."""

    change: float
    gain: float = 0.0
    ratio: float = 0.0


def _estimate_drift(e: Array, column: Array, beyond: Array, width: int) -> _Drift:
    """The drift with slopes ``column``: change = b.e / b.b, where b is ``beyond``.

    ``beyond`` is what constant parameters cannot explain of ``column``; blocks have ``width`` rows.
    """
    energy = float(beyond @ beyond)
    if energy <= 1e-9 * float(column @ column):
        return _Drift(0.0)
    change = float(beyond @ e) / energy
    left = beyond * (e - change * beyond)
    sums = np.add.reduceat(left, np.arange(0, len(left), width))
    spread = float(np.sqrt(np.sum(sums**2)))
    ratio = change * energy / spread if spread > 0 else 0.0
    return _Drift(change, change**2 * energy, ratio)


def _noise_shape_remarks(estimate: MaximumLikelihood) -> tuple[str, ...]:
    """Sentences on channels whose noise grows with reading or speed, or has heavy tails.

    Growth is not told of a channel that the fit weights by it (``_noise_weighting_remarks``).
    """
    channels = estimate.prepared[0][0].compiled.traced.channels
    weighted = _weighted_channels(estimate)
    told = []
    for j, name in enumerate(channels):
        e, h, mean = _channel_innovations(estimate, j)
        if len(e) < _FEWEST:
            continue
        growth, from_zero, tails = (
            _noise_growth_gain(e, h),
            _noise_growth_gain(e, h + mean, True),
            _heavy_tail_gain(e),
        )
        if from_zero[0] > growth[0] + _TWO:
            growth = from_zero
        speed, seconds = _clock_jitter_gain(estimate, j)
        if max(growth[0], tails[0], speed) <= _TOLD:
            continue
        if speed > max(growth[0], tails[0]) + _TWO:
            told.append(
                f"the noise of sensor {name} grows with how fast its reading changes, as where its "
                f"clock is off by {number(seconds, 2)} s (rms) from sample to sample (jitter)"
            )
        elif growth[0] > tails[0] and j not in weighted:
            told.append(
                f"the noise of sensor {name} grows with {_describe_noise_growth(growth, h + mean)}"
            )
        elif tails[0] > _TOLD:
            told.append(
                f"the noise of sensor {name} has heavy tails (outliers), like Student's t with "
                f"{number(tails[1], 2)} degrees of freedom: {_outlier_share(e)} are more than 4 "
                "standard deviations off"
            )
    return tuple(told)


def _describe_noise_growth(growth: tuple[float, float, bool], h: Array) -> str:
    """How noise grows, in words; ``h`` are the readings from zero, over their deviation."""
    _, ratio, from_zero = growth
    if not from_zero:
        times = number(float(np.sqrt(1 + 4 * ratio)), 2)
        return (
            "the amplitude of its reading: two standard deviations from the mean it is "
            f"{times} times as large as there"
        )
    low, high = np.sort(np.abs(np.quantile(h, (0.05, 0.95))))
    times = number(float(np.sqrt((1 + ratio * high**2) / (1 + ratio * low**2))), 2)
    return f"its reading, {times}-fold over the middle 90 % of its values"


def _noise_weighting_remarks(estimate: MaximumLikelihood) -> Iterator[str]:
    """Sentences on noise that grows with its reading, where the fit is weighted accordingly."""
    task = estimate.prepared[0][0]
    if (grown := task.series.grown) is None:
        return
    names = task.compiled.traced.channels
    levels = [(j, {t.series.loudness[j] for t, _ in estimate.prepared}) for j in range(len(names))]
    for j in (j for j, known in levels if len(known) > 1):
        sizes = [_white_noise(estimate, r, j) for r in range(len(estimate.prepared))]
        unit = task.model.system.unit_of(names[j])
        yield (
            f"the noise of sensor {names[j]} differs between the records "
            f"({', '.join(number(x, 3) for x in sizes)} {unit}), and each is weighted by its own"
        )
    for j in _weighted_channels(estimate):
        low, high = np.quantile(np.sqrt(grown[:, j]), (0.05, 0.95))
        yield (
            f"the noise of sensor {names[j]} grows with its reading, "
            f"{number(float(high / low), 2)}-fold over the middle 90 % of its values, and the fit "
            "weights its readings accordingly"
        )


def _white_noise(estimate: MaximumLikelihood, record: int, channel: int) -> float:
    """Standard deviation of a sensor's white noise in one record."""
    task = estimate.prepared[record][0]
    name = task.compiled.traced.channels[channel]
    return float(estimate.noise.values[f"white.{name}"] * np.sqrt(task.series.loudness[channel]))


def _weighted_channels(estimate: MaximumLikelihood) -> tuple[int, ...]:
    """Channels whose readings the fit weights by noise that grows with them."""
    series = estimate.prepared[0][0].series
    return () if series.grown is None else tuple(j for j, g in enumerate(series.growth) if g)


def _line_remarks(estimate: MaximumLikelihood) -> tuple[str, ...]:
    """A sentence for each channel of whose misses one frequency holds ``_LINE`` of the power.

    A periodic disturbance that nobody recorded (a day, a neighbouring machine), or a resonance with
    little damping that the model lacks; not what an input has at that frequency.
    """
    r = int(np.argmax([task.series.samples for task, _ in estimate.prepared]))
    task, part = estimate.prepared[r][0], estimate.predictions[r]
    given = _power_shares(sample_inputs(task.inputs, task.series.substeps))
    missed = _power_shares(part.whitened)
    said = []
    for j, channel in enumerate(task.compiled.traced.channels):
        shares = np.convolve(missed[:, j], np.ones(5), "same")  # of a line between two frequencies
        top = int(np.argmax(missed[:, j]))
        below = missed[max(top - _AROUND, _PERIODS) : max(top - 2, 0), j]
        above = missed[top + 3 : top + _AROUND, j]
        driven = given[max(top - 1, 0) : top + 2].sum(axis=0)
        stands_out = all(
            len(side) > 2 and missed[top, j] > _STANDS_OUT * np.median(side)
            for side in (below, above)
        )
        if not stands_out or shares[top] < _LINE or np.any(driven > _UNDRIVEN):
            continue
        hertz = top / (task.series.dt * len(part.whitened))
        said.append(
            f"{percent(shares[top])} of what is missed of {channel} is one line at "
            f"{number(hertz, 3)} Hz (a period of {duration(1 / hertz, 3)}) that no input has: a "
            "periodic disturbance, or a resonance that the model lacks"
        )
    return tuple(said)


def _power_shares(series: Array) -> Array:
    """(frequencies, columns) share of each column's power at every frequency; slow ones at zero."""
    level = series - series.mean(axis=0)
    power = np.abs(np.fft.rfft(level * np.hanning(len(level))[:, None], axis=0)) ** 2
    power[:_PERIODS] = 0.0
    return power / np.maximum(power.sum(axis=0), np.finfo(float).tiny)


def _converter_remarks(model: Model, estimate: MaximumLikelihood) -> Iterator[str]:
    """Sentences on sensors whose converter makes half of the variance that predictions miss.

    A step q makes an error of variance q^2 / 12, white where the motion passes many steps.
    """
    both = list(zip(estimate.prepared, estimate.predictions, strict=True))
    for j, name in enumerate(both[0][0][0].compiled.traced.channels):
        readings = np.concatenate([t.series.y[p.spreads[:, j] > 0, j] for (t, _), p in both])
        missed = np.concatenate([p.misses[p.spreads[:, j] > 0, j] for _, p in both])
        step = reading_step(readings) if len(readings) else 0.0
        if step and step**2 / 12 > _HALF * np.mean(missed**2):
            share = percent(step / float(np.std(readings)))
            unit = model.system.unit_of(name)
            yield (
                f"sensor {name} reads in steps of {number(step)} {unit} ({share} of its "
                "motion): its resolution (quantisation) makes most of its noise"
            )


def noise_growth_by_channel(estimate: MaximumLikelihood) -> dict[str, tuple[float, float, float]]:
    """c, h, m by channel whose noise variance grows by (1 + ((y - c) / h)^2) / m."""
    by_channel: dict[str, tuple[float, float, float]] = {}
    samples = sum(len(p.misses) for p in estimate.predictions)
    if not estimate.finite or samples < _FEWEST:
        return by_channel
    for j, name in enumerate(estimate.prepared[0][0].compiled.traced.channels):
        e, h, mean = _channel_innovations(estimate, j)
        centred, from_zero, tails = (
            _noise_growth_gain(e, h),
            _noise_growth_gain(e, h + mean, True),
            _heavy_tail_gain(e),
        )
        best = from_zero if from_zero[0] > centred[0] + _TWO else centred
        if len(e) < _FEWEST or best[0] <= max(_TOLD, tails[0]):
            continue
        series = estimate.prepared[0][0].series
        spread, size = float(series.y[:, j].std()), float(np.sqrt(best[1]))
        offset = mean if best[2] else 0.0
        centre = 0.0 if best[2] else float(series.y[:, j].mean())
        share = float(np.mean(1 + ((h + offset) * size) ** 2))
        by_channel[name] = (centre, spread / size, share)
    return by_channel


def _outlier_share(e: Array) -> str:
    return f"{percent(float(np.mean(np.abs(e) > 4 * e.std())))} of its readings"


def _channel_innovations(estimate: MaximumLikelihood, j: int) -> tuple[Array, Array, float]:
    """Misses of a channel, its predictions from their mean over their deviation, and that mean."""
    misses, readings, means = [], [], []
    for (task, _), part in zip(estimate.prepared, estimate.predictions, strict=True):
        seen = part.spreads[:, j] > 0
        reading = task.series.y[seen, j] - part.misses[seen, j]
        spread = float(reading.std()) if seen.any() else 0.0
        misses.append(part.whitened[seen, j])
        readings.append((reading - reading.mean()) / spread if spread > 0 else 0.0 * reading)
        means.append(float(reading.mean()) / spread if spread > 0 else 0.0)
    return np.concatenate(misses), np.concatenate(readings), float(np.mean(means))


def _noise_growth_gain(e: Array, h: Array, from_zero: bool = False) -> tuple[float, float, bool]:
    """Twice the gain of a variance a (1 + r h^2) over a constant one; r; ``from_zero``."""
    still = len(e) * np.log(np.mean(e**2))
    gains = [still - _deviance(e, 1 + r * h**2) for r in _RATIOS]
    best = int(np.argmax(gains))
    return float(gains[best]), float(_RATIOS[best]), from_zero


def _clock_jitter_gain(estimate: MaximumLikelihood, j: int) -> tuple[float, float]:
    """Twice the gain of a variance s + (tau dy/dt)^2 over a constant one, and tau in s.

    dy/dt is the change of what was predicted since the sample before, which is independent of what
    is missed at this one: what is predicted after it follows what was read.
    """
    misses, rates, spread = [], [], []
    for (task, _), part in zip(estimate.prepared, estimate.predictions, strict=True):
        seen = part.spreads[:, j] > 0
        at = np.flatnonzero(seen)
        if len(at) < _FEWEST:
            continue
        expected = task.series.y[at, j] - part.misses[at, j]
        rates.append(np.diff(expected) / np.diff(at * task.series.dt))
        misses.append(part.whitened[at[1:], j])
        spread.append(part.spreads[at[1:], j])
    size = float(np.sqrt(np.mean(np.concatenate(rates) ** 2))) if rates else 0.0
    if not 0 < size < np.inf:
        return 0.0, 0.0
    e, v = np.concatenate(misses), np.concatenate(rates) / size
    gain, ratio, _ = _noise_growth_gain(e, v, True)
    least = np.mean(e**2 / (1 + ratio * v**2)) * np.median(np.concatenate(spread))
    return gain, float(np.sqrt(ratio * least)) / size


def _deviance(e: Array, variance: Array) -> float:
    """-2 log L of N(0, a v), a the most likely, up to a constant."""
    return float(len(e) * np.log(np.mean(e**2 / variance)) + np.sum(np.log(variance)))


def _heavy_tail_gain(e: Array) -> tuple[float, float]:
    """Twice the gain of Student's t over the normal distribution, and its degrees of freedom."""
    normal = -0.5 * len(e) * (np.log(2 * np.pi * np.mean(e**2)) + 1)
    gains = [2 * (_student_log_likelihood(e, float(nu)) - normal) for nu in _TAILS]
    best = int(np.argmax(gains))
    return float(gains[best]), float(_TAILS[best])


def _student_log_likelihood(e: Array, nu: float) -> float:
    """log L of s t_nu, s the most likely (by expectation and maximisation)."""
    square = float(np.median(e**2)) or 1.0
    for _ in range(30):
        square = float(np.mean((nu + 1) / (nu + e**2 / square) * e**2))
    constant = special.gammaln((nu + 1) / 2) - special.gammaln(nu / 2)
    constant -= 0.5 * np.log(np.pi * nu * square)
    return float(len(e) * constant - 0.5 * (nu + 1) * np.sum(np.log1p(e**2 / (nu * square))))
