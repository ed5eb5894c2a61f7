"""Candidates tried from other fits than the model's own, where that may hide what is missing.

A model that lacks something makes up for it with whatever it may move, and from such a fit the
missing effect makes nothing more likely, although from another both come right together:

- *values*: it may explain much by values far from those given, an exchange that runs one way only
  in place of a loss that is not in proportion. So candidates are tried from the values given;
- *noise*: coloured noise or a drift may take a sensor's offset, and a random force whatever a force
  leaves. So candidates are tried from white noise alone, and from sensor noise alone.

Schwarz's price and the other half of the blocks judge them like any other, against the model as it
is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.fit import maximise
from spiral.engine.likelihood.noise import EXTRA, first_noise
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.candidates import Rival, first_steps, promising
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
from spiral.inference.likelihood.scores import ranking
from spiral.inference.likelihood.starts import sensors_alone
from spiral.inference.problem import Progress

_BEHIND = 2.0  # factor by which a fitted value differs from the one given that is left behind
_MOST = 4  # candidates refitted from each of these fits


def from_elsewhere(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> list[Rival]:
    """The most promising candidates after their first steps from other fits than ``base``.

    They are held against ``base``. None where that is near the values given and nothing but little
    acts at random; ``masks`` are the blocks that select.
    """
    rivals = []
    for start in _others(assembly, base, masks, progress):
        ranked = ranking(assembly, start, start.estimate.noise, masks)
        some = () if ranked is None else promising(list(ranked.ranked), _MOST)
        rivals += [first_steps(assembly, base, r, masks, start=start) for r in some]
    return rivals


def _others(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> Iterator[LikelihoodFit]:
    """Fits whose candidates may be others than those of ``base``."""
    noise, less = base.estimate.noise, base.estimate.noise.without(*EXTRA)
    others = [_at_given(assembly, base.state, masks, progress)]
    if len(less.terms) < len(noise.terms):
        progress("trying candidates beside white noise alone")
        others.append(refitted(assembly, base.state, less, masks, WARM, True))
    if not explains(base):
        progress("trying candidates beside sensor noise alone")
        deaf = sensors_alone(base)
        others.append(refitted(assembly, base.state, deaf, masks, WARM, True))
    yield from (x for x in others if x is not None and x.estimate.finite)


def _at_given(
    assembly: Assembly, state: FitState, masks: Masks, progress: Progress
) -> LikelihoodFit | None:
    """The system's values as they were given, with the noise that they want.

    Nothing where the fit is near them.
    """
    given = _given(assembly, state)
    if given is None:
        return None
    progress("trying candidates from the values given")
    prepared = subjects(assembly, given)
    noise = first_noise(prepared[0][0], LEVEL)
    estimate = maximise(prepared, (), noise, {}, masks, WARM, rough=True)
    return LikelihoodFit(with_estimate(given, estimate), estimate)


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
    return replace(state, values=values, noise=None, starts=None)
