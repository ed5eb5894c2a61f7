"""Gaussian prior of parameters: steps to the most probable values, posterior covariance.

    theta = m + L z,  z ~ N(0, I),  L L^T = V

In z a prior of any covariance V, a singular one too, is a row of the identity for each direction:
with e the whitened innovations and X their slopes,

    |e - X L dz|^2 + |z + dz|^2 -> min,    C = L (I + L^T X^T X L)^-1 L^T

are a step to the most probable values and the covariance that the record leaves.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from spiral.engine.leastsquares import least_squares
from spiral.types.record import Array

_RANK = 1e-12  # share of the largest variance (of correlations) under which a direction is known


@dataclass(frozen=True)
class Prior:
    """``mean`` (q,) and ``covariance`` (q, q) of parameters by their full names.

    ``settled``: of a fit, which this record shall not move: the prior is the posterior already.
    """

    keys: tuple[str, ...]
    mean: Array
    covariance: Array
    settled: bool = False

    @cached_property
    def root(self) -> Array:
        """(q, directions) L with L L^T = V."""
        return covariance_root(self.covariance)

    def coordinates(self, values: Array) -> Array:
        """(directions,) z of values (q,)."""
        return np.linalg.lstsq(self.root, values - self.mean, rcond=None)[0]

    def log_density(self, values: Array) -> float:
        """log p of values (q,), a constant left out."""
        z = self.coordinates(values)
        return -0.5 * float(z @ z)

    def step(self, x: Array, e: Array, values: Array) -> Array:
        """(q,) step from values (q,), with innovations e (n,) and their columns (n, q)."""
        z = self.coordinates(values)
        rows = np.concatenate([x @ self.root, np.eye(len(z))])
        return self.root @ least_squares(rows, np.concatenate([e, -z])).b

    def posterior_covariance(self, x: Array) -> Array:
        """(q, q) posterior covariance C for a record with the columns X (n, q)."""
        own = x @ self.root
        inverse = np.linalg.inv(np.eye(own.shape[1]) + own.T @ own)
        return self.root @ inverse @ self.root.T


def covariance_root(covariance: Array) -> Array:
    """L (q, directions) with L L^T = V along eigenvectors of correlations, the widest first."""
    size = np.sqrt(np.diag(covariance))
    scale = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = values > _RANK * max(values.max(initial=0.0), _RANK)
    return (scale[:, None] * vectors[:, kept] * np.sqrt(values[kept]))[:, ::-1]
