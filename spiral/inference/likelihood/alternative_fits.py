"""Candidates tried on other fits of the model, whose own fit may hide a missing effect.

A model that lacks something makes up for it with whatever it may move, and from such a fit the
missing effect makes nothing more likely, although from another both come right together:

- *values*: it may explain much by values far from those given, an exchange that runs one way only
  in place of a loss that is not in proportion. So candidates are tried from the values given;
- *noise*: coloured noise or a drift may take a sensor's offset, and a random force whatever a force
  leaves. So candidates are tried from white noise alone, and from sensor noise alone. Where noise
  is slow, the likeliest of them has the noise that the record wants beside it, as the model as it
  is has its own: beside white noise alone a constant is worth less than noise that has its colour.

What such noise leaves of the colour is not taken for what is missing: there candidates are ranked
beside innovations that follow their own past (``engine.likelihood.autoregression``).

Schwarz's penalty and the other half of the blocks judge them like any other, against
the model as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.autoregression import autoregressive_order, coloured_log_likelihood
from spiral.engine.likelihood.fit import maximise_likelihood
from spiral.engine.likelihood.noise import EXTRA, first_noise, size_limits
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.candidates import (
    Rival,
    fit_candidate_briefly,
    make_rival,
    select_promising,
)
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WARM,
    LikelihoodFit,
    fit_by_likelihood,
    free_parameters,
    is_random_force_small,
    prepare_filter_tasks,
    schwarz_penalty,
    with_estimate,
)
from spiral.inference.likelihood.noise_selection import select_noise_model
from spiral.inference.likelihood.scores import rank_candidates
from spiral.inference.likelihood.seed_fit import far_from_given, sensor_noise_only
from spiral.inference.problem import Progress
from spiral.types.noise import COLOURED, CORRELATED

_BEHIND = 2.0  # factor from the given value beyond which a fitted one is far from it
_LASTING = 0.5  # share of the longest correlation time from which noise is as good as constant
_MOST = 4  # candidates refitted from each of these fits


def rivals_from_given_values(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> list[Rival]:
    """The most promising candidates, fitted briefly from the values given.

    They are compared with ``base``. None where its values are near those given; ``masks`` are the
    blocks that select.
    """
    starts = fits_at_given_values(assembly, base.state, masks, progress)
    rivals = (r for start in starts for r in _rivals_from_fit(assembly, base, start, masks))
    return [_with_base_noise_terms(base, r, masks) for r in rivals]


def rivals_beside_less_noise(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> list[Rival]:
    """The most promising candidates beside white noise alone, and beside sensor noise alone.

    As in ``rivals_from_given_values``. None where the noise is white and the random force small.
    """
    noise, less = base.estimate.noise, base.estimate.noise.replace_with_white(*EXTRA)
    rivals = []
    if len(less.terms) < len(noise.terms):
        progress("trying candidates beside white noise alone")
        start = fit_by_likelihood(assembly, base.state, less, masks, WARM, True)
        white = _rivals_from_fit(assembly, base, start, masks, past=True)
        rivals += [_with_base_noise_terms(base, r, masks) for r in white]
        if white and _has_lasting_noise(base):
            best = _most_beside_past(start, white, masks)
            rivals.append(_refit_rival_noise(assembly, base, best, masks, progress))
    if not is_random_force_small(base):
        progress("trying candidates beside sensor noise alone")
        sensor_noise = sensor_noise_only(base)
        start = fit_by_likelihood(assembly, base.state, sensor_noise, masks, WARM, True)
        own = _rivals_from_fit(assembly, base, start, masks, past=True)
        rivals += [_with_base_noise_terms(base, r, masks) for r in own]
    return rivals


def _has_lasting_noise(fit: LikelihoodFit) -> bool:
    """Whether a random force with a memory acts, or noise of a sensor is as good as constant."""
    noise, task = fit.estimate.noise, fit.estimate.prepared[0][0]
    if any(noise.has_kind(kind) for kind in (*CORRELATED, "drift")):
        return True
    times = {t.time for t in noise.terms if t.kind in COLOURED}
    return any(noise.values[n] >= _LASTING * size_limits(task, n)[1] for n in times)


def _refit_rival_noise(
    assembly: Assembly, base: LikelihoodFit, rival: Rival, masks: Masks, progress: Progress
) -> Rival:
    """A rival of a fit beside white noise, refitted with the noise model selected for it.

    From the noise of the model as it is a drift would not let go of what the rival explains, nor
    would a force on several states at once. What the model as it is gains by that noise is no merit
    of the rival.
    """
    own = rival.assembly
    whole = fit_by_likelihood(
        own, rival.fit.state, rival.fit.estimate.noise, steps=WARM, rough=True
    )
    climbed = select_noise_model(own, whole, progress)
    fit = fit_by_likelihood(own, climbed.state, masks=masks, steps=WARM, rough=True)
    beside = fit_by_likelihood(
        assembly, base.state, fit.estimate.noise, masks, WARM, True, like=base.estimate.prepared
    )
    likelier = beside.log_likelihood > base.log_likelihood
    return make_rival(own, beside if likelier else base, rival.ranked, fit, rival.shapes)


def _most_beside_past(start: LikelihoodFit, rivals: list[Rival], masks: Masks) -> Rival:
    """The rival that is worth most where all follow their own past, as far as ``start`` does."""
    order = autoregressive_order(start.estimate.predictions, masks)

    def worth(rival: Rival) -> float:
        at = rival.fit.estimate
        if not at.finite:
            return -np.inf
        penalty = schwarz_penalty(len(rival.ranked.columns) + rival.shapes, at.prepared)
        return coloured_log_likelihood(at, order, masks) - penalty

    return max(rivals, key=worth)


def _rivals_from_fit(
    assembly: Assembly, base: LikelihoodFit, start: LikelihoodFit, masks: Masks,
    past: bool = False,
) -> list[Rival]:  # fmt: skip
    """The most promising candidates of another fit, compared with ``base``.

    ``past`` : by their scores beside innovations that follow their own past.
    """
    ranked = None
    if start.estimate.finite:
        ranked = rank_candidates(assembly, start, start.estimate.noise, masks, past)
    some = () if ranked is None else select_promising(list(ranked.ranked), _MOST)
    return [fit_candidate_briefly(assembly, base, r, masks, start=start) for r in some]


def _with_base_noise_terms(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival with the noise terms of the model as it is, where it is worth more with them.

    What acts at random with a memory is there whatever is missing; beside white noise alone a
    candidate would have to explain that too.
    """
    noise, own = base.estimate.noise, rival.assembly
    if not any(noise.has_kind(kind) for kind in EXTRA) or not rival.fit.estimate.finite:
        return rival
    like = base.estimate.prepared
    fit = fit_by_likelihood(
        own, rival.fit.state, noise, masks, WARM, True, differences=False, like=like
    )
    again = make_rival(own, base, rival.ranked, fit, rival.shapes)
    return again if fit.estimate.finite and again.worth > rival.worth else rival


