"""States where a model rests, and the integration steps that its fast modes need there.

A model may be stiff far from zero alone: prompt neutrons decay within a second where there are
neutrons, and the reactor runs away where it is cold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spiral.engine.series import MOST_STABLE, Series, sample_inputs, stable_steps
from spiral.physics.compile import CompiledModel
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import TracedModel
from spiral.types.record import Array

REST = 1e-12  # for a state at rest: a square root has no finite slope at zero
_NEWTON, _CLOSE = 50, 1e-6  # steps to where hidden states rest, and the last one's share


def hidden_of_first_order(traced: TracedModel) -> list[int]:
    """Numbers of the states that no channel shows, that are no rate and have none of their own."""
    rates = {traced.rate_name(s) for s in traced.states}
    own = [s for s in traced.states if s not in rates and traced.rate_name(s) not in traced.states]
    return [traced.states.index(s) for s in own if s not in traced.channels]


def find_rest_state(
    compiled: CompiledModel, values: Array, start: Array, inputs: Array, moving: Sequence[int]
) -> Array | None:
    """Where the rates of these states are zero, by Newton's steps from a state; or nothing."""
    n, u, values = len(start), np.ascontiguousarray(inputs), np.ascontiguousarray(values)
    x, rate, a, b = start.copy(), np.empty(n), np.zeros((n, n)), np.zeros((n, len(values)))
    x[moving] = np.where(x[moving] == 0, REST, x[moving])
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON if moving else 0):
            compiled.rate(x, u, values, rate, a, b)
            part = a[np.ix_(moving, moving)]
            if not (np.all(np.isfinite(part)) and np.all(np.isfinite(rate))):
                break
            step = np.linalg.lstsq(part, -rate[moving], rcond=None)[0]
            x[moving] += step
            if np.all(np.abs(step) <= _CLOSE * np.abs(x[moving])):
                return x
    return None


def finite_state(compiled: CompiledModel, values: Array, x: Array, inputs: Array) -> Array:
    """A state where the model is finite: x, or with its zeros moved to where their rates vanish.

    A pressure under a logarithm, or a concentration that divides, has no zero.
    """
    values, u = np.ascontiguousarray(values), np.ascontiguousarray(inputs)
    zero = [i for i, v in enumerate(x) if v == 0]
    if not zero or _is_finite_at(compiled, values, x, u):
        return x
    ones = x.copy()
    ones[zero] = 1.0
    still = find_rest_state(compiled, values, ones, u, zero)
    return still if still is not None and _is_finite_at(compiled, values, still, u) else ones


def _is_finite_at(compiled: CompiledModel, values: Array, x: Array, u: Array) -> bool:
    rate, reading = np.empty(len(x)), np.empty(len(compiled.traced.channels))
    with np.errstate(all="ignore"):
        compiled.rate_value(x, u, values, rate)
        compiled.output_value(x, u, values, reading)
    return bool(np.isfinite(rate).all() and np.isfinite(reading).all())


def state_jacobian(
    compiled: CompiledModel, values: Array, inputs: Array, at: Array | None = None
) -> Array:
    """f_x (n, n) at a state, by default rest; zero where it is not finite."""
    n = len(compiled.traced.states)
    a, b = np.zeros((n, n)), np.zeros((n, len(values)))
    x = np.full(n, REST) if at is None else np.array(at, dtype=float)
    u = np.ascontiguousarray(inputs, dtype=float)
    compiled.rate(x, u, np.ascontiguousarray(values), np.empty(n), a, b)
    return a if np.all(np.isfinite(a)) else np.zeros((n, n))


def resting_jacobian(
    compiled: CompiledModel, values: Array, series: Series, inputs: Array | None = None
) -> Array:
    """f_x (n, n) at rest under ``inputs``, by default the largest, as near as the record comes.

    What a channel shows is no nearer to zero than its readings. Where no number of steps would do
    there (a concentration that divides, under zero), states are where they are declared to begin (a
    manifold's pressure is never zero), or else hidden states of first order where they rest.
    """
    traced = compiled.traced
    largest: Array = np.abs(series.inputs).max(axis=0, initial=0.0)
    u = largest if inputs is None else inputs
    x = np.zeros(len(traced.states))
    for name, channel in traced.shown.items():
        seen = series.y[:, channel]
        x[traced.states.index(name)] = np.clip(0.0, np.nanmin(seen), np.nanmax(seen))
    x[x == 0] = REST
    for declared in (False, True):
        if declared:
            fill_declared_starts(traced, x, u, known=traced.shown)
        matrix = state_jacobian(compiled, values, u, x)
        if stable_steps(np.linalg.eigvals(matrix), series.dt) < MOST_STABLE:
            return matrix
    rest = find_rest_state(compiled, values, x, u, hidden_of_first_order(traced))
    return matrix if rest is None else state_jacobian(compiled, values, u, rest)


def steps_for_stability(compiled: CompiledModel, values: Array, series: Series) -> int:
    """Integration steps per sample that fast modes need at the record's readings to stay stable.

    At the samples with the least, the middle and the largest reading of each channel; hidden states
    of first order are where they would rest there, others where they are declared to begin.
    """
    traced, hidden = compiled.traced, hidden_of_first_order(compiled.traced)
    inputs, shown, steps = sample_inputs(series.inputs, series.substeps), traced.shown, 1
    ranks = np.argsort(series.y, axis=0)[[0, series.samples // 2, -1]]
    for k in np.unique(ranks):
        x = np.zeros(len(traced.states))
        x[[traced.states.index(name) for name in shown]] = series.y[k, list(shown.values())]
        fill_declared_starts(traced, x, inputs[k], series.y[k], known=shown)
        rest = find_rest_state(compiled, values, x, inputs[k], hidden)
        matrix = state_jacobian(compiled, values, inputs[k], x if rest is None else rest)
        steps = max(steps, stable_steps(np.linalg.eigvals(matrix), series.dt))
    return steps
