"""Where records begin, and within what a filter looks for it.

A filter is linear about its own mean. Where the machine is not linear and nothing is known of a
hidden state, what the first readings say of it is read with the wrong slopes, and the mean is
thrown to where the record never was: it takes time to come back, and the likelihood has paid for
it. So the first state is looked for as a parameter of every record, by a Kalman smoother that
begins each time where the last one ended, with steps that its first doubt keeps short
(Levenberg and Marquardt; Sarkka and Svensson 2020), and the filter then begins there within a
multiple c of what the record leaves open of it:

    p(y) ~ |P'|^(1/2) / |P|^(1/2) int N(x0; x*, P') p(y | x0) dx0,    P' = c^2 diag(P*),

P the spread of the machine's motion, P* the smoothed covariance (Laplace's approximation). For a
linear machine both sides are equal; else the larger is nearer to the truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.extended import filtered
from spiral.engine.filter.extended import smoothed as backward
from spiral.engine.filter.setup import chosen_levels, smoothed, with_level
from spiral.engine.filter.setup import prepared as filter_prepared
from spiral.engine.filter.task import Task, begun_within
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import Masks, all_predicted, log_likelihood, predicted
from spiral.engine.series import Series
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.horizons import doubts
from spiral.inference.likelihood.fitting import (
    WORTH,
    LikelihoodFit,
    explains,
    force_levels,
    refitted,
    subjects,
)
from spiral.types.record import Array

_FAR = 30.0  # times its motion that a hidden state may lie from where it is first looked for
_AGAIN = 12  # times that beginnings are looked for
_HEAD = 2048  # samples that tell where a record begins
_SHORTER = (1.0, 0.1, 0.01)  # of the machine's motion, how far one step of the search may lead
_SAME = 0.5  # log-likelihood that is no difference
_TIMES = (100.0, 10.0)  # what a record leaves open of its beginning, that the filter begins with


@dataclass(frozen=True)
class Beginning:
    """The mean (n,) and spread (n,) of a first state; ``height`` the likelihood of the head."""

    start: Array
    spread: Array
    height: float


def restarted(assembly: Assembly, found: LikelihoodFit) -> LikelihoodFit:
    """The fit again with each record begun where all of it says.

    A hidden state far from the mean that it was first given (zero) would cost likelihood until the
    record has told it, and a filter of a machine that is not linear is misled by it for longer.
    Where the model then does not explain the records, a hidden state may lie much further off than
    the motion of what is measured suggests (those who may still fall ill, beside those who are):
    beginnings are looked for that far, and the fit taken on from there, while that pays.
    """
    found = begun_closely(assembly, found)
    for _ in range(_AGAIN):
        better = _begun_again(assembly, found, 1.0)
        if better is found:
            break
        found = better
    if explains(found):
        return found
    stretch = 1.0
    for _ in range(_AGAIN):
        better = _begun_again(assembly, found, _FAR, stretch)
        if better.height > found.height + WORTH:
            found, stretch = better, 2 * stretch
        elif stretch == 1.0:
            break
        else:
            stretch = 1.0
    return found


def _begun_again(
    assembly: Assembly, found: LikelihoodFit, spread: float, stretch: float = 1.0
) -> LikelihoodFit:
    """The fit from where the records say they begin, if that is more likely.

    Within the doubt that a filter of a linear machine begins with it changes next to nothing.
    """
    at = found.estimate
    if not at.finite:
        return found
    state, far = _beginnings(found, spread, stretch)
    if not far:
        trial = all_predicted([(subjects(assembly, state, at.prepared), at.noise)])[0]
        if not log_likelihood(trial) > found.height + WORTH:
            return found
    again = refitted(assembly, state, rough=True, kept=at.kept)
    return again if again.height > found.height else found


def _beginnings(found: LikelihoodFit, spread: float, stretch: float) -> tuple[FitState, bool]:
    """The fit's state with every record begun where it says, of first states that lie so far off.

    And whether that is beyond the doubt that the filter has of a state. What it follows (a phase's
    origin) begins where the record has it as well: a filter that is linear about a first guess far
    off misses the first samples, and an effect that is not there may make up for these.

    Along a valley where a parameter makes up for a beginning the smoother goes in small steps,
    which are ``stretch`` times as long here.
    """
    starts, far, values = [], False, found.state.values.copy()
    for row, (task, settings) in zip(values, found.estimate.prepared, strict=True):
        head = head_of(task)
        levels, n = force_levels(found.estimate.noise), len(task.states)
        known = doubts(settings.tracked)
        first = smoothed(head, levels, settings.tracked, known, spread)[0]
        doubt = task.scales
        far = far or bool(np.any(np.abs(first[:n] - settings.start) > doubt))
        starts.append(settings.start + stretch * (first[:n] - settings.start))
        row[[task.keys.index(k) for k in settings.tracked]] = first[n:]
    return replace(found.state, starts=tuple(starts), values=values), far


def begun_closely(
    assembly: Assembly, found: LikelihoodFit, masks: Masks = None, steps: int = 40
) -> LikelihoodFit:
    """The fit with filters that begin near the first states, where that is more likely.

    ``masks`` and ``steps`` as in ``refitted``.
    """
    at = found.estimate
    if not at.finite or any(settings.tracked for _, settings in at.prepared):
        return found
    begun = [closest(task, at.noise) for task, _ in at.prepared]
    if all(b.start is task.start for b, (task, _) in zip(begun, at.prepared, strict=True)):
        return found
    starts, spreads = tuple(b.start for b in begun), tuple(b.spread for b in begun)
    state = replace(found.state, starts=starts, spreads=spreads)
    trial = all_predicted([(subjects(assembly, state, at.prepared), at.noise)])[0]
    if not log_likelihood(trial, masks) > found.height + WORTH:
        return found
    again = refitted(assembly, state, at.noise, masks, steps, rough=True, like=at.prepared)
    return again if again.height > found.height else found


def closest(task: Task, noise: NoiseModel) -> Beginning:
    """Where the record of a task most likely begins, and within what a filter should begin.

    Where the first step of the search changes nothing the machine is as good as linear, and the
    task's own beginning stands.
    """
    head = head_of(task)
    begun = best = replace(_at(head, noise, task.start, task.spread), start=task.start)
    first = next(_tried(head, noise, best.start, _SHORTER[:1]), None)
    if first is not None and abs(first.height - best.height) < _SAME:
        return begun
    for _ in range(_AGAIN):
        tried = _tried(head, noise, best.start, _SHORTER)
        better = max(tried, key=lambda b: b.height, default=best)
        if not better.height > best.height + _SAME:
            break
        best = better
    return best


def begun_near(task: Task, noise: NoiseModel) -> Task:
    """The task with its beginning where its record most likely has it (``closest``)."""
    begun = closest(task, noise)
    return begun_within(replace(task, start=begun.start), begun.spread)


def _tried(
    head: Task, noise: NoiseModel, start: Array, shares: Sequence[float]
) -> Iterator[Beginning]:
    """Beginnings one step of the search from ``start``."""
    levels = force_levels(noise)
    for share in shares:
        task, settings = filter_prepared(
            begun_within(replace(head, start=start), None), (), {}, share
        )
        found = filtered(
            task, with_level(task, settings, chosen_levels(task, settings, levels)), keep=True
        )
        if found.done < task.series.samples:
            continue
        found, n = backward(found), len(task.states)
        mean, variances = found.means[0, :n], found.variances[0, :n]
        if np.all(np.isfinite(mean)) and np.all(variances > 0):
            yield from (_at(head, noise, mean, t * np.sqrt(variances)) for t in _TIMES)


def _at(head: Task, noise: NoiseModel, start: Array, spread: Array) -> Beginning:
    """A beginning, no wider than the machine's own, with its likelihood."""
    task = begun_within(replace(head, start=start.copy()), spread)
    parts = predicted(*filter_prepared(task, (), {}), noise)
    return Beginning(task.start, task.spread, log_likelihood((parts,)))


def head_of(task: Task) -> Task:
    """The first samples of a task's record, within the machine's own spread."""
    inputs = _head_inputs(task)
    return begun_within(replace(task, series=_head(task.series), inputs=inputs), None)


def _head(series: Series) -> Series:
    samples = min(series.samples, _HEAD)
    seen = None if series.seen is None else series.seen[:samples]
    return replace(series, y=np.ascontiguousarray(series.y[:samples]), seen=seen)


def _head_inputs(task: Task) -> Array:
    samples = min(task.series.samples, _HEAD)
    return np.ascontiguousarray(task.inputs[: (samples - 1) * 2 * task.series.substeps + 1])
