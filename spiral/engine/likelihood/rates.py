"""Rates and readings of a compiled model along given states."""

from __future__ import annotations

import numpy as np

from spiral.physics.compile import CompiledModel
from spiral.types.record import Array


def rates_along(compiled: CompiledModel, x: Array, u: Array, p: Array) -> Array:
    """Rates (samples, states) at every row of x and u, with one value of every parameter."""
    return rates_and_readings_along(compiled, x, u, u, p)[0]


def rates_and_readings_along(
    compiled: CompiledModel, x: Array, u: Array, read: Array, p: Array
) -> tuple[Array, Array]:
    """Rates at every row of x under the inputs u, and readings there under ``read``."""
    from spiral.engine.likelihood.signatures_kernel import evaluate_along

    rates, readings = np.empty_like(x), np.empty((len(x), len(compiled.traced.channels)))
    evaluate_along(compiled.rate_value, compiled.output_value, x, u, read, p, rates, readings)
    return rates, readings
