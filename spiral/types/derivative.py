"""Derivative estimators: y(t) with noise -> y, y' and y''.

y~(t_k) = y(t_k) + e_k is measured on a uniform grid t_k = k dt; an estimator gives y, y' and y''
at the same instants (the paper's Sect. on derivative estimation, and its Algorithm 1, line 1).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from spiral.types.errors import ConfigError, InputError
from spiral.types.plugin import Plugin
from spiral.types.record import Array


@dataclass(frozen=True)
class Derivatives:
    """y, y' and y'' on the grid of the record.

    Parameters
    ----------
    position : (N, C) smoothed signal, in the unit of y.
    velocity : (N, C) first derivative, in the unit of y per s.
    acceleration : (N, C) second derivative, in the unit of y per s^2.
    edge : samples at each end where the estimate is poorer (one-sided); a regression leaves
        them out.

    C counts the channels given, or the coordinates recovered from them (``shape_functions``).
    """

    position: Array
    velocity: Array
    acceleration: Array
    edge: int = 0

    @property
    def inner(self) -> slice:
        """The samples that are not at an end; all where the record is too short for that."""
        count = len(self.position)
        return slice(self.edge, count - self.edge) if 4 * self.edge < count else slice(None)


class Derivative(Plugin):
    """How y, y' and y'' are estimated from samples of y alone.

    Its fields are the configuration's ``derivative.FIELD``. Callers use ``differentiate``, which
    checks what goes in and what comes out; a plugin may assume checked arrays.
    """

    kind: ClassVar[str] = "derivative"

    @abstractmethod
    def estimate(self, y: Array, dt: float, speed: Array | None = None) -> Derivatives:
        """y, y' and y'' on the grid.

        Parameters
        ----------
        y : (N, C) float samples, finite, one column for each channel.
        dt : sample interval in s, positive.
        speed : (N,) rotation speed in rad/s where it is known.

        Raises
        ------
        InputError : this estimator cannot serve these samples (too few, no steady speed).
        ConfigError : a field that it needs is not set.
        """


def differentiate(
    derivative: Derivative, y: Array, dt: float, speed: Array | None = None
) -> Derivatives:
    """y, y' and y'' of samples by an estimator; what goes in and what comes out is checked.

    Parameters
    ----------
    derivative : the estimator.
    y : (N,) or (N, C) samples; a vector becomes one column.
    dt : sample interval in s.
    speed : (N,) in rad/s, or None.

    Raises
    ------
    InputError : samples that are not finite, a dt that is not positive, a speed of another length;
        or an estimate that is not finite or not on the grid.
    """
    given = np.asarray(y, dtype=float)
    given = given[:, None] if given.ndim == 1 else given
    if given.ndim != 2 or not given.size or not np.isfinite(given).all():
        raise InputError(f"samples of shape {np.shape(y)}", "(N, C) finite numbers")
    if not (np.isfinite(dt) and dt > 0):
        raise InputError(f"dt={dt}", "a positive sample interval in s")
    turning = None if speed is None else np.asarray(speed, dtype=float)
    if turning is not None and turning.shape != given.shape[:1]:
        raise InputError(f"speed of shape {turning.shape}", f"{len(given)} values in rad/s")
    derivatives = derivative.estimate(given, float(dt), turning)
    parts = (derivatives.position, derivatives.velocity, derivatives.acceleration)
    shapes = {np.shape(part) for part in parts}
    if len(shapes) != 1 or len(derivatives.position) != len(given):
        raise InputError(
            f"{derivative.plugin_name()} gives shapes {sorted(shapes)}", f"({len(given)}, C) thrice"
        )
    if not all(np.isfinite(part).all() for part in parts):
        raise InputError(
            f"{derivative.plugin_name()} gives values that are not finite",
            "samples that it can smooth",
            "another derivative=, or another level of smoothing",
        )
    return derivatives


def at_least(y: Array, count: int, name: str, try_: str = "") -> None:
    """Refuse a record too short for an estimator.

    Raises
    ------
    InputError : fewer than ``count`` samples.
    """
    if len(y) < count:
        raise InputError(f"{len(y)} samples for {name}", f"at least {count}", try_)


def in_range(name: str, value: float, low: float, high: float = np.inf) -> None:
    """Refuse a field's value outside [low, high].

    Raises
    ------
    ConfigError : outside.
    """
    if not low <= value <= high:
        upper = "" if high == np.inf else f", at most {high:g}"
        raise ConfigError(f"{name}={value:g}", f"at least {low:g}{upper}")
