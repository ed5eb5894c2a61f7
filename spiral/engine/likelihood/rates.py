"""Rates of a compiled model along given states."""

from __future__ import annotations

import numpy as np

from spiral.physics.compile import CompiledModel
from spiral.types.record import Array


def rates_along(compiled: CompiledModel, x: Array, u: Array, p: Array) -> Array:
    """Rates (samples, states) at every row of x and u, with one value of every parameter."""
    from spiral.engine.likelihood.signatures_kernel import evaluate_along

    rates, readings = np.empty_like(x), np.empty((len(x), len(compiled.traced.channels)))
    evaluate_along(compiled.rate_value, compiled.output_value, x, u, u, p, rates, readings)
    return rates
