"""Twins: effects that do elsewhere what another does (``Effect.twins``).

A sensor that is late by as much as an input was, a scale of a sensor and one of an input. Fitted
from zero a twin may get nowhere where the model was fitted without any; from where the model is
with the effect, and at its values, it explains as much.
"""

from __future__ import annotations

from collections.abc import Sequence

from spiral.engine.likelihood.fit import maximise_likelihood
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.admission import drop_effects
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.enlarge import transfer_fit_state, with_variants
from spiral.inference.evidence.scoring import RankedCandidate
from spiral.inference.likelihood.alias_groups import TWIN
from spiral.inference.likelihood.candidates import (
    Rival,
    add_candidate,
    make_rival,
    unscored_candidate,
    with_variant_values,
)
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WARM,
    LikelihoodFit,
    fit_by_likelihood,
    prepare_filter_tasks,
    with_estimate,
)
from spiral.inference.likelihood.initial_states import refit_initial_states
from spiral.inference.strategies.likelihood.superfluous import admitted_variants
from spiral.types.label import owner_of


def twin_labels(assembly: Assembly, admitted: Variant) -> tuple[str, ...]:
    """Labels of the candidates that do elsewhere what an effect does."""
    return tuple(
        e.label for e in assembly.problem.candidates if _is_twin(e.plugin_name(), admitted)
    )


def twins_at_its_values(
    assembly: Assembly, base: LikelihoodFit, model: LikelihoodFit, admitted: Variant,
    ranked: Sequence[RankedCandidate],
) -> list[Rival]:  # fmt: skip
    """The offered twins and special cases of an effect, each in its place and from its values.

    Where each record begins is looked for anew: a late sensor has another beginning of the machine.
    ``base`` is the model without the effect, ``ranked`` the candidates that have a score there.
    """
    given, scored = _values_by_name(model, admitted), {r.variant.label: r for r in ranked}
    alike = {*admitted.original.twins, *admitted.original.special}
    rivals: dict[str, Rival] = {}
    for variant in assembly.offered:
        label = variant.original.label
        if label in rivals or variant.original.plugin_name() not in alike:
            continue
        own = with_variants(assembly, [variant])
        one = scored.get(variant.label) or unscored_candidate(variant)
        state = add_candidate(own, transfer_fit_state(base.state, assembly, own), one)
        state = with_variant_values(own, state, variant, given)
        noise, like = model.estimate.noise, base.estimate.prepared
        fit = fit_by_likelihood(own, state, noise, rough=True, like=like)
        if fit.estimate.finite:
            rivals[label] = make_rival(own, base, one, refit_initial_states(own, fit))
    return list(rivals.values())


def untold_twin(base: LikelihoodFit, rival: Rival, masks: Masks) -> str:
    """The effect of ``base`` that a candidate could replace as well as join; empty if none is.

    In its place and from its values the candidate explains as much as it does on these blocks: of
    the two the records show one, and a second one only makes up for what is left of its
    approximation.
    """
    own, variant = rival.assembly, rival.ranked.variant
    for admitted in admitted_variants(own, rival.fit, variant.label):
        if not _is_twin(variant.original.plugin_name(), admitted):
            continue
        state = drop_effects(own, rival.fit.state, (admitted.label,))
        state = with_variant_values(own, state, variant, _values_by_name(base, admitted))
        noise, like = base.estimate.noise, base.estimate.prepared
        fit = fit_by_likelihood(own, state, noise, masks, rough=True, like=like)
        bare = fit_without(own, rival.fit, (admitted, variant), masks)
        gain = base.log_likelihood - bare.log_likelihood
        if fit.log_likelihood - bare.log_likelihood > TWIN * gain:
            return admitted.original.label
    return ""


def fit_without(
    assembly: Assembly, model: LikelihoodFit, admitted: tuple[Variant, ...], masks: Masks = None
) -> LikelihoodFit:
    """The model without effects, at the values that it has with them; its noise is fitted again.

    From the model's noise and from that of a first start, the likelier counts: a size of noise
    near zero does not grow by itself.
    """
    bare = drop_effects(assembly, model.state, tuple(v.label for v in admitted))
    prepared = prepare_filter_tasks(assembly, bare)
    starts = (model.estimate.noise, first_noise(prepared[0][0], LEVEL))
    fits = [
        maximise_likelihood(prepared, (), noise, {}, masks, WARM, rough=True) for noise in starts
    ]
    estimate = max(fits, key=lambda f: f.log_likelihood)
    return LikelihoodFit(with_estimate(bare, estimate), estimate)


def _is_twin(name: str, admitted: Variant) -> bool:
    return name in admitted.original.twins


def _values_by_name(model: LikelihoodFit, admitted: Variant) -> dict[str, float]:
    """Values of an effect's parameters by their names alone, and what look-alikes call them."""
    task = model.estimate.prepared[0][0]
    known = zip(task.keys, task.compiled.traced.parameters, task.values, strict=True)
    own = {p.name: float(value) for key, p, value in known if owner_of(key) == admitted.label}
    return {**own, **admitted.original.limit_values(own)}
