"""Rotors: one in bearings of unequal stiffness, one on a flexible foundation.

Numbers: laboratory rotors of 1 and 2 kg; first critical speeds at 23 and 25 Hz (bearings), and at
30 Hz beside the foundation's 40 to 60 Hz.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, run_of
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import rounded, springs

Array = np.ndarray


def unbalance(u: SimpleNamespace, c: Values, label: str = "unbalance") -> Array:
    """U W^2 (cos t, sin t) + U W' (sin t, -cos t), t = phase + origin."""
    angle = u.phase + c["system.phase_origin"]
    radial = np.array([np.cos(angle), np.sin(angle)])
    tangential = np.array([radial[1], -radial[0]])
    return c[f"{label}.moment"] * (u.speed**2 * radial + u.speed_rate * tangential)


def anisotropic_rotor(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Disk and bearing housing, two axes each; a bearing that hardens, or a seal at the disk."""
    disk, housing, disk_rate, housing_rate = x[:2], x[2:4], x[4:6], x[6:8]
    shaft = springs(c, "shaft", disk - housing, np.zeros(2))
    seal = -c["cross_coupled_stiffness.stiffness"] * np.array([disk[1], -disk[0]])
    damping = [c["linear_damping.damping_x"], c["linear_damping.damping_y"]]
    on_disk = shaft + seal + unbalance(u, c) - np.array(damping) * disk_rate
    hardening = c["cubic_stiffness@bearing.stiffness"] * (housing @ housing) * housing
    on_housing = springs(c, "bearing", housing, housing_rate) - shaft - hardening
    return np.concatenate([disk_rate, housing_rate, on_disk / c["system.disk_mass"],
                           on_housing / c["system.housing_mass"]])  # fmt: skip


def foundation_rotor(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Rotor against foundation, and the foundation: m (r'' + b'') = F + U, m_b b'' = F_b - F."""
    gap, base, gap_rate, base_rate = x[:2], x[2:4], x[4:6], x[6:8]
    radius = float(np.hypot(*gap))
    touch = c["rub.stiffness"] * rounded(radius - c["rub.gap"], c["rub.width"])
    push = springs(c, "", gap, gap_rate) - (touch * gap / radius if touch else 0.0)
    hardening = c["cubic_stiffness@base.stiffness"] * (base @ base) * base
    below = springs(c, "base", base, base_rate) - hardening
    absolute = (push + unbalance(u, c, "unbalance@rotor")) / c["system.rotor_mass"]
    fit_state = (below - push) / c["system.base_mass"]
    return np.concatenate([gap_rate, base_rate, absolute - fit_state, fit_state])


def _run_up(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return run_of(10.0, float(rng.uniform(55.0, 65.0)), duration)


def _run_down(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return run_of(float(rng.uniform(65.0, 75.0)), 8.0, duration)


MACHINES = (
    Machine(
        "anisotropic_rotor", "rotors", "anisotropic_rotor", anisotropic_rotor,
        {
            "system.phase_origin": 0.4,
            "system.disk_mass": 1.0,
            "system.housing_mass": 0.2,
            "linear_damping.damping_x": 4.0,
            "linear_damping.damping_y": 4.0,
            "unbalance.moment": 2e-5,
            "linear_stiffness@shaft.stiffness_x": 4e4,
            "linear_stiffness@shaft.stiffness_y": 4e4,
            "linear_stiffness@bearing.stiffness_x": 6e4,
            "linear_stiffness@bearing.stiffness_y": 9e4,
            "linear_damping@bearing.damping_x": 30.0,
            "linear_damping@bearing.damping_y": 30.0,
        },
        {
            HIDDEN: {"cubic_stiffness@bearing.stiffness": 4e11},
            HARD: {"cross_coupled_stiffness.stiffness": 400.0},
        },
        _run_up, duration=10.0, samples_per_s=500.0,
    ),
    Machine(
        "foundation_rotor", "rotors", "foundation_rotor", foundation_rotor,
        {
            "system.phase_origin": 1.3,
            "system.rotor_mass": 2.0,
            "system.base_mass": 10.0,
            "linear_stiffness.stiffness_x": 8e4,
            "linear_stiffness.stiffness_y": 8e4,
            "linear_damping.damping_x": 20.0,
            "linear_damping.damping_y": 20.0,
            "unbalance@rotor.moment": 6e-5,
            "linear_stiffness@base.stiffness_x": 1.4e6,
            "linear_stiffness@base.stiffness_y": 8e5,
            "linear_damping@base.damping_x": 200.0,
            "linear_damping@base.damping_y": 200.0,
        },
        {
            HIDDEN: {"rub.stiffness": 2e4, "rub.gap": 3.4e-4, "rub.width": 1e-5},
            HARD: {"cubic_stiffness@base.stiffness": 3e13},
        },
        _run_down, duration=10.0, samples_per_s=500.0,
    ),
)  # fmt: skip
