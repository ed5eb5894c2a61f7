"""Observers: all states of a model, hidden ones too, from what was measured."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from spiral.types.plugin import Plugin

if TYPE_CHECKING:
    from spiral.engine.filter.task import FilterInput

Array = np.ndarray


@dataclass(frozen=True)
class Reconstruction:
    """What an observer made of one record.

    ``names`` (N,) of the columns: the model's states, then parameters tracked as states;
    ``means`` and ``deviations`` (samples, N), NaN for a state that the observer does not give.
    ``innovations`` (samples, channels) are one-step prediction errors y - h(x), ``spreads``
    (samples, channels, channels) their covariance; both are empty for an observer that predicts
    nothing. ``covariances`` (samples, N, N) or empty. ``done`` is the number of samples before
    the numbers became infinite; ``levels`` the process noise in use, by group of states. ``values``
    are uncertain parameters as the record leaves them, mean and standard deviation by name.
    """

    names: tuple[str, ...]
    means: Array
    deviations: Array
    innovations: Array
    spreads: Array
    covariances: Array
    log_likelihood: float
    done: int
    levels: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    tuning_seconds: float = 0.0
    values: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def state(self, name: str) -> tuple[Array, Array]:
        """Mean and standard deviation of one column, each (samples,)."""
        at = self.names.index(name)
        return self.means[:, at], self.deviations[:, at]


class Observer(Plugin):
    """Reconstructs the states of a model from a record; its fields are dimensionless choices."""

    kind: ClassVar[str] = "observer"
    doubts: ClassVar[bool] = False
    """Whether its bands take in what is uncertain of the parameters (``FilterInput.prior``)."""

    @abstractmethod
    def reconstruct(self, task: FilterInput) -> Reconstruction:
        """All states with their standard deviations, sample by sample.

        A filter that runs away says so by ``done``; it raises nothing.
        """
