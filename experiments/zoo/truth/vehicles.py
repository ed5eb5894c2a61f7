"""Vehicles: a quarter of a car, a crane, a glider's pitch.

Numbers: a middle-class car (Gillespie, Fundamentals of Vehicle Dynamics, ch. 5); a workshop crane
of 20 kg with 10 kg on 1.5 m of rope; a glider whose short period is 0.7 s, damped by some 40 %.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, band_limited, steps
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import drag, dry, spring

Array = np.ndarray


def quarter_car(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Suspension force on body and wheel; a seat with its passenger may sway on the body.

    The seat's states (its spring's deflection e = b - z, and its speed z') come last:
    e' = b' - z', z'' = w^2 e + 2 d w e'.
    """
    body, wheel, body_rate, wheel_rate = x[:4]
    travel, rate = body - wheel, body_rate - wheel_rate
    force = spring(c, "", travel, rate) + drag(c, "quadratic_damping", rate)
    tyre = c["system.tyre_stiffness"] * (u.road - wheel)
    seat: list[float] = []
    on_body = force
    if len(x) > 4:
        turn = 2 * np.pi * c["hidden_mode@body.natural_frequency"]
        ratio = c["hidden_mode@body.damping_ratio"]
        pull = turn**2 * x[4] + 2 * ratio * turn * (body_rate - x[5])
        on_body = force - c["hidden_mode@body.mass"] * pull
        seat = [body_rate - x[5], pull]
    return np.array([body_rate, wheel_rate, on_body / c["system.body_mass"],
                     (tyre - force) / c["system.wheel_mass"], *seat])  # fmt: skip


def crane(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Trolley and pendulum, solved for both accelerations by Cramer's rule."""
    _, angle, speed, turning = x
    trolley, load, rope = (c[f"system.{k}"] for k in ("trolley_mass", "load_mass", "rope"))
    sine, cosine = np.sin(angle), np.cos(angle)
    wind = drag(c, "quadratic_damping@hook", speed + rope * cosine * turning)
    push = u.force + load * rope * sine * turning**2 - c["linear_damping.damping"] * speed
    push += dry(c, "coulomb_friction", speed) + wind
    moment = -load * rope * c["system.gravity"] * sine - c["linear_damping@hoist.damping"] * turning
    moment += wind * rope * cosine
    a, b, d = trolley + load, load * rope * cosine, load * rope**2
    det = a * d - b * b
    return np.array([speed, turning, (d * push - b * moment) / det, (a * moment - b * push) / det])


def glider(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Incidence, pitch rate and elevator; lift gives way by the cube of the incidence."""
    incidence, pitching, elevator = x
    lift = c["lift.slope"] * incidence - c["lift_break.loss"] * incidence**3
    moment = (
        c["pitch_moment.stability"] * incidence
        + c["pitch_moment.damping"] * pitching
        + c["pitch_moment.elevator"] * elevator
    )
    servo = c["elevator_servo.bandwidth"] * (u.stick - elevator)
    return np.array([pitching - lift, -moment, servo])


def _road(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    """Long waves of 12 mm and short ones of 3 mm, rms."""
    long = band_limited(rng, 0.012, (0.4, 3.0), duration)
    short = band_limited(rng, 0.003, (3.0, 18.0), duration)

    def road(time: Array) -> Array:
        return long(time) + short(time)

    return {"road": road}


def _pushed(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"force": band_limited(rng, 60.0, (0.15, 1.5), duration)}


def _stick(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"stick": steps(rng, -0.12, 0.12, 0.6, duration)}


MACHINES = (
    Machine(
        "quarter_car", "vehicles", "quarter_car", quarter_car,
        {
            "system.body_mass": 300.0,
            "system.wheel_mass": 40.0,
            "system.tyre_stiffness": 1.8e5,
            "linear_stiffness.stiffness": 18000.0,
            "linear_damping.damping": 900.0,
        },
        {
            HIDDEN: {"quadratic_damping.damping": 1500.0},
            HARD: {
                "hidden_mode@body.mass": 60.0,
                "hidden_mode@body.natural_frequency": 3.0,
                "hidden_mode@body.damping_ratio": 0.2,
            },
        },
        _road, duration=20.0, samples_per_s=100.0, records=2,
    ),
    Machine(
        "crane", "vehicles", "crane", crane,
        {
            "system.trolley_mass": 20.0,
            "system.load_mass": 10.0,
            "system.rope": 1.5,
            "system.gravity": 9.81,
            "linear_damping.damping": 25.0,
            "linear_damping@hoist.damping": 1.0,
        },
        {
            HIDDEN: {"coulomb_friction.level": 5.0, "coulomb_friction.width": 0.02},
            HARD: {"quadratic_damping@hook.damping": 1.0},
        },
        _pushed, duration=80.0, samples_per_s=50.0, noise=0.005,
    ),
    Machine(
        "glider", "flight", "glider", glider,
        {
            "lift.slope": 3.0,
            "pitch_moment.stability": 60.0,
            "pitch_moment.damping": 3.0,
            "pitch_moment.elevator": 70.0,
            "elevator_servo.bandwidth": 15.0,
        },
        {HIDDEN: {"lift_break.loss": 25.0}},
        _stick, duration=60.0, samples_per_s=50.0,
    ),
)  # fmt: skip
