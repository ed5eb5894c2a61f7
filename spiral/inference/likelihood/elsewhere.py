"""Candidates tried from other fits than the model's own, where that may hide what is missing.

A model that lacks something makes up for it with whatever it may move, and from such a fit the
missing effect makes nothing more likely, although from another both come right together:

- *values*: it may explain much by values far from those given, an exchange that runs one way only
  in place of a loss that is not in proportion. So candidates are tried from the values given;
- *noise*: coloured noise or a drift may take a sensor's offset, and a random force whatever a force
  leaves. So candidates are tried from white noise alone, and from sensor noise alone. Where noise
  is slow, the likeliest of them has the noise that the record wants beside it, as the model as it
  is has its own: beside white noise alone a constant is worth less than noise that has its colour.

Schwarz's price and the other half of the blocks judge them like any other, against the model as it
is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.fit import maximise
from spiral.engine.likelihood.noise import EXTRA, first_noise, limits
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.candidates import Rival, first_steps, promising, rival_of
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WARM,
    LikelihoodFit,
    explains,
    moving,
    refitted,
    subjects,
    with_estimate,
)
from spiral.inference.likelihood.ladder import climbed_ladder
from spiral.inference.likelihood.scores import ranking
from spiral.inference.likelihood.starts import sensors_alone
from spiral.inference.problem import Progress
from spiral.types.noise import COLOURED

_BEHIND = 2.0  # factor by which a fitted value differs from the one given that is left behind
_LASTING = 0.5  # share of the longest correlation time from which noise is as good as constant
_MOST = 4  # candidates refitted from each of these fits


def from_given(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> list[Rival]:
    """The most promising candidates after their first steps from the values given.

    They are held against ``base``. None where that is near these; ``masks`` are the blocks that
    select.
    """
    starts = _at_given(assembly, base.state, masks, progress)
    return [r for start in starts for r in _from(assembly, base, start, masks)]


def from_less_noise(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> list[Rival]:
    """The same from white noise alone, and from sensor noise alone; see ``from_given``.

    None where nothing but little acts at random.
    """
    noise, less = base.estimate.noise, base.estimate.noise.whitened(*EXTRA)
    rivals = []
    if len(less.terms) < len(noise.terms):
        progress("trying candidates beside white noise alone")
        white = _from(
            assembly, base, refitted(assembly, base.state, less, masks, WARM, True), masks
        )
        if white and _slow(base):
            best = max(white, key=lambda r: r.worth)
            white.append(_with_own_noise(base, best, masks, progress))
        rivals += white
    if not explains(base):
        progress("trying candidates beside sensor noise alone")
        deaf = refitted(assembly, base.state, sensors_alone(base), masks, WARM, True)
        rivals += _from(assembly, base, deaf, masks)
    return rivals


def _slow(found: LikelihoodFit) -> bool:
    """Whether noise of a sensor hardly moves within the record, as its zero does."""
    noise, task = found.estimate.noise, found.estimate.prepared[0][0]
    times = {t.time for t in noise.terms if t.kind in COLOURED}
    lasting = any(noise.values[n] >= _LASTING * limits(task, n)[1] for n in times)
    return lasting or noise.has("drift")


def _with_own_noise(base: LikelihoodFit, rival: Rival, masks: Masks, progress: Progress) -> Rival:
    """A rival beside the noise that the record wants with it."""
    own = rival.assembly
    whole = refitted(own, rival.fit.state, rival.fit.estimate.noise, steps=WARM, rough=True)
    climbed = climbed_ladder(own, whole, progress)
    fit = refitted(own, climbed.state, masks=masks, steps=WARM, rough=True)
    return rival_of(own, base, rival.ranked, fit, rival.shapes)


def _from(
    assembly: Assembly, base: LikelihoodFit, start: LikelihoodFit, masks: Masks
) -> list[Rival]:
    """The most promising candidates of another fit, held against ``base``."""
    ranked = None
    if start.estimate.finite:
        ranked = ranking(assembly, start, start.estimate.noise, masks)
    some = () if ranked is None else promising(list(ranked.ranked), _MOST)
    rivals = [first_steps(assembly, base, r, masks, start=start) for r in some]
    return [_beside_noise_of(base, r, masks) for r in rivals]


def _beside_noise_of(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival with the kinds of noise that the model as it is has, where that is likelier.

    What acts at random with a memory is there whatever is missing; beside white noise alone a
    candidate would have to explain that too.
    """
    noise, own = base.estimate.noise, rival.assembly
    if not any(noise.has(kind) for kind in EXTRA) or not rival.fit.estimate.finite:
        return rival
    like = base.estimate.prepared
    fit = refitted(own, rival.fit.state, noise, masks, WARM, True, differences=False, like=like)
    again = rival_of(own, base, rival.ranked, fit, rival.shapes)
    return again if fit.estimate.finite and again.worth > rival.worth else rival


def _at_given(
    assembly: Assembly, state: FitState, masks: Masks, progress: Progress
) -> list[LikelihoodFit]:
    """The system's values as they were given, with the noise that they want, and sensors' alone.

    None where the fit is near them.
    """
    given = _given(assembly, state)
    if given is None:
        return []
    progress("trying candidates from the values given")
    prepared = subjects(assembly, given)
    noise = first_noise(prepared[0][0], LEVEL)
    estimate = maximise(prepared, (), noise, {}, masks, WARM, rough=True)
    grown = LikelihoodFit(with_estimate(given, estimate), estimate)
    if not estimate.finite or explains(grown):
        return [grown]
    estimate = maximise(prepared, (), sensors_alone(grown), {}, masks, 0)
    return [grown, LikelihoodFit(with_estimate(given, estimate), estimate)]


def _given(assembly: Assembly, state: FitState) -> FitState | None:
    """The state with the system's values as they were given; nothing where it is near them."""
    known, values = assembly.problem.model.values, state.values.copy()
    behind = False
    for key in (k for k in moving(assembly, state) if known.get(k)):
        at = assembly.study.index(key)
        share = float(values[0, at]) / known[key]
        behind = behind or not 1 / _BEHIND <= share <= _BEHIND
        values[:, at] = known[key]
    if not behind or not np.all(np.isfinite(values)):
        return None
    return replace(state, values=values, noise=None, starts=None, spreads=None)
