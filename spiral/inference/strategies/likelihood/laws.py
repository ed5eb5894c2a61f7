"""A law with a closed form in place of what no candidate explains.

Where no candidate passes any more, named laws of one variable (``spiral.physics.formulas.laws``)
are tried at every place: from the seed, in place of all that was admitted and may only stand in for
one, then beside it. They go through the scores, the race and the gates of any candidate; the price
of a law's free numbers (Schwarz) is its description length. A law is admitted where it leaves
nothing but noise, and, in place of others, only where the record is more likely with it by
``options.odds`` once all numbers are paid for.

A law may be found only because the model's other values were still far off when candidates were
tried. So the candidates of its place are tried again beside the values that were found with it, and
one that does as well takes its name.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.filter.extended import FilterInputs
from spiral.engine.likelihood.fit import maximise_likelihood
from spiral.engine.likelihood.noise import OWN
from spiral.engine.likelihood.predict import total_log_likelihood
from spiral.inference.evidence.admission import drop_effects
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState, Masks, half_masks
from spiral.inference.evidence.scoring import Ranking
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.likelihood.excerpts import excerpt_study, whole_state, whole_study
from spiral.inference.likelihood.fitting import (
    LITTLE,
    WARM,
    LikelihoodFit,
    fit_by_likelihood,
    is_random_force_small,
    net_log_likelihood,
    prepare_filter_tasks,
    schwarz_penalty,
    with_estimate,
)
from spiral.inference.likelihood.noise_selection import select_noise_model
from spiral.inference.likelihood.tolerances import Tolerances
from spiral.inference.nearness import is_moved_at_random, is_moved_unseen, is_near_noise
from spiral.inference.problem import Progress
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.accepted import (
    AcceptedCandidate,
    WholeRecordFit,
)
from spiral.inference.strategies.likelihood.admission import (
    first_to_pass,
    offer_effects,
    race_offered,
)
from spiral.inference.strategies.likelihood.benefit import (
    Refusal,
    refuse_growing_error,
    refuse_unhelpful,
)
from spiral.inference.strategies.likelihood.changes import PromisingChanges, with_every_form
from spiral.inference.strategies.likelihood.whole_fit import fit_beside_noise
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.inference.verdict import undetermined_effects
from spiral.physics.formulas.laws import laws_of
from spiral.types.effect import Effect, ForceEffect, ParameterEffect, StateFlow
from spiral.types.run import Comparison

_SEVERAL = 2  # effects admitted from which a law may stand for all of them


@dataclass(frozen=True)
class NamedLaw:
    """A law that passed, its look-alikes, the laws that were tried, and the model with it."""

    effect: Effect
    aliases: tuple[str, ...]
    ranking: Ranking
    tried: tuple[Rival, ...]
    refitted: RefittedModel


@dataclass(frozen=True)
class _LawStart:
    """A model from which laws are tried.

    ``gone`` are the effects that it lets go, ``log_likelihood`` that of the model with them of all
    samples of the ``records``, ``state`` that model's; ``worth`` what they gain on the blocks that
    select, less their penalty.
    ``tolerances`` : what known values explain beside ``base`` that are a little off.
    """

    base: LikelihoodFit
    gone: tuple[str, ...] = ()
    log_likelihood: float = -np.inf
    state: FitState | None = None
    records: FilterInputs = ()
    worth: float = 0.0
    tolerances: Tolerances = field(default_factory=Tolerances)


def find_named_law(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, base: LikelihoodFit,
    white: bool, comparison: Comparison, masks: tuple[Masks, Masks], level: float,
    changes: PromisingChanges, progress: Progress,
) -> NamedLaw | None:  # fmt: skip
    """The law that is admitted; nothing where none passes.

    Parameters
    ----------
    state : the study's. base : the same, fitted on the blocks that select. masks : (select, judge).
    white : whether nothing but noise, or what acts at random, is left of it.
    """
    gone = stand_in_labels(assembly, base)
    aided = bool(gone and comparison.random)  # a force at random makes up for a wrong form
    several = len(gone) >= _SEVERAL and not _has_coupling_force(assembly, gone)
    moved = is_moved_at_random(comparison, assembly.problem.settings)
    moved = moved and not is_moved_unseen(comparison)
    unsure = undetermined_among(assembly, gone, comparison)
    much = is_much_random(comparison)
    if (white and not (several or aided or moved or unsure or much)) or not options.laws:
        return None
    laws = laws_of(assembly.problem.model.system)
    whole = moved or not white or not gone
    for start in _law_starts(assembly, state, base, gone, whole, masks[0], changes, progress):
        progress("trying laws with a closed form")
        forms = (e for e in changes.beside(start.base) if not e.bare)
        offered = offer_effects(assembly, (*laws, *forms))
        if start.base is base:
            start = replace(start, tolerances=changes.tolerances)
        law = _find_law_from(options, offered, start, comparison, masks, level, progress)
        if law is not None:
            return law
    return None


def is_much_random(comparison: Comparison) -> bool:
    """Whether much acts at random, or is a sensor's noise with a colour: a law may hide there.

    What moves a machine that nothing else does hides none.
    """
    most = max((comparison.random or {}).values(), default=0.0)
    return most > LITTLE and not is_moved_unseen(comparison)


def stand_in_labels(assembly: Assembly, base: LikelihoodFit) -> tuple[str, ...]:
    """Compiled labels of admitted effects that a law may replace.

    Those are forces and flows without memory; where none was admitted and a random force is no
    small one, all effects: a sensor or an actuator may have taken part in what a law explains.
    """
    held = {v.label: v.effect for v in assembly.variants if v.label in base.state.labels}
    kinds = ForceEffect | StateFlow
    plain = tuple(x for x, e in held.items() if isinstance(e, kinds) and not e.states)
    return plain if plain or is_random_force_small(base) else tuple(held)


def undetermined_among(
    assembly: Assembly, labels: tuple[str, ...], comparison: Comparison
) -> tuple[str, ...]:
    """Effects, of these compiled labels, of whose values the record tells none."""
    added = tuple(assembly.variant(x).original.label for x in labels)
    return undetermined_effects(comparison.model, added, assembly.problem.settings)


def _has_coupling_force(assembly: Assembly, labels: tuple[str, ...]) -> bool:
    """Whether a force among these couples two axes, which no law of one variable stands for."""
    effects = (assembly.variant(x).effect for x in labels)
    return any(isinstance(e, ForceEffect) and e.axes == 2 for e in effects)


def _law_starts(
    assembly: Assembly, state: FitState, base: LikelihoodFit, gone: tuple[str, ...],
    whole: bool, select: Masks, changes: PromisingChanges, progress: Progress,
) -> Iterator[_LawStart]:  # fmt: skip
    """The model without the effects that a law may replace, and, if asked, the ``whole`` of it.

    Where a random force carries that one far from the values given, it is asked at these, too: a
    law has to be worth more there than the model at its own values.
    """
    before = fit_without(assembly, base, gone, select, progress) if gone else None
    if before is not None:
        numbers = len(base.estimate.keys) - len(before.estimate.keys)
        price = schwarz_penalty(numbers, before.estimate.prepared)
        worth = base.log_likelihood - before.log_likelihood - price
        records, log_likelihood = of_all_samples(assembly, state)
        yield _LawStart(before, gone, log_likelihood, state, records, worth)
    if whole:
        yield _LawStart(base)
    for held in changes.at_given_values(base, progress) if whole else ():
        lead = net_log_likelihood(base) - net_log_likelihood(held)
        yield _LawStart(held, worth=max(lead, 0.0))


def fit_without(
    assembly: Assembly, base: LikelihoodFit, gone: tuple[str, ...], select: Masks,
    progress: Progress,
) -> LikelihoodFit | None:  # fmt: skip
    """The model without some of its effects on the blocks that select; nothing if it diverges.

    Its noise is found anew: beside that of the model with them it might not find its values.
    """
    bare = replace(drop_effects(assembly, base.state, gone), noise=None)
    fit = select_noise_model(assembly, fit_by_likelihood(assembly, bare, rough=True), progress)
    if not fit.estimate.finite:
        return None
    return fit_by_likelihood(assembly, fit.state, masks=select, steps=WARM, rough=True)


def of_all_samples(assembly: Assembly, state: FitState) -> tuple[FilterInputs, float]:
    """The whole records, of which a study may be an excerpt, and their log-likelihood."""
    assert state.noise is not None
    records = prepare_filter_tasks(whole_study(assembly), whole_state(assembly, state))
    return records, total_log_likelihood(records, state.noise)


def _find_law_from(
    options: LikelihoodOptions, assembly: Assembly, start: _LawStart, comparison: Comparison,
    masks: tuple[Masks, Masks], level: float, progress: Progress,
) -> NamedLaw | None:  # fmt: skip
    """The law that is admitted from one start; nothing where none passes."""
    contest = race_offered(assembly, start.base, masks[0], progress, options.rivals)
    if contest is None:
        return None

    def objection(whole: WholeRecordFit) -> Refusal | None:
        if _explains_all(options, assembly, start, whole.refitted, comparison):
            return None
        return Refusal("it leaves more than noise, or is not likelier than what it would replace")

    race, ranked = contest
    race = replace(with_every_form(race, ranked), tolerances=start.tolerances)
    passed = first_to_pass(
        options, assembly, start.base, race, masks[1], level, objection, progress, start.worth
    ).passed
    if passed is None:
        return None
    gone = tuple(assembly.variant(x).original.label for x in start.gone)
    refitted, effect = passed.whole.refitted, passed.rival.ranked.variant.original
    known = _find_equal_candidate(options, assembly, start, passed, progress)
    if known is not None:
        passed = replace(known, aliases=(effect.label, *passed.aliases))
        refitted, effect = known.whole.refitted, known.rival.ranked.variant.original
    if effect.label in gone:  # it is what the law was to replace
        return None
    gone = tuple(x for x in gone if x != effect.label)
    refitted = replace(refitted, retired=(*refitted.retired, *gone))
    return NamedLaw(effect, passed.aliases, ranked, race.tried, refitted)


def _find_equal_candidate(
    options: LikelihoodOptions, assembly: Assembly, without: _LawStart, law: AcceptedCandidate,
    progress: Progress,
) -> AcceptedCandidate | None:  # fmt: skip
    """A candidate at a law's place that does as well beside the values found with the law."""
    own, state, effect = law.whole.assembly, law.whole.fit.state, law.rival.ranked.variant.original
    refitted, noise = law.whole.refitted, law.whole.fit.estimate.noise
    known = tuple(
        e for e in assembly.problem.candidates_beside(effect)
        if isinstance(e, ForceEffect | StateFlow) and not e.states
    )  # fmt: skip
    if not known:
        return None
    progress(f"testing which candidates do as well as {effect.label}")
    own, state = excerpt_study(own, state, law.whole.fit) or (own, state)
    bare, select = drop_effects(own, state, (law.rival.ranked.variant.label,)), half_masks(own)[0]
    first = without.base.estimate.noise
    estimate = maximise_likelihood(
        prepare_filter_tasks(own, bare), (), first, {}, select, WARM, rough=True
    )
    start = LikelihoodFit(with_estimate(bare, estimate), estimate)
    contest = race_offered(offer_effects(own, known), start, select, progress, options.rivals)
    least = refitted.log_likelihood - np.log(options.odds)
    winners = () if contest is None else contest[0].winners()
    for rival, _ in itertools.islice(winners, options.judged):
        whole = fit_beside_noise(rival, noise, progress)
        white = is_near_noise(whole.refitted.comparison, assembly.problem.settings)
        if white and whole.refitted.log_likelihood >= least:
            return AcceptedCandidate(rival, (), whole)
    return None


