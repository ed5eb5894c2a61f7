"""Fits of ``strategy=innovation`` and ``estimate``: parameters by the innovations' likelihood.

The process noise is tuned beside them.

    log L = -1/2 sum_k (log det S_k + v_k^T S_k^-1 v_k + channels log 2 pi)

climbs by scoring steps (``spiral.engine.filter.whitened``), halved until it rises; between runs of
steps the levels of the process noise are tuned. A model that lacks something needs much process
noise, and with it the filter follows the record however wrong the model is: as the parameters find
their values the noise falls, and the innovations judge ever longer predictions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from spiral.engine.filter.extended import FilterInputs, filter_record
from spiral.engine.filter.noise import noise_groups
from spiral.engine.filter.prior import Prior
from spiral.engine.filter.setup import with_level
from spiral.engine.filter.tuning import LOWEST, Likelihood, most_likely_levels
from spiral.engine.filter.whitened import WhitenedRecord, whiten_innovations
from spiral.engine.leastsquares import least_squares
from spiral.types.record import Array

_STEPS, _HALVINGS, _CYCLES = 8, 5, 12
_ENOUGH = 0.05  # log-likelihood for which no other step is taken
_WORTH = 0.5  # the same for another cycle of steps and less noise
_LESS = 0.3  # share of the process noise that is tried next
_RUNAWAY = -1e300


@dataclass(frozen=True)
class TunedTasks:
    """The maximum of the likelihood: filter tasks at its values, and the process noise.

    ``errors`` are standard errors of the parameters that moved, by the outer product of slopes, and
    ``covariance`` (q, q) is theirs together where a prior was given; ``log_likelihood`` is -inf
    where the filter ran away from the beginning, and has the prior in it.
    """

    prepared: FilterInputs
    levels: Mapping[str, float]
    log_likelihood: float
    errors: Mapping[str, float]
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def values(self) -> Array:
        """(parameters,) of the first record."""
        return self.prepared[0][0].values

    @property
    def finite(self) -> bool:
        """Whether the filter stayed with every record."""
        return bool(np.isfinite(self.log_likelihood))

    def regression(self, keys: tuple[str, ...]) -> tuple[WhitenedRecord, ...] | None:
        """Whitened innovations of every record with their slopes; nothing where one ran away."""
        return _whitened_regression(self.prepared, self.levels, keys)


def climb_likelihood(
    prepared: FilterInputs,
    keys: tuple[str, ...],
    levels: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    near: Mapping[str, float] | None = None,
    prior: Prior | None = None,
) -> TunedTasks:
    """The most likely values of parameters that all records share, and of the process noise.

    With a ``prior`` the most probable ones: log L + log p climbs.

    Parameters
    ----------
    prepared : records, at the values to start from; tracked parameters are found by the filter.
    keys : the parameters that move, none of them tracked.
    levels : process noise that is known; tuned where left out, ``near`` some that are guessed.
    bounds : lowest and highest values by name.
    """
    known = tuple(noise_groups(prepared[0][0]))
    present = dict(levels or near or most_likely_levels(*_tuning_problem(prepared, known)))
    height = log_likelihood(prepared, present, prior)
    for _ in range(_CYCLES if keys else 0):
        before = height
        prepared, height = _climb_at_levels(prepared, keys, present, height, bounds or {}, prior)
        if levels is None:
            present, height = _lower_noise_levels(prepared, present, height, prior)
        if levels is not None or height - before < _WORTH:
            break
    if levels is None and (keys or near):
        trial = most_likely_levels(*_tuning_problem(prepared, known), near=present)
        present = trial if log_likelihood(prepared, trial, prior) > height else present
        height = log_likelihood(prepared, present, prior)
        prepared, height = _climb_at_levels(prepared, keys, present, height, bounds or {}, prior)
    height = height if height > _RUNAWAY else -np.inf
    return TunedTasks(prepared, present, height, *_standard_errors(prepared, present, keys, prior))


def log_likelihood(
    prepared: FilterInputs, levels: Mapping[str, float], prior: Prior | None = None
) -> float:
    """log L summed over records, plus log p of a prior; ``_RUNAWAY`` where a filter runs away."""
    total = 0.0 if prior is None else prior.log_density(prepared[0][0].parameter_values(prior.keys))
    for task, settings in prepared:
        run = filter_record(task, with_level(task, settings, levels))
        if run.done < task.series.samples or not np.isfinite(run.log_likelihood):
            return _RUNAWAY
        total += run.log_likelihood
    return total


def _tuning_problem(
    prepared: FilterInputs, known: tuple[str, ...]
) -> tuple[tuple[str, ...], int, Likelihood]:
    """Arguments of ``most_likely_levels``: groups, samples, log-likelihood by levels."""

    def likelihood(levels: Mapping[str, float]) -> tuple[float, int]:
        runs = [
            filter_record(task, with_level(task, settings, levels)) for task, settings in prepared
        ]
        return sum(r.log_likelihood for r in runs), sum(r.done for r in runs)

    return known, sum(task.series.samples for task, _ in prepared), likelihood


def _lower_noise_levels(
    prepared: FilterInputs, levels: dict[str, float], height: float, prior: Prior | None
) -> tuple[dict[str, float], float]:
    """All levels of process noise lowered together as long as the likelihood rises."""
    while max(levels.values()) > LOWEST:
        trial = {k: max(_LESS * v, LOWEST) for k, v in levels.items()}
        reached = log_likelihood(prepared, trial, prior)
        if not reached > height:
            break
        levels, height = trial, reached
    return levels, height


def _whitened_regression(
    prepared: FilterInputs, levels: Mapping[str, float], keys: tuple[str, ...]
) -> tuple[WhitenedRecord, ...] | None:
    parts = []
    for task, settings in prepared:
        part = whiten_innovations(task, with_level(task, settings, levels), keys)
        if part is None:
            return None
        parts.append(part)
    return tuple(parts)


def _stack_rows(parts: tuple[WhitenedRecord, ...]) -> tuple[Array, Array]:
    """X (n, q) and e (n,) of all records."""
    x = np.concatenate([p.columns.reshape(-1, p.columns.shape[2]) for p in parts])
    return x, np.concatenate([p.innovations.reshape(-1) for p in parts])


def _climb_at_levels(
    prepared: FilterInputs,
    keys: tuple[str, ...],
    levels: Mapping[str, float],
    height: float,
    bounds: Mapping[str, tuple[float, float]],
    prior: Prior | None,
) -> tuple[FilterInputs, float]:
    """Scoring steps at fixed process noise until they are not worth another."""
    for _ in range(_STEPS):
        parts = _whitened_regression(prepared, levels, keys)
        if parts is None:
            break
        x, e = _stack_rows(parts)
        now = prepared[0][0].parameter_values(keys)
        step = least_squares(x, e).b if prior is None else prior.step(x, e, now)
        for halving in range(_HALVINGS):
            trial = _step_values(prepared, keys, step / 2**halving, bounds)
            reached = log_likelihood(trial, levels, prior)
            if reached > height:
                break
        else:
            break
        gain, prepared, height = reached - height, trial, reached
        if gain < _ENOUGH:
            break
    return prepared, height


def _step_values(
    prepared: FilterInputs,
    keys: tuple[str, ...],
    step: Array,
    bounds: Mapping[str, tuple[float, float]],
) -> FilterInputs:
    first = prepared[0][0]
    values = {}
    for key, delta in zip(keys, step, strict=True):
        low, high = bounds.get(key, (-np.inf, np.inf))
        values[key] = float(np.clip(first.values[first.keys.index(key)] + delta, low, high))
    return with_shared_values(prepared, values)


def with_shared_values(prepared: FilterInputs, values: Mapping[str, float]) -> FilterInputs:
    """The same records with other values of the machine's parameters."""
    return tuple((task.with_values(values), settings) for task, settings in prepared)


def _standard_errors(
    prepared: FilterInputs, levels: Mapping[str, float], keys: tuple[str, ...], prior: Prior | None
) -> tuple[dict[str, float], Array]:
    """Standard errors by name; with a prior, the posterior covariance as well."""
    parts = _whitened_regression(prepared, levels, keys) if keys else None
    if parts is None:
        return {}, np.zeros((0, 0))
    x, e = _stack_rows(parts)
    if prior is None:
        spread, covariance = least_squares(x, e).spread(1.0), np.zeros((0, 0))
    else:
        covariance = prior.posterior_covariance(x)
        spread = np.sqrt(np.diag(covariance))
    return dict(zip(keys, map(float, spread), strict=True)), covariance
