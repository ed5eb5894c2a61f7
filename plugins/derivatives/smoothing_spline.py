"""The estimator smoothing_spline."""

import numpy as np

from spiral.types.derivative import Derivative, Derivatives, at_least, in_range
from spiral.types.record import Array


class SmoothingSpline(Derivative):
    """The cubic spline u that minimises sum (u_k - y_k)^2 + penalty integral u''^2 dt.

    Time counts samples in ``penalty``, which generalised cross-validation finds where it is left
    out. Errors: the penalty is best for y, so y'' keeps more noise than it could; a natural
    spline has y'' = 0 at both ends. Source: Woltring, Adv. Eng. Softw. 8, 1986;
    ``scipy.interpolate.make_smoothing_spline``.

    Fields
    ------
    penalty : the weight in samples^3, or none for cross-validation.
    """

    penalty: float | None = None

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """The spline and its derivatives; (N, C) each."""
        from scipy.interpolate import make_smoothing_spline

        at_least(y, 8, "smoothing_spline")
        if self.penalty is not None:
            in_range("derivative.penalty", self.penalty, 0)
        time = np.arange(len(y), dtype=float)
        splines = [make_smoothing_spline(time, column, lam=self.penalty) for column in y.T]
        parts = [
            np.column_stack([s.derivative(k)(time) if k else s(time) for s in splines]) / dt**k
            for k in range(3)
        ]
        return Derivatives(*parts, edge=20)
