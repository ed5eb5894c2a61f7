"""A candidate's own force beside the one that a model lacks, at the same states and inputs.

    B F = f(x, u, p of the refitted model) - f(x, u, p of the model before),    B = df / dF

in the least squares of all rates, F on the axes of the port at which the missing force acts. The
effect alone is the same with its amplitudes at zero in place of the model before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.inference.where.latent import MissingForce, latent_keys
from spiral.physics.compile import Compiled, compile_model
from spiral.physics.trace import Traced, trace
from spiral.types.model import Model
from spiral.types.record import Array

_MOST = 4000  # samples at which the forces are asked


@dataclass(frozen=True)
class OwnForce:
    """Forces over the missing one, rows of the record: (samples, axes), in the port's unit.

    ``rows`` are those of the missing force that were asked; ``alone`` the effect's own force,
    ``refitted`` that with all that its refit changed elsewhere.
    """

    rows: Array
    alone: Array
    refitted: Array


def own_force(missing: MissingForce, after: Model, label: str) -> OwnForce | None:
    """What an effect of a refitted model pushes with where a force was missing before.

    Nothing for an effect that brings states of its own, whose force no state of the model before
    tells, and for one that changes no rate, as of a sensor.
    """
    effect = next((e for e in after.effects if e.label == label), None)
    traced = trace(after.system, after.effects)
    known = list(missing.task.states)
    if effect is None or effect.states or not {*traced.states} <= {*known}:
        return None
    rows = np.arange(0, len(missing.force), max(1, -(-len(missing.force) // _MOST)))
    x = np.ascontiguousarray(missing.states[rows])
    grid, step = missing.task.inputs, 2 * missing.task.series.substeps
    u = np.ascontiguousarray(grid[rows * step])
    own = np.ascontiguousarray(x[:, [known.index(n) for n in traced.states]])
    compiled = compile_model(traced)
    with_it = _rates(compiled, own, u, _values(traced, after))
    absent = dict.fromkeys(after.amplitudes(label), 0.0)
    none = _values(traced, replace(after, values={**after.values, **absent}))
    gains = _gains(missing, x, u)
    alone = _pushed(gains, _placed(with_it - _rates(compiled, own, u, none), traced, known))
    before = _rates(missing.task.compiled, x, u, _zeroed(missing))
    refitted = _pushed(gains, _placed(with_it, traced, known) - before)
    if not np.isfinite(refitted).all() or not np.any(alone):
        return None
    return OwnForce(rows, alone, refitted)


def _values(traced: Traced, model: Model) -> Array:
    known = dict(zip(traced.keys, traced.parameters, strict=True))
    return np.array([model.values.get(k, known[k].start or 0.0) for k in traced.keys])


def _zeroed(missing: MissingForce) -> Array:
    """Values of the model before, without the force that it lacks."""
    task = missing.task
    values = np.array(task.values, dtype=float)
    values[[task.keys.index(k) for k in latent_keys(task.model)]] = 0.0
    return values


def _gains(missing: MissingForce, x: Array, u: Array) -> Array:
    """B (samples, states, axes): what a force on each axis does to every rate."""
    columns = [missing.task.keys.index(k) for k in latent_keys(missing.task.model)]
    return missing.task.compiled.rate.parameter_slopes(x, u, _zeroed(missing), columns)


def _rates(compiled: Compiled, x: Array, u: Array, p: Array) -> Array:
    """Rates (samples, states) at every row of x and u."""
    from spiral.engine.likelihood.signatures_kernel import evaluate_along

    found, readings = np.empty_like(x), np.empty((len(x), len(compiled.traced.channels)))
    evaluate_along(compiled.rate_value, compiled.output_value, x, u, p, found, readings)
    return found


def _placed(rates: Array, traced: Traced, known: list[str]) -> Array:
    """Rates in the order of the model before; those of states that are no more are zero."""
    found = np.zeros((len(rates), len(known)))
    found[:, [known.index(n) for n in traced.states]] = rates
    return found


def _pushed(gains: Array, rates: Array) -> Array:
    """The force on each axis that makes these rates, in least squares."""
    return np.einsum("sai,si->sa", np.linalg.pinv(gains), rates)
