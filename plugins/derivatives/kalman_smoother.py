"""The estimator kalman_smoother."""

from math import factorial
from typing import Any

import numpy as np

from spiral.types.derivative import Derivative, Derivatives, at_least, in_range
from spiral.types.record import Array

_DECADES = (-24.0, 6.0)  # of the ratio that the likelihood looks through


class KalmanSmoother(Derivative):
    """d^m y / dt^m = white noise of intensity q, y~ = y + e with variance r: E[y, y', y'' | y~].

    An exact filter and smoother over (y, y', ..., y^(m-1)), started without prior knowledge.
    ``ratio`` q / r, with time in samples, is the most likely one where left out. With m = 2 it
    is the cubic smoothing spline of penalty r / q, with m = 3 the quintic one (Wahba 1978).
    Errors: the model has no resonance, so the sharpest part of a record sets the smoothing.
    Source: Rauch, Tung and Striebel 1965; ``statsmodels.tsa.statespace``.

    Fields
    ------
    order : m, at least 3 so that y'' is a state.
    ratio : q / r, or none for the most likely.
    """

    order: int = 4
    ratio: float | None = None

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """The smoothed states; (N, C) each."""
        in_range("derivative.order", self.order, 3, 6)
        at_least(y, 4 * self.order, "kalman_smoother")
        states = np.stack([self._smooth_channel(column) for column in y.T], axis=2)
        return Derivatives(*(states[k] / dt**k for k in range(3)), edge=20)

    def _smooth_channel(self, column: Array) -> Array:
        """(order, N) smoothed states of one channel, time in samples."""
        scale = float(np.std(column)) or 1.0
        filter_ = _state_space_model((column - column[0]) / scale, self.order)
        noise = filter_["state_cov"].copy()
        decade = _most_likely_decade(filter_, noise) if self.ratio is None else np.log10(self.ratio)
        filter_["state_cov"] = 10.0**decade * noise
        states = scale * np.array(filter_.smooth().smoothed_state)
        states[0] += column[0]
        return states


def _state_space_model(y: Array, order: int) -> Any:
    """The state-space model of y (N,) with q = r = 1 and unit steps."""
    from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother as Smoother

    model = Smoother(k_endog=1, k_states=order, k_posdef=order)
    model.bind(np.ascontiguousarray(y[:, None]))
    rows = range(order)
    model["transition"] = np.array(
        [[1.0 / factorial(j - i) if j >= i else 0.0 for j in rows] for i in rows]
    )
    left = [order - 1 - i for i in rows]  # powers of the remaining time
    model["state_cov"] = np.array(
        [[1.0 / ((a + b + 1) * factorial(a) * factorial(b)) for b in left] for a in left]
    )
    model["selection"] = np.eye(order)
    model["design"] = np.eye(order)[:1]
    model["obs_cov"] = np.ones((1, 1))
    model.initialize_diffuse()
    model.filter_concentrated = True  # the common scale of q and r is not searched for
    return model


def _most_likely_decade(model: Any, noise: Array) -> float:
    """log10 of the most likely q / r."""
    from scipy.optimize import minimize_scalar

    def negative_log_likelihood(decade: float) -> float:
        model["state_cov"] = 10.0**decade * noise
        return -float(model.loglike())

    grid = np.arange(*_DECADES, 2.0)
    best = float(grid[int(np.argmin([negative_log_likelihood(d) for d in grid]))])
    optimum = minimize_scalar(
        negative_log_likelihood,
        bounds=(best - 2.0, best + 2.0),
        method="bounded",
        options={"xatol": 0.02},
    )
    return float(optimum.x)
