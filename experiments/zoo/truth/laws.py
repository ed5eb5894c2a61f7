"""Forces of the catalog, by hand: each takes the values of one effect and is zero without them."""

from __future__ import annotations

import numpy as np

from experiments.studies.trajectory import Values

Array = np.ndarray


def cubic(values: Values, label: str, q: float) -> float:
    """-k q^3."""
    return -values[f"{label}.stiffness"] * q * q * q


def dry(values: Values, label: str, v: float) -> float:
    """-F tanh(v / w)."""
    level = values[f"{label}.level"]
    return -level * np.tanh(v / values[f"{label}.width"]) if level else 0.0


def drag(values: Values, label: str, v: float) -> float:
    """-d |v| v."""
    return -values[f"{label}.damping"] * abs(v) * v


def stops(values: Values, label: str, q: float) -> float:
    """-k (|q| - g) sign q where |q| > g, its corner rounded by a parabola over +-w."""
    stiffness = values[f"{label}.stiffness"]
    if not stiffness:
        return 0.0
    depth = rounded(abs(q) - values[f"{label}.gap"], values[f"{label}.width"])
    return -stiffness * depth * np.sign(q)


def rounded(depth: float, width: float) -> float:
    """max(depth, 0); between -w and w the parabola (depth + w)^2 / (4 w) instead."""
    if abs(depth) < width:
        return (depth + width) ** 2 / (4 * width)
    return max(depth, 0.0)


def spring(values: Values, port: str, q: float, v: float) -> float:
    """-k q - c v of the seed's spring and damper at a port; ``port`` empty for the first one."""
    place = f"@{port}" if port else ""
    stiffness = values[f"linear_stiffness{place}.stiffness"]
    damping = values[f"linear_damping{place}.damping"]
    return -stiffness * q - damping * v


def springs(values: Values, port: str, q: Array, v: Array) -> Array:
    """The same of a port with two axes x and y."""
    place = f"@{port}" if port else ""
    k = [values[f"linear_stiffness{place}.stiffness_{axis}"] for axis in "xy"]
    c = [values[f"linear_damping{place}.damping_{axis}"] for axis in "xy"]
    return -np.array(k) * q - np.array(c) * v
