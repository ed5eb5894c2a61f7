"""The force of a candidate along the motion on which the missing force was estimated.

    B F = f(x, u, p of the refitted model) - f(x, u, p of the model before),    B = df / dF

in the least squares of all rates, F on the axes of the port at which the missing force acts. The
effect alone is the same with its amplitudes at zero in place of the model before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.likelihood.rates import rates_along
from spiral.engine.series import sample_inputs
from spiral.inference.where.latent import MissingForce, latent_keys
from spiral.physics.compile import compile_model
from spiral.physics.trace import TracedModel, trace
from spiral.types.model import Model
from spiral.types.record import Array

_MOST = 4000  # samples at which the forces are evaluated


@dataclass(frozen=True)
class OwnForce:
    """Forces to compare with the missing one, (samples, axes) in the port's unit.

    ``rows`` are the rows of the missing force at which they are evaluated; ``alone`` is the
    effect's own force, ``refitted`` includes all that its refit changed elsewhere.
    """

    rows: Array
    alone: Array
    refitted: Array


def effect_own_force(missing: MissingForce, after: Model, label: str) -> OwnForce | None:
    """The force of an effect of a refitted model, along the motion of the missing force.

    Nothing for an effect with states of its own, whose force is no function of the states of the
    model before, and for one that changes no rate, as of a sensor.
    """
    effect = next((e for e in after.effects if e.label == label), None)
    traced = trace(after.system, after.effects)
    known = list(missing.task.states)
    if effect is None or effect.states or not {*traced.states} <= {*known}:
        return None
    rows = np.arange(0, len(missing.force), max(1, -(-len(missing.force) // _MOST)))
    x = np.ascontiguousarray(missing.states[rows])
    u = sample_inputs(missing.task.inputs, missing.task.series.substeps)[rows]
    own = np.ascontiguousarray(x[:, [known.index(n) for n in traced.states]])
    compiled = compile_model(traced)
    with_it = rates_along(compiled, own, u, _values_in_order(traced, after))
    absent = dict.fromkeys(after.amplitudes(label), 0.0)
    none = _values_in_order(traced, replace(after, values={**after.values, **absent}))
    gains = _force_gains(missing, x, u)
    alone = _least_squares_force(
        gains, _reorder_rates(with_it - rates_along(compiled, own, u, none), traced, known)
    )
    before = rates_along(missing.task.compiled, x, u, _values_without_latent(missing))
    refitted = _least_squares_force(gains, _reorder_rates(with_it, traced, known) - before)
    if not np.isfinite(refitted).all() or not np.any(alone):
        return None
    return OwnForce(rows, alone, refitted)


def _values_in_order(traced: TracedModel, model: Model) -> Array:
    known = dict(zip(traced.keys, traced.parameters, strict=True))
    return np.array([model.values.get(k, known[k].start or 0.0) for k in traced.keys])


def _values_without_latent(missing: MissingForce) -> Array:
    """Values of the model before, without the force that it lacks."""
    task = missing.task
    values = np.array(task.values, dtype=float)
    values[[task.keys.index(k) for k in latent_keys(task.model)]] = 0.0
    return values


def _force_gains(missing: MissingForce, x: Array, u: Array) -> Array:
    """B (samples, states, axes): what a force on each axis does to every rate."""
    columns = [missing.task.keys.index(k) for k in latent_keys(missing.task.model)]
    return missing.task.compiled.rate.parameter_slopes(
        x, u, _values_without_latent(missing), columns
    )


def _reorder_rates(rates: Array, traced: TracedModel, known: list[str]) -> Array:
    """Rates in the order of the model before; those of states that are no more are zero."""
    ordered = np.zeros((len(rates), len(known)))
    ordered[:, [known.index(n) for n in traced.states]] = rates
    return ordered


def _least_squares_force(gains: Array, rates: Array) -> Array:
    """The force on each axis that makes these rates, in least squares."""
    return np.einsum("sai,si->sa", np.linalg.pinv(gains), rates)
