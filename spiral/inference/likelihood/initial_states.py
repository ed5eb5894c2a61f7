"""Initial states of the records, and the spread that a filter starts with around them.

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

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.filter.extended import filter_record
from spiral.engine.filter.extended import smooth_run as backward
from spiral.engine.filter.setup import choose_levels, smoothed_states, with_level
from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import FilterInput, with_start_spread
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import Masks, log_likelihood, predict_cases, predict_readings
from spiral.engine.series import Series
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.horizons import tracked_deviations
from spiral.inference.likelihood.fitting import (
    WORTH,
    LikelihoodFit,
    fit_by_likelihood,
    force_levels,
    is_random_force_small,
    prepare_filter_tasks,
)
from spiral.types.record import Array

_FAR = 30.0  # spreads of its motion by which a hidden state may be off its first guess
_AGAIN = 12  # searches for initial states, at most
_HEAD = 2048  # samples at the head of a record from which its initial state is estimated
_SHORTER = (1.0, 0.1, 0.01)  # of the machine's motion, how far one step of the search may lead
_SAME = 0.5  # log-likelihood that is no difference
_TIMES = (100.0, 10.0)  # c: initial spread of the filter over the smoothed deviation


@dataclass(frozen=True)
class InitialState:
    """Mean (n,) and spread (n,) of an initial state; log-likelihood of the first samples.

    ``deviations`` (n,) that these leave of it, where a smoother has told it.
    """

    start: Array
    spread: Array
    log_likelihood: float
    deviations: Array = field(default_factory=lambda: np.zeros(0))


def refit_initial_states(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit again from initial states that are smoothed over the head of each record.

    A hidden state far from the mean that it was first given (zero) would cost likelihood until the
    record has told it, and a filter of a machine that is not linear is misled by it for longer.
    Where the model then does not explain the records, a hidden state may lie much further off than
    the motion of what is measured suggests (those who may still fall ill, beside those who are):
    beginnings are looked for that far, and the fit taken on from there, while that pays.
    """
    fit = narrow_initial_states(assembly, fit)
    for _ in range(_AGAIN):
        better = _refit_from_smoothed_states(assembly, fit, 1.0)
        if better is fit:
            break
        fit = better
    if is_random_force_small(fit):
        return fit
    stretch = 1.0
    for _ in range(_AGAIN):
        better = _refit_from_smoothed_states(assembly, fit, _FAR, stretch)
        if better.log_likelihood > fit.log_likelihood + WORTH:
            fit, stretch = better, 2 * stretch
        elif stretch == 1.0:
            break
        else:
            stretch = 1.0
    return fit


def far_initial_states(assembly: Assembly, state: FitState, noise: NoiseModel) -> FitState | None:
    """The state with hidden states smoothed from a wide doubt, at its values; nothing if no better.

    A hidden state that only adds up what flows in (a charge, a store) may begin anywhere. Once
    values have moved to make up for where it was taken to begin, another slow state does its work,
    and the smoother does not tell them apart any more: so it is looked for before they move.
    """
    fit = fit_by_likelihood(assembly, state, noise, steps=0)
    if not fit.estimate.finite:
        return None
    begun = fit
    for _ in range(_AGAIN):
        there, _ = _smoothed_initial_states(fit, _FAR, 1.0)
        again = fit_by_likelihood(assembly, there, noise, steps=0, like=begun.estimate.prepared)
        if not again.log_likelihood > fit.log_likelihood + WORTH:
            break
        fit = again
    return None if fit is begun else fit.state


def _refit_from_smoothed_states(
    assembly: Assembly, fit: LikelihoodFit, spread: float, stretch: float = 1.0
) -> LikelihoodFit:
    """The fit from smoothed initial states, if that is more likely.

    Where these lie within the filter's first spread a refit is tried only if they alone are
    likelier: for a linear machine they change next to nothing.
    """
    at = fit.estimate
    if not at.finite:
        return fit
    state, far = _smoothed_initial_states(fit, spread, stretch)
    if not far:
        trial = predict_cases([(prepare_filter_tasks(assembly, state, at.prepared), at.noise)])[0]
        if not log_likelihood(trial) > fit.log_likelihood + WORTH:
            return fit
    again = fit_by_likelihood(assembly, state, rough=True, kept=at.kept)
    return again if again.log_likelihood > fit.log_likelihood else fit


def _smoothed_initial_states(
    fit: LikelihoodFit, spread: float, stretch: float
) -> tuple[FitState, bool]:
    """The fit's state with smoothed initial states, and whether one lies beyond its first spread.

    ``spread`` widens the doubt that the smoother starts with. Tracked parameters (a phase's
    origin) start where the record has them as well: a filter that is linear about a first guess
    far off misses the first samples, and an effect that is not there may make up for these.

    Along a valley where a parameter makes up for a beginning the smoother goes in small steps,
    which are ``stretch`` times as long here.
    """
    starts, far, values = [], False, fit.state.values.copy()
    for row, (task, settings) in zip(values, fit.estimate.prepared, strict=True):
        head = head_task(task)
        levels, n = force_levels(fit.estimate.noise), len(task.states)
        known = tracked_deviations(settings.tracked)
        first = smoothed_states(head, levels, settings.tracked, known, spread)[0]
        doubt = task.scales
        far = far or bool(np.any(np.abs(first[:n] - settings.start) > doubt))
        starts.append(settings.start + stretch * (first[:n] - settings.start))
        row[[task.keys.index(k) for k in settings.tracked]] = first[n:]
    return replace(fit.state, starts=tuple(starts), values=values), far


