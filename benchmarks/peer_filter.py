"""The same extended filter in filterpy, a loop over NumPy calls: what ours is checked against.

Mean by RK4 and covariance by the Jacobian of that step, update by ``ExtendedKalmanFilter.update``.
The model's functions are either NumPy ones made from the same traced physics, as a user of filterpy
has them, or spiral's compiled ones, which leave filterpy only its own cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.task import FilterInput


@dataclass(frozen=True)
class Peer:
    """Means (samples, n), covariances and transitions (samples, n, n) of filterpy's run."""

    means: np.ndarray
    covariances: np.ndarray
    transitions: np.ndarray


Function = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def compiled_functions(task: FilterInput) -> tuple[Function, Function]:
    """f with f_x, and h with h_x, as spiral compiles them."""
    n, m, count = len(task.states), task.series.y.shape[1], len(task.values)
    a, b, f = np.zeros((n, n)), np.zeros((n, count)), np.empty(n)
    c, d, h = np.zeros((m, n)), np.zeros((m, count)), np.empty(m)

    def rate(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        task.compiled.rate(x, u, task.values, f, a, b)
        return f, a

    def output(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        task.compiled.output(x, u, task.values, h, c, d)
        return h, c

    return rate, output


def numpy_functions(task: FilterInput) -> tuple[Function, Function]:
    """The same in NumPy, from the same expressions."""
    import sympy as sp

    traced = task.compiled.traced
    numbers = dict(zip(traced.p, map(float, task.values), strict=True))

    def function(value: tuple, slope: sp.Matrix) -> Function:
        expressions = [sp.Matrix(value).subs(numbers), slope.subs(numbers)]
        made = sp.lambdify([traced.x, traced.u], expressions, "numpy", cse=True)

        def at(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            found, jacobian = made(x, u)
            return found[:, 0], jacobian

        return at

    return function(traced.rate, traced.rate_x), function(traced.output, traced.output_x)


def filterpy_run(
    task: FilterInput,
    settings: FilterSettings,
    samples: int,
    functions: tuple[Function, Function] | None = None,
) -> Peer:
    """Filter the first samples of a task (no tracked parameter) with filterpy."""
    from filterpy.kalman import ExtendedKalmanFilter

    rate, output = functions or compiled_functions(task)
    n, m = len(task.states), task.series.y.shape[1]
    kalman = ExtendedKalmanFilter(dim_x=n, dim_z=m)
    kalman.x, kalman.P = settings.start.copy(), settings.covariance.copy()
    kalman.Q, kalman.R = settings.process, np.diag(settings.noise)
    means, covariances, transitions = np.empty((samples, n)), *np.empty((2, samples, n, n))
    for k in range(samples):
        u = task.inputs[3 * k * task.series.substeps]
        reading, slopes = output(kalman.x, u)
        kalman.update(task.series.y[k], lambda x, c=slopes: c, lambda x, h=reading: h)
        means[k], covariances[k] = kalman.x, kalman.P
        moved, kalman.F = runge_kutta(task, kalman.x, k, rate)
        transitions[k] = kalman.F
        kalman.x, kalman.P = moved, kalman.F @ kalman.P @ kalman.F.T + kalman.Q
    return Peer(means, covariances, transitions)


def runge_kutta(
    task: FilterInput, x: np.ndarray, sample: int, rate: Function | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """One sample of RK4 and its Jacobian, in NumPy."""
    rate = rate or compiled_functions(task)[0]
    n, substeps = len(x), task.series.substeps
    step = task.series.dt / substeps
    s = np.eye(n)
    for sub in range(substeps):
        slope, rates, total, sums = np.zeros(n), np.zeros((n, n)), np.zeros(n), np.zeros((n, n))
        for stage, (point, gain) in enumerate(((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))):
            at = 3 * (sample * substeps + sub) + (stage + 1) // 2
            inputs = task.inputs[min(at, len(task.inputs) - 1)]
            f, a = rate(x + point * step * slope, inputs)
            slope, rates = f.copy(), a @ (s + point * step * rates)
            total, sums = total + gain * slope, sums + gain * rates
        x, s = x + step / 6 * total, s + step / 6 * sums
    return x, s
