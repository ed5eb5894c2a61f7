"""Where the states of a model begin, as far as it declares that."""

from __future__ import annotations

from collections.abc import Collection

from spiral.physics.trace import TracedModel
from spiral.types.record import Array


def fill_declared_starts(
    traced: TracedModel,
    states: Array,
    inputs: Array,
    readings: Array | None = None,
    known: Collection[str] = (),
) -> None:
    """Write into states (..., n), the ``known`` apart, where each is declared to begin.

    At its ``start``, or at what it is ``like``: a state, an input (..., inputs), or a reading
    (..., channels) that is computed from states.
    """
    for name, start in traced.starts:
        if name not in known:
            states[..., traced.states.index(name)] = start
    for name, shown in traced.like:
        if name in known:
            continue
        if shown in traced.inputs:
            value = inputs[..., traced.inputs.index(shown)]
        elif shown in traced.states:
            value = states[..., traced.states.index(shown)]
        elif readings is not None:
            value = readings[..., traced.channels.index(shown)]
        else:
            continue
        states[..., traced.states.index(name)] = value
