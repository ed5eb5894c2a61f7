"""Which admitted effects a fit still needs, and how far each is from zero."""

from __future__ import annotations

import numpy as np
from scipy import special

from spiral.inference.evidence.admission import drop_effects
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.scoring import amplitude_keys
from spiral.inference.likelihood.fitting import LikelihoodFit, fit_by_likelihood, schwarz_penalty
from spiral.inference.likelihood.initial_states import refit_initial_states
from spiral.inference.likelihood.interpolation import fit_with_other_interpolations
from spiral.inference.problem import Progress
from spiral.types.effect import InputEffect, SensorEffect
from spiral.types.label import owner_of, parameter_of
from spiral.types.model import Model


def drop_superfluous_effects(
    assembly: Assembly, fit: LikelihoodFit, latest: str = ""
) -> tuple[LikelihoodFit, tuple[str, ...]]:
    """Drop effects admitted earlier, before the ``latest``, that the record no longer supports."""
    gone: list[str] = []
    for variant in admitted_variants(assembly, fit, latest):
        keys = amplitude_keys(assembly, variant)
        if _is_far_from_zero(assembly, fit, keys):
            continue
        trial = _refit_without(assembly, fit, variant)
        if trial.log_likelihood > fit.log_likelihood - schwarz_penalty(
            len(keys), trial.estimate.prepared
        ):
            fit = trial
            gone.append(variant.original.label)
    return fit, tuple(gone)


def _refit_without(
    assembly: Assembly, fit: LikelihoodFit, variant: Variant, rough: bool = False
) -> LikelihoodFit:
    """The fit without one effect, the initial states of each record estimated anew.

    States of an effect on a sensor may have made up for wrong initial states of the machine.
    """
    trial = fit_by_likelihood(
        assembly, drop_effects(assembly, fit.state, (variant.label,)), rough=rough
    )
    return refit_initial_states(assembly, trial) if trial.estimate.finite else trial


def admitted_variants(assembly: Assembly, fit: LikelihoodFit, latest: str = "") -> list[Variant]:
    """Variants of the effects that a fit holds beyond the seed, without the latest."""
    seed = assembly.problem.model.labels
    return [assembly.variant(x) for x in fit.state.labels if x not in seed and x != latest]


def replace_by_interpolation(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> tuple[LikelihoodFit, tuple[str, ...]]:
    """Drop effects on inputs and sensors where another interpolation of the input does as well.

    A force that a controller holds looks like an actuator that lags by half a sample; while another
    effect is missing the lag may be the more likely of the two, as its time can make up for that.
    """
    gone: list[str] = []
    for variant in admitted_variants(assembly, fit):
        if not isinstance(variant.original, InputEffect | SensorEffect):
            continue
        without = drop_effects(assembly, fit.state, (variant.label,))
        worth = schwarz_penalty(len(amplitude_keys(assembly, variant)), fit.estimate.prepared)
        fits = fit_with_other_interpolations(
            assembly, fit, without, fit.log_likelihood - worth, progress
        )
        best = max(fits, key=lambda f: f.log_likelihood, default=None)
        if best is not None and best.log_likelihood > fit.log_likelihood - worth:
            fit = best
            gone.append(variant.original.label)
    return fit, tuple(gone)


def _is_far_from_zero(assembly: Assembly, fit: LikelihoodFit, keys: tuple[str, ...]) -> bool:
    """Whether one of these values is further from zero than standard errors allow."""
    values, errors = fit.estimate.values, fit.estimate.errors
    least = assembly.problem.settings.least_t
    return any(abs(values.get(k, 0.0)) > least * errors.get(k, np.inf) for k in keys)


def _is_shown_far_from_zero(shown: Model, label: str, least: float) -> bool:
    """Whether an amplitude of an effect is so in the model that is shown."""
    known = shown.estimates().get(label, {})
    sizes = [known[parameter_of(k)].t for k in shown.amplitudes(label)]
    return any(t is not None and abs(t) > least for t in sizes)


def likelihood_ratio_t(assembly: Assembly, fit: LikelihoodFit, shown: Model) -> dict[str, float]:
    """Distance from zero, by the likelihood ratio, of effects with small |t|, by label.

    A |t| is small by the errors of the fit, or of the model that is ``shown``, whose values may be
    those of free runs, which tell less of an effect that acts now and then. The slope at an
    amplitude's estimate says nothing of zero where the effect saturates, or where a shape makes up
    for the amplitude. The ratio is given in standard errors of one estimate: z with P(|x| > z) that
    of a chi-squared 2 (log L_1 - log L_0).
    """
    told: dict[str, float] = {}
    for variant in admitted_variants(assembly, fit) if fit.estimate.finite else ():
        label, least = variant.original.label, assembly.problem.settings.least_t
        far = _is_far_from_zero(assembly, fit, amplitude_keys(assembly, variant))
        if far and _is_shown_far_from_zero(shown, label, least):
            continue
        without = _refit_without(assembly, fit, variant, rough=True)
        free = [k for k in fit.estimate.keys if owner_of(k) == variant.label]
        gain = max(fit.log_likelihood - without.log_likelihood, 0.0)
        told[label] = _equivalent_t(2 * gain, len(free))
    return told


def _equivalent_t(statistic: float, degrees: int) -> float:
    """The |t| of one normal estimate that is as unlikely as a chi-squared statistic."""
    single = float(np.sqrt(special.chdtri(1, special.chdtrc(max(degrees, 1), statistic))))
    return min(single, float(np.sqrt(statistic)))