def narrow_initial_states(
    assembly: Assembly, fit: LikelihoodFit, masks: Masks = None, steps: int = 40
) -> LikelihoodFit:
    """The fit with filters that start close to the most likely initial states, if it is likelier.

    ``masks`` and ``steps`` as in ``fit_by_likelihood``.
    """
    at = fit.estimate
    if not at.finite or any(settings.tracked for _, settings in at.prepared):
        return fit
    begun = [likely_initial_state(task, at.noise) for task, _ in at.prepared]
    if all(b.start is task.start for b, (task, _) in zip(begun, at.prepared, strict=True)):
        return fit
    starts, spreads = tuple(b.start for b in begun), tuple(b.spread for b in begun)
    state = replace(fit.state, starts=starts, spreads=spreads)
    trial = predict_cases([(prepare_filter_tasks(assembly, state, at.prepared), at.noise)])[0]
    if not log_likelihood(trial, masks) > fit.log_likelihood + WORTH:
        return fit
    again = fit_by_likelihood(assembly, state, at.noise, masks, steps, rough=True, like=at.prepared)
    return again if again.log_likelihood > fit.log_likelihood else fit


def likely_initial_state(task: FilterInput, noise: NoiseModel) -> InitialState:
    """The most likely initial state of a task's record, with the spread that a filter starts with.

    Where the first step of the search changes nothing the machine is as good as linear, and the
    task's own beginning stands.
    """
    head = head_task(task)
    begun = best = replace(
        _evaluate_initial_state(head, noise, task.start, task.spread), start=task.start
    )
    for _ in range(_AGAIN):
        better = _likelier_initial_state(head, noise, best, first=best is begun)
        if better is None:
            break
        best = better
    return best


def _likelier_initial_state(
    head: FilterInput, noise: NoiseModel, best: InitialState, first: bool
) -> InitialState | None:
    """The initial state of the longest step that is likelier than ``best``; nothing without one.

    No shorter steps are tried where a whole one stays within the deviation that the record leaves
    (the maximum is there), or changes nothing at the ``first`` (the machine is as good as linear).
    """
    for share in _SHORTER:
        whole = share == _SHORTER[0]
        trials = _initial_state_trials(head, noise, best.start, share)
        trial = next(trials, None)
        if trial is None:
            continue
        if first and whole and abs(trial.log_likelihood - best.log_likelihood) < _SAME:
            return None
        trial = max([trial, *trials], key=lambda b: b.log_likelihood)
        if trial.log_likelihood > best.log_likelihood + _SAME:
            return trial
        if whole and np.all(np.abs(trial.start - best.start) < trial.deviations):
            return None
    return None


def set_likely_initial_state(task: FilterInput, noise: NoiseModel) -> FilterInput:
    """The task with the initial state and spread of ``likely_initial_state``."""
    begun = likely_initial_state(task, noise)
    return with_start_spread(replace(task, start=begun.start), begun.spread)


def _initial_state_trials(
    head: FilterInput, noise: NoiseModel, start: Array, share: float
) -> Iterator[InitialState]:
    """Initial states one step of the search (Levenberg and Marquardt) away from ``start``."""
    task, settings = filter_prepared(
        with_start_spread(replace(head, start=start), None), (), {}, share
    )
    levels = choose_levels(task, settings, force_levels(noise))
    filter_pass = filter_record(task, with_level(task, settings, levels), keep=True)
    if filter_pass.done < task.series.samples:
        return
    filter_pass, n = backward(filter_pass), len(task.states)
    mean, variances = filter_pass.means[0, :n], filter_pass.variances[0, :n]
    if np.all(np.isfinite(mean)) and np.all(variances > 0):
        deviations = np.sqrt(variances)
        for times in _TIMES:
            one = _evaluate_initial_state(head, noise, mean, times * deviations)
            yield replace(one, deviations=deviations)


def _evaluate_initial_state(
    head: FilterInput, noise: NoiseModel, start: Array, spread: Array
) -> InitialState:
    """An initial state, its spread at most the machine's own, with the head's log-likelihood."""
    task = with_start_spread(replace(head, start=start.copy()), spread)
    parts = predict_readings(*filter_prepared(task, (), {}), noise)
    return InitialState(task.start, task.spread, log_likelihood((parts,)))


def head_task(task: FilterInput) -> FilterInput:
    """The task over the first samples of its record, with the machine's own initial spread."""
    inputs = _head_inputs(task)
    return with_start_spread(replace(task, series=_head_series(task.series), inputs=inputs), None)


def _head_series(series: Series) -> Series:
    samples = min(series.samples, _HEAD)
    seen = None if series.seen is None else series.seen[:samples]
    return replace(series, y=np.ascontiguousarray(series.y[:samples]), seen=seen)


def _head_inputs(task: FilterInput) -> Array:
    samples = min(task.series.samples, _HEAD)
    return np.ascontiguousarray(task.inputs[: (samples - 1) * 3 * task.series.substeps + 1])
