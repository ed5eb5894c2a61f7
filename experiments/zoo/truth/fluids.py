"""Fluid power: a hydraulic cylinder, a control valve.

Numbers: a cylinder of 20 cm^2 that moves 200 kg, oil resonance 15 Hz (Merritt, ch. 6); the control
valve of Garcia 2008 with a softer spring, its stiction within the usual 5 to 20 % of the stroke.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, Steps, steps
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import dry, spring

Array = np.ndarray


def hydraulic_cylinder(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Position, speed (per unit mass), pressure; dry friction of the seals."""
    place, speed, pressure = x
    acceleration = c["oil_column.push"] * pressure - c["load_spring.stiffness"] * place
    acceleration -= c["load_spring.damping"] * speed
    acceleration += dry(c, "seal_friction", speed)
    filling = c["servo_valve.gain"] * u.valve - c["oil_column.relief"] * speed
    filling -= c["piston_leakage.rate"] * pressure
    filling -= c["orifice_leakage.rate"] * abs(pressure) * pressure
    return np.array([speed, acceleration, filling])


def control_valve(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """m x'' = S p - k x - c x' - F tanh(x' / w)."""
    force = c["system.area"] * u.pressure + spring(c, "", x[0], x[1])
    return np.array([x[1], (force + dry(c, "coulomb_friction", x[1])) / c["system.mass"]])


def _valve(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"valve": steps(rng, -1.0, 1.0, 0.08, duration)}


def _pressures(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    """Up and down between 0.4 and 1.6 bar in steps of 60 ms."""
    levels = np.cumsum(rng.normal(0.0, 2.5e4, round(duration / 0.06) + 2))
    folded = 1e5 + 6e4 * np.sin(levels / 6e4)
    folded[0] = 1e5
    return {"pressure": Steps(folded, 0.06)}


MACHINES = (
    Machine(
        "hydraulic_cylinder", "fluids", "hydraulic_cylinder", hydraulic_cylinder,
        {
            "oil_column.push": 10.0,
            "oil_column.relief": 888.0,
            "servo_valve.gain": 266.0,
            "piston_leakage.rate": 8.0,
            "load_spring.stiffness": 400.0,
            "load_spring.damping": 3.0,
        },
        {
            HIDDEN: {"seal_friction.level": 12.0, "seal_friction.width": 0.01},
            HARD: {"orifice_leakage.rate": 8.0},
        },
        _valve, duration=8.0, samples_per_s=500.0,
    ),
    Machine(
        "control_valve", "fluids", "control_valve", control_valve,
        {
            "system.mass": 1.6,
            "system.area": 0.0445,
            "linear_stiffness.stiffness": 2e5,
            "linear_damping.damping": 400.0,
        },
        {
            HIDDEN: {"coulomb_friction.level": 400.0, "coulomb_friction.width": 0.02},
            HARD: {"coulomb_friction.level": 400.0, "coulomb_friction.width": 6e-3},
        },
        _pressures, duration=8.0, samples_per_s=500.0, start={"stem": 1e5 * 0.0445 / 2e5},
    ),
)  # fmt: skip
