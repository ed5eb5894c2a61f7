"""Whether the records tell the model's own parameters apart, by the information they hold.

With X the slopes of the whitened misses and each parameter counted in units of its own value, the
singular values of X diag(theta) are inverse standard errors of combinations of relative changes.
A combination of several effects that may change by its whole size unseen is one that the records
cannot tell.
"""

from __future__ import annotations

import numpy as np

from spiral.inference.identifiability.parameters import components
from spiral.inference.likelihood.fitting import LikelihoodFit

_WHOLE = 1.0  # relative standard error of a combination from which it is not told
_PART = 0.3  # share of the largest part from which a parameter takes part


def untold(found: LikelihoodFit) -> tuple[tuple[str, ...], ...]:
    """Groups of effects that these records cannot tell apart; none where they can."""
    estimate = found.estimate
    if not estimate.finite or not estimate.keys:
        return ()
    sizes = np.array([abs(estimate.values[k]) for k in estimate.keys])
    rows = [p.columns.reshape(-1, len(sizes)) for p in estimate.parts]
    gram = np.sum([r.T @ r for r in rows], axis=0)
    told = sizes > 0
    scaled = np.sqrt(np.maximum(np.diag(gram), 0.0)) * sizes
    keys = [k for k, t in zip(estimate.keys, told, strict=True) if t]
    matrix = gram[np.ix_(told, told)] * np.outer(sizes[told], sizes[told])
    values, vectors = np.linalg.eigh(matrix)
    groups: list[set[str]] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value * _WHOLE**2 >= 1.0:
            continue
        part = np.abs(vector) > _PART * np.abs(vector).max()
        owners = {k.rsplit(".", 1)[0] for k, p in zip(keys, part, strict=True) if p}
        if len(owners) > 1 and np.all(scaled[told][part] > 1.0):
            groups.append(owners)
    return components(groups)
