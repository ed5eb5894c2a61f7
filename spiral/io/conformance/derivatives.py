"""Conformance checks of derivative estimators: each returns what it saw, or raises an error."""

from __future__ import annotations

import numpy as np

from spiral.types.derivative import Derivative, Derivatives, differentiate
from spiral.types.errors import ConfigError, InputError, PluginError
from spiral.types.record import Array

_SAMPLES, _DT, _HZ = 500, 2e-3, 5.0
_TOLERANCE = (0.02, 0.05, 0.2)  # of y, y', y'' relative to their rms, on a sine without noise


def sine_channels() -> tuple[Array, Array]:
    """Two channels of a sine of 5 Hz, 1 s at 500 Hz, and the speed that goes with it."""
    angle = 2 * np.pi * _HZ * _DT * np.arange(_SAMPLES)
    return np.column_stack([np.sin(angle), np.cos(angle)]), np.full(_SAMPLES, 2 * np.pi * _HZ)


def estimate_or_refusal(
    derivative: Derivative, y: Array, speed: Array
) -> Derivatives | InputError | ConfigError:
    """The estimate on the sine, or the refusal."""
    try:
        return differentiate(derivative, y, _DT, speed)
    except (InputError, ConfigError) as error:
        if derivative.plugin_name() in error.given and "gives" in error.given:
            raise
        return error


def check_sine(derivative: Derivative) -> str:
    """y, y' and y'' of a sine, away from its ends; or a refusal that says what to change."""
    y, speed = sine_channels()
    estimate = estimate_or_refusal(derivative, y, speed)
    if isinstance(estimate, Exception):
        return f"refused: {estimate.given}, expected {estimate.expected}"
    if estimate.position.shape != y.shape:
        return f"{estimate.position.shape[1]} coordinates of {y.shape[1]} channels"
    omega = 2 * np.pi * _HZ
    turned = np.column_stack([y[:, 1], -y[:, 0]])
    truths = (y, omega * turned, -(omega**2) * y)
    parts = (estimate.position, estimate.velocity, estimate.acceleration)
    errors = []
    for name, part, truth, allowed in zip(
        ("y", "y'", "y''"), parts, truths, _TOLERANCE, strict=True
    ):
        off = (part - truth)[estimate.inner]
        errors.append(float(np.sqrt(np.mean(off**2) / np.mean(truth**2))))
        if not errors[-1] <= allowed:
            raise PluginError(
                f"{name} of a sine is off by {errors[-1]:.2g}", f"at most {allowed:g} of its rms"
            )
    return "errors " + ", ".join(f"{e:.1e}" for e in errors)


def check_repeatable_estimate(derivative: Derivative) -> str:
    """Two estimates of the same samples are the same numbers, and the samples stay as they are."""
    y, speed = sine_channels()
    before = y.copy()
    once, again = (
        estimate_or_refusal(derivative, y, speed),
        estimate_or_refusal(derivative, y, speed),
    )
    if isinstance(once, Exception) or isinstance(again, Exception):
        return "refused"
    if not np.array_equal(y, before):
        raise PluginError("samples changed in place", "arrays left as they were")
    if not np.array_equal(once.acceleration, again.acceleration):
        raise PluginError("two estimates that differ", "the same numbers each time")
    return "same numbers"
