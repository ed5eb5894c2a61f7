"""Uncertainty of a free run by the uncertainty of its initial state and parameters.

With J the slopes of the readings by the start x_0 and the parameters p along the free run,

    y(t) - y^(t) = J(t) (dx_0, dp),    V = (diag(S_0, V_p)^-1 + J_h^T R^-1 J_h)^-1,

S_0 the first doubt of the states, V_p the covariance of the estimate, J_h and R the slopes and the
noise on the samples that tell where the record begins. What a machine integrates grows with time;
of a chaotic motion it grows until nothing is left to be predicted: sqrt(2) of its deviation.

A machine that only its controller keeps upright is elsewhere in a free run, where slopes say
nothing of how it fell. There it is asked how doubt grows along the motion that was measured, with F
of a filter that follows it,

    d(x, p)_{k+1} = F_k d(x, p)_k,    d(x, p) = (0, V_p^(1/2)) where the free run is on its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.prior import covariance_root
from spiral.engine.filter.setup import prepare_filter
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.noise import NoiseModel, first_noise
from spiral.engine.likelihood.predict import predict_readings
from spiral.types.record import Array

_MOST = 1e9  # deviations of the noise by which a doubt is seen to move a reading
_UNTOLD = 1e100  # variance of a value of which nothing is known
_SMALL = 1e-5  # share of a state's first doubt by which its start is moved


def free_doubt(
    task: FilterInput, start: Array, keys: Sequence[str], covariance: Array, noise: NoiseModel,
    settled: int,
) -> Array:  # fmt: skip
    """(samples - settled, channels) standard deviation of a free run from ``start``.

    Parameters
    ----------
    keys : parameters whose ``covariance`` is known. noise : of the sensors. settled : samples that
        told where the record begins.
    """
    task, settings = prepare_filter(replace(task, moved=tuple(keys)), ())  # one flow for all passes
    sure = replace(settings, covariance=np.zeros_like(settings.covariance))
    deviations = task.series.deviations
    # A filter that is sure of its state corrects nothing.
    no_correction = first_noise(task, 0.0, deviations)
    spreads = _SMALL * task.spread

    def misses(x: Array, names: Sequence[str] = ()) -> tuple[Array, Array]:
        run = predict_readings(task, replace(sure, start=x), no_correction, names)
        left = run.misses if run.whole else np.full_like(run.misses, np.nan)
        return left, run.slopes

    with np.errstate(all="ignore"):
        base, slopes = misses(start, keys)
        moved = [misses(start + step)[0] - base for step in np.diag(spreads)]
        by_start = np.stack(moved, axis=2) / _SMALL
        by_values = -slopes @ _bounded_root(covariance)
        scaled = np.concatenate([by_start, by_values], axis=2)  # for doubts of one
        white = np.array([noise.values[f"white.{c}"] for c in task.compiled.traced.channels])
        head = (scaled[:settled] / white[:, None]).reshape(-1, scaled.shape[2])
        head = np.clip(np.nan_to_num(head), -_MOST, _MOST)  # of a run that leaves all bounds
        known = np.linalg.qr(np.concatenate([np.eye(scaled.shape[2]), head]), mode="r")
        parts = scaled[settled:] @ np.linalg.inv(known)
        doubt = np.sqrt(np.sum(parts**2, axis=2))
    most = np.sqrt(2.0) * deviations
    return np.minimum(np.nan_to_num(doubt, nan=np.inf, posinf=np.inf), most)


def doubt_along_readings(
    task: FilterInput, settings: FilterSettings, noise: NoiseModel, settled: int
) -> Array:
    """(samples - settled, channels) deviation by doubt of parameters, along the measured motion.

    Parameters
    ----------
    settings : of a filter that tracks these parameters, ``doubt`` and ``correlation`` as of the
        fit. noise : of the filter. settled : samples after which a free run is on its own.
    """
    n, tracked = len(task.states), len(settings.tracked)
    most = np.sqrt(2.0) * task.series.deviations
    doubt = np.broadcast_to(most, (task.series.samples - settled, len(most))).copy()
    with np.errstate(all="ignore"):
        run = predict_readings(task, settings, noise, carry=True)
        root = _bounded_root(settings.first_covariance[n:, n:])
        along = np.concatenate([np.zeros((n, root.shape[1])), root])
        for k in range(settled, run.done):
            own = np.linalg.norm(run.rows[k, :, : n + tracked] @ along, axis=1)
            if not np.all(own < _MOST * most):
                break
            doubt[k - settled] = np.minimum(own, most)
            along = run.transitions[k, : n + tracked, : n + tracked] @ along
    return doubt


def _bounded_root(covariance: Array) -> Array:
    """L (q, directions) of V = L L^T.

    A variance that overflows, of a value that no reading tells, is very large, and goes with none.
    """
    known = np.isfinite(covariance)
    return covariance_root(np.where(known, covariance, _UNTOLD * np.eye(len(covariance))))
