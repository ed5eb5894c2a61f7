"""The estimator total_variation: Chartrand's regularised differentiation in banded form."""

from math import comb
from typing import Literal

import numpy as np

from spiral.types.derivative import Derivative, Derivatives, at_least, in_range
from spiral.types.record import Array

_DEGREE = {"velocity": 2, "acceleration": 3, "jerk": 4}  # differences that are penalised
_SMOOTH = 1e-3  # of the mean difference: where |d| is rounded off to sqrt(d^2 + e^2)
_HELD = 1e-2  # of the penalty, and of one: the weight of a sample that is held out
_SEARCH = 15  # passes at most for each penalty that is tried
_DECADES = np.arange(-4.0, 8.0)  # of the penalty that cross-validation looks through
_CLOSE, _FINAL = 1e-3, 1e-6  # relative change at which an iteration ends, in and after the search


class TotalVariation(Derivative):
    """min over u of sum_k (u_k - y_k)^2 + penalty sum_k |D^m u|_k, then y' = u', y'' = u''.

    With m = 2, the variation of the velocity v = u', this is the paper's eq. (tv) written in u
    with v = D u / dt; its second derivative is a row of spikes. The usual m = 4 penalises the
    variation of the jerk, so that y'' is a broken line. Solved by Chartrand's lagged diffusivity:
    |d| becomes d^2 / sqrt(d_before^2 + e^2), a banded system for each pass, O(N).
    ``penalty`` is dimensionless (y over its standard deviation, time in samples) and found by
    cross-validation on interleaved samples where left out.
    Errors: the noise must be white for cross-validation to mean anything; y' and y'' of u by
    five-point stencils add (w dt)^4 / 30. Source: R. Chartrand, ISRN Appl. Math. 2011, 164564.

    Fields
    ------
    variation : of what is penalised: velocity (as printed), acceleration or jerk.
    penalty : its weight, or none for cross-validation.
    folds : of the cross-validation.
    passes : of the lagged diffusivity at most.
    """

    variation: Literal["velocity", "acceleration", "jerk"] = "jerk"
    penalty: float | None = None
    folds: int = 5
    passes: int = 50

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """u, u', u'' of each channel; (N, C) each."""
        from scipy.signal import savgol_filter

        in_range("derivative.folds", self.folds, 2)
        in_range("derivative.passes", self.passes, 1)
        at_least(y, 8 * self.folds, "total_variation")
        smooth = np.column_stack([self._regularise_channel(column) for column in y.T])
        parts = [
            savgol_filter(smooth, 5, 4, deriv=k, delta=dt, axis=0, mode="interp") for k in (1, 2)
        ]
        return Derivatives(smooth, *parts, edge=20)

    def _regularise_channel(self, column: Array) -> Array:
        scale = float(np.std(column))
        if scale == 0:
            return column.copy()
        y = (column - column.mean()) / scale
        penalty = self.penalty if self.penalty is not None else cross_validated_penalty(y, self)
        in_range("derivative.penalty", penalty, 0)
        u = minimise_total_variation(
            y, np.ones_like(y), penalty, _DEGREE[self.variation], self.passes
        )
        return column.mean() + scale * u


def cross_validated_penalty(y: Array, settings: TotalVariation) -> float:
    """The penalty that predicts held-out samples of y (N,) best.

    Every ``folds``-th sample is held out in turn; the best decade is refined by golden section.
    Each minimum is looked for from the data: begun from that of another penalty the error would
    depend on the order of the search, and the penalty found on rounding.
    """
    from scipy.optimize import minimize_scalar

    folds, degree = settings.folds, _DEGREE[settings.variation]

    def error(decade: float) -> float:
        total = 0.0
        for fold in range(folds):
            held = slice(fold, None, folds)
            weight = np.ones_like(y)
            weight[held] = _HELD * min(1.0, 10.0**decade)
            u = minimise_total_variation(y, weight, 10.0**decade, degree, _SEARCH, _CLOSE)
            total += float(np.sum((u[held] - y[held]) ** 2))
        return total

    errors = [error(d) for d in _DECADES]
    best = float(_DECADES[int(np.argmin(errors))])
    optimum = minimize_scalar(
        error, bounds=(best - 1.0, best + 1.0), method="bounded", options={"xatol": 0.1}
    )
    return 10.0 ** float(optimum.x if optimum.fun < min(errors) else best)


def minimise_total_variation(
    y: Array,
    weight: Array,
    penalty: float,
    degree: int,
    passes: int,
    close: float = _FINAL,
) -> Array:
    """argmin of sum w (u - y)^2 + penalty sum |D^degree u|, all (N,), by lagged diffusivity.

    Each pass solves for the multipliers z of D u, which stays well posed however heavy the
    penalty: (D W^-1 D^T / 2 + diag(sqrt(d^2 + e^2) / penalty)) z = D y, u = y - W^-1 D^T z / 2.
    """
    from scipy.linalg import solve_banded

    if penalty == 0:
        return y.copy()
    stencil = np.array([(-1.0) ** (degree - i) * comb(degree, i) for i in range(degree + 1)])
    spread = 1.0 / weight
    gram, bent = 0.5 * _banded_gram(stencil, spread), np.convolve(y, stencil[::-1], "valid")
    u: Array | None = None
    for _ in range(passes):
        matrix = gram.copy()
        matrix[degree] += _rounded_magnitude(y if u is None else u, stencil) / penalty
        z = solve_banded((degree, degree), matrix, bent, overwrite_ab=True, check_finite=False)
        next_u = y - 0.5 * spread * np.convolve(z, stencil)
        if u is not None and np.linalg.norm(next_u - u) <= close * np.linalg.norm(next_u):
            return next_u
        u = next_u
    assert u is not None
    return u


def _rounded_magnitude(u: Array, stencil: Array) -> Array:
    """sqrt(d^2 + e^2) of the differences d of u."""
    d = np.convolve(u, stencil[::-1], "valid")
    small = _SMOOTH * float(np.mean(np.abs(d))) + np.finfo(float).tiny
    return np.sqrt(d * d + small * small)


def _banded_gram(stencil: Array, spread: Array) -> Array:
    """D diag(spread) D^T in banded form, (2 degree + 1, N - degree)."""
    degree = len(stencil) - 1
    rows = len(spread) - degree
    bands = np.zeros((2 * degree + 1, rows))
    for offset in range(degree + 1):
        count = rows - offset
        below = np.zeros(count)
        for shared in range(degree + 1 - offset):
            product = stencil[shared + offset] * stencil[shared]
            below += product * spread[offset + shared : offset + shared + count]
        bands[degree + offset, :count] = below
        bands[degree - offset, offset:] = below
    return bands
