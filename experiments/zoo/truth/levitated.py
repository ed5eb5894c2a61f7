"""Machines that stand only by their controller: a magnetic levitator, a ball on a beam.

Numbers: a float of 0.5 kg at 10 mm under 1.2 A; a ball of 0.1 kg on a beam of 0.02 kg m^2, the
closed loop's poles at 4 and 8 rad/s.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, band_limited
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import cubic, drag, dry, spring

Array = np.ndarray


def levitator(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """The float under weight and magnet, the payload on its hanger."""
    place, payload, speed, payload_speed = x
    stretch, rate = payload - place, payload_speed - speed
    hanger = -spring(c, "hanger", stretch, rate) - cubic(c, "cubic_stiffness@hanger", stretch)
    current = c["system.current"] + c["system.proportional"] * place
    current += c["system.derivative"] * speed + u.command
    pull = c["system.magnet"] * (current / (c["system.gap"] + place)) ** 2
    floating, hanging = c["system.float_mass"], c["system.payload_mass"]
    weight = (floating + hanging) * c["system.gravity"]
    on_float = weight - pull + hanger + drag(c, "quadratic_damping", speed)
    return np.array([speed, payload_speed, on_float / floating, -hanger / hanging])


def ball_and_beam(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """7/5 m r'' and (J + m r^2) a'' under weight, controller and dry rolling friction."""
    place, angle, speed, turning = x
    mass, weight = c["system.ball_mass"], c["system.ball_mass"] * c["system.gravity"]
    torque = u.command + c["system.gain_place"] * place + c["system.gain_speed"] * speed
    torque -= c["system.gain_angle"] * angle + c["system.gain_rate"] * turning
    torque += weight * place * (1.0 - np.cos(angle))
    torque -= 2 * mass * place * speed * turning + c["linear_damping@beam.damping"] * turning
    rolling = mass * place * turning**2 - weight * np.sin(angle)
    rolling += dry(c, "coulomb_friction", speed) - c["linear_damping.damping"] * speed
    inertia = c["system.beam_inertia"] + mass * place**2
    return np.array([speed, turning, rolling / (1.4 * mass), torque / inertia])


def _current(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"command": band_limited(rng, 0.05, (0.5, 20.0), duration)}


def _moment(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"command": band_limited(rng, 0.4, (0.1, 2.0), duration)}


MACHINES = (
    Machine(
        "levitator", "electromechanics", "levitator", levitator,
        {
            "system.float_mass": 0.5,
            "system.payload_mass": 0.1,
            "system.magnet": 4.0875e-4,
            "system.gap": 0.01,
            "system.current": 1.2,
            "system.proportional": 240.0,
            "system.derivative": 1.5,
            "system.gravity": 9.81,
            "linear_stiffness@hanger.stiffness": 150.0,
            "linear_damping@hanger.damping": 0.2,
        },
        {
            HIDDEN: {"cubic_stiffness@hanger.stiffness": 1.2e7},
            HARD: {"quadratic_damping.damping": 150.0},
        },
        _current, duration=20.0, samples_per_s=200.0,
    ),
    Machine(
        "ball_and_beam", "electromechanics", "ball_and_beam", ball_and_beam,
        {
            "system.ball_mass": 0.1,
            "system.beam_inertia": 0.02,
            "system.gravity": 9.81,
            "system.gain_place": 2.926,
            "system.gain_speed": 1.536,
            "system.gain_angle": 2.854,
            "system.gain_rate": 0.336,
            "linear_damping.damping": 0.05,
            "linear_damping@beam.damping": 0.05,
        },
        {HIDDEN: {"coulomb_friction.level": 0.03, "coulomb_friction.width": 0.01}},
        _moment, duration=80.0, samples_per_s=50.0,
    ),
)  # fmt: skip
