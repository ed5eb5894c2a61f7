"""The missing force: what a model lacks, estimated as a force with its uncertainty.

    x' = f(x, u, p) + G F(t),    F a random walk: dF = sqrt(q) dw,

estimated with the states by the extended filter and its fixed-interval smoother
(``spiral.engine.filter``), the force being tracked as a parameter at the system's first port. All
that the model does not explain then appears as a force on each axis. The one number q is estimated
by maximum likelihood of the innovations. (Jazwinski 1970; Kennedy and Alvin
1999.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.filter.extended import FilterSettings, filter_record, smooth_run
from spiral.engine.filter.setup import choose_levels, prepare_filter, with_level
from spiral.engine.filter.task import FilterInput, prepare_task
from spiral.types.effect import ForceEffect
from spiral.types.label import owner_of
from spiral.types.model import Model
from spiral.types.parameter import Parameter
from spiral.types.record import Array, Record
from spiral.types.system import has_coordinates

MOST = 60_000  # samples that are smoothed at once: memory is 1.5 kB each
_LEVELS = (-3.0, -2.0, -1.0, 0.0, 1.0)  # decimal logarithms that are tried first
_TOLERANCE = 0.05


class LatentForce(ForceEffect):
    """A force of unknown origin: F_i(t), one value per axis."""

    parameters = (Parameter("force", "force", per_axis=True),)

    def force(self, at, u, p):
        """F_i per axis."""
        return list(p.force)


@dataclass(frozen=True)
class MissingForce:
    """The smoothed force of one record, with the states that belong to it.

    ``force`` and ``deviation`` (samples, axes) in ``unit``; ``states`` and ``spreads`` (samples,
    n) are the smoothed states and their standard deviations; ``axes`` name the axes of the port.
    ``start`` is the record's sample that row 0 belongs to; ``level`` the random walk's size, as a
    share of the force that moves the model, over the motion's own time.
    """

    axes: tuple[str, ...]
    unit: str
    force: Array
    deviation: Array
    states: Array
    spreads: Array
    level: float
    start: int
    task: FilterInput

    @property
    def stop(self) -> int:
        """The record's sample after the last row."""
        return self.start + len(self.force)


def add_latent_force(model: Model) -> Model:
    """The model with an unknown force at its first port, zero until it is estimated.

    A system without forces is left as it is.
    """
    if not has_coordinates(model.system):
        return model
    wide = model.add(LatentForce())
    return replace(wide, values={**wide.values, **dict.fromkeys(latent_keys(wide), 0.0)})


def latent_keys(model: Model) -> tuple[str, ...]:
    """Names of the unknown force's parameters in a model that has it."""
    label = LatentForce().label
    return tuple(k for k, _ in model.pairs if owner_of(k) == label)


def missing_force(
    model: Model,
    record: Record,
    inputs: Array | None = None,
    substeps: int | None = None,
    first: int = 0,
) -> MissingForce | None:
    """The force that a fitted model lacks on one record.

    Parameters
    ----------
    model : a value for every parameter, the record's own included.
    inputs, substeps : as of ``stage_inputs``, where a fit has corrected them.
    first : sample to begin at in a record longer than ``MOST`` samples; all of a shorter one.

    Returns nothing for a system without forces, and where the filter runs away.
    """
    if not has_coordinates(model.system):
        return None
    start = min(first, max(record.samples - MOST, 0))
    stop = min(start + MOST, record.samples)
    if (start, stop) != (0, record.samples):
        record = record.stretch(start, stop)
        if inputs is not None and substeps is not None:
            inputs = inputs[3 * substeps * start : 3 * substeps * (stop - 1) + 1]
    wide = model if LatentForce().label in model.labels else add_latent_force(model)
    whole = prepare_task(wide, record, inputs=inputs, substeps=substeps, every=True)
    task, settings = prepare_filter(whole, ())
    keys = latent_keys(wide)
    sizes, rates = _force_scales(task, keys)
    settings = replace(settings, tracked=keys, doubt=sizes)

    def with_walk_level(level: float) -> FilterSettings:
        return replace(settings, wander=(10.0**level * sizes) ** 2 * rates * record.dt)

    level = _most_likely_level(task, with_walk_level)
    return (
        None if level is None else _smooth_force(task, with_walk_level(level), 10.0**level, start)
    )


