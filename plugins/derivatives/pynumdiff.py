"""The estimator pynumdiff: any method of the PyNumDiff library."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from spiral.types.derivative import Derivative, Derivatives, at_least
from spiral.types.errors import ConfigError, InputError, did_you_mean
from spiral.types.record import Array

_USUAL: dict[str, dict[str, Any]] = {
    "butterdiff": {"filter_order": 4, "cutoff_freq": 0.2},
    "kerneldiff": {"kernel": "gaussian", "window_size": 15},
    "polydiff": {"degree": 5, "window_size": 31, "stride": 5},
    "rtsdiff": {"order": 3, "log_qr_ratio": -2.0},
    "savgoldiff": {"degree": 4, "window_size": 31, "smoothing_win": 5},
    "spectraldiff": {"cutoff_freq": 0.1},
}


class Pynumdiff(Derivative):
    """(y, y') = method(y~), then (y', y'') = method(y'): a method of PyNumDiff applied twice.

    Errors: those of the method. Time counts samples in ``options``; where these are left out,
    usual ones are taken for the methods that need some. Source: Van Breugel, Kutz and Brunton,
    IEEE Access 8, 2020; https://pynumdiff.readthedocs.io.

    Fields
    ------
    method : a function of pynumdiff: rtsdiff, savgoldiff, butterdiff, spectraldiff, ...
    options : its arguments by name.
    """

    method: str = "rtsdiff"
    options: Mapping[str, Any] | None = None

    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """y, y', y'' of each channel; (N, C) each."""
        at_least(y, 32, "pynumdiff")
        method = _pynumdiff_function(self.method)
        options = dict(_USUAL.get(self.method, {}) if self.options is None else self.options)
        parts = [self._differentiate_channel(method, column, dt, options) for column in y.T]
        position, velocity, acceleration = (np.column_stack(p) for p in zip(*parts, strict=True))
        return Derivatives(position, velocity, acceleration, edge=len(y) // 20)

    def _differentiate_channel(
        self, method: Callable[..., Any], column: Array, dt: float, options: Mapping[str, Any]
    ) -> tuple[Array, Array, Array]:
        try:
            position, velocity = method(column.copy(), 1.0, **options)
            twice = method(velocity.copy(), 1.0, **options)[1]
            return position, velocity / dt, twice / dt**2
        except TypeError as error:
            given = ", ".join(f"{k}={v}" for k, v in options.items()) or "no options"
            raise ConfigError(
                f"pynumdiff.{self.method} with {given}: {error}",
                f"its arguments: {inspect.signature(method)}",
                "derivative.options='{NAME: VALUE}'",
            ) from error
        except (ValueError, np.linalg.LinAlgError) as error:
            raise InputError(f"pynumdiff.{self.method}: {error}", "samples it can use") from error


def _pynumdiff_function(name: str) -> Callable[..., Any]:
    """A function of pynumdiff, imported when first needed."""
    import warnings

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about solvers that are not installed
            import pynumdiff
    except ImportError as error:
        raise ConfigError(
            "derivative=pynumdiff, which is not installed",
            "the package pynumdiff",
            "pip install 'spiral-po[derivatives]', or derivative=kalman_smoother",
        ) from error
    known = {n for n in dir(pynumdiff) if n.endswith("diff") and callable(getattr(pynumdiff, n))}
    if name not in known:
        raise ConfigError(
            f"derivative.method={name}",
            f"one of {', '.join(sorted(known))}",
            did_you_mean(name, known),
        )
    return getattr(pynumdiff, name)
