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

Hausman (1978), Specification tests in econometrics, Econometrica 46, compares two estimates that
both are right if a model is, as these are where what acts beside it is random.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from spiral.engine.leastsquares import least_squares
from spiral.engine.likelihood.fit import (
    MaximumLikelihood,
    add_standard_errors,
    maximise_likelihood,
)
from spiral.engine.likelihood.free_spread import draw_free_misses
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
from spiral.inference.likelihood.seed_fit import white_noise_only
from spiral.inference.problem import Progress
from spiral.types.formatting import number
from spiral.types.label import without_variant
from spiral.types.record import Array

FREE_RUN_VALUES_NOTE = (
    "the values minimise the free-run error: a large force that is not random acts beside the "
    "model, and one-step predictions, which each reading corrects, would give other values"
)
"""The note on a comparison whose values are those of free runs."""

_BETTER = 0.9  # share of the other's error below which values by free runs are taken
_APART = 3.0  # standard errors between two estimates from which they contradict each other


def refit_by_free_run(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress, halves_agree: bool = True
) -> LikelihoodFit:
    """The fit with the values that minimise the free-run error, if these are far better.

    Its noise is the most likely one beside them. Its standard errors are those of the free run,
    widened by how much blocks of the record differ and by what random forces make of them. Without
    ``halves_agree`` the check on halves is left out, for callers that decide on data which neither
    fit has seen.
    """
    if not fit.estimate.finite or is_random_force_small(fit) or not fit.estimate.keys:
        return fit
    if all(task.is_driven_unseen for task, _ in fit.estimate.prepared):
        return fit  # a free run has nothing to follow
    progress("fitting values that minimise the free-run error")
    white, like = white_noise_only(fit), fit.estimate.prepared
    free = fit_by_likelihood(assembly, fit.state, white, rough=True, like=like)
    ours, theirs = (_mean_free_run_error(f, white, None) for f in (fit, free))
    if not theirs < _BETTER * ours:
        return fit
    if not halves_agree:
        return _with_noise_terms_of(assembly, free, fit)
    ours = 0.0
    for fitted, other in itertools.permutations(_record_halves(fit.estimate.prepared)):
        stepwise = fit_by_likelihood(
            assembly, fit.state, masks=fitted, rough=True, kept=fit.estimate.kept
        )
        ours += _mean_free_run_error(stepwise, white, other) ** 2
    if not error_on_other_halves(assembly, free, white) < ours:
        return fit
    return _with_noise_terms_of(assembly, free, fit)


def error_on_other_halves(assembly: Assembly, free: LikelihoodFit, white: NoiseModel) -> float:
    """The summed squared free-run errors of each half of the records by values of the other.

    ``free`` : the values to begin with. ``white`` : the sensors' noise, beside no random force.
    """
    total = 0.0
    for fitted, other in itertools.permutations(_record_halves(free.estimate.prepared)):
        freely = fit_by_likelihood(assembly, free.state, white, fitted, rough=True)
        total += _mean_free_run_error(freely, white, other) ** 2
    return total


def _random_force_errors(free: MaximumLikelihood, noise: NoiseModel) -> Array:
    """(keys,) standard errors that random forces make of values of a free run.

    With E_s the misses of a drawn motion (``draw_free_misses``) and X the slopes of the free run,
    both over the sensors' noise: rms over s of (X^T X)^-1 X^T E_s. What a motion misses lasts, and
    blocks of a record know too little of it.
    """
    slopes = np.concatenate([p.columns.reshape(-1, len(free.keys)) for p in free.predictions])
    drawn = []
    for r, ((task, settings), part) in enumerate(zip(free.prepared, free.predictions, strict=True)):
        misses = draw_free_misses(task, settings, noise, seed=r)
        drawn.append([(m * part.weight).ravel() for m in misses])
    moved = [least_squares(slopes, np.concatenate(one)).b for one in zip(*drawn, strict=False)]
    return np.sqrt(np.mean(np.square(moved), axis=0))


def free_run_sentences(fit: LikelihoodFit, free: LikelihoodFit) -> tuple[str, ...]:
    """A sentence where the values of the best free run are not the most likely ones, else none.

    With v, s of one fit and w, r of the other: |v - w| > 3 sqrt(s^2 + r^2) for any value. As in the
    test of Hausman (1978): both are right where what is beside the model is random, and only there.
    """
    if free is fit:
        return ()
    most_likely, best = fit.estimate, free.estimate
    apart = {
        key: abs(most_likely.values[key] - best.values[key])
        / np.hypot(most_likely.errors[key], best.errors[key])
        for key in most_likely.keys
        if key in best.errors and most_likely.errors[key] > 0
    }
    key = max(apart, key=lambda k: apart[k], default="")
    if not key or not apart[key] > _APART:
        return ()
    return (
        f"{without_variant(key)} is {number(most_likely.values[key])} where the next sample is "
        f"predicted best and {number(best.values[key])} where a free run is, "
        f"{number(apart[key], 2)} standard errors apart: the force beside the model is not random",
    )


def _record_halves(prepared: FilterInputs) -> tuple[Masks, Masks]:
    """The first half of every record, and the second."""
    counts = [task.series.samples for task, _ in prepared]
    first, second = zip(*(halves(n, (n + 1) // 2) for n in counts), strict=True)
    return first, second


def _mean_free_run_error(fit: LikelihoodFit, white: NoiseModel, masks: Masks) -> float:
    """Free-run error of a fit, rms over each channel's deviation, mean over channels."""
    prepared = fit.estimate.prepared
    parts = predict_cases([(prepared, white)])[0]
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
    """The values of ``free`` with the noise terms of another fit, at their most likely sizes.

    That fit, where no filter stays with the record at the values of ``free``: one that acts only
    where nothing was measured may have run away.
    """
    known, keys = add_standard_errors(free.estimate), free.estimate.keys
    random = _random_force_errors(known, fit.estimate.noise)
    widened = np.array(known.widened)
    if known.regression is not None:
        white = known.regression.spread(1.0)[: len(keys)]
        widened = np.maximum(widened, np.hypot(1.0, random / white))
    noisy = maximise_likelihood(free.estimate.prepared, (), fit.estimate.noise, rough=True)
    if not noisy.finite:
        return fit
    parts = predict_cases([(noisy.prepared, noisy.noise)], keys, keep=True)[0]
    estimate = replace(
        noisy, keys=keys, predictions=parts, regression=known.regression, sizes=known.sizes,
        widened=tuple(map(float, widened)),
    )  # fmt: skip
    return LikelihoodFit(with_estimate(free.state, estimate), estimate)
