"""Look-alikes (effects that the record did not distinguish) tested again on the final model.

While another effect is missing, misses that belong to it hide what tells two candidates apart.
Once no further candidate passes, each effect admitted before the last is held against those that
looked like it then: it is let go, and they begin from the values and the noise that the final model
has. Those that stay behind by ``options.odds`` are told apart. One that is ahead by as much takes
the place of the effect.

An effect that is not there may be admitted first, with a second one that mends what the first does
wrong. So what promised something beside the first is asked, too, whether it makes the record as
likely as both: then it takes the place of the two, at the price of fewer numbers.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.likelihood.noise import EXTRA
from spiral.engine.threads import run_in_threads
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import RankedCandidate, Ranking, amplitude_keys
from spiral.inference.likelihood.alias_groups import (
    indistinguishable_rivals,
    log_likelihood_lead,
    twin_rivals,
)
from spiral.inference.likelihood.candidates import Rival, start_race, unscored_candidate
from spiral.inference.likelihood.excerpts import excerpt_fit
from spiral.inference.likelihood.fitting import (
    WARM,
    LikelihoodFit,
    continue_fit,
    fit_by_likelihood,
    longest,
    schwarz_penalty,
)
from spiral.inference.likelihood.scores import rank_variants
from spiral.inference.problem import Progress
from spiral.inference.strategies.likelihood.accepted import AcceptedCandidate, WholeRecordFit
from spiral.inference.strategies.likelihood.admission import offer_effects
from spiral.inference.strategies.likelihood.benefit import Refusal, refuse_growing_error
from spiral.inference.strategies.likelihood.superfluous import admitted_variants
from spiral.inference.strategies.likelihood.twins import (
    fit_without,
    twin_labels,
    twins_at_its_values,
)
from spiral.inference.strategies.likelihood.whole_fit import fit_with_rival
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.effect import ParameterEffect, is_plain_change
from spiral.types.formatting import first_words
from spiral.types.label import make_label, owner_of
from spiral.types.port import varied_key
from spiral.types.run import Comparison, Suggestion

_LOOK = 3  # scoring steps after which a rival with the model's noise is to be likelier
_PROMISING = 3  # candidates that are asked in place of two effects
_CLOSE = 0.95  # share of an effect's worth from which a candidate was close behind it


@dataclass(frozen=True)
class LikelierLookAlike:
    """A look-alike that takes the place of an effect, and how it was found."""

    passed: AcceptedCandidate
    ranking: Ranking
    tried: tuple[Rival, ...]


def recheck_admitted(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, comparison: Comparison,
    aliases: Mapping[str, tuple[str, ...]], promising: Mapping[str, tuple[Suggestion, ...]],
    progress: Progress,
) -> tuple[dict[str, tuple[str, ...]], LikelierLookAlike | None]:  # fmt: skip
    """Remaining look-alikes of a final model's effects, and a likelier one, if there is one.

    Parameters
    ----------
    assembly, state, comparison : the study's. aliases, promising : by admitted effect, its
        look-alikes then, and all that promised something then, the best first, with itself.
    """
    model = fit_by_likelihood(assembly, state, steps=WARM, rough=True)
    left = dict(aliases)
    effects = admitted_variants(assembly, model) if model.estimate.finite else []
    part = excerpt_fit(assembly, model) if effects else None
    for admitted in effects:
        label = admitted.original.label
        declared = _declared_look_alikes(assembly, admitted)
        close = _runners_up(label, promising.get(label, ()))
        near = tuple(dict.fromkeys((*aliases.get(label, ()), *declared, *close)))
        others = tuple(dict.fromkeys((*near, *_changes_of_others(assembly, admitted))))
        again = _contest_on_all_samples(
            options, assembly, model, part, (admitted,), others, progress, near
        )
        if again is None:
            continue
        left[label] = again.untold(aliases.get(label, ()))
        likelier = again.find_likelier(options, comparison, progress)
        if likelier is not None:
            return left, likelier
    for pair in itertools.pairwise(effects):
        first = pair[0].original.label
        others = tuple(s.effect for s in promising.get(first, ()) if s.effect != first)[:_PROMISING]
        again = _contest_on_all_samples(options, assembly, model, part, pair, others, progress)
        likelier = again.find_likelier(options, comparison, progress) if again else None
        if likelier is not None:
            return left, likelier
    return left, None


def prefer_special_case(
    options: LikelihoodOptions, passed: AcceptedCandidate, progress: Progress
) -> AcceptedCandidate:
    """A winner, or the special case of it that explains the records as well, or a likelier twin.

    These may have dropped out of the race early, while they still had to find the width of a
    friction, say. Twins that are not told from the winner are among its aliases. Where effects that
    the model had are let go for it, or noise of another kind is found beside it, others at its
    place are held against it as well: they were raced beside what is gone. So are plain changes of
    a parameter, with whatever it follows, against one that has a point and a width.
    """
    whole, admitted = passed.whole, passed.rival.ranked.variant
    declared = _declared_look_alikes(whole.assembly, admitted)
    beside: tuple[str, ...] = ()
    if whole.refitted.retired or _has_new_noise(passed):
        near = whole.assembly.problem.candidates_beside(admitted.original)
        beside = tuple(e.label for e in near if e.label != admitted.original.label)
    beside = (*beside, *_plain_changes(whole.assembly, admitted))
    others = tuple(dict.fromkeys((*declared, *beside)))
    if not others:
        return passed
    study, model = excerpt_fit(whole.assembly, whole.fit) or (whole.assembly, whole.fit)
    again = _contest_effects(options, study, model, (admitted,), others, progress, declared)
    if again is None:
        return passed
    likelier = again.find_likelier(options, whole.refitted.comparison, progress)
    if likelier is None:
        alike = (*again.twins, *(x for x in again.aliases if x in beside))
        return replace(passed, aliases=tuple(dict.fromkeys((*passed.aliases, *alike))))
    gone = tuple(x for x in likelier.passed.whole.refitted.retired if x != admitted.original.label)
    refitted = replace(likelier.passed.whole.refitted, retired=gone)
    told = log_likelihood_lead(likelier.passed.rival, again.ours) >= np.log(options.odds)
    others = (*passed.aliases, *(() if told else (admitted.original.label,)))
    aliases = tuple(x for x in others if x != likelier.passed.rival.label)
    return AcceptedCandidate(
        likelier.passed.rival, aliases, replace(likelier.passed.whole, refitted=refitted)
    )


def _has_new_noise(passed: AcceptedCandidate) -> bool:
    """Whether a winner's model has noise beyond white that it did not have in the race."""
    raced, refitted = (
        {(t.kind, t.where) for t in noise.terms if t.kind in EXTRA}
        for noise in (passed.rival.fit.estimate.noise, passed.whole.fit.estimate.noise)
    )
    return not refitted <= raced


