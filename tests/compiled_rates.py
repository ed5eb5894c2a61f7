"""Rates of a compiled system at a point, by name."""

import numpy as np

from spiral.physics.compile import compile_model
from spiral.physics.trace import trace


def rates(system, effects, values, states, inputs):
    """The compiled rates by name."""
    traced = trace(system, effects)
    found = np.zeros(len(traced.states))
    x, u = ([given[n] for n in names] for given, names in (
        (states, traced.states), (inputs, traced.inputs)))  # fmt: skip
    p = [values.get(k, q.start) for k, q in zip(traced.keys, traced.parameters, strict=True)]
    compile_model(traced).rate_value(*(np.array(a, float) for a in (x, u, p)), found)
    return dict(zip(traced.states, found, strict=True))
