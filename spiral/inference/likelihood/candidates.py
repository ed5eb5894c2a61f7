"""The race of candidates: the best-scored are refitted, those that fall behind are dropped.

1. *Score.* Candidates are ranked along the motion that the filter predicts (``scores``).
2. *Refit.* The best are refitted with parameters and noise on the blocks that select, in a race:
   a few steps for all, more for those that keep up.
3. *Judge.* On the other blocks the winner must predict better (``judging``).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from spiral.engine.likelihood.fit import SlopeCache
from spiral.engine.likelihood.noise import EXTRA, NoiseModel, first_noise
from spiral.engine.likelihood.predict import Masks
from spiral.engine.score import Score
from spiral.engine.threads import run_in_threads
from spiral.inference.evidence.admission import refit_start_values
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.enlarge import transfer_fit_state as carried_to
from spiral.inference.evidence.enlarge import with_variants
from spiral.inference.evidence.fit_state import FitState, has_two_sided_bounds
from spiral.inference.evidence.scoring import RankedCandidate, active_labels, amplitude_keys
from spiral.inference.likelihood.fitting import (
    LEVEL,
    LikelihoodFit,
    fit_by_likelihood,
    has_still_state,
    is_random_force_small,
    longest,
    restart_vanished_noise,
    schwarz_penalty,
    with_tracked_values,
)
from spiral.inference.likelihood.initial_states import narrow_initial_states
from spiral.inference.likelihood.shapes import refit_effect_shapes
from spiral.inference.likelihood.tolerances import Tolerances
from spiral.inference.problem import Progress
from spiral.types.formatting import first_words
from spiral.types.label import make_label, owner_of

_HEAT, _RACE = 3, 12  # scoring steps, at most: for all rivals, and for those that keep up
_FRESH = 8  # scoring steps from noise that is begun afresh
_FAR, _FAR_ONES = 0.1, 3  # share of its bound that an amplitude starts from; shapes tried so
_KEEP, _PROMISED = 0.3, 0.7  # share of the best gain, and of its score, that keeps up at first
_NEAR = 0.6  # share of the best gain that keeps up to the end
_SEVERAL, _OTHERS = 2, 2  # shapes from which others are tried, and how many of these
_ALIKE, _ALIKE_ONES = 0.9, 3  # share of the best score from which a candidate looks like it


@dataclass(frozen=True)
class Rival:
    """A candidate refitted on the blocks that select.

    ``gain`` in log-likelihood over the model as it is; ``worth`` is the gain less Schwarz's (BIC)
    penalty for its amplitudes and for the ``shapes`` that took their most likely values here. The
    fit is in terms of a study of its own, the model with this candidate; ``plain`` is the fit with
    fewer noise terms, where that is not as likely.
    """

    assembly: Assembly
    ranked: RankedCandidate
    fit: LikelihoodFit
    gain: float
    worth: float
    shapes: int = 0
    plain: LikelihoodFit | None = None

    @cached_property
    def stands_still(self) -> bool:
        """Whether a state of its own hardly moves (``has_still_state``)."""
        return has_still_state(self.fit, self.ranked.variant.label)

    @property
    def label(self) -> str:
        """Its effect."""
        return self.ranked.variant.original.label


@dataclass
class Race:
    """Candidates refitted on the blocks that select; only those that keep up are fitted further.

    ``runners`` have been taken a few steps, best first; those of ``finals`` to the likelihood's
    maximum. ``tolerances`` : what known values explain that are a little off.
    """

    assembly: Assembly
    base: LikelihoodFit
    masks: Masks
    progress: Progress
    runners: list[Rival]
    finals: list[list[Rival]] = field(default_factory=list)
    tolerances: Tolerances = field(default_factory=Tolerances)

    @property
    def finalists(self) -> tuple[Rival, ...]:
        """The rivals of all finals so far."""
        return tuple(r for final in self.finals for r in final)

    @property
    def behind(self) -> list[Rival]:
        """Rivals that have not been fitted to the maximum in a final yet."""
        gone = {r.label for r in self.finalists}
        return [r for r in self.runners if r.label not in gone]

    @property
    def tried(self) -> tuple[Rival, ...]:
        """All rivals: the finalists, then those behind."""
        return (*self.finalists, *self.behind)

    @property
    def best(self) -> float:
        """The largest worth of a candidate on the blocks that select; zero without candidates."""
        return 0.0 if self.first is None else self.first.worth

    @property
    def first(self) -> Rival | None:
        """The candidate worth most on the blocks that select; nothing without candidates."""
        return max(self._nth_final(0), key=lambda r: r.worth, default=None)

    def with_more_rivals(self, others: Sequence[Rival]) -> Race:
        """The race started again with more rivals, already fitted briefly."""
        if not others:
            return self
        return replace(self, runners=_sort_by_worth([*self.tried, *others]), finals=[])

    def with_candidates(
        self, chosen: Sequence[RankedCandidate], far: Collection[RankedCandidate] = ()
    ) -> Race:
        """The race started again with these candidates too, fitted briefly; ``far`` from zero."""

        def fit_briefly(numbered: tuple[int, RankedCandidate]) -> Rival:
            number, ranked = numbered
            label = ranked.variant.original.label
            self.progress(f"refitting with {label} ({number} of {len(chosen)})")
            return fit_candidate_briefly(
                self.assembly, self.base, ranked, self.masks, ranked in far
            )

        samples = longest(self.base.estimate.prepared)
        numbered = list(enumerate(chosen, start=1))
        return self.with_more_rivals(run_in_threads(fit_briefly, numbered, samples))

    def with_only_rivals(self, others: Sequence[Rival]) -> Race:
        """The same race between these rivals alone, already fitted briefly."""
        return replace(self, runners=_sort_by_worth(others), finals=[])

    def against_model(self, worth: float, always: Collection[str]) -> Race:
        """The race without those that fell behind a model of this worth after their first steps.

        ``always``: effects that stay in it.
        """
        least = _keep_threshold(_KEEP, worth)
        return self.with_only_rivals(
            [r for r in self.runners if r.worth >= least or r.label in always]
        )

    def winners(self) -> Iterator[tuple[Rival, list[Rival]]]:
        """Winners in turn, each with the rivals that remained in its final, most likely first.

        After a final, those it left behind run theirs: one that makes the most of the blocks that
        select may be nothing on the others.
        """
        number = 0
        while last := self._nth_final(number):
            if not last[0].worth > 0:
                return
            for place, rival in enumerate(last):
                yield rival, last[place:]
            number += 1

    def _nth_final(self, number: int) -> list[Rival]:
        """Rivals of the final of this number, fitted when first needed; empty if none is left."""
        if number == len(self.finals) and self.behind:
            self.finals.append(self._run_final(self.behind))
        return self.finals[number] if number < len(self.finals) else []

    def _run_final(self, runners: list[Rival]) -> list[Rival]:
        promised = _PROMISED * runners[0].ranked.score.gain
        least = _keep_threshold(_KEEP, runners[0].worth)
        near = [r for r in runners if r.worth >= least or r.ranked.score.gain >= promised]
        self.progress(f"refitting with {first_words([r.label for r in near])}")
        again = self._of_each(near, lambda r: _refine_rival(self.base, r, self.masks))
        least = _keep_threshold(_NEAR, max(r.worth for r in again))
        rising = zip(near, again, strict=True)  # what it has just won it may win once more
        fit = [r for was, r in rising if r.worth + max(r.worth - was.worth, 0.0) >= least]
        kept = self._of_each(fit, lambda r: _restart_rival_noise(self.base, r, self.masks))
        further = self._of_each(kept, lambda r: _continue_rival(self.base, r, self.masks, _RACE))
        last = sorted(further, key=lambda r: -r.worth)
        return [_try_other_shapes(self.assembly, self.base, last[0], self.masks), *last[1:]]

    def _of_each(self, rivals: Sequence[Rival], fit: Callable[[Rival], Rival]) -> list[Rival]:
        return run_in_threads(fit, rivals, longest(self.base.estimate.prepared))


def _keep_threshold(share: float, worth: float) -> float:
    """The least worth that keeps up: a share of the best's; if that is negative, the best's own."""
    return min(share * worth, worth)


def start_race(
    assembly: Assembly, base: LikelihoodFit, scored: list[RankedCandidate], masks: Masks,
    progress: Progress, most: int,
) -> Race:  # fmt: skip
    """A race of the promising candidates, each already fitted briefly.

    ``scored`` are all candidates, the best first; those whose score is not
    worth their penalty are not refitted, nor are more than ``most``, special cases not counted.
    """
    far = (
        [] if is_random_force_small(base) else second_basin_candidates(assembly, base.state, scored)
    )

    race = Race(assembly, base, masks, progress, [])
    return race.with_candidates([*select_promising(scored, most), *far], far)


def _sort_by_worth(runners: Sequence[Rival]) -> list[Rival]:
    """Rivals with a finite fit, the best first."""
    finite = [r for r in runners if r.fit.estimate.finite]
    return sorted(finite, key=lambda r: -r.worth)


def select_promising(scored: list[RankedCandidate], most: int) -> list[RankedCandidate]:
    """Candidates to refit: the best, what scores like the best, special cases and twins.

    What needs more numbers for the same score (an offset of each of several sensors, beside a load)
    is not worth its penalty, yet the records may not tell the two apart. Neither may they tell the
    best from what does the same elsewhere, whose score beside a large random force may be nothing.
    """
    chosen = [r for r in scored if r.rank < 0 and not r.whole][:most]
    best = max((r.score.gain for r in chosen), default=np.inf)
    alike = (r for r in scored if r.score.gain >= _ALIKE * best and not r.whole)
    chosen += itertools.islice((r for r in alike if r not in chosen), _ALIKE_ONES)
    known = {r.variant.original.label: r for r in reversed(scored)}
    effects = [r.variant.original for r in chosen]
    labels = [make_label(name, e.port) for e in effects for name in e.special]
    special = [known[label] for label in dict.fromkeys(labels) if label in known]
    names = effects[0].twins if effects else ()
    twins = [r for r in known.values() if r.variant.original.plugin_name() in names][:_ALIKE_ONES]
    also = dict.fromkeys(r.variant.original.label for r in (*special, *twins))
    return chosen + [known[x] for x in also if known[x] not in chosen]


def refit_candidate(assembly: Assembly, base: LikelihoodFit, ranked: RankedCandidate) -> Rival:
    """A candidate refitted alone to all samples, with its shapes free where data identify them."""
    runner = fit_candidate_briefly(assembly, base, ranked, None)
    if not runner.fit.estimate.finite:
        return runner
    return _free_rival_shapes(base, _continue_rival(base, runner, None, _HEAT), None)


def second_basin_candidates(
    assembly: Assembly, state: FitState, scored: list[RankedCandidate]
) -> list[RankedCandidate]:
    """Candidates bounded on both sides, whose likelihood may have a basin far from zero amplitude.

    What a rim lets over, or a limit cuts off, is unseen from there. Of each effect a few shapes
    over its grid are tried.
    """
    present = active_labels(assembly, state)
    known = {r.variant.label: r for r in scored}
    grids: dict[str, list[Variant]] = {}
    for variant in assembly.offered:
        label = variant.original.label
        if has_two_sided_bounds(variant.original) and label not in present:
            grids.setdefault(label, []).append(variant)
    chosen = []
    for grid in grids.values():
        spots = np.unique(np.linspace(0, len(grid) - 1, _FAR_ONES).round().astype(int))
        chosen += [grid[i] for i in spots]
    return [known.get(v.label) or unscored_candidate(v) for v in chosen]


def unscored_candidate(variant: Variant) -> RankedCandidate:
    """A variant as a candidate with a score of zero."""
    none = Score((0,), np.zeros(1), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return RankedCandidate(variant, (0,), none, 0.0, variant.searched)


def fit_candidate_briefly(
    assembly: Assembly, base: LikelihoodFit, ranked: RankedCandidate, masks: Masks,
    far: bool = False, start: LikelihoodFit | None = None,
) -> Rival:  # fmt: skip
    """A candidate added to the model and fitted for a few scoring steps.

    ``far``: its amplitudes start at a share of their bounds; else at zero, where the first step
    finds their size. ``start``: the fit to start from in place of ``base``, with which it is
    compared. Where a large random force acts beside both models the noise is started afresh as
    well: the noise of the model as it is may leave the candidate no way to where little is random.
    There a lag or a delay also starts at its full size: a random force follows the readings of a
    late sensor, and near zero nothing is gained by its time.
    """
    begun = start or base
    own = with_variants(assembly, [ranked.variant])
    wider = add_candidate(own, carried_to(begun.state, assembly, own), ranked, far)
    at = begun.estimate

    def fit_rival(
        state: FitState, noise: NoiseModel, steps: int, kept: SlopeCache | None = None
    ) -> Rival:
        fit = fit_by_likelihood(
            own, state, noise, masks, steps, True, kept, differences=False, like=at.prepared
        )
        return make_rival(own, base, ranked, fit)

    one = fit_rival(wider, at.noise, _HEAT, at.kept)
    if is_random_force_small(base):
        return one
    if start is None and not is_random_force_small(one.fit):
        wide = first_noise(at.prepared[0][0], LEVEL)
        whole = (
            [_with_effect_at_full_size(own, wider, ranked.variant)]
            if ranked.variant.effect.whole
            else []
        )
        one = max([one, *(fit_rival(b, wide, _FRESH) for b in (wider, *whole))], key=_finite_worth)
    return _narrow_rival_initial_states(base, one, masks, _FRESH)


def _finite_worth(rival: Rival) -> float:
    """A rival's worth; minus infinity where its fit diverged."""
    return rival.worth if rival.fit.estimate.finite else -np.inf


