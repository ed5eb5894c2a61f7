"""Hidden states by a static map, without a filter."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from spiral.engine.filter.observer import Observer, Reconstruction
from spiral.types.errors import ConfigError

if TYPE_CHECKING:
    from spiral.engine.filter.task import FilterInput


class Static(Observer):
    """q_h = -K_hh^-1 K_ho q_o: hidden coordinates from measured ones, no dynamics, no filter.

    The map is derived from the traced balance of forces at rest. Its band is the measurement noise
    sent through the map; rates are not given. The baseline of every other observer.
    """

    def reconstruct(self, task: FilterInput) -> Reconstruction:
        """Send every sample through the map.

        Raises
        ------
        ConfigError : a model without hidden coordinates that follow measured ones.
        """
        clock = time.perf_counter()
        mapping = task.static
        if mapping is None:
            raise ConfigError(
                f"observer=static with system {task.model.system.plugin_name()!r}",
                "a system with hidden coordinates and a stiffness that holds them",
                "observer=ekf",
            )
        samples, m = task.series.y.shape
        means, deviations = np.full((2, samples, len(task.states)), np.nan)
        seen = [task.compiled.traced.channels.index(n) for n in mapping.observed]
        y, variance = task.series.y[:, seen], task.series.sigma[seen] ** 2
        for names, matrix in ((mapping.observed, np.eye(len(seen))),
                              (mapping.hidden, mapping.matrix)):  # fmt: skip
            at = [task.states.index(n) for n in names]
            means[:, at] = y @ matrix.T
            deviations[:, at] = np.sqrt(matrix**2 @ variance)
        return Reconstruction(
            names=task.states,
            means=means,
            deviations=deviations,
            innovations=np.empty((0, m)),
            spreads=np.empty((0, m, m)),
            covariances=np.empty((0, len(task.states), len(task.states))),
            log_likelihood=np.nan,
            done=samples,
            seconds=time.perf_counter() - clock,
        )
