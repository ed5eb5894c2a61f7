"""Candidates tried from the values that the model was given, where its fit has left these behind.

A model that lacks something may explain much of a record by values far from those given: an
exchange that runs one way only in place of a loss that is not in proportion. From there the missing
effect makes nothing more likely, although from the values given both come right together. Schwarz's
price and the other half of the blocks judge it like any other.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.likelihood.fit import maximise
from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.candidates import Rival, first_steps, promising
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WARM,
    LikelihoodFit,
    moving,
    subjects,
    with_estimate,
)
from spiral.inference.likelihood.scores import ranking
from spiral.inference.problem import Progress

_BEHIND = 2.0  # factor by which a fitted value differs from the one given that is left behind
_MOST = 4  # candidates refitted from there


def from_given(
    assembly: Assembly, base: LikelihoodFit, masks: Masks, progress: Progress
) -> list[Rival]:
    """The most promising candidates after their first steps from the values given.

    They are held against ``base``. None where that is near these; ``masks`` are the blocks that
    select.
    """
    given = _given(assembly, base.state)
    if given is None:
        return []
    progress("trying candidates from the values given")
    prepared = subjects(assembly, given)
    noise = first_noise(prepared[0][0], LEVEL)
    estimate = maximise(prepared, (), noise, {}, masks, WARM, rough=True)
    start = LikelihoodFit(with_estimate(given, estimate), estimate)
    if not estimate.finite:
        return []
    ranked = ranking(assembly, start, estimate.noise, masks)
    some = () if ranked is None else promising(list(ranked.ranked), _MOST)
    return [first_steps(assembly, base, r, masks, start=start) for r in some]


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
