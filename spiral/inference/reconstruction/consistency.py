"""Whether a filter's own uncertainty is right: NIS, NEES, whiteness, prediction, divergence.

    NIS_k = v_k^T S_k^-1 v_k ~ chi2(channels),    NEES_k = e_k^T P_k^-1 e_k ~ chi2(states)

Their means over N samples lie in chi2(N dof) / N bounds when model, Q and R are right. A mean NIS
alone is weak evidence: where the model is wrong at some speeds only, large and small values cancel,
so it is given by speed band too, and beside it the whiteness of the innovations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from spiral.engine.filter.observer import Reconstruction
from spiral.engine.statistics import whiteness
from spiral.types.record import Array, Record

_BANDS = 6
_LAGS = 40
_BLOCKS = 64  # a divergence is looked for block by block
_MARGIN = 3.0  # noise standard deviations allowed beside the signal itself


@dataclass(frozen=True)
class BoundedMean:
    """A mean of chi2 values with the 95 % bounds that a consistent filter keeps."""

    mean: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the mean lies inside its bounds."""
        return self.low <= self.mean <= self.high

    def as_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {"mean": self.mean, "bounds": [self.low, self.high], "inside": self.inside}


@dataclass(frozen=True)
class Band:
    """NIS inside a band of speed (or of time, where there is no speed)."""

    of: str
    low: float
    high: float
    nis: BoundedMean

    def as_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {"of": self.of, "range": [self.low, self.high], **self.nis.as_dict()}


@dataclass(frozen=True)
class Consistency:
    """Consistency statistics of a filter from its innovations.

    ``prediction``: rms one-step error of each channel over the noise's standard deviation (the
    error of predicting, never of the filtered value, which may echo the measurement).
    """

    nis: BoundedMean
    bands: tuple[Band, ...]
    prediction: Mapping[str, float]
    whiteness_p: float
    whiteness_effect: float

    def as_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "nis": self.nis.as_dict(),
            "nis_bands": [b.as_dict() for b in self.bands],
            "prediction": dict(self.prediction),
            "whiteness_p": self.whiteness_p,
            "whiteness_effect": self.whiteness_effect,
        }


def mean_with_bounds(values: Array, dof: int) -> BoundedMean:
    """Mean of chi2(dof) values with 95 % bounds of that mean."""
    count = max(len(values), 1)
    low, high = special.chdtri(count * dof, [0.975, 0.025]) / count
    mean = float(np.mean(values)) if len(values) else np.nan
    return BoundedMean(mean, float(low), float(high))


def normalised_squares(errors: Array, covariances: Array) -> Array:
    """e^T P^-1 e for (samples, n) and (samples, n, n); NaN where P is singular."""
    scale = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 1e-300))
    unit = covariances / (scale[:, :, None] * scale[:, None, :])
    e = errors / scale
    try:
        return np.sum(e * np.linalg.solve(unit, e[:, :, None])[:, :, 0], axis=1)
    except np.linalg.LinAlgError:
        solved = np.linalg.pinv(unit, hermitian=True) @ e[:, :, None]
        return np.sum(e * solved[:, :, 0], axis=1)


def consistency(reconstruction: Reconstruction, record: Record, first: int) -> Consistency | None:
    """Statistics of the innovations from sample ``first`` on; nothing where there are none."""
    if not len(reconstruction.innovations) or reconstruction.done <= first + _LAGS + 2:
        return None
    cut = slice(first, reconstruction.done)
    v, s = reconstruction.innovations[cut], reconstruction.spreads[cut]
    nis = normalised_squares(v, s)
    root = np.linalg.cholesky(s)
    white = whiteness((np.linalg.solve(root, v[:, :, None])[:, :, 0],), _LAGS)
    sigma = record.sigma()
    prediction = {
        c: float(np.sqrt(np.mean(v[:, j] ** 2)) / sigma[c]) for j, c in enumerate(record.channels)
    }
    return Consistency(
        mean_with_bounds(nis, v.shape[1]),
        _nis_by_band(nis, v.shape[1], record, cut),
        prediction,
        white.p,
        white.effect,
    )


def _nis_by_band(nis: Array, dof: int, record: Record, cut: slice) -> tuple[Band, ...]:
    by = "speed" if "speed" in record.inputs and np.ptp(record.inputs["speed"][cut]) else "time"
    values = record.inputs["speed"][cut] if by == "speed" else record.time[cut]
    edges = np.linspace(values.min(), values.max(), _BANDS + 1)
    which = np.clip(np.digitize(values, edges) - 1, 0, _BANDS - 1)
    return tuple(
        Band(by, float(edges[b]), float(edges[b + 1]), mean_with_bounds(nis[which == b], dof))
        for b in range(_BANDS)
        if np.any(which == b)
    )


def stable_samples(reconstruction: Reconstruction, record: Record) -> int:
    """Samples before the filter diverged; all of them where it did not.

    A filter has diverged where a number became infinite, and where in a block of a 64th of the
    record its one-step prediction is worse than predicting the channel's mean would be by more than
    three standard deviations of the noise.
    """
    if not len(reconstruction.innovations):
        return reconstruction.done
    block = max(16, record.samples // _BLOCKS)
    for start in range(0, reconstruction.done, block):
        cut = slice(start, min(start + block, reconstruction.done))
        for j, (name, noise) in enumerate(record.sigma().items()):
            values = record.channels[name]
            size = max(float(np.std(values)), float(np.std(values[cut])))
            if np.sqrt(np.mean(reconstruction.innovations[cut, j] ** 2)) > size + _MARGIN * noise:
                if start == 0:  # the start is unknown; it may take its time
                    continue
                return start
    return reconstruction.done
