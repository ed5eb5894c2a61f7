"""Machines with a law that the catalog is made not to know, and their motion by DOP853.

Every equation is written here once more, by hand; ``missing`` is what the model lacks. Sizes are
drawn for every record from the ranges given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.studies.signals import Signal, band_limited
from experiments.studies.trajectory import trajectory

Array = np.ndarray
Drawn = dict[str, float]


@dataclass(frozen=True)
class Case:
    """A machine as a user has it, and the law that is missing.

    Parameters
    ----------
    known : time derivatives of the model without the law, by (states, input, values).
    missing : what the law adds to them. draw : its numbers. values : the machine's, with units.
    right : labels of which each has the law's closed form. without : what the catalog is not to
        know. force : rms and band in Hz of the input, its mean and its unit.
    """

    states: Mapping[str, str]
    values: Mapping[str, tuple[float, str]]
    free: tuple[str, ...]
    known: Callable[[Any, Any, Any], list[Any]]
    missing: Callable[[Array, Drawn], list[Any]]
    draw: Callable[[np.random.Generator], Drawn]
    right: tuple[str, ...]
    without: tuple[str, ...]
    force: tuple[float, tuple[float, float], float, str]
    duration: float = 25.0
    rate: float = 100.0


def _mass(x: Any, u: Any, p: Any) -> list[Any]:
    """1 kg on 400 N/m and 4 N s/m, pushed."""
    q, v = x
    return [v, (u - p["c"] * v - p["k"] * q) / p["m"]]


def _pendulum(x: Any, u: Any, p: Any) -> list[Any]:
    """A balanced arm on a spring: J q'' = u - c q' - k q."""
    q, v = x
    return [v, (u - p["c"] * v - p["k"] * q) / p["J"]]


def _vessel(x: Any, u: Any, p: Any) -> list[Any]:
    """A store that is filled and leaks: s' = b u - r s."""
    (s,) = x
    return [p["b"] * u - p["r"] * s]


_SPRING = {"m": (1.0, "kg"), "c": (4.0, "N*s/m"), "k": (400.0, "N/m")}
_LINE = {"q": "m", "v": "m/s"}
_PUSH = (2.5, (0.2, 8.0), 0.0, "N")


def _on(count: int, force: Callable[[Array, Drawn], Any]) -> Callable[[Array, Drawn], list[Any]]:
    """A force on the last of so many rates."""
    return lambda x, d: [0.0] * (count - 1) + [force(x, d)]


CASES = {
    "stribeck": Case(
        _LINE, _SPRING, ("c", "k"), _mass,
        _on(2, lambda x, d: -(d["a"] + d["b"] * np.exp(-((x[1] / d["c"]) ** 2)))
            * np.tanh(x[1] / d["l"])),
        lambda r: {"a": r.uniform(0.3, 0.6), "b": r.uniform(0.4, 0.8),
                   "c": r.uniform(0.03, 0.06), "l": 0.004},
        ("stribeck_law",),
        ("coulomb_friction", "stribeck_friction", "bouc_wen", "jenkins"),
        _PUSH,
    ),
    "magnet": Case(
        _LINE, _SPRING, ("c", "k"), _mass,
        _on(2, lambda x, d: d["f"] / (1 - x[0] / d["g"]) ** 2 - d["f"]),
        lambda r: {"f": r.uniform(1.5, 3.0), "g": r.uniform(0.05, 0.06)},
        ("inverse_square_law",), (), (1.2, (0.2, 8.0), 0.0, "N"),
    ),
    "dead_zone": Case(
        _LINE, _SPRING, ("c", "k"), _mass,
        _on(2, lambda x, d: -d["k"] * (np.maximum(x[0] - d["g"], 0)
                                       - np.maximum(-x[0] - d["g"], 0))),
        lambda r: {"k": r.uniform(150, 400), "g": r.uniform(0.004, 0.01)},
        ("dead_zone_law", "saturation_law"), ("clearance", "stop"), _PUSH,
    ),
    "hill": Case(
        {"s": "g/l"}, {"b": (1.0, "1/s"), "r": (0.05, "1/s")}, ("b", "r"), _vessel,
        _on(1, lambda x, d: -d["a"] * np.abs(x[0]) ** d["n"]
            / (d["K"] ** d["n"] + np.abs(x[0]) ** d["n"])),
        lambda r: {"a": r.uniform(0.6, 0.9), "n": r.uniform(2.5, 4.0), "K": r.uniform(1.0, 1.6)},
        ("hill_law_s@s",), (), (0.35, (0.005, 0.4), 0.6, "g/l"), 250.0, 10.0,
    ),
    "double_angle": Case(
        {"q": "rad", "v": "rad/s"},
        {"J": (0.02, "kg*m^2"), "c": (0.02, "N*m*s/rad"), "k": (0.3, "N*m/rad")}, ("c", "k"),
        _pendulum,
        _on(2, lambda x, d: -d["a"] * np.sin(2 * x[0])),
        lambda r: {"a": r.uniform(0.06, 0.14)},
        ("sine_law",), ("cogging", "gravity_torque"), (0.25, (0.1, 3.0), 0.0, "N*m"), 50.0, 50.0,
    ),
    "bump": Case(
        _LINE, _SPRING, ("c", "k"), _mass,
        _on(2, lambda x, d: -d["k"] * x[0] * np.exp(-((x[0] / d["l"]) ** 2))),
        lambda r: {"k": r.uniform(200, 400), "l": r.uniform(0.005, 0.01)}, (), (), _PUSH,
    ),
    "worn": Case(
        _LINE, _SPRING, ("c", "k"), _mass,
        _on(2, lambda x, d: -d["a"] * (1 + np.sin(x[0] / d["l"])) * np.tanh(x[1] / 0.004)),
        lambda r: {"a": r.uniform(0.3, 0.6), "l": r.uniform(0.004, 0.008)}, (), (), _PUSH,
    ),
}  # fmt: skip
UNLISTED = tuple(name for name, case in CASES.items() if not case.right)
"""Laws that are no named one: there is no right name, and any is wrong."""


def draw(name: str, seed: int) -> tuple[Drawn, np.random.Generator]:
    """The law's numbers of a seed, and what draws all else."""
    rng = np.random.default_rng([seed, list(CASES).index(name)])
    return CASES[name].draw(rng), rng


def motion(
    case: Case, drawn: Drawn, share: float, rng: np.random.Generator, part: float = 1.0
) -> tuple[Array, Array, Array]:
    """(time, states, input) of a record; the law is there to ``share``."""
    rms, band, mean, _ = case.force
    duration = part * case.duration
    signal: Signal = band_limited(rng, rms, band, duration, mean)
    p = {k: v for k, (v, _) in case.values.items()}
    inertia = next(iter(p.values())) if len(case.states) > 1 else 1.0

    def rate(x: Array, u: Any, values: Any) -> Array:
        law = case.missing(x, drawn)
        known = case.known(x, u.force, p)
        return np.array([a + share * b / inertia for a, b in zip(known, law, strict=True)])

    time = np.arange(round(duration * case.rate)) / case.rate
    start = np.full(len(case.states), mean / 2)
    return time, trajectory(rate, start, time, {"force": signal}, {}), signal(time)
