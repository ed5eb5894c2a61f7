"""What may be missing, by likelihood: scored, refitted on one half, judged on the other.

1. *Score.* Candidates are ranked along the filtered motion (``scores``).
2. *Refit.* The best are refitted with parameters and noise on the blocks that select, in a race:
   a few steps for all, more for those that keep up.
3. *Judge.* On the other blocks the winner must predict better than the model as it is, both with
   their values from the first; and by Wilks' test, both refitted there, significantly so, for as
   many tests as values of its shapes were tried.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from spiral.engine.likelihood.fit import maximise
from spiral.engine.likelihood.noise import EXTRA
from spiral.engine.likelihood.predict import Masks, log_likelihood
from spiral.engine.score import Score
from spiral.inference.evidence.admission import TOLD, stepped
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.fit_state import FitState, two_sided
from spiral.inference.evidence.scoring import Ranked, present_labels, tested_keys
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    bounds_of,
    explains,
    refitted,
    samples_of,
    with_variants,
)
from spiral.inference.problem import Progress
from spiral.inference.unknown.holding import carried as carried_to
from spiral.types.effect import SensorEffect
from spiral.types.record import Array

_RIVALS = 8  # candidates refitted
_HEAT, _RACE = 3, 12  # scoring steps for all rivals, and for those that keep up
_FAR, _FAR_ONES = 0.1, 3  # share of its bound that an amplitude starts from; shapes tried so
_KEEP, _PROMISED = 0.3, 0.7  # share of the best gain, and of its score, that keeps up
_ODDS = 100.0  # ratio of likelihoods under which two candidates are not told apart


@dataclass(frozen=True)
class Rival:
    """A candidate refitted on the blocks that select.

    ``gain`` in log-likelihood over the model as it is; ``worth`` the same less Schwarz's price.
    """

    ranked: Ranked
    fit: LikelihoodFit
    gain: float
    worth: float

    @property
    def label(self) -> str:
        """Its effect."""
        return self.ranked.variant.original.label


def race(
    assembly: Assembly, base: LikelihoodFit, found: list[Ranked], masks: Masks, progress: Progress
) -> tuple[Assembly, list[Rival]]:
    """Candidates refitted on the blocks that select, best first; those that fell behind are out.

    They are in terms of a study that has them all.
    """
    far = [] if explains(base) else from_afar(assembly, base.state, found)
    chosen = [*found[:_RIVALS], *far]
    if not chosen:
        return assembly, []
    progress(f"compiling {len(chosen)} candidates")
    wide = with_variants(assembly, [r.variant for r in chosen])
    start = in_study(base, assembly, wide)
    runners = []
    for ranked in chosen:
        progress(f"refitting with {ranked.variant.original.label}")
        runners.append(_refit(wide, start, ranked, masks, _HEAT, ranked in far))
    runners = [r for r in runners if r.fit.estimate.finite]
    if not runners:
        return wide, []
    best = max(runners, key=lambda r: r.worth)
    promised = _PROMISED * best.ranked.score.gain
    near = [r for r in runners
            if r.worth >= _KEEP * best.worth or r.ranked.score.gain >= promised]  # fmt: skip
    done = []
    for runner in near:
        progress(f"refitting with {runner.label}")
        done.append(_further(wide, start, runner, masks, _RACE))
    return wide, sorted(done, key=lambda r: -r.worth)


def from_afar(assembly: Assembly, state: FitState, found: list[Ranked]) -> list[Ranked]:
    """Candidates with a second basin, bounded on both sides, which zero amplitude may not show.

    What a rim lets over, or a limit cuts off, is unseen from there. Of each effect a few shapes
    over its grid are tried.
    """
    present = present_labels(assembly, state)
    known = {r.variant.label: r for r in found}
    none = Score((0,), np.zeros(1), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    grids: dict[str, list[Variant]] = {}
    for variant in assembly.offered:
        label = variant.original.label
        if two_sided(variant.original) and label not in present:
            grids.setdefault(label, []).append(variant)
    chosen = []
    for grid in grids.values():
        spots = np.unique(np.linspace(0, len(grid) - 1, _FAR_ONES).round().astype(int))
        chosen += [grid[i] for i in spots]
    return [known.get(v.label, Ranked(v, (0,), none, 0.0, v.searched)) for v in chosen]


def in_study(fit: LikelihoodFit, old: Assembly, new: Assembly) -> LikelihoodFit:
    """A fit's state in another study's order; its estimate stays in the old one's."""
    return replace(fit, state=carried_to(fit.state, old, new))


def _refit(
    assembly: Assembly,
    base: LikelihoodFit,
    ranked: Ranked,
    masks: Masks,
    steps: int,
    far: bool = False,
) -> Rival:
    """A candidate added to the model as it is, a few steps from where that stands.

    ``far``: from a share of its bounds; else from zero, where the first step finds its size.
    """
    wider = added(assembly, base.state, ranked, far)
    fit = refitted(assembly, wider, base.estimate.noise, masks, steps, rough=True)
    return _rival(base, ranked, fit)


def added(assembly: Assembly, state: FitState, ranked: Ranked, far: bool = False) -> FitState:
    """A state with a candidate: from zero, or ``far`` from there."""
    variant = ranked.variant
    values = stepped(assembly, state.values, variant, ranked.score.step)
    for key in tested_keys(assembly, variant) if far else ():
        position = assembly.study.index(key)
        known = assembly.study.compiled.traced.parameters[position]
        values = values.copy()
        values[:, position] = _FAR * (known.upper or 1.0)
    return replace(
        state,
        labels=(*state.labels, variant.label),
        values=values,
        held=(*state.held, *ranked.held),
    )


