"""Living things: a chemostat, an epidemic.

Numbers: growth of 0.5 per hour at half saturation 0.3 g/l, yield 0.5 (Smith, Waltman, The Theory of
the Chemostat); incubation 4 days, recovery 7 days, basic reproduction number 2.8.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from experiments.studies.signals import Signal, steps
from experiments.studies.trajectory import Values
from experiments.zoo.machine import HARD, HIDDEN, Machine

Array = np.ndarray
_HOUR, _DAY = 3600.0, 86400.0


def chemostat(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Biomass and substrate under Monod growth; cells that die, or eat without growing."""
    cells, food = x
    eaten = cells * food / (c["monod_growth.half_saturation"] + food)
    grown = c["monod_growth.growth"] * eaten - c["cell_decay.rate"] * cells
    used = c["monod_growth.uptake"] * eaten + c["maintenance.rate"] * cells
    return np.array([
        grown - u.dilution * cells,
        u.dilution * (c["system.feed"] - food) - used,
    ])  # fmt: skip


def epidemic(x: Array, u: SimpleNamespace, c: Values) -> Array:
    """Susceptible, exposed, infectious; the recovered lose their immunity."""
    healthy, exposed, ill = x
    caught = c["contagion.rate"] * u.contacts * healthy * ill
    onset = c["course_of_disease.onset"] * exposed
    waned = c["waning_immunity.rate"] * (1.0 - healthy - exposed - ill)
    return np.array([waned - caught, caught - onset, onset - c["course_of_disease.recovery"] * ill])


def _dilution(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"dilution": steps(rng, 0.15 / _HOUR, 0.55 / _HOUR, 5 * _HOUR, duration)}


def _contacts(rng: np.random.Generator, duration: float) -> dict[str, Signal]:
    return {"contacts": steps(rng, 0.4, 1.2, 15 * _DAY, duration)}


MACHINES = (
    Machine(
        "chemostat", "biology", "chemostat", chemostat,
        {
            "system.feed": 10.0,
            "monod_growth.growth": 0.5 / _HOUR,
            "monod_growth.uptake": 1.0 / _HOUR,
            "monod_growth.half_saturation": 0.3,
        },
        {
            HIDDEN: {"cell_decay.rate": 0.006 / _HOUR},
            HARD: {"maintenance.rate": 0.02 / _HOUR},
        },
        _dilution, duration=240 * _HOUR, samples_per_s=10 / _HOUR,
        start={"biomass": 4.0, "substrate": 0.5},
    ),
    Machine(
        "epidemic", "biology", "epidemic", epidemic,
        {
            "contagion.rate": 0.4 / _DAY,
            "course_of_disease.onset": 0.25 / _DAY,
            "course_of_disease.recovery": 1.0 / 7.0 / _DAY,
        },
        {HIDDEN: {"waning_immunity.rate": 1.0 / 500.0 / _DAY}},
        _contacts, duration=500 * _DAY, samples_per_s=2 / _DAY, records=3,
        start={"susceptible": 0.97, "exposed": 0.004, "infectious": 0.004}, spread=0.02,
    ),
)  # fmt: skip
