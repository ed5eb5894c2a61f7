"""Slopes of the misses by sizes of the noise and by parameters, kept from step to step of a search.

Slopes by the logarithm a of a size of the noise cost a run of the filter each. A step of the search
tells how misses and variances changed along it for nothing: with d the change that the slopes W by
sizes did not foresee and b the step in the logarithms,

    W <- W + d b^T / |b|^2

agrees with what was seen and changes nothing across (Broyden, A class of methods for solving
nonlinear simultaneous equations, Mathematics of Computation 19, 1965).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import Prediction
from spiral.types.record import Array

_IDLE = 1e-6  # information on the logarithm of a size below which it does nothing
_LEAST = 0.05  # step in the logarithms that tells of the slopes

Beside = Mapping[str, tuple[tuple[Array, Array], ...]]
"""By size of the noise, for every record: slopes of e and of log s by its logarithm."""


@dataclass(frozen=True)
class SlopeCache:
    """Cache of slopes by finite differences.

    ``beyond`` by parameter and record: slopes of the whitened misses less those with held gains;
    ``sizes`` by size of the noise, made where the sizes were ``at`` and carried on to where they
    were ``near``.
    """

    beyond: Mapping[str, tuple[Array, ...]] = field(default_factory=dict)
    sizes: Beside = field(default_factory=dict)
    at: Mapping[str, float] = field(default_factory=dict)
    near: Mapping[str, float] = field(default_factory=dict)

    def match_records(self, parts: Sequence[Prediction]) -> bool:
        """Whether the slopes have the shapes of these records."""
        shapes = [p.misses.shape for p in parts]
        each = (*self.beyond.values(), *([m for m, _ in b] for b in self.sizes.values()))
        return all([x.shape for x in one] == shapes for one in each)

    def are_stale(self, noise: NoiseModel, names: Sequence[str], moved: float) -> bool:
        """Whether slopes by a size are missing, or its logarithm has moved by more since made."""
        return self._have_moved(self.at, noise, names, moved)

    def are_far(self, noise: NoiseModel, names: Sequence[str], moved: float) -> bool:
        """Whether slopes by a size are missing, or it has moved by more since they were carried."""
        return self._have_moved(self.near, noise, names, moved)

    def _have_moved(
        self, since: Mapping[str, float], noise: NoiseModel, names: Sequence[str], moved: float
    ) -> bool:
        return any(
            n not in self.sizes or abs(np.log(noise.values[n] / since[n])) > moved for n in names
        )

    def made_at(self, noise: NoiseModel, sizes: Beside) -> SlopeCache:
        """With slopes by sizes made at this noise."""
        here = dict(noise.values)
        return replace(self, sizes=sizes, at=here, near=here)

    def carried(
        self, before: Sequence[Prediction], after: Sequence[Prediction], noise: NoiseModel,
        step: Mapping[str, float],
    ) -> SlopeCache:  # fmt: skip
        """The slopes by sizes after a ``step`` in their logarithms alone, from what it changed.

        ``noise`` : that after the step. Unchanged where the step is too short to tell.
        """
        length = float(np.sum(np.square(list(step.values()))))
        if length < _LEAST**2 or any(n not in self.sizes for n in step):
            return self
        sizes: dict[str, list[tuple[Array, Array]]] = {n: [] for n in step}
        for r, (old, new) in enumerate(zip(before, after, strict=True)):
            seen = (old.spreads > 0) & (new.spreads > 0)
            change = np.where(seen, new.misses - old.misses, 0.0)
            ratio = np.divide(new.spreads, old.spreads, where=seen, out=np.ones_like(change))
            grown = np.log(ratio)
            miss = {n: _unweighted(self.sizes[n][r][0], old) for n in step}
            for n, b in step.items():
                change = change - miss[n] * b
                grown = grown - self.sizes[n][r][1] * b
            for n, b in step.items():
                here = (miss[n] + change * (b / length)) * new.weight
                sizes[n].append((here, self.sizes[n][r][1] + grown * (b / length)))
        kept = {**self.sizes, **{n: tuple(each) for n, each in sizes.items()}}
        return replace(self, sizes=kept, near=dict(noise.values))


def _unweighted(slopes: Array, part: Prediction) -> Array:
    """Slopes of the misses themselves, from those over s^(1/2)."""
    return np.divide(slopes, part.weight, where=part.weight > 0, out=np.zeros_like(slopes))


def size_slopes(
    part: Prediction, misses: Array, spreads: Array, difference: float
) -> tuple[Array, Array]:
    """Slopes of the misses over s^(1/2), and of log s, from a run with one size a little larger.

    ``difference`` : of its logarithm. Nothing, where that run overflows, or the size is idle:
    slopes that are of rounding alone would move it at random. It stays where it is.
    """
    seen = part.spreads > 0
    if not (np.all(np.isfinite(misses)) and np.all(spreads[seen] > 0)):
        return np.zeros_like(misses), np.zeros_like(misses)
    miss = (misses - part.misses) * part.weight / difference
    grown = np.log(spreads, where=seen, out=np.zeros_like(spreads))
    grown -= np.log(part.spreads, where=seen, out=np.zeros_like(part.spreads))
    grown /= difference
    told = float(np.sum(miss**2) + 0.5 * np.sum(grown**2))
    return (miss, grown) if told > _IDLE else (np.zeros_like(miss), np.zeros_like(grown))
