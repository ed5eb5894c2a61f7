"""A machine of the zoo: its equations written a second time, its numbers, and how it is tested."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from experiments.studies.signals import Signal
from experiments.studies.trajectory import Rate

Array = np.ndarray
Excite = Callable[[np.random.Generator, float], dict[str, Signal]]
"""(what draws, duration in s) -> the inputs of one record."""

HIDDEN, HARD, NULL = "hidden", "hard", "null"


@dataclass(frozen=True)
class Machine:
    """One machine: the truth by hand, and the test that an engineer would run.

    Parameters
    ----------
    name, topic : of the zoo and its field.
    system, fields : the plugin that a user would write, in ``experiments/zoo/systems``.
    rate : x' by hand, states in the order of the plugin's, own states of effects last.
    values : true numbers by the plugin's full names; what is missing in the model is not here.
    effects : case -> the values of the effect that is hidden in it.
    excite : inputs of a record. start : initial states, by name; zero where left out.
    duration, samples_per_s : of each record, s and 1/s. records : to fit; one more is the test.
    free : known parameters of the system that the user lets the fit find.
    noise : of each channel, as a share of its standard deviation.
    spread : of initial states between records, as a share of ``start``.
    """

    name: str
    topic: str
    system: str
    rate: Rate
    values: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]]
    excite: Excite
    duration: float
    samples_per_s: float
    fields: Mapping[str, object] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    records: int = 1
    free: tuple[str, ...] = ()
    noise: float = 0.01
    spread: float = 0.0

    @property
    def cases(self) -> tuple[str, ...]:
        """What may be asked of it: something hidden, in one place or two, or nothing."""
        return (*self.effects, NULL)

    def hidden(self, case: str) -> dict[str, float]:
        """Values of the hidden effect by full name; none in the null case."""
        return {} if case == NULL else dict(self.effects[case])

    def time(self) -> Array:
        """Sample times in s."""
        return np.arange(round(self.duration * self.samples_per_s)) / self.samples_per_s
