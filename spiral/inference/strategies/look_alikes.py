"""Effects that the record did not tell apart when they were admitted, asked again at the end.

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
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.likelihood.fit import maximise
from spiral.engine.likelihood.noise import first_noise
from spiral.inference.evidence.admission import let_go
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import Ranked, Ranking, tested_keys
from spiral.inference.likelihood.candidates import Rival, race, unscored
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WARM,
    LikelihoodFit,
    price,
    refitted,
    subjects,
    with_estimate,
)
from spiral.inference.likelihood.groups import alike, lead, twins
from spiral.inference.likelihood.scores import ranked_along
from spiral.inference.nearness import grown
from spiral.inference.problem import Progress
from spiral.inference.strategies.admission import Passed, offering, with_rival
from spiral.inference.strategies.needed import admitted
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.types.label import make_label
from spiral.types.run import Comparison

_PROMISING = 3  # candidates that are asked in place of two effects


@dataclass(frozen=True)
class Likelier:
    """A look-alike that takes the place of an effect, and how it was found."""

    passed: Passed
    ranking: Ranking
    tried: tuple[Rival, ...]


def asked_again(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, comparison: Comparison,
    aliases: Mapping[str, tuple[str, ...]], promising: Mapping[str, tuple[str, ...]],
    progress: Progress,
) -> tuple[dict[str, tuple[str, ...]], Likelier | None]:  # fmt: skip
    """What still looks like the effects of a final model, and one that is likelier than its own.

    Parameters
    ----------
    assembly, state, comparison : the study's. aliases, promising : by admitted effect, its
        look-alikes then, and all that promised something then, the best first.
    """
    model = refitted(assembly, state, steps=WARM, rough=True)
    left = dict(aliases)
    effects = admitted(assembly, model) if model.estimate.finite else []
    for held in effects:
        label = held.original.label
        others = tuple(dict.fromkeys((*aliases.get(label, ()), *_special(held))))
        again = _again(options, assembly, model, (held,), others, progress)
        if again is None:
            continue
        left[label] = tuple(x for x in aliases.get(label, ()) if x in again.aliases)
        likelier = again.likelier(options, comparison, progress)
        if likelier is not None:
            return left, likelier
    for pair in itertools.pairwise(effects):
        others = promising.get(pair[0].original.label, ())[:_PROMISING]
        again = _again(options, assembly, model, pair, others, progress)
        likelier = again.likelier(options, comparison, progress) if again else None
        if likelier is not None:
            return left, likelier
    return left, None


def simplest(options: LikelihoodOptions, passed: Passed, progress: Progress) -> Passed:
    """A winner, or the special case of it that explains the records as well.

    In a race the simpler one may have been left behind on its way to the width of a friction, say.
    """
    whole, held = passed.whole, passed.rival.ranked.variant
    if not _special(held):
        return passed
    again = _again(options, whole.assembly, whole.fit, (held,), _special(held), progress)
    if again is None:
        return passed
    found = again.likelier(options, whole.settled.comparison, progress)
    if found is None:
        return passed
    gone = tuple(x for x in found.passed.whole.settled.retired if x != held.original.label)
    settled = replace(found.passed.whole.settled, retired=gone)
    told = lead(found.passed.rival, again.ours) >= np.log(options.odds)
    others = (*passed.aliases, *(() if told else (held.original.label,)))
    aliases = tuple(x for x in others if x != found.passed.rival.label)
    return Passed(found.passed.rival, aliases, replace(found.passed.whole, settled=settled))


def _special(held: Variant) -> tuple[str, ...]:
    """Labels of what an effect becomes at the ends of its shapes."""
    return tuple(make_label(x, held.original.port) for x in held.original.special)


@dataclass(frozen=True)
class _Contest:
    """Effects of the model, those that look like them best first, and look-alikes that stay.

    ``ours`` is the model with its effects ``labels``, as a rival of the others.
    """

    labels: tuple[str, ...]
    ours: Rival
    others: tuple[Rival, ...]
    aliases: tuple[str, ...]
    ranking: Ranking

    def likelier(
        self, options: LikelihoodOptions, comparison: Comparison, progress: Progress
    ) -> Likelier | None:
        """The look-alike that is likelier by the odds and predicts no worse, if there is one.

        Of a special case it is enough that it is as likely, of one for several that it is likelier
        once all numbers are paid for.
        """
        special = _special(self.ours.ranked.variant)
        for rival in self.others:
            odds = float(np.log(options.odds)) if len(self.labels) == 1 else 0.0
            if not lead(rival, self.ours) > (-odds if rival.label in special else odds):
                continue
            whole = with_rival(rival, progress)
            settings = rival.assembly.problem.settings
            if whole.fit.estimate.finite and not grown(
                comparison, whole.settled.comparison, settings
            ):
                gone = tuple(dict.fromkeys((*self.labels, *whole.settled.retired)))
                whole = replace(whole, settled=replace(whole.settled, retired=gone))
                return Likelier(Passed(rival, (), whole), self.ranking, self.others)
        return None


def _again(
    options: LikelihoodOptions, assembly: Assembly, model: LikelihoodFit,
    held: tuple[Variant, ...], others: tuple[str, ...], progress: Progress,
) -> _Contest | None:  # fmt: skip
    """Effects against others in their place; nothing where these are no candidates."""
    known = tuple(e for e in assembly.problem.candidates if e.label in others)
    if not known:
        return None
    labels = tuple(v.original.label for v in held)
    progress(f"asking again whether {', '.join(labels)} may be {', '.join(others)}")
    base = _without(assembly, model, held)
    offered = offering(assembly, (*known, *(v.original for v in held)))
    ranked = ranked_along(offered, base, base.estimate.noise, None, lambda _: list(offered.offered))
    mine = [] if ranked is None else [r for r in ranked.ranked if _is(r, held)]
    if ranked is None or not any(r.rank < 0 for r in mine):
        return None  # from there not even the effect itself would be found
    others_ranked = [r for r in ranked.ranked if not _is(r, held)]
    run = race(offered, base, others_ranked, None, progress, options.rivals)
    ours = _ours(assembly, base, model, held)
    finals = [rival for rival, _ in itertools.islice(run.winners(), len(known))]
    best = sorted((_beside(model, base, r) for r in finals), key=lambda r: -r.worth)
    asked = {e.label for e in known}
    stay = {*alike([ours, *best], options.odds), *twins(ours, best)}
    return _Contest(
        labels, ours, tuple(best), tuple(x for x in others if x in stay or x not in asked), ranked
    )


def _is(one: Ranked, held: tuple[Variant, ...]) -> bool:
    return one.variant.original.label in {v.original.label for v in held}


def _without(assembly: Assembly, model: LikelihoodFit, held: tuple[Variant, ...]) -> LikelihoodFit:
    """The model without effects at the values that it has with them, its noise grown for that.

    Grown from what is left beside the effect, or fallen from as much as at a first start: a size
    near nothing does not grow.
    """
    bare = let_go(assembly, model.state, tuple(v.label for v in held))
    prepared = subjects(assembly, bare)
    starts = (model.estimate.noise, first_noise(prepared[0][0], LEVEL))
    fits = [maximise(prepared, (), noise, {}, None, WARM, rough=True) for noise in starts]
    estimate = max(fits, key=lambda f: f.log_likelihood)
    return LikelihoodFit(with_estimate(bare, estimate), estimate)


def _ours(
    assembly: Assembly, base: LikelihoodFit, model: LikelihoodFit, held: tuple[Variant, ...]
) -> Rival:
    """The model with its effects as a rival of those that look like them."""
    gain, keys = model.height - base.height, model.estimate.keys
    count = sum(
        max(sum(k.rpartition(".")[0] == v.label for k in keys), len(tested_keys(assembly, v)))
        for v in held
    )
    worth = gain - price(count, base.estimate.prepared)
    return Rival(assembly, unscored(held[0]), model, gain, worth)


def _beside(model: LikelihoodFit, base: LikelihoodFit, rival: Rival) -> Rival:
    """A rival with the model's noise, where that is likelier."""
    fit = refitted(rival.assembly, rival.fit.state, model.estimate.noise, rough=True)
    more = fit.height - rival.fit.height
    if not (fit.estimate.finite and more > 0):
        return rival
    return replace(rival, fit=fit, gain=rival.gain + more, worth=rival.worth + more)