def _special_case_labels(admitted: Variant) -> tuple[str, ...]:
    """Labels of the special cases of an effect, which it becomes at the ends of its shapes."""
    return tuple(make_label(x, admitted.original.port) for x in admitted.original.special)


def _runners_up(label: str, promising: Sequence[Suggestion]) -> tuple[str, ...]:
    """Candidates worth nearly as much as the effect was when it was admitted.

    What they were worth then was beside other noise, or values that were not there yet. A net share
    s of what is left is worth -log(1 - s) in log-likelihood for each two samples.
    """
    worth = {s.effect: -np.log1p(-min(s.net or 0.0, 1.0)) for s in promising}
    least = _CLOSE * worth.pop(label, np.inf)
    return tuple(effect for effect, gain in worth.items() if gain >= least)


def _changes_of_others(assembly: Assembly, admitted: Variant) -> tuple[str, ...]:
    """Plain changes of other parameters with what an admitted change follows; else none.

    While none of them is there, scores hardly tell an emission that falls with time from a filament
    that grows cooler: all other values are wrong.
    """
    system, change = assembly.problem.model.system, admitted.original
    if not isinstance(change, ParameterEffect) or change.steady:
        return ()
    followed = system.place(change).against
    return tuple(
        e.label for e in assembly.problem.changes()
        if is_plain_change(e) and e.port != change.port and system.place(e).against == followed
    )  # fmt: skip


