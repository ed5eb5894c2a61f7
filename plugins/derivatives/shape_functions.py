"""The estimator shape_functions: several measurement planes, solved for the coordinates."""

import numpy as np
from spiral_plugins.derivatives.kalman_smoother import KalmanSmoother

from spiral.types.derivative import Derivative, Derivatives, differentiate
from spiral.types.errors import ConfigError, InputError
from spiral.types.record import Array


class ShapeFunctions(Derivative):
    """y(t) = S q(t) at several planes, so q = S^+ y with no differentiation at all.

    Row i of S holds what channel i reads of each coordinate. A rigid rotor measured in x at the
    distances z_1 and z_2 from its disk has S = [[1, z_1], [1, z_2]] and q = (x, tilt): the tilt
    is then measured, not hidden. q' and q'' come from another estimator applied to q.
    Errors: noise in q is that of y times the rows of S^+; planes close together amplify it.
    Source: the paper, on measurements at several spatial locations.

    Fields
    ------
    shapes : S, one row for each channel, one column for each coordinate.
    inner : the estimator of q' and q''.
    """

    shapes: tuple[tuple[float, ...], ...] = ()
    inner: Derivative = KalmanSmoother()

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """q, q', q''; (N, coordinates) each."""
        coordinates = y @ np.linalg.pinv(self._shape_matrix(y.shape[1])).T
        return differentiate(self.inner, coordinates, dt, speed)

    def _shape_matrix(self, channels: int) -> Array:
        """S, checked: a row for each channel and as many independent columns as it has."""
        widths = {len(row) for row in self.shapes}
        if len(widths) != 1 or widths == {0}:
            raise ConfigError(
                f"derivative.shapes={[list(r) for r in self.shapes]}",
                "one row for each channel, all of one length",
                "derivative.shapes='[[1, 0.1], [1, -0.2]]'",
            )
        matrix = np.array(self.shapes, dtype=float)
        if len(matrix) != channels:
            raise InputError(
                f"shapes of {len(matrix)} channels for {channels}", "a row for each channel"
            )
        if np.linalg.matrix_rank(matrix) < matrix.shape[1]:
            raise ConfigError(
                f"{matrix.shape[1]} coordinates from {channels} planes that do not tell them apart",
                "at least as many planes as coordinates, at different places",
                "another plane, or fewer columns in derivative.shapes",
            )
        return matrix