def _with_effect_at_full_size(assembly: Assembly, state: FitState, variant: Variant) -> FitState:
    """A state with a variant's parameters at the sizes that its effect declares (``whole``)."""
    sizes = {
        name: variant.shapes[f"{variant.label}.{given}"] if isinstance(given, str) else given
        for name, given in variant.effect.whole.items()
    }
    return with_variant_values(assembly, state, variant, sizes)


def with_variant_values(
    assembly: Assembly, state: FitState, variant: Variant, given: Mapping[str, float]
) -> FitState:
    """A state in which a variant's parameters of these names have these values."""
    traced, values = assembly.study.compiled.traced, state.values.copy()
    for key, parameter in zip(traced.keys, traced.parameters, strict=True):
        if owner_of(key) == variant.label and parameter.name in given:
            values[:, assembly.study.index(key)] = given[parameter.name]
    return replace(state, values=values)


def add_candidate(
    assembly: Assembly, state: FitState, ranked: RankedCandidate, far: bool = False
) -> FitState:
    """A state with a candidate added, its amplitudes one step from zero, or ``far`` from there."""
    variant = ranked.variant
    values = refit_start_values(assembly, state.values, variant, ranked.score.step)
    for key in amplitude_keys(assembly, variant) if far else ():
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


def _continue_rival(base: LikelihoodFit, rival: Rival, masks: Masks, steps: int) -> Rival:
    """A rival fitted further, with fewer noise terms where the record is as likely so."""
    own, fit, plain = rival.assembly, rival.fit, rival.plain
    noise, less = fit.estimate.noise, fit.estimate.noise.without(*EXTRA)
    if len(less.terms) < len(noise.terms):
        if plain is None or plain.state.freed != fit.state.freed:
            plain = replace(fit, estimate=replace(fit.estimate, noise=less))
        plain = _continue_rival_fit(own, plain, masks, steps, fit.log_likelihood)
        if plain.log_likelihood >= fit.log_likelihood:
            return make_rival(own, base, rival.ranked, plain, rival.shapes)
    continued = _continue_rival_fit(own, fit, masks, steps)
    fit = continued if continued.log_likelihood >= fit.log_likelihood else fit
    return replace(make_rival(own, base, rival.ranked, fit, rival.shapes), plain=plain)


