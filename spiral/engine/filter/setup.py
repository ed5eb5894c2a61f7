"""Converts the dimensionless options of an observer to the numbers of one filter run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from spiral.engine.filter.extended import FilterSettings, filter_record, tracked_indices
from spiral.engine.filter.extended import smooth_run as backward
from spiral.engine.filter.noise import (
    driven_states,
    noise_groups,
    noise_intensity,
    sampled_covariance,
)
from spiral.engine.filter.rounding import rounding_level
from spiral.engine.filter.task import FilterInput
from spiral.engine.filter.tuning import most_likely_levels
from spiral.engine.study import ORIGIN
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.record import Array

_TURNS = 8  # phase origins tried where the record's own is not known
_SEARCH = 2.0  # s of a record that the search looks at
_WORTH = 20.0  # log-likelihood by which another origin must win
_SEARCH_LEVEL = 0.3
_SHARE = 0.2  # first doubt of a tracked parameter, as a share of its value
_DRIFT = 0.05  # rad / sqrt(s): random walk of a phase that was integrated from speed
_WORTHLESS = 0.5  # log-likelihood that a process noise must be worth
_SHARES = (0.3, 0.1, 0.03, 0.0)  # of that drift, each tried after the one before

DRIFT = "drift"
"""Name of the share of a tracked phase's drift, beside the levels of the groups of states."""


def tracked_parameters(task: FilterInput, named: tuple[str, ...] | None) -> tuple[str, ...]:
    """Parameters estimated as states: those named, else the record's phase origin.

    It is a nuisance where something turns with the phase, unless it is uncertain by itself.

    Raises
    ------
    ConfigError : one that is uncertain as well.
    """
    uncertain = task.prior.keys if task.prior else ()
    if named is not None:
        for name in named:
            if name in uncertain:
                raise ConfigError(
                    f"{name} in track and in uncertain", "one of them", "observer.track=[]"
                )
        return named
    turning = any("phase" in e.inputs for e in task.model.effects)
    return tuple(k for k in task.keys if k == ORIGIN and turning and k not in uncertain)


def prepare_filter(
    task: FilterInput,
    track: tuple[str, ...] | None = None,
    doubt: Mapping[str, float] | None = None,
    spread: float = 1.0,
) -> tuple[FilterInput, FilterSettings]:
    """The input and settings without process noise; a tracked phase origin is searched for first.

    Parameters
    ----------
    track : parameters estimated as states; ``None`` takes the record's own.
    doubt : their first standard deviations by name. spread : of the states, as a share of theirs.

    Raises
    ------
    ConfigError : a name that is no parameter of the model, or that is not tracked.
    """
    tracked = tracked_parameters(task, track)
    tracked_indices(task, tracked)
    settings = FilterSettings(
        process=np.zeros((len(task.states), len(task.states))),
        noise=task.series.sigma**2,
        start=task.start,
        covariance=np.diag((spread * task.first_spread) ** 2),
        tracked=tracked,
        doubt=_initial_deviations(task, tracked, doubt or {}),
        wander=_drift_variances(task, tracked),
        volume=_log_volume_share(task),
    )
    angle = "system.phase_origin"
    if angle in tracked and angle not in (doubt or {}):
        task = _search_phase_origin(task, settings, angle)
    return task, settings


def with_level(
    task: FilterInput, settings: FilterSettings, levels: Mapping[str, float]
) -> FilterSettings:
    """The settings with process noise at these levels, and with that share of the drift."""
    process = sampled_covariance(task, noise_intensity(task, levels))
    drift = settings.wander * levels.get(DRIFT, 1.0) ** 2
    return replace(settings, process=process, wander=drift)


def choose_levels(
    task: FilterInput, settings: FilterSettings, given: Mapping[str, float] | float | None
) -> dict[str, float]:
    """The levels given, or the most likely ones.

    Raises
    ------
    ConfigError : a group of states that the model does not have, or a negative level.
    """
    known = tuple(noise_groups(task))
    if given is None:

        def likelihood(levels: Mapping[str, float]) -> tuple[float, int]:
            run = filter_record(task, with_level(task, settings, levels))
            return run.log_likelihood, run.done

        return zero_unneeded_levels(
            task, settings, most_likely_levels(known, task.series.samples, likelihood)
        )
    known = (*known, DRIFT) if np.any(settings.wander) else known
    levels = dict(given) if isinstance(given, Mapping) else dict.fromkeys(noise_groups(task), given)
    for name, value in levels.items():
        if name not in known and not driven_states(task, name):
            raise ConfigError(
                f"process_noise of {name!r}", f"one of {', '.join(known)}",
                did_you_mean(name, known),
            )  # fmt: skip
        if not value >= 0:
            raise ConfigError(f"process_noise of {name!r}: {value!r}", "a level, zero or above")
    return {k: float(v) for k, v in levels.items()}


