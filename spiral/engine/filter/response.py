"""How a machine moves that random forces alone drive: its stationary response at rest.

With A the slopes of the rates at rest and white noise of unit intensity on every state that has a
law of its own, the covariance P of the states solves

    A P + P A^T + Q = 0        (Lyapunov)

and A P A^T is that of their rates. One factor for all makes the readings move as much as measured.
A record of a bridge in the wind has no input from which a free run would tell such scales, nor has
one of hidden states that move while it decays.
"""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.shifts import slopes_by_states
from spiral.engine.resting import REST
from spiral.engine.series import Series
from spiral.physics.compile import CompiledModel
from spiral.types.label import parameter_of
from spiral.types.record import Array

_LEAST_DECAY = 10.0  # over the record: what would decay less has no stationary response in it


def response_scales(
    compiled: CompiledModel, values: Array, series: Series
) -> tuple[Array, Array] | None:
    """(n,) standard deviations of the states and of their rates in a response as large as measured.

    Nothing where the machine has no stationary response at rest, or none that the sensors see.
    """
    from scipy.linalg import LinAlgError, solve_continuous_lyapunov

    rest, inputs = np.full(len(compiled.traced.states), REST), series.mean_inputs
    a, c = slopes_by_states(compiled, rest, np.ascontiguousarray(inputs), values)
    if not (np.all(np.isfinite(a)) and np.all(np.isfinite(c))):
        return None
    least, modes = _LEAST_DECAY / (series.dt * series.samples), np.linalg.eigvals(a)
    slowest = float(modes.real.max())
    if not (slowest <= least and np.all(np.abs(modes) > least)):  # it runs away, or rests anywhere
        return None
    a = a - max(slowest + least, 0.0) * np.eye(len(a))  # every mode decays so much at least
    names, rate_name = compiled.traced.states, compiled.traced.rate_name
    ruled = [rate_name(name) in names or bool(parameter_of(name)) for name in names]
    try:
        covariance = solve_continuous_lyapunov(a, -np.diag(np.logical_not(ruled).astype(float)))
    except LinAlgError:
        return None
    scales, rates, readings = (
        np.sqrt(np.maximum(np.diag(m @ covariance @ m.T), 0.0)) for m in (np.eye(len(a)), a, c)
    )
    seen = (readings > 0) & (series.deviations > 0)
    if not (np.any(seen) and np.all(np.isfinite(scales) & (scales > 0) & (rates > 0))):
        return None
    factor = np.exp(np.mean(np.log(series.deviations[seen] / readings[seen])))
    return factor * scales, factor * rates