def smoothed_states(
    model: Model, record: Record, inputs: Array | None = None, substeps: int | None = None
) -> tuple[Array, Array] | None:
    """States and their standard deviations, (samples, n) each, of a system without forces.

    By the extended filter and its smoother, with the most likely process noise in place of a
    missing force; nothing for more than ``MOST`` samples, and where the filter runs away.
    """
    if record.samples > MOST:
        return None
    task, settings = prepare_filter(prepare_task(model, record, inputs=inputs, substeps=substeps))
    levels = choose_levels(task, settings, None)
    filter_pass = filter_record(task, with_level(task, settings, levels), keep=True)
    if filter_pass.done < record.samples:
        return None
    filter_pass, n = smooth_run(filter_pass), len(task.states)
    return filter_pass.means[:, :n].copy(), np.sqrt(np.maximum(filter_pass.variances[:, :n], 0.0))


def _force_scales(task: FilterInput, keys: tuple[str, ...]) -> tuple[Array, Array]:
    """For every axis, the force that makes the model's own accelerations, and their rate in 1/s."""
    n, count = len(task.states), len(task.keys)
    a, b = np.zeros((n, n)), np.zeros((n, count))
    u = np.ascontiguousarray(task.inputs.mean(axis=0))
    task.compiled.rate(np.full(n, 1e-12), u, np.ascontiguousarray(task.values), np.empty(n), a, b)
    sizes, rates = [], []
    for key in keys:
        column = np.abs(b[:, task.keys.index(key)])
        row = int(np.argmax(column / np.maximum(task.rates, 1e-300)))
        sizes.append(task.rates[row] / column[row])
        rates.append(task.rates[row] / task.scales[row])
    return np.array(sizes), np.array(rates)


def _most_likely_level(task: FilterInput, walking) -> float | None:
    """Decimal logarithm of the level with the highest likelihood; nothing where all run away."""
    from scipy.optimize import minimize_scalar

    samples = task.series.samples

    def cost(level: float) -> float:
        filter_pass = filter_record(task, walking(level))
        finished = filter_pass.done == samples and np.isfinite(filter_pass.log_likelihood)
        return -filter_pass.log_likelihood if finished else np.inf

    costs = [cost(level) for level in _LEVELS]
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        return None
    low, high = _LEVELS[max(best - 1, 0)], _LEVELS[min(best + 1, len(_LEVELS) - 1)]
    with np.errstate(invalid="ignore"):  # a level at which the filter runs away costs infinity
        minimum: Any = minimize_scalar(
            cost, bounds=(low, high), method="bounded", options={"xatol": _TOLERANCE, "maxiter": 6}
        )
    return float(minimum.x) if minimum.fun < costs[best] else _LEVELS[best]


def _smooth_force(
    task: FilterInput, settings: FilterSettings, level: float, start: int
) -> MissingForce | None:
    filter_pass = filter_record(task, settings, keep=True)
    if filter_pass.done < task.series.samples:
        return None
    filter_pass = smooth_run(filter_pass)
    n = len(task.states)
    spread = np.sqrt(np.maximum(filter_pass.variances, 0.0))
    model = task.model
    port = model.system.port()
    return MissingForce(
        axes=port.axes,
        unit=model.unit(settings.tracked[0]),
        force=filter_pass.means[:, n:].copy(),
        deviation=spread[:, n:],
        states=filter_pass.means[:, :n].copy(),
        spreads=spread[:, :n],
        level=level,
        start=start,
        task=task,
    )