def zero_unneeded_levels(
    task: FilterInput, settings: FilterSettings, levels: Mapping[str, float]
) -> dict[str, float]:
    """The levels, each zero where that is as likely; of a drift the smallest share that is.

    Zero means the level of the integration error (``spiral.engine.filter.rounding``).
    """

    def trial_likelihood(trial: Mapping[str, float]) -> float:
        run = filter_record(task, with_level(task, settings, trial))
        return run.log_likelihood if run.done == task.series.samples else -np.inf

    present, lowest = dict(levels), rounding_level(task)
    reached = trial_likelihood(present)
    trials = [dict.fromkeys(present, lowest), *({k: lowest} for k in present)]
    trials += [{DRIFT: share} for share in _SHARES] if np.any(settings.wander) else []
    for change in trials:
        trial = {**present, **change}
        if any(trial[k] != present.get(k) for k in trial):
            value = trial_likelihood(trial)
            if value > reached - _WORTHLESS:
                present, reached = trial, max(value, reached)
    return present


def smoothed_states(
    task: FilterInput,
    levels: Mapping[str, float] | None = None,
    track: tuple[str, ...] | None = None,
    doubt: Mapping[str, float] | None = None,
    spread: float = 1.0,
) -> Array:
    """Smoothed states and tracked parameters (samples, N); the process noise given or tuned.

    ``spread`` of the first states, as in ``prepare_filter``.
    """
    task, settings = prepare_filter(task, track, doubt, spread)
    levels = choose_levels(task, settings, levels)
    run = filter_record(task, with_level(task, settings, levels), keep=True)
    if run.done == task.series.samples:
        run = backward(run)
    return np.nan_to_num(run.means)


def _log_volume_share(task: FilterInput) -> float:
    """1/2 log(|P'| / |P|), P' the initial covariance where narrower than the machine's own P.

    A state that is known by itself, as where nothing tells where a machine is, counts in neither.
    """
    own = task.first_spread
    narrow = (own > 0) & (own < task.scales)
    return float(np.log(own[narrow] / task.scales[narrow]).sum())


def _initial_deviations(
    task: FilterInput, tracked: tuple[str, ...], given: Mapping[str, float]
) -> Array:
    """First standard deviation of tracked parameters: an eighth turn, or a fifth of the value."""
    for name in given:
        if name not in tracked:
            raise ConfigError(
                f"doubt of {name!r}", f"a tracked parameter: {', '.join(tracked) or 'none'}",
                f"observer.track=[{name}]",
            )  # fmt: skip
    known = dict(task.model.pairs)
    deviations = []
    for name in tracked:
        if name in given:
            deviations.append(given[name])
            continue
        value = abs(task.values[task.keys.index(name)])
        deviations.append(np.pi / _TURNS if known[name].unit == "rad" else _SHARE * value or 1.0)
    return np.array(deviations, dtype=float)


def _drift_variances(task: FilterInput, tracked: tuple[str, ...]) -> Array:
    """Variance per sample of a random walk: of a phase that was not measured, else zero."""
    measured = "phase" in task.series.record.measured
    drift = 0.0 if measured else _DRIFT**2 * task.series.dt
    return np.array([drift if name == "system.phase_origin" else 0.0 for name in tracked])


def _search_phase_origin(task: FilterInput, settings: FilterSettings, angle: str) -> FilterInput:
    """The task with its phase origin at the present value, or at the best of eight turns."""
    first = task.values[task.keys.index(angle)]
    samples = min(task.series.samples, max(64, round(_SEARCH / task.series.dt)))
    levels = dict.fromkeys(noise_groups(task), _SEARCH_LEVEL)
    noisy = with_level(task, settings, levels)
    best, highest = task, -np.inf
    for turn in range(_TURNS):
        trial = task.with_values({angle: first + 2 * np.pi * turn / _TURNS})
        run = filter_record(trial, noisy, samples=samples)
        score = run.log_likelihood if run.done == samples else -np.inf
        if score > highest + (_WORTH if turn else 0.0):
            best, highest = trial, score
    return best


prepared = prepare_filter
"""The former name of ``prepare_filter``, which users' observers may import."""
