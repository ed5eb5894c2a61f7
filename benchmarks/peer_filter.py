"""The same extended filter in filterpy, a loop over NumPy calls: what ours is checked against.

Mean by RK4 and covariance by the Jacobian of that step, both from the model's compiled functions
(so filterpy is not slowed down by the model), update by ``ExtendedKalmanFilter.update``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.filtering.extended import Settings
from spiral.filtering.task import Task


@dataclass(frozen=True)
class Peer:
    """Means (samples, n), covariances and transitions (samples, n, n) of filterpy's run."""

    means: np.ndarray
    covariances: np.ndarray
    transitions: np.ndarray


def filterpy_run(task: Task, settings: Settings, samples: int) -> Peer:
    """Filter the first samples of a task (no tracked parameter) with filterpy."""
    from filterpy.kalman import ExtendedKalmanFilter

    n, m = len(task.states), task.series.y.shape[1]
    kalman = ExtendedKalmanFilter(dim_x=n, dim_z=m)
    kalman.x, kalman.P = settings.start.copy(), settings.covariance.copy()
    kalman.Q, kalman.R = settings.process, np.diag(settings.noise)
    means, covariances, transitions = np.empty((samples, n)), *np.empty((2, samples, n, n))
    h, c, d = np.empty(m), np.zeros((m, n)), np.zeros((m, len(task.values)))
    first = np.zeros(0)

    def reading(x: np.ndarray) -> np.ndarray:
        task.compiled.output(x, first, task.values, h, c, d)
        return h

    def slopes(x: np.ndarray) -> np.ndarray:
        task.compiled.output(x, first, task.values, h, c, d)
        return c

    for k in range(samples):
        first = task.inputs[2 * k * task.series.substeps]
        kalman.update(task.series.y[k], slopes, reading)
        means[k], covariances[k] = kalman.x, kalman.P
        moved, kalman.F = runge_kutta(task, kalman.x, k)
        transitions[k] = kalman.F
        kalman.x, kalman.P = moved, kalman.F @ kalman.P @ kalman.F.T + kalman.Q
    return Peer(means, covariances, transitions)


def runge_kutta(task: Task, x: np.ndarray, sample: int) -> tuple[np.ndarray, np.ndarray]:
    """One sample of RK4 and its Jacobian, in NumPy."""
    n, substeps = len(x), task.series.substeps
    step = task.series.dt / substeps
    a, b, f = np.zeros((n, n)), np.zeros((n, len(task.values))), np.empty(n)
    s = np.eye(n)
    for sub in range(substeps):
        slope, rates, total, sums = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
        for stage, (point, gain) in enumerate(((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))):
            at = 2 * (sample * substeps + sub) + (stage + 1) // 2
            inputs = task.inputs[min(at, len(task.inputs) - 1)]
            task.compiled.rate(x + point * step * slope, inputs, task.values, f, a, b)
            slope, rates = f.copy(), a @ (s + point * step * rates)
            total, sums = total + gain * slope, sums + gain * rates
        x, s = x + step / 6 * total, s + step / 6 * sums
    return x, s
