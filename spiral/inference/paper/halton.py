"""The learned residual, projected onto the library on quasi-random points (the paper's Step 4).

    theta_H = argmin sum_j |f(xi_j) - Phi(xi_j) theta|^2,   xi_j a Halton sequence in the box that
    the training samples span,

accumulated block by block as a triangular factor, so memory does not grow with the points. The
regressor is xi = (q, q', scheduling inputs). Library terms that also depend on the phase are
evaluated at phases drawn as one more dimension, of which the learned function knows nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from spiral.engine.gate import Surface
from spiral.engine.leastsquares import solve_triangle, triangle
from spiral.inference.paper.regression import Equations, Samples
from spiral.physics.trace import TracedModel
from spiral.types.learner import Learned
from spiral.types.record import Array
from spiral.types.system import System

_BLOCK = 8192


@dataclass(frozen=True)
class Regressor:
    """Which columns of states and inputs make up xi, and which inputs are phases."""

    names: tuple[str, ...]
    states: tuple[int, ...]
    inputs: tuple[int, ...]
    phases: tuple[int, ...]

    def of(self, states: Array, inputs: Array) -> Array:
        """xi (N, n_xi) (paper, eq. regressor)."""
        return np.concatenate([states[:, self.states], inputs[:, self.inputs]], axis=1)


def regressor(system: System, traced: TracedModel) -> Regressor:
    """Measured coordinates, their rates, and the inputs that are not derived from others."""
    moving = [*traced.channels, *(traced.rate_name(n) for n in traced.channels)]
    scheduling = [i.name for i in system.inputs if i.derived_from is None]
    phases = [i.name for i in system.inputs if i.derived_from is not None]
    return Regressor(
        (*moving, *scheduling),
        tuple(traced.states.index(n) for n in moving),
        tuple(traced.inputs.index(n) for n in scheduling),
        tuple(traced.inputs.index(n) for n in phases),
    )


def box_points(regressor: Regressor, samples: Samples, count: int, seed: int) -> Iterator[tuple]:
    """Blocks of (states, inputs) filling the box that xi spans; phases fill a turn."""
    from scipy.stats import qmc

    xi = regressor.of(samples.states, samples.inputs)
    low, high = xi.min(axis=0), xi.max(axis=0)
    high = np.where(high > low, high, low + 1e-300)
    width = len(low) + len(regressor.phases)
    sequence = qmc.Halton(width, scramble=True, rng=np.random.default_rng(seed))
    left = count
    while left > 0:
        unit = sequence.random(min(_BLOCK, left))
        left -= len(unit)
        states = np.zeros((len(unit), samples.states.shape[1]))
        inputs = np.zeros((len(unit), samples.inputs.shape[1]))
        scaled = low + unit[:, : len(low)] * (high - low)
        moving = len(regressor.states)
        states[:, regressor.states] = scaled[:, :moving]
        inputs[:, regressor.inputs] = scaled[:, moving:]
        inputs[:, regressor.phases] = 2 * np.pi * unit[:, len(low) :]
        yield states, inputs


def trajectory_points(samples: Samples, keep: Array) -> Iterator[tuple]:
    """Blocks of (states, inputs) of the training samples themselves: states that were visited."""
    at = np.flatnonzero(keep)
    for start in range(0, len(at), _BLOCK):
        part = at[start : start + _BLOCK]
        yield samples.states[part], samples.inputs[part]


def project_surface(
    learned: Learned,
    regressor: Regressor,
    regression: Equations,
    candidates: tuple[int, ...],
    points: Iterator[tuple],
    row: Array,
) -> Surface:
    """Least squares of the learned function on the candidates' columns over all points."""
    energy = 0.0

    def blocks() -> Iterator[Array]:
        nonlocal energy
        for states, inputs in points:
            nothing = np.zeros((len(states), regression.parts.rows))
            columns, _ = regression.evaluate(states, inputs, nothing, row)
            value = learned.predict(regressor.of(states, inputs))
            energy += float(np.sum(value**2))
            chosen = columns[..., list(candidates)].reshape(-1, len(candidates))
            yield np.column_stack([chosen, value.reshape(-1)])

    upper, rows = triangle(blocks())
    fit = solve_triangle(upper, rows)
    return Surface(fit, rows // regression.parts.rows, 1.0 - fit.rss / max(energy, 1e-300))
