"""A candidate that takes most of what a free run misses, where no likelihood tells it.

Beside a random force that is too large to be an explanation a model is corrected at every sample,
and what changes its motion over long times makes the next sample hardly likelier: a level sensor
whose zero is off, over an outlet. What a free run misses does tell it. From the values with which
that is least candidates are scored and refitted without any random force, and one passes

- whose free runs of the fitted records are likelier than by chance, counted in as many independent
  values as what is missed consists of (``engine.likelihood.free_misses``), at the round's level
  over all candidates that were scored;
- whose values from each half of the records predict the other half better than the model as it is;
- with which free runs of unseen data err less, by a size that counts, and no error ahead grows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from spiral.engine.likelihood.free_misses import (
    free_run_gain,
    free_run_level,
    independent_misses,
)
from spiral.engine.likelihood.noise import NoiseModel
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.scoring import RankedCandidate
from spiral.inference.likelihood.alias_groups import simplest_rival
from spiral.inference.likelihood.candidates import Rival, fit_candidate_briefly, select_promising
from spiral.inference.likelihood.fitting import LikelihoodFit, fit_by_likelihood
from spiral.inference.likelihood.free_fit import error_on_other_halves
from spiral.inference.likelihood.scores import rank_candidates
from spiral.inference.likelihood.seed_fit import white_noise_only
from spiral.inference.problem import Progress
from spiral.inference.strategies.likelihood.accepted import Objection, RaceOutcome
from spiral.inference.strategies.likelihood.admission import fit_and_ask
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.record import Array

_TRIED = 2  # times the rivals of a round: many effects bend a motion alike, and a fit is short


@dataclass(frozen=True)
class _FreeRun:
    """A model that runs freely: a study, and its fit without random forces."""

    assembly: Assembly
    fit: LikelihoodFit

    @property
    def noise(self) -> NoiseModel:
        """White noise of the sensors, as large as what is missed."""
        return self.fit.estimate.noise

    @property
    def misses(self) -> tuple[Array, ...]:
        """(samples, channels) of each record."""
        return tuple(p.misses for p in self.fit.estimate.predictions)

    @cached_property
    def independent(self) -> Array:
        """(channels,) independent values of what is missed."""
        return independent_misses(self.misses)

    @property
    def values(self) -> float:
        """The same, mean over channels."""
        return float(np.mean(self.independent))

    @cached_property
    def error_elsewhere(self) -> float:
        """Of each half of the records by values of the other half (``error_on_other_halves``)."""
        return error_on_other_halves(self.assembly, self.fit, self.noise)


def first_to_take_free_run(
    options: LikelihoodOptions, assembly: Assembly, base: LikelihoodFit, before: RaceOutcome,
    level: float, objection: Objection, progress: Progress,
) -> tuple[RaceOutcome, tuple[Rival, ...]]:  # fmt: skip
    """The first candidate that takes enough of a free run's error, and all that were refitted.

    ``base`` : the model as it is, with its noise. ``before`` : what came of those tried so far.
    """
    progress("trying candidates by what they do to a free run")
    now = _run_freely(assembly, base)
    ranked = None if now is None else rank_candidates(assembly, now.fit, now.noise, None)
    if now is None or ranked is None:
        return before, ()
    promising = select_promising(list(ranked.ranked), _TRIED * options.rivals)
    rivals = _sort(r for one in promising if (r := _fit_freely(now, one)) is not None)
    rejected, level = dict(before.rejected), level / max(len(ranked.ranked), 1)
    for rival in rivals[: options.judged]:
        if reason := _chance_reason(now, rival, level):
            rejected[rival.label] = reason
            continue
        chosen, aliases = _simplest_beyond_chance(options, now, rival, rivals, level)
        progress(f"most likely values with {chosen.label}")
        beside = replace(chosen.fit.state, noise=base.estimate.noise)
        noisy = replace(chosen, fit=replace(chosen.fit, state=beside))
        passed, refusal = fit_and_ask(noisy, aliases, objection, progress)
        if refusal is None:
            return replace(before, passed=passed, rejected=rejected), tuple(rivals)
        rejected[chosen.label] = refusal.reason
    return replace(before, rejected=rejected), tuple(rivals)


def _run_freely(assembly: Assembly, base: LikelihoodFit) -> _FreeRun | None:
    """The model as it is with the values whose free run errs least; nothing if it runs away."""
    white, like = white_noise_only(base), base.estimate.prepared
    fit = fit_by_likelihood(assembly, base.state, white, rough=True, like=like)
    return _FreeRun(assembly, fit) if fit.estimate.finite else None


def _sort(rivals: Iterable[Rival]) -> list[Rival]:
    """By worth, one of each effect."""
    best: dict[str, Rival] = {}
    for rival in sorted(rivals, key=lambda r: -r.worth):
        best.setdefault(rival.label, rival)
    return list(best.values())


def _simplest_beyond_chance(
    options: LikelihoodOptions, now: _FreeRun, rival: Rival, rivals: list[Rival], level: float
) -> tuple[Rival, tuple[str, ...]]:
    """The simplest rival within the odds of this one, and the labels of the others."""
    others, least = [r for r in rivals if r is not rival], rival.worth - np.log(options.odds)
    near = tuple(r.label for r in others if r.worth > least)
    chosen, aliases = simplest_rival(rival, near, rivals)
    if chosen is not rival and _chance_reason(now, chosen, level):
        return rival, near
    return chosen, aliases


def _fit_freely(now: _FreeRun, ranked: RankedCandidate) -> Rival | None:
    """A candidate beside the model, running freely; nothing where it runs away or is worth nothing.

    Its worth is its gain less Schwarz's penalty, both counted in independent values.
    """
    brief = fit_candidate_briefly(now.assembly, now.fit, ranked, None, start=now.fit)
    at = brief.fit.estimate
    if not at.finite:
        return None
    fit = fit_by_likelihood(
        brief.assembly, brief.fit.state, at.noise, rough=True, differences=False, like=at.prepared
    )
    if not fit.estimate.finite:
        return None
    gain = free_run_gain(now.misses, _FreeRun(brief.assembly, fit).misses, now.independent)
    worth = gain - 0.5 * len(ranked.columns) * float(np.log(max(now.values, 1.0)))
    return replace(brief, fit=fit, gain=gain, worth=worth) if worth > 0 else None


def _chance_reason(now: _FreeRun, rival: Rival, level: float) -> str:
    """Why what a rival takes of a free run may be chance; empty where it is not."""
    known, added = len(now.fit.estimate.keys), len(rival.ranked.columns)
    p = free_run_level(rival.gain, now.values, known, added)
    if not p <= level:
        return f"what it takes of a free run may be chance (p = {p:.2g})"
    if not error_on_other_halves(rival.assembly, rival.fit, now.noise) < now.error_elsewhere:
        return "its values from one half of the records do not make the other's free run better"
    return ""