def fits_at_given_values(
    assembly: Assembly, state: FitState, masks: Masks, progress: Progress
) -> list[LikelihoodFit]:
    """Fits at the given values, with their most likely noise, and with sensor noise alone.

    None where the state is near these values.
    """
    given = _given_values_if_far(assembly, state)
    if given is None:
        return []
    progress("trying candidates from the values given")
    prepared = prepare_filter_tasks(assembly, given)
    noise = first_noise(prepared[0][0], LEVEL)
    estimate = maximise_likelihood(prepared, (), noise, {}, masks, WARM, rough=True)
    grown = LikelihoodFit(with_estimate(given, estimate), estimate)
    if not estimate.finite or is_random_force_small(grown):
        return [grown]
    estimate = maximise_likelihood(prepared, (), sensor_noise_only(grown), {}, masks, 0)
    return [grown, LikelihoodFit(with_estimate(given, estimate), estimate)]


def _given_values_if_far(assembly: Assembly, state: FitState) -> FitState | None:
    """The state with the system's values as they were given; nothing where it is near them."""
    if not far_from_given(assembly, state, _BEHIND):
        return None
    known, values = assembly.problem.model.given_values, state.values.copy()
    for key in (k for k in free_parameters(assembly, state) if known.get(k)):
        values[:, assembly.study.index(key)] = known[key]
    if not np.all(np.isfinite(values)):
        return None
    return replace(state, values=values, noise=None, starts=None, spreads=None)
