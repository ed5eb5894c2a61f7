"""The estimators fourier and multi_harmonic: a series fitted to the record and differentiated."""

import numpy as np

from spiral.types.derivative import Derivative, Derivatives, at_least, in_range
from spiral.types.errors import ConfigError, InputError
from spiral.types.record import Array


class Fourier(Derivative):
    """y(t) = a_0 + sum_k a_k cos(k w t) + b_k sin(k w t), with the frequency w known.

    Least squares over the whole record, differentiated exactly: no numerical differentiation.
    Errors: exact for a signal in the series; with noise s the variance of y'' is
    s^2 sum_k 2 (k w)^4 / N. Source: the paper, on known harmonic inputs.

    Fields
    ------
    frequency : w / 2 pi in Hz; must be given.
    harmonics : k = 1 ... harmonics.
    """

    frequency: float | None = None
    harmonics: int = 5

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """The series and its derivatives; (N, C) each."""
        if self.frequency is None or not self.frequency > 0:
            raise ConfigError(
                f"derivative.frequency={self.frequency}",
                "the known frequency of the motion in Hz",
                "derivative.frequency=5.0, or derivative=multi_harmonic where speed is an input",
            )
        return _fit_series(y, dt, 2 * np.pi * self.frequency, self.harmonics)


class MultiHarmonic(Derivative):
    """y(t) = a_0 + sum_k a_k cos(k W t) + b_k sin(k W t), with the speed W known and steady.

    The paper's eq. (fourier_fit). W is the mean of the measured speed; a speed that drifts, so
    that the angle leaves W t by more than ``drift``, is refused. Errors: as ``fourier``.

    Fields
    ------
    harmonics : k = 1 ... harmonics.
    drift : largest |integral of (speed - W)| in rad over the record.
    """

    harmonics: int = 5
    drift: float = 0.05

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """The series and its derivatives; (N, C) each."""
        if speed is None:
            raise InputError(
                "a record without speed for multi_harmonic",
                "a known steady speed",
                "derivative=fourier derivative.frequency=HZ",
            )
        steady = float(np.mean(speed))
        off = float(np.abs(np.cumsum(speed - steady)).max() * dt)
        if off > self.drift or steady == 0:
            raise InputError(
                f"a speed between {speed.min():.4g} and {speed.max():.4g} rad/s for multi_harmonic",
                f"a steady one: the angle within {self.drift:g} rad of a constant speed's",
                "derivative=total_variation or derivative=kalman_smoother",
            )
        return _fit_series(y, dt, abs(steady), self.harmonics)


def _fit_series(y: Array, dt: float, omega: float, harmonics: int) -> Derivatives:
    """The least-squares series of angular frequency ``omega`` in rad/s."""
    in_range("derivative.harmonics", harmonics, 1)
    at_least(y, 2 * harmonics + 2, "a series", "fewer derivative.harmonics")
    if harmonics * omega * dt >= np.pi:
        raise ConfigError(
            f"{harmonics} harmonics of {omega / (2 * np.pi):.4g} Hz",
            f"frequencies below half the sample rate, {0.5 / dt:.4g} Hz",
            f"derivative.harmonics={int(np.pi / (omega * dt))}",
        )
    rates = omega * np.arange(1, harmonics + 1)
    angles = dt * np.arange(len(y))[:, None] * rates
    cosine, sine = np.cos(angles), np.sin(angles)
    columns = np.hstack([np.ones((len(y), 1)), cosine, sine])
    solution = np.linalg.lstsq(columns, y, rcond=None)[0]
    a, b = solution[1 : harmonics + 1], solution[harmonics + 1 :]
    by_rate = rates[:, None]
    return Derivatives(
        columns @ solution,
        cosine @ (by_rate * b) - sine @ (by_rate * a),
        -(cosine @ (by_rate**2 * a) + sine @ (by_rate**2 * b)),
    )
