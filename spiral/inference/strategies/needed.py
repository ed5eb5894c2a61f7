"""Which of the effects that a model holds a fit needs, and how far each is from none."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from spiral.inference.evidence.admission import let_go
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.scoring import tested_keys
from spiral.inference.likelihood.beginnings import restarted
from spiral.inference.likelihood.between import run_otherwise
from spiral.inference.likelihood.fitting import LikelihoodFit, price, refitted
from spiral.inference.problem import Progress
from spiral.types.effect import InputEffect, SensorEffect


def without_superfluous(
    assembly: Assembly, found: LikelihoodFit, latest: str
) -> tuple[LikelihoodFit, tuple[str, ...]]:
    """Effects admitted before that the record no longer wants, let go."""
    gone: list[str] = []
    for variant in admitted(assembly, found, latest):
        keys = tested_keys(assembly, variant)
        if _far_from_zero(assembly, found, keys):
            continue
        trial = _without(assembly, found, variant)
        if trial.height > found.height - price(len(keys), trial.estimate.prepared):
            found = trial
            gone.append(variant.original.label)
    return found, tuple(gone)


def _without(
    assembly: Assembly, found: LikelihoodFit, variant: Variant, rough: bool = False
) -> LikelihoodFit:
    """The fit without one effect, each record begun where this model says.

    The states of an effect on a sensor may have made up for where another's begin.
    """
    trial = refitted(assembly, let_go(assembly, found.state, (variant.label,)), rough=rough)
    return restarted(assembly, trial) if trial.estimate.finite else trial


def admitted(assembly: Assembly, found: LikelihoodFit, latest: str = "") -> list[Variant]:
    """What a fit holds beside the seed, but for the latest."""
    seed = assembly.problem.model.labels
    return [assembly.variant(x) for x in found.state.labels if x not in seed and x != latest]


def run_otherwise_instead(
    assembly: Assembly, found: LikelihoodFit, progress: Progress
) -> tuple[LikelihoodFit, tuple[str, ...]]:
    """Effects of inputs and sensors that another way of the input between samples makes needless.

    A force that a controller holds looks like an actuator that lags by half a sample; while another
    effect is missing the lag may be the more likely of the two, as its time can make up for that.
    """
    gone: list[str] = []
    for variant in admitted(assembly, found):
        if not isinstance(variant.original, InputEffect | SensorEffect):
            continue
        without = let_go(assembly, found.state, (variant.label,))
        worth = price(len(tested_keys(assembly, variant)), found.estimate.prepared)
        fits = run_otherwise(assembly, found, without, found.height - worth, progress)
        best = max(fits, key=lambda f: f.height, default=None)
        if best is not None and best.height > found.height - worth:
            found = best
            gone.append(variant.original.label)
    return found, tuple(gone)


def _far_from_zero(assembly: Assembly, found: LikelihoodFit, keys: tuple[str, ...]) -> bool:
    """Whether one of these values is further from zero than standard errors allow."""
    values, errors = found.estimate.values, found.estimate.errors
    least = assembly.problem.settings.least_t
    return any(abs(values.get(k, 0.0)) > least * errors.get(k, np.inf) for k in keys)


def told_by_likelihood(assembly: Assembly, found: LikelihoodFit) -> dict[str, float]:
    """How far effects within their standard errors of none are by the likelihood without them.

    A slope where an amplitude stands says nothing of zero where it saturates (a rim that spills
    all), or where a shape makes up for it. The ratio is told in standard errors of one estimate: z
    with P(|x| > z) that of a chi-squared 2 (log L_1 - log L_0).
    """
    told: dict[str, float] = {}
    for variant in admitted(assembly, found) if found.estimate.finite else ():
        if _far_from_zero(assembly, found, tested_keys(assembly, variant)):
            continue
        without = _without(assembly, found, variant, rough=True)
        free = [k for k in found.estimate.keys if k.rpartition(".")[0] == variant.label]
        gain = max(found.height - without.height, 0.0)
        told[variant.original.label] = _as_one(2 * gain, len(free))
    return told


def _as_one(statistic: float, degrees: int) -> float:
    """Standard errors of one estimate that are as unlikely as a chi-squared statistic."""
    single = float(np.sqrt(chi2.isf(chi2.sf(statistic, max(degrees, 1)), 1)))
    return min(single, float(np.sqrt(statistic)))
