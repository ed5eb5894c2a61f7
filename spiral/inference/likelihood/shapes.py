"""Shapes of an effect in a fit: held at their most likely values, free where data allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.admission import TOLD
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.spectrum import frequency_band, frequency_shapes
from spiral.inference.likelihood.fitting import LikelihoodFit, fit_by_likelihood, schwarz_penalty
from spiral.inference.likelihood.tied_parameters import find_parameter_ties
from spiral.types.effect import Effect
from spiral.types.parameter import Parameter

_FIRST = 6  # scoring steps of a fit from another value of a shape
_BAND = 7  # values over the band that a record shows, with its ends


def refit_effect_shapes(
    assembly: Assembly,
    fit: LikelihoodFit,
    effect: Effect,
    keys: tuple[str, ...],
    masks: Masks = None,
    steps: int = 40,
    chosen: bool = False,
) -> LikelihoodFit:
    """A fit in which the shapes ``keys`` of one of its effects take their most likely values.

    They were held while it was a candidate: the corner of a gap rounded over a share of the motion,
    say. Those that the record determines are free, with errors of their own; where their most
    likely values gain more than their penalty, the others are held there; else they stay. ``masks``
    and ``steps`` as in ``fit_by_likelihood``. For shapes already ``chosen`` by a race over their
    grids the penalty has been paid: they are free wherever determined, else the errors of the
    effect's other parameters would be those for a known shape.
    """
    if not keys or not fit.estimate.finite:
        return fit
    at, loose = fit.estimate, _refit_with_free_shapes(assembly, fit, keys, masks, steps)
    worth = loose.log_likelihood > fit.log_likelihood + schwarz_penalty(len(keys), at.prepared)
    if not (worth or (chosen and loose.log_likelihood >= fit.log_likelihood)):
        return fit
    told = determined_shapes(loose, keys, effect)
    if len(told) == len(keys):
        return loose
    begun = loose if worth else fit
    for some in dict.fromkeys((told, ())):
        if not (some or worth):
            return fit
        state = replace(begun.state, freed=(*fit.state.freed, *some))
        again = fit_by_likelihood(
            assembly, state, begun.estimate.noise, masks, steps, rough=True, like=at.prepared
        )
        if (
            again.log_likelihood > fit.log_likelihood
            and determined_shapes(again, some, effect) == some
        ):
            return again
    return fit


def refit_from_other_shapes(
    assembly: Assembly, fit: LikelihoodFit, effect: Effect, keys: tuple[str, ...]
) -> LikelihoodFit:
    """The best refit from the other grid values of these shapes, each in turn.

    The shapes start in the middle of their grids, or bands, from where a fit may not get to a width
    of friction that is ten times smaller.
    """
    for shape in effect.parameters:
        key = f"{effect.label}.{shape.name}"
        if key not in keys or not fit.estimate.finite:
            continue
        at, index = fit.estimate, assembly.study.index(key)
        for value in _other_shape_values(
            assembly, effect, shape, float(fit.state.values[0, index])
        ):
            values = fit.state.values.copy()
            values[:, index] = value
            begun = replace(fit.state, values=values)
            trial = fit_by_likelihood(
                assembly, begun, at.noise, steps=_FIRST, rough=True, like=at.prepared
            )
            fit = max(fit, trial, key=lambda f: f.log_likelihood)
    return fit


def _other_shape_values(
    assembly: Assembly, effect: Effect, shape: Parameter, value: float
) -> list[float]:
    """The rest of a shape's grid, of which ``value`` is the middle; or values over its band."""
    if shape.spectrum:
        series = max(assembly.study.series, key=lambda s: s.samples)
        ends = frequency_band(series.samples, series.dt)
        return [frequency_shapes(effect, f)[shape.name] for f in np.geomspace(*ends, _BAND)[1:-1]]
    if not shape.grid:
        return []
    middle = shape.grid[len(shape.grid) // 2]
    return [g * (value / middle if middle else 1.0) for g in shape.grid if g != middle]


def held_shapes(assembly: Assembly, fit: LikelihoodFit, effect: Effect) -> tuple[str, ...]:
    """Shapes of an effect that a fit holds fixed, without those at zero, which have no slope."""
    return tuple(
        k
        for p in effect.parameters
        if p.role == "shape"
        and not p.choice
        and (k := f"{effect.label}.{p.name}") not in fit.state.freed
        and fit.state.values[0, assembly.study.index(k)] != 0
    )


def determined_shapes(fit: LikelihoodFit, keys: tuple[str, ...], effect: Effect) -> tuple[str, ...]:
    """Those of an effect's free shapes that have a relative standard error of at most ``TOLD``.

    That of a shape with a grid on both sides of zero is relative to its largest grid value. One
    that the record tells only in combination with another parameter (the unit in which a power
    counts, with its factor) is not determined.
    """
    tied = {*find_parameter_ties(fit).parts} if keys else set()
    values, errors = fit.estimate.values, fit.estimate.errors
    sizes = {
        f"{effect.label}.{p.name}": max(map(abs, p.grid))
        for p in effect.parameters
        if p.grid and min(p.grid) < 0
    }
    return tuple(
        k for k in keys
        if k not in tied
        and errors.get(k, np.inf) <= TOLD * max(abs(values.get(k, 0.0)), sizes.get(k, 0.0))
    )  # fmt: skip


def _refit_with_free_shapes(
    assembly: Assembly,
    fit: LikelihoodFit,
    keys: tuple[str, ...],
    masks: Masks,
    steps: int,
) -> LikelihoodFit:
    """A fit continued with these shapes free; ``masks``, ``steps`` as in ``fit_by_likelihood``."""
    freer = replace(fit.state, freed=tuple(dict.fromkeys((*fit.state.freed, *keys))))
    at = fit.estimate
    return fit_by_likelihood(
        assembly, freer, at.noise, masks, steps, rough=True, kept=at.kept, like=at.prepared
    )
