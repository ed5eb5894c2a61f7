"""What acted at random, as the whole record tells it: the disturbance smoother.

With the innovations e, their variances s, rows c, gains K and transitions F that a filter kept,

    r <- (I - K c)^T r + c^T e / s     at a sample, its channels from the last to the first,
    r <- F^T r                         from a sample to the one before,

the noise w that was added between samples k and k + 1 is expected to be Q r, r that of sample k + 1
before its readings (de Jong 1989, J. Am. Stat. Assoc. 84; Koopman 1993, Biometrika 80).
"""

from __future__ import annotations

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.noise import NoiseModel, noise_matrices
from spiral.engine.likelihood.predict import Prediction, predict_readings
from spiral.types.record import Array


def smoothed_forces(task: FilterInput, settings: FilterSettings, noise: NoiseModel) -> Array | None:
    """(samples, n) what random forces add to every state over each sample; the last row is zero.

    Forces with a memory are states z of the noise, z <- Phi z + w, and act as G z through the
    sample. Nothing where the filter runs away.
    """
    run = predict_readings(task, settings, noise, keep=True, carry=True)
    if not run.whole:
        return None
    parts, n = noise_matrices(task, settings, noise), len(task.states)
    added = _smoothed_noise(run, parts.q)
    first = added.shape[1] - len(parts.phi)
    forces, z = added[:, :n].copy(), np.zeros(len(parts.phi))
    for k, row in enumerate(added[:-1, first:]):
        forces[k] += task.series.dt * (parts.driven @ z)
        z = parts.phi @ z + row
    return forces


def _smoothed_noise(run: Prediction, q: Array) -> Array:
    """(samples, N) the noise that was added after each sample, as the whole record has it."""
    added, adjoint = np.zeros((len(run.misses), len(q))), np.zeros(len(q))
    for k in range(len(added) - 1, 0, -1):
        for j in range(run.misses.shape[1] - 1, -1, -1):
            if run.spreads[k, j] > 0:
                told = run.misses[k, j] / run.spreads[k, j] - run.gains[k, j] @ adjoint
                adjoint = adjoint + run.rows[k, j] * told
        added[k - 1] = q @ adjoint
        adjoint = run.transitions[k - 1].T @ adjoint
    return added
