"""A parameter's learned change in one of the forms that have a name.

A curve finds the place of a change, and values of the model, from which the forms of the catalog
can start: each is laid through the curve by least squares,

    c f(v; theta) = value(v) / mean,   c into the parameter itself,

and fitted to the records from there, beside the noise that the curve's fit has found. The likeliest
takes the curve's place where it is likelier, its fewer numbers paid for (Schwarz).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from spiral.inference.evidence.admission import drop_effects
from spiral.inference.evidence.assembly import Variant
from spiral.inference.evidence.enlarge import transfer_fit_state, with_variants
from spiral.inference.likelihood.candidates import with_variant_values
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    continue_fit,
    fit_by_likelihood,
    net_log_likelihood,
)
from spiral.inference.problem import Progress
from spiral.inference.strategies.likelihood.accepted import Objection, WholeRecordFit
from spiral.inference.strategies.likelihood.admission import offer_effects
from spiral.inference.strategies.likelihood.whole_fit import compare_whole_record_fit
from spiral.inference.unknown.forcecurve import Unknown
from spiral.physics.plugin_calls import call_equation
from spiral.types.effect import Effect, ParameterEffect
from spiral.types.port import At, varied_key
from spiral.types.record import Array

_MOST = 4  # forms that are fitted to the records
_BAD = 1e3  # squared distance from the curve, of a form that is no number there


@dataclass(frozen=True)
class NamedCurve:
    """The form that takes a curve's place, others that are as likely, and the model with it."""

    effect: Effect
    aliases: tuple[str, ...]
    whole: WholeRecordFit


@dataclass(frozen=True)
class _Form:
    """A form laid through a curve: its values by name, c, and its squared distance from it."""

    variant: Variant
    values: dict[str, float]
    factor: float
    distance: float


def name_curve(
    whole: WholeRecordFit, curve: Variant, shape: Unknown, objection: Objection, odds: float,
    progress: Progress,
) -> NamedCurve | None:  # fmt: skip
    """The form of a parameter's learned change that is likelier than the curve, if one is.

    Parameters
    ----------
    whole : the model with the curve, fitted to all samples. shape : what the curve looks like.
    objection : the form is not taken where it objects to the model with it. odds : between forms
        up to which the records do not tell them apart.
    """
    own, effect = whole.assembly, curve.original
    if not isinstance(effect, ParameterEffect):
        return None
    changes = (e for e in own.problem.changes() if e.port == effect.port and not e.bare)
    offered = offer_effects(own, tuple(changes)).offered
    fits: list[tuple[LikelihoodFit, Variant]] = []
    mean = _mean_factor(whole, curve, shape)
    for form in _nearest_forms(offered, shape):
        progress(f"fitting {form.variant.original.label} in place of the curve")
        fits.append((_fit_in_place(whole, curve, form, mean), form.variant))
    fits = [(f, v) for f, v in fits if f.estimate.finite]
    fits.sort(key=lambda pair: -net_log_likelihood(pair[0]))
    least = net_log_likelihood(whole.fit)
    if not fits or not net_log_likelihood(fits[0][0]) > least:
        return None
    best, variant = fits[0]
    study = with_variants(own, [variant])
    gone = tuple(x for x in whole.refitted.retired if x != effect.label)
    named = compare_whole_record_fit(study, continue_fit(study, best), gone, progress)
    if objection(named) is not None:
        return None
    near = net_log_likelihood(best) - np.log(odds)
    alike = tuple(v.original.label for f, v in fits[1:] if net_log_likelihood(f) > near)
    return NamedCurve(variant.original, alike, named)


def _nearest_forms(offered: Sequence[Variant], shape: Unknown) -> list[_Form]:
    """Forms by their distance from a curve, the nearest first, one for each effect."""
    (curve,) = shape.as_dict()["curves"]
    at, share, visited = (np.array(curve[k], dtype=float) for k in ("at", "force", "visited"))
    best: dict[str, _Form] = {}
    for variant in offered:
        form = _lay_through(variant, at, 1.0 + share, np.sqrt(visited / visited.sum()))
        known = best.get(variant.original.label)
        if known is None or form.distance < known.distance:
            best[variant.original.label] = form
    return sorted(best.values(), key=lambda f: f.distance)[:_MOST]


def _lay_through(variant: Variant, at: Array, value: Array, weight: Array) -> _Form:
    """A form of a change through a curve by least squares, c and all that is no choice free."""
    from scipy.optimize import least_squares

    effect = variant.effect
    assert isinstance(effect, ParameterEffect)
    named = {p.name: p for p in effect.parameters}
    first = {
        n: variant.shapes.get(f"{variant.label}.{n}", p.start or 0.0) for n, p in named.items()
    }
    free = [n for n, p in named.items() if not (p.choice or p.centre)]
    size = float(np.abs(at).max()) or 1.0

    def misses(x: Array) -> Array:
        given = SimpleNamespace(**{**first, **dict(zip(free, x[1:], strict=True))})
        place = At((at,), (), SimpleNamespace())
        with np.errstate(all="ignore"):
            factor = call_equation(effect, "factor", effect.factor, place, SimpleNamespace(), given)
        apart = weight * (x[0] * np.broadcast_to(factor, at.shape) - value)
        return np.where(np.isfinite(apart), apart, _BAD)

    low = np.array(
        [-np.inf, *(-np.inf if named[n].lower is None else named[n].lower for n in free)]
    )
    high = np.array([np.inf, *(np.inf if named[n].upper is None else named[n].upper for n in free)])
    begin = np.array([1.0, *(first[n] for n in free)])
    begin = np.clip(begin, low + 1e-9 * size, high - 1e-9 * size)
    solved = least_squares(misses, begin, bounds=(low, high), x_scale="jac")
    values = {**first, **dict(zip(free, map(float, solved.x[1:]), strict=True))}
    return _Form(variant, values, float(solved.x[0]), float(2 * solved.cost))


def _mean_factor(whole: WholeRecordFit, curve: Variant, shape: Unknown) -> float:
    """The mean of a curve's factor over what was visited, of which its shape tells the shares."""
    effect, own = curve.effect, whole.assembly
    assert isinstance(effect, ParameterEffect)
    (told,) = shape.as_dict()["curves"]
    row = whole.fit.state.values[0]
    values = {p.name: row[own.study.index(f"{curve.label}.{p.name}")] for p in effect.parameters}
    at = At((np.array(told["at"], dtype=float),), (), SimpleNamespace())
    given = (at, SimpleNamespace(), SimpleNamespace(**values))
    factor = call_equation(effect, "factor", effect.factor, *given)
    return float(np.median(factor / (1.0 + np.array(told["force"], dtype=float))))


def _fit_in_place(whole: WholeRecordFit, curve: Variant, form: _Form, mean: float) -> LikelihoodFit:
    """The model with a form in place of the curve, fitted from where the curve has led."""
    own, fit, variant = whole.assembly, whole.fit, form.variant
    study = with_variants(own, [variant])
    state = drop_effects(study, transfer_fit_state(fit.state, own, study), (curve.label,))
    state = replace(state, labels=(*state.labels, variant.label))
    state = with_variant_values(study, state, variant, form.values)
    key, values = varied_key(own.problem.model.system.place(curve.original)), state.values.copy()
    values[:, study.study.index(key)] *= form.factor * mean
    state = replace(state, values=values, freed=(*state.freed, *variant.tuned))
    return fit_by_likelihood(study, state, fit.estimate.noise, rough=True)
