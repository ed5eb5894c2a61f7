"""Electric machines: a loudspeaker, a step-down converter, a battery cell, a neuron.

Numbers: a woofer of 20 g moving mass (Klippel's large-signal papers); a 24 V converter with 100 uH
and 200 uF; a 2.5 Ah cell (Plett); FitzHugh's constants a = 0.7, b = 0.8, eps = 0.08.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, band_limited, steps
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine
from experiments.zoo.truth.laws import cubic, spring

Array = np.ndarray


def loudspeaker(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Cone and coil; a suspension that hardens, evenly or to one side."""
    cone, _, speed, current = x
    force = c["system.force_factor"] * current + spring(c, "", cone, speed)
    force += cubic(c, "cubic_stiffness", cone)
    force -= c["quadratic_stiffness.stiffness"] * cone**2
    across = u.voltage - c["system.force_factor"] * speed
    across -= c["linear_damping@coil.damping"] * current
    return np.array([speed, current, force / c["system.moving_mass"],
                     across / c["system.inductance"]])  # fmt: skip


def converter(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Flux and output voltage; a saturating core draws a current that grows with the cube."""
    flux, voltage = x
    across = c["system.supply"] * u.duty - voltage - c["coil.drop"] * flux
    charging = c["coil.charging"] * flux + c["coil_saturation.charging"] * flux**3
    return np.array([across, charging - c["resistive_load.rate"] * voltage])


def battery_cell(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """State of charge, overvoltage, and the voltmeter behind its filter."""
    charge, over, terminal = x
    rest = c["system.empty"] + c["system.slope"] * charge + c["system.bend"] * charge**3
    relaxing = c["polarisation.decay"] * over + c["charge_transfer.rate"] * over**3
    clamps = (rest + over - terminal) / c["system.filter"]
    return np.array([
        u.current / c["system.capacity"],
        c["polarisation.rise"] * u.current - relaxing,
        clamps + c["ohmic_drop.rise"] * u.current,
    ])  # fmt: skip


def neuron(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Membrane and recovery; a channel that leaks more one way."""
    v, w = x
    membrane = c["membrane_current.excitation"] * v - c["membrane_current.saturation"] * v**3
    membrane -= c["rectified_leak.rate"] * v**2
    recovery = c["recovery.drive"] * v + c["recovery.level"] - c["recovery.decay"] * w
    return np.array([membrane - w + u.current, recovery])


def _voltage(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"voltage": band_limited(rng, 8.0, (15.0, 300.0), duration)}


def _duty(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"duty": steps(rng, 0.15, 0.85, 1e-3, duration)}


def _current(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"current": steps(rng, -4.0, 4.0, 25.0, duration)}


def _injected(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"current": steps(rng, -0.2, 1.2, 8.0, duration)}


MACHINES = (
    Machine(
        "loudspeaker", "electromechanics", "loudspeaker", loudspeaker,
        {
            "system.moving_mass": 0.02,
            "system.inductance": 2e-3,
            "system.force_factor": 7.0,
            "linear_stiffness.stiffness": 2000.0,
            "linear_damping.damping": 1.5,
            "linear_damping@coil.damping": 6.0,
        },
        {
            HIDDEN: {"cubic_stiffness.stiffness": 2e8},
            HARD: {"quadratic_stiffness.stiffness": 1e5},
        },
        _voltage, duration=1.5, samples_per_s=3000.0,
    ),
    Machine(
        "converter", "electronics", "converter", converter,
        {
            "system.supply": 24.0,
            "coil.drop": 1000.0,
            "coil.charging": 5e7,
            "resistive_load.rate": 2500.0,
        },
        {HIDDEN: {"coil_saturation.charging": 2.5e13}},
        _duty, duration=0.16, samples_per_s=25000.0,
    ),
    Machine(
        "battery_cell", "electrochemistry", "battery_cell", battery_cell,
        {
            "system.capacity": 9000.0,
            "system.filter": 2.0,
            "system.empty": 3.3,
            "system.slope": 0.7,
            "system.bend": 0.2,
            "polarisation.rise": 1.5e-3,
            "polarisation.decay": 0.025,
            "ohmic_drop.rise": 0.015,
        },
        {HIDDEN: {"charge_transfer.rate": 1.5}},
        _current, duration=4000.0, samples_per_s=1.0,
        start={"charge_state": 0.5, "terminal": 3.675},
    ),
    Machine(
        "neuron", "biology", "neuron", neuron,
        {
            "membrane_current.excitation": 1.0,
            "membrane_current.saturation": 1.0 / 3.0,
            "recovery.drive": 0.08,
            "recovery.level": 0.056,
            "recovery.decay": 0.064,
        },
        {HIDDEN: {"rectified_leak.rate": 0.1}},
        _injected, duration=400.0, samples_per_s=8.0,
        start={"membrane": -1.0, "recovery": -0.5},
    ),
)  # fmt: skip
