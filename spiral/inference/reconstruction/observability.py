"""Observability of the linearised model from its channels: rank and singular values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.resting import state_jacobian
from spiral.types.record import Array


@dataclass(frozen=True)
class Observability:
    """``singular_values`` of the scaled observability matrix, largest first; ``rank`` of it.

    ``weakest`` is the state with the largest share in the direction seen least.
    """

    rank: int
    singular_values: tuple[float, ...]
    weakest: str

    def as_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "rank": self.rank,
            "states": len(self.singular_values),
            "singular_values": list(self.singular_values),
            "weakest": self.weakest,
        }


def observability(task: FilterInput) -> Observability:
    """Singular values of [C; C A; ...; C A^(n-1)] at the mean of settled states and inputs.

    States are scaled by their settled standard deviations, channels by theirs, time by the fastest
    mode, so that the values do not depend on units.
    """
    n = len(task.states)
    mean = task.inputs.mean(axis=0) if task.inputs.size else np.zeros(task.inputs.shape[1])
    a = state_jacobian(task.compiled, task.values, mean, task.centre)
    a = a * task.scales / task.scales[:, None]
    c = _output_slopes(task, mean) * task.scales
    norms = np.linalg.norm(c, axis=1, keepdims=True)
    c = c / np.where(norms > 0, norms, 1.0)
    fastest = float(np.abs(np.linalg.eigvals(a)).max()) or 1.0
    rows = [c]
    for _ in range(n - 1):
        rows.append(rows[-1] @ a / fastest)
    _, values, right = np.linalg.svd(np.concatenate(rows))
    tolerance = values[0] * max(n, len(c) * n) * np.finfo(float).eps
    weakest = task.states[int(np.argmax(np.abs(right[-1])))]
    return Observability(int(np.sum(values > tolerance)), tuple(map(float, values)), weakest)


def _output_slopes(task: FilterInput, inputs: Array) -> Array:
    """h_x (channels, n) at the mean of the settled states."""
    n, m = len(task.states), len(task.compiled.traced.channels)
    c, d = np.zeros((m, n)), np.zeros((m, len(task.values)))
    values = np.ascontiguousarray(task.values)
    task.compiled.output(task.centre, np.ascontiguousarray(inputs), values, np.empty(m), c, d)
    return c
