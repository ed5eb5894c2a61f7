"""Whether a record can tell the model's own parameters apart, judged by their signatures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.sensitivities import reduce_windows
from spiral.engine.study import ParameterColumns, column_owner
from spiral.inference.evidence.assembly import Assembly, columns_with_bounds
from spiral.inference.evidence.fit_state import FitState, all_samples, fit_growing_windows
from spiral.inference.evidence.scoring import amplitude_keys
from spiral.inference.identifiability.richness import merge_overlapping_groups
from spiral.types.record import Array

_COLLINEAR = 0.1  # singular value of unit signatures under which a combination is looked at
_NOISE = 0.1  # expected share of noise in a combination's signature above which it is not trusted
_TIED = 0.1  # part of a signature outside the others' span under which it counts as tied to them
_DRAWS = 4


@dataclass(frozen=True)
class Entanglement:
    """Combinations of parameters that a record cannot tell apart.

    ``groups`` are sets of effects whose signatures coincide; ``smallest`` the smallest singular
    value of the unit signatures; ``noise_share`` the share of the worst combination's signature
    that noise in the initial states makes.
    """

    groups: tuple[tuple[str, ...], ...]
    smallest: float
    noise_share: float


def find_entanglement(assembly: Assembly, fit_state: FitState) -> Entanglement | None:
    """Parameters of a fit state that the record cannot tell apart; None where it can.

    A combination counts as entangled where its unit signatures are nearly collinear (singular
    value s < 0.1) *and* what is left of them is made by noise: with the initial states drawn anew
    within their own uncertainty the squared signature |J v|^2 grows by the share f that noise has
    in it, and f > 0.1 (a signature made by noise alone has f near 1, but few windows scatter). In
    the steady state of a constant speed only the noise in the estimated
    initial states still excites a transient. Window lengths are tried in turn; one that tells
    the parameters apart is enough.
    """
    fit_state = replace(fit_state, corrected=False)  # speed taken as exact
    moving, _ = columns_with_bounds(assembly, fit_state.keys(assembly))
    if moving.count == 0:
        return None
    worst: Entanglement | None = None
    for stage in fit_growing_windows(
        assembly, fit_state, all_samples(assembly), None, patient=True
    ):
        if stage.fitted.reduction is None:
            break
        triangle = stage.fitted.reduction.triangle[:-1, :-1]
        norms = np.linalg.norm(triangle, axis=0)
        if np.any(norms == 0):
            bad, smallest, share = np.eye(len(norms))[norms == 0], 0.0, 1.0
        else:
            bad, smallest, share = _noisy_directions(
                assembly, stage, moving, triangle / norms, norms
            )
        if not len(bad):
            return None
        owners = [assembly.study.keys[i] for i in moving.index]
        worst = Entanglement(
            _entangled_groups(assembly, fit_state, stage, bad, owners), smallest, share
        )
    return worst


def _noisy_directions(
    assembly: Assembly, stage: Stage, moving: ParameterColumns, unit: Array, norms: Array
) -> tuple[Array, float, float]:
    """Singular vectors that noise sustains, smallest singular value, largest noise share."""
    _, singular, right = np.linalg.svd(unit)
    suspects = [i for i, s in enumerate(singular) if s < _COLLINEAR]
    if not suspects:
        return np.zeros((0, len(norms))), float(singular[-1]), 0.0
    grown_energy = np.zeros(len(suspects))
    for draw in range(_DRAWS):
        other = _redrawn_triangle(assembly, stage, moving, np.random.default_rng(draw))
        for place, i in enumerate(suspects):
            grown_energy[place] += float(np.sum((other @ (right[i] / norms)) ** 2)) / _DRAWS
    shares = grown_energy / np.maximum(singular[suspects] ** 2, 1e-300) - 1.0
    bad = [right[i] for i, share in zip(suspects, shares, strict=True) if share > _NOISE]
    return np.array(bad), float(singular[-1]), float(np.max(shares))


def _redrawn_triangle(
    assembly: Assembly, stage: Stage, moving: ParameterColumns, rng: np.random.Generator
) -> Array:
    """The triangle of signatures, initial states moved by fresh noise of the residual's size."""
    study, point = assembly.study, stage.fitted.point
    misfit = np.sqrt(max(stage.fitted.chi2_per_dof, 1.0))
    noisy = replace(
        study,
        series=tuple(
            replace(s, y=s.y + rng.normal(size=s.y.shape) * s.sigma * misfit) for s in study.series
        ),
    )
    assert stage.fitted.reduction is not None
    now = [e[:, :, -1] for e in stage.fitted.reduction.elimination]
    then = reduce_windows(noisy, stage.layouts, point, moving).elimination
    starts = tuple(
        x + e[:, :, -1] - base for x, e, base in zip(point.starts, then, now, strict=True)
    )
    moved = reduce_windows(study, stage.layouts, replace(point, starts=starts), moving)
    return moved.triangle[:-1, :-1]


def _entangled_groups(
    assembly: Assembly, fit_state: FitState, stage: Stage, bad: Array, owners: list[str]
) -> tuple[tuple[str, ...], ...]:
    """Effects tied together: the model's entangled ones, and candidates that they mimic."""
    links = [{column_owner(owners[i]) for i in np.flatnonzero(np.abs(v) > 0.1)} for v in bad]
    groups = [(v, amplitude_keys(assembly, v)) for v in assembly.variants]
    keys = tuple(k for _, g in groups for k in g)
    active = columns_with_bounds(assembly, fit_state.keys(assembly))[0].count
    moving, _ = columns_with_bounds(assembly, (*fit_state.keys(assembly), *keys))
    triangle = reduce_windows(assembly.study, stage.layouts, stage.fitted.point, moving).triangle
    norms = np.linalg.norm(triangle, axis=0)
    norms[norms == 0] = 1.0
    unit = triangle / norms
    left, singular, right = np.linalg.svd(unit[:, :active], full_matrices=False)
    kept = singular > _TIED
    first = active
    for variant, group in groups:
        block = unit[:, first : first + len(group)]
        first += len(group)
        along = left[:, kept].T @ block
        rest = np.sqrt(np.maximum(1.0 - np.sum(along**2, axis=0), 0.0))
        if np.min(rest) > _TIED:
            continue
        shares = right[kept].T @ (along / singular[kept][:, None])
        tied = {
            column_owner(owners[i]) for i in np.flatnonzero(np.max(np.abs(shares), axis=1) > 0.1)
        }
        links.append({variant.original.label, *tied})
    return tuple(g for g in merge_overlapping_groups(links) if len(g) > 1)
