"""The machines of the zoo with their equations written a second time, by hand."""

from __future__ import annotations

from experiments.zoo.machine import Machine
from experiments.zoo.truth import (
    chains,
    drives,
    electric,
    fluids,
    levitated,
    living,
    rotors,
    thermal,
    vehicles,
)

_GROUPS = (chains, drives, electric, fluids, levitated, living, rotors, thermal, vehicles)

MACHINES: dict[str, Machine] = {m.name: m for group in _GROUPS for m in group.MACHINES}
"""Every machine by name."""
