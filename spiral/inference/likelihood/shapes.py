"""Shapes of an effect that a fit holds: at their most likely values, free where they are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.admission import TOLD
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.spectrum import band, spectral
from spiral.inference.likelihood.fitting import LikelihoodFit, price, refitted
from spiral.types.effect import Effect
from spiral.types.parameter import Parameter

_FIRST = 6  # scoring steps from another value
_BAND = 7  # values over the band that a record shows, with its ends


def with_own_shapes(
    assembly: Assembly,
    found: LikelihoodFit,
    effect: Effect,
    keys: tuple[str, ...],
    masks: Masks = None,
    steps: int = 40,
    chosen: bool = False,
) -> LikelihoodFit:
    """A fit in which shapes ``keys`` of an effect that it holds take their most likely values.

    They were held while it was a candidate: the corner of a gap rounded over a share of the motion,
    say. Where the record tells them they are free, with an error of their own; where their most
    likely values are better than their price, they are held there; else they stay. ``masks`` and
    ``steps`` as in ``refitted``. Of those ``chosen``, by a race over their grids and by its first
    half, the price is paid: where they are told they are free, else the errors of all that goes
    with them would be those of a shape that is known.
    """
    if not keys or not found.estimate.finite:
        return found
    at, loose = found.estimate, _loosened(assembly, found, keys, masks, steps)
    worth = loose.height > found.height + price(len(keys), at.prepared)
    if not (worth or (chosen and loose.height >= found.height)):
        return found
    if told(loose, keys, effect):
        return loose
    if not worth:
        return found
    held = replace(loose.state, freed=found.state.freed)
    again = refitted(
        assembly, held, loose.estimate.noise, masks, steps, rough=True, like=at.prepared
    )
    return again if again.height > found.height else found


def from_other_values(
    assembly: Assembly, found: LikelihoodFit, effect: Effect, keys: tuple[str, ...]
) -> LikelihoodFit:
    """A fit begun again from the other values of its grid for each of these shapes in turn.

    The shapes stand in the middle of their grids, or bands, from where a fit may find no way to a
    width of friction that is ten times smaller.
    """
    for shape in effect.parameters:
        key = f"{effect.label}.{shape.name}"
        if key not in keys or not found.estimate.finite:
            continue
        at, index = found.estimate, assembly.study.index(key)
        for value in _others(assembly, effect, shape, float(found.state.values[0, index])):
            values = found.state.values.copy()
            values[:, index] = value
            begun = replace(found.state, values=values)
            trial = refitted(assembly, begun, at.noise, steps=_FIRST, rough=True, like=at.prepared)
            found = max(found, trial, key=lambda f: f.height)
    return found


def _others(assembly: Assembly, effect: Effect, shape: Parameter, value: float) -> list[float]:
    """The rest of a shape's grid, of which ``value`` is the middle; or values over its band."""
    if shape.spectrum:
        series = max(assembly.study.series, key=lambda s: s.samples)
        ends = band(series.samples, series.dt)
        return [spectral(effect, f)[shape.name] for f in np.geomspace(*ends, _BAND)[1:-1]]
    if not shape.grid:
        return []
    middle = shape.grid[len(shape.grid) // 2]
    return [g * (value / middle if middle else 1.0) for g in shape.grid if g != middle]


def held_shapes(assembly: Assembly, found: LikelihoodFit, effect: Effect) -> tuple[str, ...]:
    """Shapes of an effect that a fit holds at a size; one at zero (a sharp corner) has no slope."""
    return tuple(
        k
        for p in effect.parameters
        if p.role == "shape"
        and (k := f"{effect.label}.{p.name}") not in found.state.freed
        and found.state.values[0, assembly.study.index(k)] != 0
    )


def told(fit: LikelihoodFit, keys: tuple[str, ...], effect: Effect) -> bool:
    """Whether a fit leaves these shapes of an effect a relative error of a half at most.

    One that may as well be zero (its grid is on both sides) is held against its grid instead.
    """
    values, errors = fit.estimate.values, fit.estimate.errors
    sizes = {
        f"{effect.label}.{p.name}": max(map(abs, p.grid))
        for p in effect.parameters
        if p.grid and min(p.grid) < 0
    }
    return all(
        errors.get(k, np.inf) <= TOLD * max(abs(values.get(k, 0.0)), sizes.get(k, 0.0))
        for k in keys
    )


def _loosened(
    assembly: Assembly,
    fit: LikelihoodFit,
    keys: tuple[str, ...],
    masks: Masks,
    steps: int,
) -> LikelihoodFit:
    """A fit taken on with these shapes free; ``masks`` and ``steps`` as in ``refitted``."""
    freer = replace(fit.state, freed=tuple(dict.fromkeys((*fit.state.freed, *keys))))
    at = fit.estimate
    return refitted(
        assembly, freer, at.noise, masks, steps, rough=True, kept=at.kept, like=at.prepared
    )
