"""Identifiability of the model's own parameters, by the information in the records.

With X the slopes of the whitened misses and each parameter counted in units of its own value, the
singular values of X diag(theta) are inverse standard errors of combinations of relative changes.
A combination that may change by its whole size without being seen is one that the records do not
identify.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.inference.identifiability.richness import merge_overlapping_groups
from spiral.inference.likelihood.fitting import LikelihoodFit
from spiral.types.label import owner_of
from spiral.types.record import Array

_WHOLE = 1.0  # relative standard error from which a combination is not identified
_PART = 0.3  # relative change, of a whole or of the largest, from which a parameter takes part
_FLATTEST = 1e-24  # information that a combination is taken to have at least


@dataclass(frozen=True)
class InseparableGroups:
    """``groups`` of effects, or of parameters of one effect, that records do not identify apart.

    ``parts`` are parameters, those with the largest part in the flat combinations first. Holding
    one of them removes one combination; ties are then sought again in a new fit, as those of a fit
    that has gone astray mean nothing, and it may recover with one parameter less. ``error`` is the
    largest relative standard error of a combination.
    """

    groups: tuple[tuple[str, ...], ...] = ()
    parts: tuple[str, ...] = ()
    error: float = 0.0

    def __bool__(self) -> bool:
        return bool(self.groups)


def find_parameter_ties(fit: LikelihoodFit) -> InseparableGroups:
    """Parameters that the records do not identify apart; empty ties where they do.

    A combination may be flat beside the noise as it is, or only where the sizes of the noise move
    with it (a hidden state counted in another unit, and the random force on it).
    """
    estimate = fit.estimate
    if not estimate.finite or not estimate.keys:
        return InseparableGroups()
    sizes = np.array([abs(estimate.values[k]) for k in estimate.keys])
    rows = [p.columns.reshape(-1, len(sizes)) for p in estimate.predictions]
    gram = np.sum([r.T @ r for r in rows], axis=0)
    told = sizes > 0
    seen = np.sqrt(np.maximum(np.diag(gram), 0.0))[told] * sizes[told] > 1.0
    keys = [k for k, t in zip(estimate.keys, told, strict=True) if t]
    groups: list[set[str]] = []
    flat, error = [], 0.0
    for vector in _flat_directions(gram, estimate.covariance, sizes, told):
        change = np.abs(vector)
        part = change > _PART * min(change.max(), _WHOLE)
        owners = {owner_of(k) for k, p in zip(keys, part, strict=True) if p}
        if np.sum(part) > 1 and np.all(seen[part]):
            groups.append(owners if len(owners) > 1 else set(np.array(keys)[part].tolist()))
            error = max(error, float(np.linalg.norm(vector)))
            flat.append(np.where(part, vector, 0.0) / np.linalg.norm(vector[part]))
    if not flat:
        return InseparableGroups()
    parts = np.sum(np.square(flat), axis=0)
    order = [i for i in np.argsort(-parts, kind="stable") if parts[i] > 0.0]
    return InseparableGroups(merge_overlapping_groups(groups), tuple(keys[i] for i in order), error)


def _flat_directions(gram: Array, covariance: Array, sizes: Array, told: Array) -> list[Array]:
    """Combinations of relative changes with a standard error above one, of that length each.

    First those of the information beside the noise as it is, then those of the covariance, in which
    the noise's sizes move too.
    """
    scale = sizes[told]
    information = gram[np.ix_(told, told)] * np.outer(scale, scale)
    pairs = [(1.0 / max(x, _FLATTEST), v) for x, v in _eigenpairs(information)]
    pairs += _eigenpairs(covariance[np.ix_(told, told)] / np.outer(scale, scale))
    return [np.sqrt(x) * v for x, v in pairs if x > _WHOLE**2]


def _eigenpairs(matrix: Array) -> list[tuple[float, Array]]:
    """Eigenvalues and vectors of a symmetric matrix; none where it is not finite."""
    if not np.all(np.isfinite(matrix)):
        return []
    values, vectors = np.linalg.eigh(matrix)
    return list(zip(values.tolist(), vectors.T, strict=True))