def _plain_changes(assembly: Assembly, admitted: Variant) -> tuple[str, ...]:
    """Plain changes of the parameter whose change has shapes to be searched; else none.

    Beside the noise of a model that lacks it, a bump over what is measured may make up for more
    than a resistance that follows a cell's core, which no sensor sees.
    """
    system, change = assembly.problem.model.system, admitted.original
    if not isinstance(change, ParameterEffect) or change.steady or is_plain_change(change):
        return ()
    own = varied_key(system.place(change))
    return tuple(
        e.label for e in assembly.problem.changes()
        if is_plain_change(e) and varied_key(system.place(e)) == own
    )  # fmt: skip


def _declared_look_alikes(assembly: Assembly, admitted: Variant) -> tuple[str, ...]:
    """Labels of the special cases and twins of an effect."""
    return (*_special_case_labels(admitted), *twin_labels(assembly, admitted))


@dataclass(frozen=True)
class _Contest:
    """Effects of the model against their look-alikes, each fitted in their place.

    ``ours`` is the model with its effects ``labels``, as a rival of the ``others`` (best first);
    ``aliases`` are those that are still not told apart, ``twins`` those among the others that do
    elsewhere what our effect does, and explain nearly as much.
    """

    labels: tuple[str, ...]
    ours: Rival
    others: tuple[Rival, ...]
    aliases: tuple[str, ...]
    twins: tuple[str, ...]
    ranking: Ranking

    def untold(self, before: tuple[str, ...]) -> tuple[str, ...]:
        """Effects not told from ours: those that were ``before``, and any others that were fitted.

        A twin whose fit was held up while another effect was missing is found here for the first
        time.
        """
        fitted = {r.label for r in self.others}
        return tuple(x for x in self.aliases if x in before or x in fitted)

    def find_likelier(
        self, options: LikelihoodOptions, comparison: Comparison, progress: Progress
    ) -> LikelierLookAlike | None:
        """The look-alike that is likelier by the odds and predicts no worse, if there is one.

        Of a special case it is enough that it is as likely, of one for several that it is likelier
        once all numbers are paid for.
        """

        def predicts_worse(whole: WholeRecordFit) -> Refusal | None:
            settings = whole.assembly.problem.settings
            return refuse_growing_error(comparison, whole.refitted.comparison, settings)

        special = _special_case_labels(self.ours.ranked.variant)
        for rival in self.others:
            odds = float(np.log(options.odds)) if len(self.labels) == 1 else 0.0
            if not log_likelihood_lead(rival, self.ours) > (
                -odds if rival.label in special else odds
            ):
                continue
            whole = fit_with_rival(rival, progress, predicts_worse)
            if whole.fit.estimate.finite and predicts_worse(whole) is None:
                gone = tuple(dict.fromkeys((*self.labels, *whole.refitted.retired)))
                whole = replace(whole, refitted=replace(whole.refitted, retired=gone))
                return LikelierLookAlike(
                    AcceptedCandidate(rival, (), whole), self.ranking, self.others
                )
        return None


def _contest_on_all_samples(
    options: LikelihoodOptions, assembly: Assembly, model: LikelihoodFit,
    part: tuple[Assembly, LikelihoodFit] | None, admitted: tuple[Variant, ...],
    others: tuple[str, ...], progress: Progress, always: tuple[str, ...] | None = None,
) -> _Contest | None:  # fmt: skip
    """A contest in which an excerpt (``part``) drops what it tells from the effects already."""
    if part is None:
        return _contest_effects(options, assembly, model, admitted, others, progress, always)
    first = _contest_effects(options, *part, admitted, others, progress, always)
    if first is None:
        return None
    again = _contest_effects(options, assembly, model, admitted, first.aliases, progress)
    return again or first


