"""Chains of masses, a building, and a self-excited oscillator.

Numbers: chains as a laboratory would build them (masses of half a kilogram to one, steel springs of
some kN/m, first modes at 1 to 4 Hz); the building after Chopra's examples of shear frames (storeys
of 30 t, first mode 1.9 Hz, damping some 2 %); van der Pol's oscillator at 1 Hz.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, band_limited
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import cubic, dry, spring, stops

Array = np.ndarray


def four_masses(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Four masses: each is pulled by the spring behind it and the one ahead."""
    q, v = x[:4], x[4:]
    mount = spring(c, "", q[0], v[0])
    links = []
    for i, port in enumerate(("link_12", "link_23", "link_34")):
        d, s = q[i + 1] - q[i], v[i + 1] - v[i]
        links.append(
            -spring(c, port, d, s)
            - cubic(c, f"cubic_stiffness@{port}", d)
            - stops(c, f"clearance@{port}", d)
        )
    force = np.array([mount + u.force + links[0], links[1] - links[0], links[2] - links[1],
                      -links[2]])  # fmt: skip
    return np.concatenate([v, force / c["system.mass"]])


def mass_chain(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """n equal masses on equal links; a cubic spring in the middle or dry friction at the end."""
    n = len(x) // 2
    q, v = x[:n], x[n:]
    link = c["system.stiffness"] * np.diff(q) + c["system.damping"] * np.diff(v)
    half = n // 2
    link[half - 1] -= cubic(c, "cubic_stiffness@middle", q[half] - q[half - 1])
    link[-1] -= dry(c, "coulomb_friction@end", v[-1] - v[-2])
    force = np.zeros(n)
    force[0] = u.force + spring(c, "", q[0], v[0])
    force[:-1] += link
    force[1:] -= link
    return np.concatenate([v, force / c["system.mass"]])


def shear_building(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Five floors on a shaken ground: the shear of each storey holds the floors above it."""
    q, v = x[:5], x[5:]
    drift, rate = np.diff(q, prepend=0.0), np.diff(v, prepend=0.0)
    shear = np.empty(6)
    shear[5] = 0.0
    for i in range(5):
        port = f"storey_{i + 1}" if i else ""
        shear[i] = spring(c, port, drift[i], rate[i])
    shear[0] += dry(c, "coulomb_friction", rate[0])
    shear[2] += stops(c, "clearance@storey_3", drift[2])
    return np.concatenate([v, (shear[:5] - shear[1:]) / c["system.mass"] - u.ground])


def van_der_pol(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """x'' = F + c x' - a x^2 x' - k x - k3 x^3 for a mass of one."""
    q, v = x
    damping = c["linear_damping.damping"] + c["amplitude_damping.damping"] * q * q
    force = u.force - damping * v - c["linear_stiffness.stiffness"] * q
    force += cubic(c, "cubic_stiffness", q)
    return np.array([v, force / c["system.mass"]])


def _hammered(rms: float, low: float, high: float, name: str = "force"):
    def excite(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
        return {name: band_limited(rng, rms, (low, high), duration)}

    return excite


_LINKS = ("link_12", "link_23", "link_34")
_CHAIN = {
    "system.mass": 0.5,
    "system.stiffness": 4000.0,
    "system.damping": 1.0,
    "linear_stiffness.stiffness": 4000.0,
    "linear_damping.damping": 2.0,
}

MACHINES = (
    Machine(
        "chain_4", "structures", "four_masses", four_masses,
        {
            "system.mass": 1.0,
            "linear_stiffness.stiffness": 4000.0,
            "linear_damping.damping": 4.0,
            **{f"linear_stiffness@{k}.stiffness": 3000.0 for k in _LINKS},
            **{f"linear_damping@{k}.damping": 2.0 for k in _LINKS},
        },
        {
            HIDDEN: {"cubic_stiffness@link_12.stiffness": 6e6},
            HARD: {
                "clearance@link_34.stiffness": 2000.0,
                "clearance@link_34.gap": 6e-3,
                "clearance@link_34.width": 1e-4,
            },
        },
        _hammered(10.0, 0.5, 25.0), duration=20.0, samples_per_s=200.0,
    ),
    Machine(
        "chain_8", "structures", "mass_chain", mass_chain, _CHAIN,
        {
            HIDDEN: {"cubic_stiffness@middle.stiffness": 2e7},
            HARD: {"coulomb_friction@end.level": 0.3, "coulomb_friction@end.width": 3e-3},
        },
        _hammered(8.0, 0.5, 25.0), duration=20.0, samples_per_s=200.0, fields={"masses": 8},
        free=("system.stiffness", "system.damping"),
    ),
    Machine(
        "chain_12", "structures", "mass_chain", mass_chain, _CHAIN,
        {HIDDEN: {"cubic_stiffness@middle.stiffness": 2e7}},
        _hammered(8.0, 0.5, 25.0), duration=20.0, samples_per_s=200.0, fields={"masses": 12},
        free=("system.stiffness", "system.damping"),
    ),
    Machine(
        "shear_building", "structures", "shear_building", shear_building,
        {
            "system.mass": 3e4,
            "linear_stiffness.stiffness": 6e7,
            "linear_damping.damping": 2e5,
            **{f"linear_stiffness@storey_{i}.stiffness": k
               for i, k in ((2, 5e7), (3, 5e7), (4, 4e7), (5, 3e7))},
            **{f"linear_damping@storey_{i}.damping": 2e5 for i in (2, 3, 4, 5)},
        },
        {
            HIDDEN: {"coulomb_friction.level": 4e4, "coulomb_friction.width": 2e-3},
            HARD: {
                "clearance@storey_3.stiffness": 5e7,
                "clearance@storey_3.gap": 4e-3,
                "clearance@storey_3.width": 4e-4,
            },
        },
        _hammered(1.0, 0.3, 12.0, "ground"), duration=40.0, samples_per_s=100.0,
    ),
    Machine(
        "van_der_pol", "oscillations", "van_der_pol", van_der_pol,
        {
            "system.mass": 1.0,
            "linear_stiffness.stiffness": 39.5,
            "linear_damping.damping": -2.0,
            "amplitude_damping.damping": 2.0,
        },
        {HIDDEN: {"cubic_stiffness.stiffness": 0.08}},
        _hammered(12.0, 0.2, 3.0), duration=60.0, samples_per_s=50.0, start={"x": 1.0},
        spread=0.5,
    ),
)  # fmt: skip
