"""Values by which a model predicts best without correction, where much acts at random beside it.

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

from spiral.engine.likelihood.fit import informed, maximise
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import Masks, Prepared, all_predicted
from spiral.engine.windows import halves
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    explains,
    refitted,
    with_estimate,
)
from spiral.inference.likelihood.starts import sensors_alone
from spiral.inference.problem import Progress

FREELY = (
    "the values are those that predict best without correction: much acts beside the model that "
    "is not random, and one-step predictions, which are corrected for it, would choose others"
)
"""What is said where values are those of free runs."""

_BETTER = 0.9  # share of the other's error below which values by free runs are taken


def by_free_runs(
    assembly: Assembly, found: LikelihoodFit, progress: Progress, halves_agree: bool = True
) -> LikelihoodFit:
    """The fit with the values that predict best without correction, if these are far better.

    Its noise is the most likely one beside them, its standard errors those of the free run
    (widened by how much blocks of the record differ). Without ``halves_agree`` halves are not
    asked: data that neither has seen are to decide then.
    """
    if not found.estimate.finite or explains(found) or not found.estimate.keys:
        return found
    progress("asking what predicts best without correction")
    deaf = sensors_alone(found)
    deaf = deaf.of(t for t in deaf.terms if t.kind == "white")
    free = refitted(assembly, found.state, deaf, rough=True, like=found.estimate.prepared)
    ours, theirs = (_missed(f, deaf, None) for f in (found, free))
    if not theirs < _BETTER * ours:
        return found
    if not halves_agree:
        return _with_noise_of(assembly, free, found)
    ours = theirs = 0.0
    for fitted, other in itertools.permutations(_halves(found.estimate.prepared)):
        stepwise = refitted(
            assembly, found.state, masks=fitted, rough=True, kept=found.estimate.kept
        )
        freely = refitted(assembly, free.state, deaf, fitted, rough=True)
        ours += _missed(stepwise, deaf, other) ** 2
        theirs += _missed(freely, deaf, other) ** 2
    if not theirs < ours:
        return found
    return _with_noise_of(assembly, free, found)


def _halves(prepared: Prepared) -> tuple[Masks, Masks]:
    """The first half of every record, and the second."""
    counts = [task.series.samples for task, _ in prepared]
    first, second = zip(*(halves(n, (n + 1) // 2) for n in counts), strict=True)
    return first, second


def _missed(found: LikelihoodFit, deaf: NoiseModel, masks: Masks) -> float:
    """Mean over channels of what free runs of a fit miss, over the channels' deviations."""
    prepared = found.estimate.prepared
    parts = all_predicted([(prepared, deaf)])[0]
    if not all(p.whole for p in parts):
        return np.inf
    total, count = 0.0, 0
    for r, ((task, _), part) in enumerate(zip(prepared, parts, strict=True)):
        chosen = None if masks is None else masks[r]
        misses = (part.misses if chosen is None else part.misses[chosen]) / task.series.deviations
        total, count = total + np.sum(misses**2, axis=0), count + len(misses)
    return float(np.mean(np.sqrt(total / max(count, 1))))


def _with_noise_of(assembly: Assembly, free: LikelihoodFit, found: LikelihoodFit) -> LikelihoodFit:
    """A free fit's values with the noise terms of another, at their most likely sizes."""
    known, keys = informed(free.estimate), free.estimate.keys
    noisy = maximise(free.estimate.prepared, (), found.estimate.noise, rough=True)
    parts = all_predicted([(noisy.prepared, noisy.noise)], keys, keep=True)[0]
    estimate = replace(
        noisy, keys=keys, parts=parts, solved=known.solved, sizes=known.sizes,
        widened=known.widened,
    )  # fmt: skip
    return LikelihoodFit(with_estimate(free.state, estimate), estimate)
