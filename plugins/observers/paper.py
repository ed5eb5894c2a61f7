"""The paper's filter, with the numbers of its table."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from spiral.engine.filter.observer import Observer, Reconstruction

if TYPE_CHECKING:
    from spiral.engine.filter.task import FilterInput


class EkfPaper(Observer):
    """Extended Kalman filter with the settings of the paper's table ekf_params.

    Q = q0 diag(1e-2, 1) on coordinates and rates, R from second differences (Var(D^2 y) / 6), P0 =
    diag(1e-6 measured coordinates, 1e-4 hidden ones, 1e-4 their rates, 1e-3 hidden rates), start at
    the first sample with zero for the rest. The numbers are absolute: in SI units, where the motion
    is 5e-5 m, they make the filter follow every measurement. Its x, y error is then the noise and
    its NIS near zero whatever the model, which is no evidence for the model.

    Fields
    ------
    q0 : scale of Q per sample.
    """

    q0: float = 1e-3

    def reconstruct(self, task: FilterInput) -> Reconstruction:
        """Filter the record with the paper's numbers."""
        from spiral.engine.filter.extended import FilterSettings, as_reconstruction, filter_record

        names, traced = task.states, task.compiled.traced
        channels = traced.channels
        rate = np.array([traced.rate_name(n) not in names for n in names])
        seen = np.array([traced.base_name(n) in channels for n in names])
        first = np.where(rate, np.where(seen, 1e-4, 1e-3), np.where(seen, 1e-6, 1e-4))
        start = np.zeros(len(names))
        start[[names.index(c) for c in channels]] = task.series.y[0]
        settings = FilterSettings(
            process=np.diag(self.q0 * np.where(rate, 1.0, 1e-2)),
            noise=np.var(np.diff(task.series.y, n=2, axis=0), axis=0) / 6,
            start=start,
            covariance=np.diag(first),
            second_order=True,
        )
        clock = time.perf_counter()
        filter_pass = filter_record(task, settings, keep=bool(task.series.record.truth))
        seconds = time.perf_counter() - clock
        return as_reconstruction(task, settings, filter_pass, {}, seconds, 0.0)
