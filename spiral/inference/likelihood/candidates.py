"""What may be missing, by likelihood: scored, refitted on one half, judged on the other.

1. *Score.* Candidates are ranked along the filtered motion (``scores``).
2. *Refit.* The best are refitted with parameters and noise on the blocks that select, in a race:
   a few steps for all, more for those that keep up.
3. *Judge.* On the other blocks the winner must predict better (``judging``).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.likelihood.fit import Kept
from spiral.engine.likelihood.noise import EXTRA, NoiseModel, first_noise
from spiral.engine.likelihood.predict import Masks
from spiral.engine.score import Score
from spiral.inference.evidence.admission import stepped
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.fit_state import FitState, two_sided
from spiral.inference.evidence.scoring import Ranked, present_labels, tested_keys
from spiral.inference.likelihood.beginnings import begun_closely
from spiral.inference.likelihood.fitting import (
    LEVEL,
    LikelihoodFit,
    explains,
    price,
    refitted,
    reopened,
    settled_values,
)
from spiral.inference.likelihood.shapes import with_own_shapes
from spiral.inference.problem import Progress
from spiral.inference.unknown.holding import carried as carried_to
from spiral.inference.unknown.holding import with_variants
from spiral.types.label import make_label

_HEAT, _RACE = 3, 12  # scoring steps for all rivals, at most, and for those that keep up
_FRESH = 8  # from noise that is begun afresh
_FAR, _FAR_ONES = 0.1, 3  # share of its bound that an amplitude starts from; shapes tried so
_KEEP, _PROMISED = 0.3, 0.7  # share of the best gain, and of its score, that keeps up at first
_NEAR = 0.6  # share of the best gain that keeps up to the end
_SEVERAL, _OTHERS = 2, 2  # shapes from which others are tried, and how many of these
_ALIKE, _ALIKE_ONES = 0.9, 3  # share of the best score from which a candidate looks like it


@dataclass(frozen=True)
class Rival:
    """A candidate refitted on the blocks that select.

    ``gain`` in log-likelihood over the model as it is; ``worth`` the same less Schwarz's price of
    its amplitudes and of the ``shapes`` that took their most likely values here. The fit is in
    terms of a study of its own, the model with this candidate; ``plain`` is how far it came with
    less at random, where that is not as likely.
    """

    assembly: Assembly
    ranked: Ranked
    fit: LikelihoodFit
    gain: float
    worth: float
    shapes: int = 0
    plain: LikelihoodFit | None = None

    @property
    def label(self) -> str:
        """Its effect."""
        return self.ranked.variant.original.label


@dataclass
class Race:
    """Candidates refitted on the blocks that select, and taken on as long as they keep up.

    ``runners`` have been taken a few steps, best first; those of ``finals`` to the likelihood's
    maximum.
    """

    assembly: Assembly
    base: LikelihoodFit
    masks: Masks
    progress: Progress
    runners: list[Rival]
    finals: list[list[Rival]] = field(default_factory=list)

    @property
    def finalists(self) -> tuple[Rival, ...]:
        """Those of all finals so far."""
        return tuple(r for final in self.finals for r in final)

    @property
    def behind(self) -> list[Rival]:
        """Those that are in no final, nor another variant of their effect."""
        gone = {r.label for r in self.finalists}
        return [r for r in self.runners if r.label not in gone]

    @property
    def tried(self) -> tuple[Rival, ...]:
        """All: the finalists, then those behind."""
        return (*self.finalists, *self.behind)

    @property
    def best(self) -> float:
        """The most that a candidate makes of the blocks that select, beyond its price."""
        return max((r.worth for r in self._at(0)), default=0.0)

    def joined_by(self, others: Sequence[Rival]) -> Race:
        """The race begun again with others that have taken their first steps."""
        if not others:
            return self
        return replace(self, runners=_in_order([*self.tried, *others]), finals=[])

    def of(self, others: Sequence[Rival]) -> Race:
        """A race of others, that have taken their first steps, alone."""
        return replace(self, runners=_in_order(others), finals=[])

    def winners(self) -> Iterator[tuple[Rival, list[Rival]]]:
        """One after the other with the rivals that are left in its final, most likely first.

        After a final, those it left behind run theirs: one that makes the most of the blocks that
        select may be nothing on the others.
        """
        number = 0
        while last := self._at(number):
            if not last[0].worth > 0:
                return
            for place, rival in enumerate(last):
                yield rival, last[place:]
            number += 1

    def _at(self, number: int) -> list[Rival]:
        """A final, run when it is first asked for; empty where nobody is left for it."""
        if number == len(self.finals) and self.behind:
            self.finals.append(self._final(self.behind))
        return self.finals[number] if number < len(self.finals) else []

    def _final(self, runners: list[Rival]) -> list[Rival]:
        promised = _PROMISED * runners[0].ranked.score.gain
        least = _share(_KEEP, runners[0].worth)
        near = [r for r in runners if r.worth >= least or r.ranked.score.gain >= promised]
        for runner in near:
            self.progress(f"refitting with {runner.label}")
        again = [_heated(self.base, r, self.masks) for r in near]
        least = _share(_NEAR, max(r.worth for r in again))
        rising = zip(near, again, strict=True)  # what it has just won it may win once more
        fit = [r for was, r in rising if r.worth + max(r.worth - was.worth, 0.0) >= least]
        kept = [_reopened(self.base, r, self.masks) for r in fit]
        last = sorted((self._further(r, _RACE) for r in kept), key=lambda r: -r.worth)
        return [_of_other_shapes(self.assembly, self.base, last[0], self.masks), *last[1:]]

    def _further(self, rival: Rival, steps: int) -> Rival:
        return _further(self.base, rival, self.masks, steps)


def _share(share: float, worth: float) -> float:
    """What keeps up with the best; where nothing is worth its price, the best alone."""
    return min(share * worth, worth)


def race(
    assembly: Assembly, base: LikelihoodFit, found: list[Ranked], masks: Masks, progress: Progress,
    most: int,
) -> Race:  # fmt: skip
    """The candidates that may be missing after their first steps.

    ``found`` are all, the best first; those whose score is not worth their price are not refitted,
    nor more than ``most``, their special cases apart.
    """
    far = [] if explains(base) else from_afar(assembly, base.state, found)
    runners = []
    for ranked in [*promising(found, most), *far]:
        progress(f"refitting with {ranked.variant.original.label}")
        runners.append(first_steps(assembly, base, ranked, masks, ranked in far))
    return Race(assembly, base, masks, progress, _in_order(runners))


def _in_order(runners: Sequence[Rival]) -> list[Rival]:
    """Those whose fit is one, the best first."""
    finite = [r for r in runners if r.fit.estimate.finite]
    return sorted(finite, key=lambda r: -r.worth)


def promising(found: list[Ranked], most: int) -> list[Ranked]:
    """The promising ones that come first, what scores like the best, special cases and twins.

    What needs more numbers for the same score (an offset of each of several sensors, beside a load)
    is not worth their price, yet the records may not tell the two apart. Neither may they tell the
    best from what does the same elsewhere, whose score beside a large random force may be nothing.
    """
    chosen = [r for r in found if r.rank < 0 and not r.whole][:most]
    best = max((r.score.gain for r in chosen), default=np.inf)
    alike = (r for r in found if r.score.gain >= _ALIKE * best and not r.whole)
    chosen += itertools.islice((r for r in alike if r not in chosen), _ALIKE_ONES)
    known = {r.variant.original.label: r for r in reversed(found)}
    effects = [r.variant.original for r in chosen]
    labels = [make_label(name, e.port) for e in effects for name in e.special]
    special = [known[label] for label in dict.fromkeys(labels) if label in known]
    names = effects[0].twins if effects else ()
    twins = [r for r in known.values() if r.variant.original.plugin_name() in names][:_ALIKE_ONES]
    also = dict.fromkeys(r.variant.original.label for r in (*special, *twins))
    return chosen + [known[x] for x in also if known[x] not in chosen]


def refit_alone(assembly: Assembly, base: LikelihoodFit, ranked: Ranked) -> Rival:
    """A candidate refitted to all samples without others, its shapes free where they are told."""
    runner = first_steps(assembly, base, ranked, None)
    if not runner.fit.estimate.finite:
        return runner
    return _freed(base, _further(base, runner, None, _HEAT), None)


def from_afar(assembly: Assembly, state: FitState, found: list[Ranked]) -> list[Ranked]:
    """Candidates with a second basin, bounded on both sides, which zero amplitude may not show.

    What a rim lets over, or a limit cuts off, is unseen from there. Of each effect a few shapes
    over its grid are tried.
    """
    present = present_labels(assembly, state)
    known = {r.variant.label: r for r in found}
    grids: dict[str, list[Variant]] = {}
    for variant in assembly.offered:
        label = variant.original.label
        if two_sided(variant.original) and label not in present:
            grids.setdefault(label, []).append(variant)
    chosen = []
    for grid in grids.values():
        spots = np.unique(np.linspace(0, len(grid) - 1, _FAR_ONES).round().astype(int))
        chosen += [grid[i] for i in spots]
    return [known.get(v.label) or unscored(v) for v in chosen]


def unscored(variant: Variant) -> Ranked:
    """A variant without evidence."""
    none = Score((0,), np.zeros(1), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return Ranked(variant, (0,), none, 0.0, variant.searched)


def first_steps(
    assembly: Assembly, base: LikelihoodFit, ranked: Ranked, masks: Masks, far: bool = False,
    start: LikelihoodFit | None = None,
) -> Rival:  # fmt: skip
    """A candidate added to the model as it is, a few steps from where that stands.

    ``far``: from a share of its bounds; else from zero, where the first step finds its size.
    ``start``: where it begins, of other values than ``base``, against which it is held.
    Where much acts at random beside both models the noise is begun afresh as well: what the model
    as it is has found to be at random may leave the candidate no way to where little is. There a
    lag or a delay begins whole, too: such a force follows readings of a sensor that is late, and
    near zero nothing is gained by its time.
    """
    begun = start or base
    own = with_variants(assembly, [ranked.variant])
    wider = added(own, carried_to(begun.state, assembly, own), ranked, far)
    at = begun.estimate

    def taken(state: FitState, noise: NoiseModel, steps: int, kept: Kept | None = None) -> Rival:
        fit = refitted(
            own, state, noise, masks, steps, True, kept, differences=False, like=at.prepared
        )
        return rival_of(own, base, ranked, fit)

    one = taken(wider, at.noise, _HEAT, at.kept)
    if explains(base):
        return one
    if start is None and not explains(one.fit):
        wide = first_noise(at.prepared[0][0], LEVEL)
        whole = [_whole(own, wider, ranked.variant)] if ranked.variant.effect.whole else []
        one = max([one, *(taken(b, wide, _FRESH) for b in (wider, *whole))], key=_worth)
    return _begun_near(base, one, masks, _FRESH)


def _worth(rival: Rival) -> float:
    """Worth, of what is finite."""
    return rival.worth if rival.fit.estimate.finite else -np.inf


def _whole(assembly: Assembly, state: FitState, variant: Variant) -> FitState:
    """A state with an effect as its name says."""
    traced, values = assembly.study.compiled.traced, state.values.copy()
    for key, parameter in zip(traced.keys, traced.parameters, strict=True):
        owner, given = key.rsplit(".", 1)[0], variant.effect.whole.get(parameter.name)
        if owner == variant.label and given is not None:
            size = variant.shapes[f"{owner}.{given}"] if isinstance(given, str) else given
            values[:, assembly.study.index(key)] = size
    return replace(state, values=values)


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


def _further(base: LikelihoodFit, rival: Rival, masks: Masks, steps: int) -> Rival:
    """A rival's fit taken on, with less at random where the record is as likely so."""
    own, fit, plain = rival.assembly, rival.fit, rival.plain
    noise, less = fit.estimate.noise, fit.estimate.noise.without(*EXTRA)
    if len(less.terms) < len(noise.terms):
        if plain is None or plain.state.freed != fit.state.freed:
            plain = replace(fit, estimate=replace(fit.estimate, noise=less))
        plain = _taken(own, plain, masks, steps, fit.height)
        if plain.height >= fit.height:
            return rival_of(own, base, rival.ranked, plain, rival.shapes)
    found = _taken(own, fit, masks, steps)
    fit = found if found.height >= fit.height else fit
    return replace(rival_of(own, base, rival.ranked, fit, rival.shapes), plain=plain)


