"""Drives: a belt, a soft shaft, a sprung gear pair.

Numbers: servo motors of some hundred watts with loads of a few times their inertia; the first
resonance at 16 (belt), 19 (shaft) and 130 Hz (gears). A position
controller holds two of them like a spring. Encoders read to 0.2 to 0.5 % of the motion.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, band_limited
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import cubic, drag, dry, spring, stops

Array = np.ndarray


def belt_drive(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Belt force F on both pulleys; the fan's drag grows with the square of its speed."""
    motor, fan, motor_rate, fan_rate = x
    first, second = c["system.motor_radius"], c["system.fan_radius"]
    stretch = first * motor - second * fan
    rate = first * motor_rate - second * fan_rate
    force = -spring(c, "belt", stretch, rate) - cubic(c, "cubic_stiffness@belt", stretch)
    on_motor = u.torque - first * force - c["linear_damping.damping"] * motor_rate
    on_fan = second * force - c["linear_damping@fan.damping"] * fan_rate
    on_fan += drag(c, "quadratic_damping@fan", fan_rate)
    return np.array([motor_rate, fan_rate, on_motor / c["system.motor_inertia"],
                     on_fan / c["system.fan_inertia"]])  # fmt: skip


def two_mass_drive(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Twist b - a of the shaft; dry friction at the load, or stops in the coupling."""
    motor, load, motor_rate, load_rate = x
    twist, rate = load - motor, load_rate - motor_rate
    moment = -spring(c, "shaft", twist, rate) - stops(c, "clearance@shaft", twist)
    on_motor = u.torque + moment + spring(c, "", motor, motor_rate)
    on_load = -moment + dry(c, "coulomb_friction@load", load_rate)
    return np.array([motor_rate, load_rate, on_motor / c["system.motor_inertia"],
                     on_load / c["system.load_inertia"]])  # fmt: skip


def gear_pair(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """The mesh slips by s = r1 a - r2 b against springs; beyond a gap the teeth touch."""
    pinion, gear, pinion_rate, gear_rate = x
    first, second = c["system.pinion_radius"], c["system.gear_radius"]
    slip = first * pinion - second * gear
    rate = first * pinion_rate - second * gear_rate
    force = -spring(c, "mesh", slip, rate) - stops(c, "clearance@mesh", slip)
    on_pinion = u.torque - first * force + spring(c, "", pinion, pinion_rate)
    on_gear = second * force - c["linear_damping@gear.damping"] * gear_rate
    return np.array([pinion_rate, gear_rate, on_pinion / c["system.pinion_inertia"],
                     on_gear / c["system.gear_inertia"]])  # fmt: skip


def _torque(rms: float, low: float, high: float):
    def excite(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
        return {"torque": band_limited(rng, rms, (low, high), duration)}

    return excite


MACHINES = (
    Machine(
        "belt_drive", "drives", "belt_drive", belt_drive,
        {
            "system.motor_inertia": 0.01,
            "system.fan_inertia": 0.04,
            "system.motor_radius": 0.05,
            "system.fan_radius": 0.1,
            "linear_damping.damping": 0.02,
            "linear_damping@fan.damping": 0.02,
            "linear_stiffness@belt.stiffness": 2e4,
            "linear_damping@belt.damping": 20.0,
        },
        {
            HIDDEN: {"quadratic_damping@fan.damping": 0.005},
            HARD: {"cubic_stiffness@belt.stiffness": 8e9},
        },
        _torque(1.0, 1.0, 25.0), duration=20.0, samples_per_s=200.0, noise=0.002,
    ),
    Machine(
        "two_mass_drive", "drives", "two_mass_drive", two_mass_drive,
        {
            "system.motor_inertia": 0.02,
            "system.load_inertia": 0.05,
            "linear_stiffness.stiffness": 20.0,
            "linear_damping.damping": 0.5,
            "linear_stiffness@shaft.stiffness": 200.0,
            "linear_damping@shaft.damping": 0.1,
        },
        {
            HIDDEN: {"coulomb_friction@load.level": 0.2, "coulomb_friction@load.width": 0.05},
            HARD: {
                "clearance@shaft.stiffness": 400.0,
                "clearance@shaft.gap": 0.015,
                "clearance@shaft.width": 1e-3,
            },
        },
        _torque(3.0, 1.0, 30.0), duration=20.0, samples_per_s=200.0, noise=0.005,
    ),
    Machine(
        "gear_pair", "drives", "gear_pair", gear_pair,
        {
            "system.pinion_inertia": 1e-3,
            "system.gear_inertia": 8e-3,
            "system.pinion_radius": 0.03,
            "system.gear_radius": 0.06,
            "linear_stiffness.stiffness": 100.0,
            "linear_damping.damping": 0.15,
            "linear_damping@gear.damping": 0.05,
            "linear_stiffness@mesh.stiffness": 5e5,
            "linear_damping@mesh.damping": 60.0,
        },
        {
            HIDDEN: {
                "clearance@mesh.stiffness": 2e6,
                "clearance@mesh.gap": 1.6e-4,
                "clearance@mesh.width": 1e-5,
            },
        },
        _torque(2.0, 20.0, 250.0), duration=2.0, samples_per_s=2000.0, noise=0.002,
    ),
)  # fmt: skip