def _explains_all(
    options: LikelihoodOptions, assembly: Assembly, start: _LawStart, refitted: RefittedModel,
    comparison: Comparison,
) -> bool:  # fmt: skip
    """Whether a law leaves only noise and is likelier, penalty included, than what it replaces.

    One of whose values the record tells none only describes that something is needed at its place.
    A parameter's change is an effect that the catalog names: as beside any of these, something may
    still act at random.
    """
    settings, model = assembly.problem.settings, refitted.comparison.model
    new = tuple(x for x in model.labels if x not in comparison.model.labels)
    if undetermined_effects(model, new, settings):
        return False
    changed = any(isinstance(e, ParameterEffect) for e in model.effects if e.label in new)
    limit = OWN if changed else settings.random_limit
    if not is_near_noise(refitted.comparison, replace(settings, random_limit=limit)):
        return False
    if not start.gone:
        return refuse_unhelpful(options, comparison, refitted.comparison, settings) is None
    if refuse_growing_error(comparison, refitted.comparison, settings) is not None:
        return False
    log_likelihood = refitted.log_likelihood - _parameter_penalty(start, refitted.comparison)
    least = np.log(options.odds) - _parameter_penalty(start, comparison)
    if not log_likelihood > start.log_likelihood + least:
        return False
    return (
        log_likelihood
        > _log_likelihood_beside_law_noise(assembly, start, refitted.fit_state) + least
    )


def _log_likelihood_beside_law_noise(assembly: Assembly, start: _LawStart, law: FitState) -> float:
    """Log-likelihood of the model that a law replaces, beside the noise of the law's own fit.

    A term of noise that came in with the law (a drift, say) is no merit of the law.
    """
    known = start.state
    assert known is not None
    assert known.noise is not None
    if law.noise is None or {*law.noise.names} == {*known.noise.names}:
        return start.log_likelihood
    whole, known = whole_study(assembly), whole_state(assembly, known)
    return fit_by_likelihood(whole, known, law.noise, rough=True).log_likelihood


def _parameter_penalty(start: _LawStart, of: Comparison) -> float:
    """Schwarz's penalty of the fitted numbers of a model."""
    return schwarz_penalty(len(of.model.errors), start.records)
