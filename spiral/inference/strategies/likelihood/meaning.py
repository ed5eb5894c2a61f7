"""Fitted values that make no sense for an effect: it is refused, whatever it explains."""

from __future__ import annotations

import numpy as np

from spiral.inference.evidence.assembly import Variant
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.likelihood.departures import drifting_parameters
from spiral.inference.likelihood.fitting import has_still_state
from spiral.inference.nearness import is_near_noise
from spiral.inference.strategies.likelihood.accepted import WholeRecordFit
from spiral.inference.strategies.likelihood.benefit import Refusal
from spiral.inference.verdict import LIKELIHOOD_RATIO_T
from spiral.types.formatting import number
from spiral.types.label import owner_of, parameter_of, split_key, without_variant
from spiral.types.model import Model

STILL_STATE = (
    "its own state hardly moves in these records: it adds a constant, which another effect may be"
)
_REMAINS = 1 / 3  # of a given value, below which an effect has taken its place
_BEYOND = 100.0  # times its scaled value from which a shape is of no motion in the records


def refuse_senseless(whole: WholeRecordFit, rival: Rival) -> Refusal | None:
    """A refusal where the fitted values make no sense for the effect; nothing where they do.

    What it has as states of its own must move, and what it has fitted must not contradict what its
    name says.
    """
    if not whole.fit.estimate.finite:
        return Refusal("with it the fit to all samples diverges")
    if rival.label in whole.refitted.retired:
        return Refusal("another interpolation of an input between its samples explains as much")
    if _has_vanished(whole, rival.label):
        return Refusal("fitted to all samples its amplitude is not distinguishable from zero")
    if (taken := _taken_place(whole, rival.label)) is not None:
        return Refusal(f"it takes the place of {taken}: the record does not tell them apart")
    model, variant = whole.refitted.comparison.model, rival.ranked.variant
    for key, share in drifting_parameters(whole.fit.estimate).items():
        if owner_of(without_variant(key)) == rival.label and abs(share) > 1.0:
            return Refusal(
                f"its {parameter_of(key)} would change by more than itself over the record: it "
                "stands for something that changes with time, or with what changes over the record",
                alone=True,
            )
    near = is_near_noise(whole.refitted.comparison, whole.assembly.problem.settings)
    if (refusal := refuse_shapes(model, variant, near)) is not None:
        return refusal
    if (late := _late_beyond_record(whole, rival.label)) is not None:
        return Refusal(f"its time goes to {number(late)} s, longer than the record")
    if has_still_state(whole.fit, variant.label):
        return Refusal(STILL_STATE)
    known = model.estimates().get(rival.label, {}).items()
    said = variant.original.contradiction({n: e.estimate for n, e in known if e.se is not None})
    return Refusal(said) if said else None


def refuse_shapes(model: Model, variant: Variant, near: bool) -> Refusal | None:
    """A refusal where a fitted shape no longer means what the effect means by it.

    It runs to an end of its range, or far beyond the motion that it was scaled by; or beyond its
    ``Parameter.most``, unless the model is ``near`` its noise: as a stand-in for what is missing an
    effect of such a shape is not told by its name, but what explains all that is left is right.
    """
    tried, limits = (
        {parameter_of(k): size for k, size in sizes.items()}
        for sizes in (variant.shapes, variant.limits)
    )
    for key, parameter in model.pairs:
        owner, name = split_key(key)
        if owner != variant.original.label or parameter.role != "shape" or key not in model.values:
            continue
        value = model.values[key]
        if parameter.at_bound(value):
            return Refusal(f"its {name} runs to the end of its range, {number(value)}")
        if parameter.grid and abs(value) > _BEYOND * abs(tried.get(name) or np.inf):
            return Refusal(f"its {name} goes to {number(value)}, far beyond the motion")
        if abs(value) > limits.get(name, np.inf) and not near:
            return Refusal(f"its {name} goes to {number(value)}, over too much of the motion")
    return None


def _late_beyond_record(whole: WholeRecordFit, label: str) -> float | None:
    """By how long an effect is late, in s, where that is longer than every record."""
    model = whole.refitted.comparison.model
    longest = max(r.dt * r.samples for r in whole.assembly.problem.records)
    of_own = ((k, p) for k, p in model.pairs if split_key(k)[0] == label)
    times = [k for k, p in of_own if p.role == "amplitude" and p.unit == "s"]
    return next((model.values[k] for k in times if abs(model.values.get(k, 0)) > longest), None)


def _taken_place(whole: WholeRecordFit, label: str) -> str | None:
    """A value that surely fell below a third of what was given, beside amplitudes not told alone.

    The record determines both in combination only: the effect does the work of what the model has
    already (a store that a shaft fills in place of the shaft's own inertia). One whose amplitude is
    told by itself may take a value's place: a coupling that has play has no other stiffness.
    """
    sizes, least = _amplitude_sizes(whole, label), whole.assembly.problem.settings.least_t
    if not sizes or max(sizes) >= least:
        return None
    at, given = whole.fit.estimate, whole.assembly.problem.model.given_values
    most = {k: abs(value) + least * at.errors.get(k, np.inf) for k, value in at.values.items()}
    fallen = (k for k, size in most.items() if size < _REMAINS * abs(given.get(k, 0.0)))
    return next(map(without_variant, fallen), None)


def _amplitude_sizes(whole: WholeRecordFit, label: str) -> list[float]:
    """|t| of every amplitude of an effect; none where one has no error."""
    model = whole.refitted.comparison.model
    known = model.estimates().get(label, {})
    sizes = [known[parameter_of(key)].t for key in model.amplitudes(label)]
    return [abs(t) for t in sizes if t is not None] if None not in sizes else []


def _has_vanished(whole: WholeRecordFit, label: str) -> bool:
    """Whether no amplitude of an effect is told from zero, by its error or by the likelihood."""
    model, refitted = whole.refitted.comparison.model, whole.refitted
    told = refitted.details.get(LIKELIHOOD_RATIO_T, {}).get(label, 0.0)
    known, least = model.estimates().get(label, {}), whole.assembly.problem.settings.least_t
    names = [parameter_of(key) for key in model.amplitudes(label)]
    zero = [known[n].estimate == 0.0 for n in names]
    sizes = _amplitude_sizes(whole, label)
    faint = bool(sizes) and not max([*sizes, told]) >= least
    return bool(names) and (all(zero) or faint)
