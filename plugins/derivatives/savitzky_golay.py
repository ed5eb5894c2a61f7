"""The estimator savitzky_golay."""

from spiral.types.derivative import Derivative, Derivatives, at_least, in_range
from spiral.types.errors import ConfigError
from spiral.types.record import Array


class SavitzkyGolay(Derivative):
    """A polynomial around each sample: y(t + s) = sum_k a_k s^k, y' = a_1, y'' = 2 a_2.

    Least squares over a sliding window; exact for polynomials up to its order, and at the ends
    from the first and last window. Errors: the bias of y'' is O((window dt)^(order - 1)), its
    standard deviation falls with window^(-5/2). Source: Savitzky and Golay, Anal. Chem. 36, 1964;
    ``scipy.signal.savgol_filter``.

    Fields
    ------
    window : samples in the window, odd.
    order : degree of the polynomial, at least 2 and less than the window.
    """

    window: int = 31
    order: int = 6

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """y, y', y'' of the polynomials; (N, C) each."""
        from scipy.signal import savgol_filter

        in_range("derivative.order", self.order, 2)
        if self.window % 2 == 0 or self.window <= self.order:
            raise ConfigError(
                f"derivative.window={self.window}, order {self.order}",
                "an odd number of samples greater than the order",
                f"derivative.window={max(self.window, self.order) // 2 * 2 + 1}",
            )
        at_least(y, self.window, "savitzky_golay", f"derivative.window below {self.window}")
        parts = [
            savgol_filter(y, self.window, self.order, deriv=k, delta=dt, axis=0, mode="interp")
            for k in range(3)
        ]
        return Derivatives(*parts, edge=self.window // 2)
