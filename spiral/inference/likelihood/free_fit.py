"""Values that minimise the free-run error, for models beside which a large random force acts.

One-step predictions tell a machine's values best where what acts on it is random. Where it only
looks so, because the model still lacks something, the filter is corrected at every sample by what
is lacking, and values that fit one step may be far from those that fit a whole run. These minimise

    sum_kj (y_kj - y^_kj(theta))^2 / r_j^2

over the free run y^ from the record's own start (output error; Ljung, System Identification, 1999,
section 7.3). They are taken where they predict the records better by more than a tenth, and halves
of them, each by values of the other, better as well: beside forces that are truly random the two
differ by less, and one-step predictions are the more precise ones. What a free run misses is
correlated over long times, so the halves are whole: blocks that alternate would be no witness of
one another.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.fit import add_standard_errors, maximise_likelihood
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import FilterInputs, Masks, predict_cases
from spiral.engine.windows import halves
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    fit_by_likelihood,
    is_random_force_small,
    with_estimate,
)
from spiral.inference.likelihood.seed_fit import sensor_noise_only
from spiral.inference.problem import Progress

FREE_RUN_VALUES_NOTE = (
    "the values minimise the free-run error: a large force that is not random acts beside the "
    "model, and one-step predictions, which each reading corrects, would give other values"
)
"""The note on a comparison whose values are those of free runs."""

_BETTER = 0.9  # share of the other's error below which values by free runs are taken


def refit_by_free_run(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress, halves_agree: bool = True
) -> LikelihoodFit:
    """The fit with the values that minimise the free-run error, if these are far better.

    Its noise is the most likely one beside them, its standard errors those of the free run
    (widened by how much blocks of the record differ). Without ``halves_agree`` the check on halves
    is left out, for callers that decide on data which neither fit has seen.
    """
    if not fit.estimate.finite or is_random_force_small(fit) or not fit.estimate.keys:
        return fit
    progress("fitting values that minimise the free-run error")
    noise, like = sensor_noise_only(fit), fit.estimate.prepared
    white_noise_only = noise.select_terms(t for t in noise.terms if t.kind == "white")
    free = fit_by_likelihood(assembly, fit.state, white_noise_only, rough=True, like=like)
    ours, theirs = (_mean_free_run_error(f, white_noise_only, None) for f in (fit, free))
    if not theirs < _BETTER * ours:
        return fit
    if not halves_agree:
        return _with_noise_terms_of(assembly, free, fit)
    ours = theirs = 0.0
    for fitted, other in itertools.permutations(_record_halves(fit.estimate.prepared)):
        stepwise = fit_by_likelihood(
            assembly, fit.state, masks=fitted, rough=True, kept=fit.estimate.kept
        )
        freely = fit_by_likelihood(assembly, free.state, white_noise_only, fitted, rough=True)
        ours += _mean_free_run_error(stepwise, white_noise_only, other) ** 2
        theirs += _mean_free_run_error(freely, white_noise_only, other) ** 2
    if not theirs < ours:
        return fit
    return _with_noise_terms_of(assembly, free, fit)


def _record_halves(prepared: FilterInputs) -> tuple[Masks, Masks]:
    """The first half of every record, and the second."""
    counts = [task.series.samples for task, _ in prepared]
    first, second = zip(*(halves(n, (n + 1) // 2) for n in counts), strict=True)
    return first, second


def _mean_free_run_error(fit: LikelihoodFit, white_noise_only: NoiseModel, masks: Masks) -> float:
    """Free-run error of a fit, rms over each channel's deviation, mean over channels."""
    prepared = fit.estimate.prepared
    parts = predict_cases([(prepared, white_noise_only)])[0]
    if not all(p.whole for p in parts):
        return np.inf
    total, count = 0.0, 0
    for r, ((task, _), part) in enumerate(zip(prepared, parts, strict=True)):
        chosen = None if masks is None else masks[r]
        misses = (part.misses if chosen is None else part.misses[chosen]) / task.series.deviations
        total, count = total + np.sum(misses**2, axis=0), count + len(misses)
    return float(np.mean(np.sqrt(total / max(count, 1))))


def _with_noise_terms_of(
    assembly: Assembly, free: LikelihoodFit, fit: LikelihoodFit
) -> LikelihoodFit:
    """The values of ``free`` with the noise terms of another fit, at their most likely sizes."""
    known, keys = add_standard_errors(free.estimate), free.estimate.keys
    noisy = maximise_likelihood(free.estimate.prepared, (), fit.estimate.noise, rough=True)
    parts = predict_cases([(noisy.prepared, noisy.noise)], keys, keep=True)[0]
    estimate = replace(
        noisy, keys=keys, predictions=parts, regression=known.regression, sizes=known.sizes,
        widened=known.widened,
    )  # fmt: skip
    return LikelihoodFit(with_estimate(free.state, estimate), estimate)