def _restart_rival_noise(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival with vanished noise started again, where that is more likely.

    Its filter, too, begins where the records do with it, where the model without leaves much.
    """
    fit = restart_vanished_noise(rival.assembly, rival.fit, masks, _RACE)
    if fit is not rival.fit:
        rival = make_rival(rival.assembly, base, rival.ranked, fit, rival.shapes)
    return (
        rival
        if is_random_force_small(base)
        else _narrow_rival_initial_states(base, rival, masks, _RACE)
    )


def _narrow_rival_initial_states(
    base: LikelihoodFit, rival: Rival, masks: Masks, steps: int
) -> Rival:
    """A rival whose filter starts at its own most likely initial states, if that is likelier."""
    fit = narrow_initial_states(rival.assembly, rival.fit, masks, steps)
    if fit is rival.fit:
        return rival
    return make_rival(rival.assembly, base, rival.ranked, fit, rival.shapes)


def _continue_rival_fit(
    own: Assembly, fit: LikelihoodFit, masks: Masks, steps: int, least: float = -np.inf
) -> LikelihoodFit:
    """A rival's fit continued by ``steps``; ``least`` as in ``maximise_likelihood``.

    What the filter tracks (a phase's origin) begins where this model, not the one without the
    candidate, has it: a first guess far off costs more than a candidate may win.
    """
    at = fit.estimate
    followed = any(settings.tracked for _, settings in at.prepared)
    state = with_tracked_values(fit) if followed else fit.state
    return fit_by_likelihood(
        own, state, at.noise, masks, steps, rough=True, kept=at.kept, like=at.prepared,
        least=least,
    )  # fmt: skip


def _refine_rival(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival fitted a few steps further, its shapes at their most likely values."""
    return _free_rival_shapes(base, _continue_rival(base, rival, masks, _HEAT), masks)


def _free_rival_shapes(base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """A rival with its shapes at their most likely values, where that is worth their penalty."""
    variant, own = rival.ranked.variant, rival.assembly
    fit = refit_effect_shapes(own, rival.fit, variant.effect, variant.tuned, masks, _RACE)
    if fit is rival.fit:
        return rival
    return make_rival(own, base, rival.ranked, fit, len(variant.tuned))


def _try_other_shapes(assembly: Assembly, base: LikelihoodFit, rival: Rival, masks: Masks) -> Rival:
    """The winner fitted from other shapes that score as well, where one of these is worth more.

    The likelihood of one shape has a valley; that of several (the length of a slip, and how much
    of it depends on the side) has more.
    """
    if len(rival.ranked.variant.tuned) < _SEVERAL:
        return rival
    others = [
        fit_candidate_briefly(assembly, base, r, masks) for r in rival.ranked.others[:_OTHERS]
    ]
    heated = [_refine_rival(base, r, masks) for r in _sort_by_worth(others)]
    return _sort_by_worth([rival, *(_continue_rival(base, r, masks, _RACE) for r in heated)])[0]


def make_rival(
    assembly: Assembly,
    base: LikelihoodFit,
    ranked: RankedCandidate,
    fit: LikelihoodFit,
    shapes: int = 0,
) -> Rival:
    """A fit with a candidate, compared with the model as it is; ``shapes`` of it were searched."""
    gain = fit.log_likelihood - base.log_likelihood
    worth = gain - schwarz_penalty(len(ranked.columns) + shapes, fit.estimate.prepared)
    return Rival(assembly, ranked, fit, gain, worth, shapes)