def _reopened(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival with noise that had vanished begun again, where that is more likely.

    Its filter, too, begins where the records do with it, where the model without leaves much.
    """
    fit = reopened(rival.assembly, rival.fit, masks, _RACE)
    if fit is not rival.fit:
        rival = rival_of(rival.assembly, base, rival.ranked, fit, rival.shapes)
    return rival if explains(base) else _begun_near(base, rival, masks, _RACE)


def _begun_near(base: LikelihoodFit, rival: Rival, masks: Masks, steps: int) -> Rival:
    """A rival whose filter begins where the record does with it, where that is more likely."""
    fit = begun_closely(rival.assembly, rival.fit, masks, steps)
    if fit is rival.fit:
        return rival
    return rival_of(rival.assembly, base, rival.ranked, fit, rival.shapes)


def _taken(
    own: Assembly, fit: LikelihoodFit, masks: Masks, steps: int, least: float = -np.inf
) -> LikelihoodFit:
    """A rival's fit taken on by so many steps; ``least`` as in ``maximise``.

    What the filter follows (a phase's origin) begins where this model, not the one without the
    candidate, has it: a first guess far off costs more than a candidate may win.
    """
    at = fit.estimate
    followed = any(settings.tracked for _, settings in at.prepared)
    state = settled_values(fit) if followed else fit.state
    return refitted(
        own, state, at.noise, masks, steps, rough=True, kept=at.kept, like=at.prepared,
        least=least,
    )  # fmt: skip


def _heated(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival taken a few steps further, its shapes at their most likely values."""
    return _freed(base, _further(base, rival, masks, _HEAT), masks)


def _freed(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival with its shapes at their most likely values, where that is worth their price."""
    variant, own = rival.ranked.variant, rival.assembly
    fit = with_own_shapes(own, rival.fit, variant.effect, variant.tuned, masks, _RACE)
    if fit is rival.fit:
        return rival
    return rival_of(own, base, rival.ranked, fit, len(variant.tuned))


def _of_other_shapes(assembly: Assembly, base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """The winner begun from other shapes that score as well, where that leads further.

    The likelihood of one shape has a valley; that of several (the length of a slip, and how much
    of it depends on the side) has more.
    """
    if len(rival.ranked.variant.tuned) < _SEVERAL:
        return rival
    others = [first_steps(assembly, base, r, masks) for r in rival.ranked.others[:_OTHERS]]
    heated = [_heated(base, r, masks) for r in _in_order(others)]
    return _in_order([rival, *(_further(base, r, masks, _RACE) for r in heated)])[0]


def rival_of(
    assembly: Assembly, base: LikelihoodFit, ranked: Ranked, fit: LikelihoodFit, shapes: int = 0
) -> Rival:
    """A fit with a candidate held against the model as it is; ``shapes`` of it were searched."""
    gain = fit.height - base.height
    worth = gain - price(len(ranked.columns) + shapes, fit.estimate.prepared)
    return Rival(assembly, ranked, fit, gain, worth, shapes)