def _further(
    assembly: Assembly, base: LikelihoodFit, rival: Rival, masks: Masks, steps: int
) -> Rival:
    """A rival's fit taken on, its shapes set free where the record tells them."""
    fit = refitted(assembly, rival.fit.state, rival.fit.estimate.noise, masks, steps, rough=True)
    fit = fit if fit.height >= rival.fit.height else rival.fit
    plain = fit.estimate.noise.without(*EXTRA)
    if len(plain.terms) < len(fit.estimate.noise.terms):
        less = refitted(assembly, rival.fit.state, plain, masks, steps, rough=True)
        fit = less if less.height >= fit.height else fit
    tuned = rival.ranked.variant.tuned
    if tuned:
        freer = replace(fit.state, freed=tuple(dict.fromkeys((*fit.state.freed, *tuned))))
        loose = refitted(assembly, freer, fit.estimate.noise, masks, steps, rough=True)
        if loose.estimate.finite and told(loose, tuned):
            fit = loose
    return _rival(base, rival.ranked, fit)


def told(fit: LikelihoodFit, keys: tuple[str, ...]) -> bool:
    """Whether a fit leaves these parameters a relative error of a half at most."""
    values, errors = fit.estimate.values, fit.estimate.errors
    return all(errors.get(k, np.inf) <= TOLD * abs(values.get(k, 0.0)) for k in keys)


def _rival(base: LikelihoodFit, ranked: Ranked, fit: LikelihoodFit) -> Rival:
    gain = fit.height - base.height
    price = 0.5 * len(ranked.columns) * float(np.log(samples_of(fit.estimate.prepared)))
    return Rival(ranked, fit, gain, gain - price)


@dataclass(frozen=True)
class Judged:
    """The winner on the blocks that did not select, in log-likelihood.

    ``predicted`` its gain where both models have their values from the blocks that did,
    ``refitted`` where both have their most likely ones; ``terms`` the parameters that it has beyond
    the model as it is; ``searched`` among how many values its shapes were looked for.
    """

    predicted: float
    refitted: float
    terms: int
    searched: int

    def passes(self, level: float) -> bool:
        """Whether it holds there, at a level of error."""
        return self.predicted > 0 and self.p_value < level

    @property
    def p_value(self) -> float:
        """Of Wilks' test, for as many tests as shapes were searched among."""
        single = float(stats.chi2.sf(2 * max(self.refitted, 0.0), self.terms))
        return min(self.searched * single, 1.0)


def judged(assembly: Assembly, base: LikelihoodFit, rival: Rival, masks: Masks) -> Judged:
    """A winner against the model as it is on other blocks than those that chose it.

    Parameters
    ----------
    base : the model as it is. masks : the blocks that did not select.
    """
    theirs = log_likelihood(rival.fit.estimate.parts, masks)
    ours = log_likelihood(base.estimate.parts, masks)
    before = max(_most_likely(assembly, base, masks), ours)
    after = max(_most_likely(assembly, rival.fit, masks), theirs)
    freed = set(rival.fit.state.freed) - set(base.state.freed)
    terms = len(rival.ranked.columns) + len(freed)
    searched = rival.ranked.variant.searched if freed else 1
    return Judged(theirs - ours, after - before, terms, searched)


def _most_likely(assembly: Assembly, fit: LikelihoodFit, masks: Masks) -> float:
    """The highest log-likelihood of a model on some blocks."""
    keys = fit.estimate.keys
    bounds = bounds_of(assembly, keys)
    found = maximise(fit.estimate.prepared, keys, fit.estimate.noise, bounds, masks, _RACE)
    return found.log_likelihood


def alike(rivals: list[Rival]) -> tuple[str, ...]:
    """Rivals that the whole records do not tell from the first one."""
    first, *others = rivals
    best = log_likelihood(first.fit.estimate.parts) - _terms(first)
    near = [
        r for r in others
        if best - log_likelihood(r.fit.estimate.parts) + _terms(r) < np.log(_ODDS)
    ]  # fmt: skip
    return tuple(dict.fromkeys(r.label for r in near if r.label != first.label))


def machine_first(
    rival: Rival, aliases: tuple[str, ...], rivals: list[Rival]
) -> tuple[Rival, tuple[str, ...]]:
    """A change of the machine in place of one of a sensor that is not told from it."""
    if not isinstance(rival.ranked.variant.original, SensorEffect):
        return rival, aliases
    for other in rivals:
        own = other.ranked.variant.original
        if other.label in aliases and not isinstance(own, SensorEffect):
            return other, (rival.label, *(x for x in aliases if x != other.label))
    return rival, aliases


def _terms(rival: Rival) -> float:
    return 0.5 * len(rival.ranked.columns) * float(np.log(samples_of(rival.fit.estimate.prepared)))


def response_change(base: LikelihoodFit, rival: Rival) -> Array:
    """Root mean square of the change of each prediction, in standard deviations of the misses."""
    before = np.concatenate([p.misses for p in base.estimate.parts])
    after = np.concatenate([p.misses for p in rival.fit.estimate.parts])
    spread = np.concatenate([np.sqrt(p.spreads) for p in base.estimate.parts])
    seen = spread > 0
    change = np.where(seen, (after - before) / np.where(seen, spread, 1.0), 0.0)
    return np.sqrt(np.mean(change**2, axis=0))