def _contest_effects(
    options: LikelihoodOptions, assembly: Assembly, model: LikelihoodFit,
    admitted: tuple[Variant, ...], others: tuple[str, ...], progress: Progress,
    always: tuple[str, ...] | None = None,
) -> _Contest | None:  # fmt: skip
    """Refit others in the place of effects; nothing where none of them is a candidate.

    ``always``: those that are fitted to their end although they fall behind the effects after their
    first steps; all where it is not given.
    """
    labels = tuple(v.original.label for v in admitted)
    there = {v.original.label for v in admitted_variants(assembly, model)}
    asked_for = (*assembly.problem.candidates, *assembly.problem.changes())
    known = tuple(e for e in asked_for if e.label in others and e.label not in there)
    if not known:
        return None
    progress(f"testing again whether {', '.join(labels)} may be {first_words(others)}")
    base = fit_without(assembly, model, admitted)
    offered = offer_effects(assembly, (*known, *(v.original for v in admitted)))
    ranked = rank_variants(
        offered, base, base.estimate.noise, None, lambda _: list(offered.offered)
    )
    if ranked is None:
        return None
    others_ranked = [r for r in ranked.ranked if not _is_variant_of(r, admitted)]
    ours = _model_as_rival(assembly, base, model, admitted)
    finals = twins_at_its_values(offered, base, model, admitted[0], others_ranked)
    if any(r.rank < 0 for r in ranked.ranked if _is_variant_of(r, admitted)):
        race = start_race(offered, base, others_ranked, None, progress, options.rivals)
        race = race.against_model(ours.worth, others if always is None else always)
        finals += [rival for rival, _ in itertools.islice(race.winners(), len(known))]
    elif not finals:
        return None  # from there not even the effect itself would be found
    best = _likeliest_of_each_effect(model, finals)
    asked = {e.label for e in known}
    twins = twin_rivals(ours, best)
    stay = {*indistinguishable_rivals([ours, *best], options.odds), *twins}
    left = tuple(x for x in others if x in stay or x not in asked)
    return _Contest(labels, ours, tuple(best), left, twins, ranked)


def _likeliest_of_each_effect(model: LikelihoodFit, rivals: Sequence[Rival]) -> list[Rival]:
    """The likeliest rival of each effect, with the model's noise where it prefers that.

    Where an input was found to run another way beside the effect, the system's own way is tried as
    well: a lag of one input and a late second one do together what a slow sensor does alone.
    """
    samples = longest(model.estimate.prepared)
    tuned = run_in_threads(lambda r: _with_model_noise(model, r), rivals, samples)
    tuned += run_in_threads(
        lambda r: _with_model_noise(model, r, replace(r.fit.state, between={})),
        [r for r in tuned if r.fit.state.between],
        samples,
    )
    of_effect: dict[str, Rival] = {}
    for rival in sorted(tuned, key=lambda r: -r.worth):
        of_effect.setdefault(rival.label, rival)
    return list(of_effect.values())


def _is_variant_of(one: RankedCandidate, admitted: tuple[Variant, ...]) -> bool:
    return one.variant.original.label in {v.original.label for v in admitted}


def _model_as_rival(
    assembly: Assembly, base: LikelihoodFit, model: LikelihoodFit, admitted: tuple[Variant, ...]
) -> Rival:
    """The model with its effects as a rival of those that look like them."""
    gain, keys = model.log_likelihood - base.log_likelihood, model.estimate.keys
    count = sum(
        max(sum(owner_of(k) == v.label for k in keys), len(amplitude_keys(assembly, v)))
        for v in admitted
    )
    worth = gain - schwarz_penalty(count, base.estimate.prepared)
    return Rival(assembly, unscored_candidate(admitted[0]), model, gain, worth)


def _with_model_noise(model: LikelihoodFit, rival: Rival, state: FitState | None = None) -> Rival:
    """A rival with the model's noise, and in another ``state``, where that is likelier.

    A few steps tell: where the two are alike, the rival is near its maximum from the start; where
    they are not, its misses are many times that noise, and no step would lead there.
    """
    noise, own = model.estimate.noise, rival.assembly
    look = fit_by_likelihood(
        own, state or rival.fit.state, noise, steps=_LOOK, rough=True, differences=False
    )
    if not (look.estimate.finite and look.log_likelihood > rival.fit.log_likelihood):
        return rival
    fit = continue_fit(own, look, rough=True)
    more = fit.log_likelihood - rival.fit.log_likelihood
    if not (fit.estimate.finite and more > 0):
        return rival
    return replace(rival, fit=fit, gain=rival.gain + more, worth=rival.worth + more)
