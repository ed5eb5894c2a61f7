"""Heat: a counterflow heat exchanger, a heated box.

Numbers: residence times of 10 s in each cell of the exchanger; a box of 2 kJ/K of air and fittings
in walls of 20 kJ/K under up to 400 W.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, steps
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine

Array = np.ndarray


def heat_exchanger(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Hot, wall and cold in two cells each; heat lost from the wall or from the cold stream."""
    hot, wall, cold = x[:2], x[2:4], x[4:]
    before_hot = np.array([u.hot_inlet, hot[0]])
    before_cold = np.array([cold[1], 0.0])
    hot_rate = c["hot_stream.exchange"] * (before_hot - hot)
    hot_rate = hot_rate - c["hot_transfer.cooling"] * (hot - wall)
    wall_rate = c["hot_transfer.heating"] * (hot - wall) - c["cold_transfer.cooling"] * (
        wall - cold
    )
    wall_rate = wall_rate - c["shell_loss.rate"] * wall
    cold_rate = c["cold_stream.exchange"] * u.cold_flow * (before_cold - cold)
    cold_rate = cold_rate + c["cold_transfer.heating"] * (wall - cold) - c["cold_loss.rate"] * cold
    return np.concatenate([hot_rate, wall_rate, cold_rate])


def thermal_box(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Air and wall; the wall radiates, or sheds heat by free convection."""
    air, wall = x
    passed = air - wall
    room = c["wall_radiation.room"]
    radiated = c["wall_radiation.rate"] * ((room + wall) ** 4 - room**4)
    shed = c["free_convection.rate"] * abs(wall) ** 0.25 * wall
    return np.array([
        c["heater.gain"] * u.heating - c["wall_transfer.cooling"] * passed,
        c["wall_transfer.heating"] * passed - c["wall_loss.rate"] * wall - radiated - shed,
    ])  # fmt: skip


def _streams(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {
        "hot_inlet": steps(rng, 30.0, 70.0, 70.0, duration),
        "cold_flow": steps(rng, 0.4, 1.6, 50.0, duration),
    }


def _heating(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"heating": steps(rng, 0.0, 400.0, 900.0, duration)}


MACHINES = (
    Machine(
        "heat_exchanger", "thermal", "heat_exchanger", heat_exchanger,
        {
            "hot_stream.exchange": 0.1,
            "cold_stream.exchange": 0.08,
            "hot_transfer.cooling": 0.06,
            "hot_transfer.heating": 0.05,
            "cold_transfer.cooling": 0.05,
            "cold_transfer.heating": 0.06,
        },
        {
            HIDDEN: {"shell_loss.rate": 0.004},
            HARD: {"cold_loss.rate": 0.008},
        },
        _streams, duration=3000.0, samples_per_s=1.0,
    ),
    Machine(
        "thermal_box", "thermal", "thermal_box", thermal_box,
        {
            "heater.gain": 5e-4,
            "wall_transfer.cooling": 0.01,
            "wall_transfer.heating": 0.001,
            "wall_loss.rate": 0.00025,
        },
        {
            HIDDEN: {"wall_radiation.rate": 2.5e-13, "wall_radiation.room": 293.0},
            HARD: {"free_convection.rate": 1.2e-5},
        },
        _heating, duration=40000.0, samples_per_s=0.1,
    ),
)  # fmt: skip
