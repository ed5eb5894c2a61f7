"""Whether a record can tell the model's own parameters apart, judged by their signatures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spiral.assembly import Assembly, columns
from spiral.evidence import Standing, tested_keys, all_samples, grown
from spiral.record import Array
from spiral.shooting.growth import Stage
from spiral.shooting.sensitivities import reduce

_COLLINEAR = 0.02  # singular value of unit signatures under which a combination counts as one
_UNSEEN = 30.0  # noise standard deviations, in total, that a change by 100 % must cause


@dataclass(frozen=True)
class Entanglement:
    """Combinations of parameters that a record cannot tell apart.

    ``groups`` are sets of effects whose signatures coincide; ``smallest`` the smallest singular
    value of the unit signatures; ``seen`` the total change of the response, in noise standard
    deviations, when the worst combination changes its parameters by 100 %.
    """

    groups: tuple[tuple[str, ...], ...]
    smallest: float
    seen: float


def entangled(assembly: Assembly, standing: Standing) -> Entanglement | None:
    """Check the standing's parameters; nothing where the record tells them apart.

    A combination counts as entangled where its unit signatures have a singular value below 0.02
    *and* changing its parameters by 100 % changes the whole response by less than 30 noise
    standard deviations: what a fit then sees of it is the noise in the initial states. Window
    lengths are tried in turn; one that tells the parameters apart is enough.
    """
    keys = standing.keys(assembly)
    moving, _ = columns(assembly, keys)
    worst: Entanglement | None = None
    for stage in grown(assembly, standing, all_samples(assembly), None, patient=True):
        if stage.fitted.reduction is None:
            return None
        triangle = stage.fitted.reduction.triangle[:-1, :-1]
        values = moving.current(stage.fitted.point.values)
        bad, smallest, seen = _directions(triangle, values)
        if not len(bad):
            return None
        owners = [assembly.study.keys[i] for i in moving.index]
        groups = _groups(assembly, standing, stage, bad, owners)
        worst = Entanglement(groups, smallest, seen)
    return worst


def _directions(triangle: Array, values: Array) -> tuple[Array, float, float]:
    """Right singular vectors of entangled combinations, the smallest singular value, what is seen."""
    norms = np.linalg.norm(triangle, axis=0)
    if np.any(norms == 0):
        return np.eye(len(norms))[norms == 0], 0.0, 0.0
    _, singular, right = np.linalg.svd(triangle / norms)
    bad, least = [], np.inf
    for value, vector in zip(singular, right, strict=True):
        taking = np.abs(vector) > 0.05
        reach = float(np.min(norms[taking] * np.abs(values[taking]) / np.abs(vector[taking])))
        if value < _COLLINEAR and value * reach < _UNSEEN:
            bad.append(vector)
            least = min(least, value * reach)
    return np.array(bad), float(singular[-1]), float(least)


def _groups(
    assembly: Assembly, standing: Standing, stage: Stage, bad: Array, owners: list[str]
) -> tuple[tuple[str, ...], ...]:
    """Effects tied together: by the seed's entangled combinations, and candidates that they mimic."""
    links: list[set[str]] = []
    for vector in bad:
        links.append({_owner(owners[i]) for i in np.flatnonzero(np.abs(vector) > 0.1)})
    groups = [(v, tested_keys(assembly, v)) for v in assembly.variants]
    keys = tuple(k for _, g in groups for k in g)
    active = columns(assembly, standing.keys(assembly))[0].count
    moving, _ = columns(assembly, (*standing.keys(assembly), *keys))
    triangle = reduce(assembly.study, stage.layouts, stage.fitted.point, moving).triangle
    norms = np.linalg.norm(triangle, axis=0)
    norms[norms == 0] = 1.0
    unit = triangle / norms
    left, singular, right = np.linalg.svd(unit[:, :active], full_matrices=False)
    kept = singular > _COLLINEAR
    first = active
    for variant, group in groups:
        block = unit[:, first : first + len(group)]
        first += len(group)
        along = left[:, kept].T @ block
        rest = np.sqrt(np.maximum(1.0 - np.sum(along**2, axis=0), 0.0))
        if np.min(rest) > _COLLINEAR:
            continue
        shares = right[kept].T @ (along / singular[kept][:, None])
        tied = {_owner(owners[i]) for i in np.flatnonzero(np.max(np.abs(shares), axis=1) > 0.1)}
        links.append({variant.original.label, *tied})
    return _components(links)


def _owner(key: str) -> str:
    owner, name = key.rsplit(".", 1)
    return "unbalance" if name == "phase_origin" else owner


def _components(links: list[set[str]]) -> tuple[tuple[str, ...], ...]:
    """Connected components of overlapping sets."""
    merged: list[set[str]] = []
    for link in links:
        touching = [m for m in merged if m & link]
        merged = [m for m in merged if not m & link]
        merged.append(link.union(*touching))
    return tuple(tuple(sorted(m)) for m in merged if len(m) > 1)
