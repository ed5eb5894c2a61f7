"""Learned curves as candidates of the likelihood: which state a missing force or flow follows.

Where no effect with a name explains what is left, every curve (``spiral.physics.learned``) at
every place is scored, refitted and judged as candidates with names are, each of its coefficients
at Schwarz's penalty. Effects that were admitted may only have stood in for a curve, so that curves
are tried in their place as well, beside the seed alone.

A model that lacks a curve may have come to values from which none makes much more likely (two
stores that have changed places). So curves are also scored and raced beside the values given, and
the leading ones fitted afresh: flat, from these values, from the several starts that a seed has.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.likelihood.noise import first_noise
from spiral.engine.likelihood.predict import Prediction, predict_cases
from spiral.engine.series import sample_inputs
from spiral.inference.evidence.admission import drop_effects
from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.fit_state import FitState, Masks
from spiral.inference.evidence.scoring import CandidateColumns, Ranking
from spiral.inference.likelihood.candidates import Race, Rival, make_rival
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WARM,
    LikelihoodFit,
    fit_by_likelihood,
    is_random_force_small,
    net_log_likelihood,
    schwarz_penalty,
)
from spiral.inference.likelihood.seed_fit import best_fit, with_given_values
from spiral.inference.likelihood.suggestions import suggestions
from spiral.inference.nearness import is_near_noise
from spiral.inference.problem import Progress, silent
from spiral.inference.strategies.base import RefittedModel
from spiral.inference.strategies.likelihood.accepted import (
    AcceptedCandidate,
    Objection,
    WholeRecordFit,
)
from spiral.inference.strategies.likelihood.admission import (
    benefit_objection,
    first_to_pass,
    offer_effects,
    race_offered,
)
from spiral.inference.strategies.likelihood.benefit import Refusal
from spiral.inference.strategies.likelihood.changes import PromisingChanges
from spiral.inference.strategies.likelihood.laws import (
    NamedLaw,
    fit_without,
    of_all_samples,
    stand_in_labels,
    undetermined_among,
)
from spiral.inference.strategies.likelihood.named_curves import name_curve
from spiral.inference.strategies.likelihood.whole_fit import compare_whole_record_fit
from spiral.inference.strategy_options import LikelihoodOptions
from spiral.inference.unknown.forcecurve import CurveFit, Unknown, describe_curve
from spiral.physics.learned import LEVELS, Learned, LearnedParameterChange
from spiral.physics.signatures import auxiliary_along
from spiral.types.record import Array
from spiral.types.run import Comparison
from spiral.types.system import TIME

_MOST = 3  # curves refitted from one model
_UNSEEN = 1e-3  # share of its own slope by which a coefficient is held where others can do its work


@dataclass(frozen=True)
class MissingCurve:
    """A curve that passed: its shape, the model with it, and effects in whose place it stands.

    ``undetermined`` are those of them whose values the record does not tell, where the curve
    explains as much as they do, and not more. ``law`` : a form with a name that is likelier.
    """

    shape: Unknown
    refitted: RefittedModel
    replaces: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    law: NamedLaw | None = None


def find_missing_curve(
    options: LikelihoodOptions, assembly: Assembly, base: LikelihoodFit, comparison: Comparison,
    masks: tuple[Masks, Masks], level: float, changes: PromisingChanges, progress: Progress,
) -> MissingCurve | None:  # fmt: skip
    """The curve that makes the record most likely, beside the model or in place of what it added.

    Parameters
    ----------
    base : the model as it is on the blocks that select. comparison : of the model as it is, on
        whose unseen data it must do better. masks : (select, judge). level : of the judging test.
    """
    progress("trying curves over each state")
    helps = benefit_objection(options, comparison, assembly.problem.settings)
    held = changes.at_given_values(base, progress)
    best = (e for fit in (base, *held) for e in changes.beside(fit))  # at promising places
    curves = tuple(dict.fromkeys(e for e in best if e.bare))
    assembly = offer_effects(assembly, (*assembly.problem.dictionary, *curves))
    search = _CurveSearch(options, assembly, masks, level, helps, progress)
    alone = _fit_seed_alone(assembly, base.state, masks[0])
    passing = instead = None if alone is None else search.in_place_of(base, alone)
    if passing is None and not is_random_force_small(base):
        starts = [*held, *_restart_from_first_noise(assembly, base, masks[0])]
        others = [p for p in (search.in_place_of(base, s) for s in starts) if p is not None]
        passing = max(others, key=lambda p: p[0].whole.fit.log_likelihood, default=None)
    if passing is None and alone is not None:
        passing = instead = search.in_place_of(base, alone, afresh=True)
    if passing is None:
        passing = search.beside(base)
    if passing is None and alone is None:
        passing = search.beside(base, afresh=True)
    if passing is None:
        return None
    gone = () if instead is None else _added_labels(assembly, base.state)
    replaces = tuple(assembly.variant(x).original.label for x in gone)
    curve = replace(_missing_curve(passing, helps, progress), replaces=replaces)
    passed, (race, ranked) = passing
    variant = passed.rival.ranked.variant
    named = name_curve(passed.whole, variant, curve.shape, helps, options.odds, progress)
    if named is None:
        return curve
    refitted = named.whole.refitted
    refitted = replace(refitted, retired=(*refitted.retired, *replaces))
    law = NamedLaw(named.effect, named.aliases, ranked, race.tried, refitted)
    return replace(curve, law=law)


def find_equal_curve(
    options: LikelihoodOptions, assembly: Assembly, state: FitState, base: LikelihoodFit,
    comparison: Comparison, masks: tuple[Masks, Masks], level: float, progress: Progress,
) -> MissingCurve | None:  # fmt: skip
    """The curve that explains a record as well as effects of whose values the record tells none.

    Such effects only describe that something is needed at their place: a smooth softening is a
    clearance whose gap, width and stiffness have errors as large as they are. A curve in place of
    all that has no memory has to leave no more than noise, and the record must be as likely with it
    as with the effects once these have paid for their numbers (Schwarz). Nothing where none does,
    or all effects are determined. ``state`` : the study's; others as in ``find_missing_curve``.
    """
    settings, gone = assembly.problem.settings, stand_in_labels(assembly, base)
    unsure = undetermined_among(assembly, gone, comparison)
    if not unsure:
        return None
    replaces = tuple(assembly.variant(x).original.label for x in gone)
    progress(f"trying one curve in place of {', '.join(replaces)}")
    start = fit_without(assembly, base, gone, masks[0], progress)
    if start is None:
        return None
    records, log_likelihood = of_all_samples(assembly, state)
    numbers = len(base.estimate.keys) - len(start.estimate.keys)
    least = log_likelihood - schwarz_penalty(numbers, records)
    assembly = offer_effects(assembly, assembly.problem.dictionary)

    def objection(whole: WholeRecordFit) -> Refusal | None:
        told = replace(whole.refitted.comparison, converged=True)  # no knot has to be determined
        near = is_near_noise(told, settings)
        return None if near and whole.fit.log_likelihood >= least else Refusal("it explains less")

    search = _CurveSearch(options, assembly, masks, level, objection, progress)
    passing = search.beside(start)
    if passing is None:
        return None
    curve = _missing_curve(passing, objection, progress)
    return replace(curve, replaces=replaces, undetermined=unsure)


def _missing_curve(
    passing: Passing, objection: Objection,
    progress: Progress,
) -> MissingCurve:  # fmt: skip
    """A curve that passed, on as many knots as are worth their penalty, and its shape.

    Knots to which the ``objection`` is made are not added: a curve that few readings hold at its
    ends may leave all bounds on unseen data.
    """
    passed, (race, ranked) = passing
    label, own = passed.rival.label, passed.rival.ranked.variant.label
    whole = _refine_knots(passed.whole, own, progress)
    if whole is not passed.whole and objection(whole) is not None:
        whole = passed.whole
    listed = suggestions(race.tried, ranked, label, passed.aliases)
    return MissingCurve(describe_curve(_as_curve_fit(whole, own), label, listed), whole.refitted)


Passing = tuple[AcceptedCandidate, tuple[Race, Ranking]]
"""A curve that passed, with its race."""


@dataclass(frozen=True)
class _CurveSearch:
    """Curves that the study offers, beside any model of it; ``masks`` are (select, judge).

    ``races`` : those that were run, each with the model that it began with.
    """

    options: LikelihoodOptions
    assembly: Assembly
    masks: tuple[Masks, Masks]
    level: float
    objection: Objection
    progress: Progress
    races: list[tuple[LikelihoodFit, tuple[Race, Ranking] | None]] = field(default_factory=list)

    def in_place_of(
        self, base: LikelihoodFit, start: LikelihoodFit, afresh: bool = False
    ) -> Passing | None:
        """The curve that comes first beside ``start`` and makes more likely than ``base`` is."""
        ahead = _lead_of_model(base, start, self.options.odds)
        passing = self.beside(start, ahead, afresh)
        if passing is None or not _is_likelier_alone(passing[0], base, self.options.odds):
            return None
        return passing

    def beside(
        self, start: LikelihoodFit, ahead: float = 0.0, afresh: bool = False
    ) -> Passing | None:
        """The curve that comes first beside a model and passes, with its race.

        It has to be worth more than ``ahead``, by which the model that it would replace leads. In
        place of a change of a parameter a force or a flow that is not told from it. ``afresh`` :
        those that lead are fitted anew.
        """
        contest = self._race_beside(start) if start.estimate.finite else None
        if contest is None:
            return None
        if afresh:
            contest = _start_curves_afresh(*contest, self.progress)
        passed = first_to_pass(
            self.options, self.assembly, start, contest[0], self.masks[1], self.level,
            self.objection, self.progress, ahead,
        ).passed  # fmt: skip
        if passed is None:
            return None
        plain = tuple(e for e in self.assembly.problem.dictionary if e.label in passed.aliases)
        if plain and isinstance(passed.rival.ranked.variant.effect, LearnedParameterChange):
            alone = replace(self, assembly=offer_effects(self.assembly, plain), races=[])
            other = alone.beside(start, ahead, afresh)
            if other is not None:  # a spring's stiffness that follows its own length is a force
                return other
        return passed, contest

    def _race_beside(self, start: LikelihoodFit) -> tuple[Race, Ranking] | None:
        """The race of the curves beside a model, run once for each."""
        for known, contest in self.races:
            if known is start:
                return contest
        parts = functools.partial(_coefficient_columns, self.assembly)
        select = self.masks[0]
        contest = race_offered(self.assembly, start, select, self.progress, _MOST, parts)
        self.races.append((start, contest))
        return contest


def _start_curves_afresh(race: Race, ranked: Ranking, progress: Progress) -> tuple[Race, Ranking]:
    """The race with its leading curves fitted anew, those alone."""
    anew = []
    for rival in race.runners[:_MOST]:
        progress(f"starting again with {rival.label}, flat, from the values given")
        anew.append(_fit_curve_afresh(race, rival))
    return race.with_only_rivals([r for r in anew if r.fit.estimate.finite]), ranked


def _fit_curve_afresh(race: Race, rival: Rival) -> Rival:
    """A curve fitted from the values given, flat at first, on the knots worth their price."""
    own, label = rival.assembly, rival.ranked.variant.label
    state = with_given_values(own, rival.fit.state) or rival.fit.state
    values, levels = state.values.copy(), _knot_levels(own, own.variant(label))
    values[:, [own.study.index(key) for key in levels]] = 0.0
    begun = replace(state, values=values, noise=None, starts=None, spreads=None)
    whole = _with_worthy_knots(own, best_fit(own, begun, silent), label, silent)
    fit = fit_by_likelihood(own, whole.state, masks=race.masks, steps=WARM, rough=True)
    knots = sum(key in levels for key in fit.estimate.keys) - len(rival.ranked.columns)
    return make_rival(own, race.base, rival.ranked, fit, rival.shapes + max(knots, 0))


def _restart_from_first_noise(
    assembly: Assembly, base: LikelihoodFit, select: Masks
) -> list[LikelihoodFit]:
    """Fits begun from the first noise again, at the model's values and at those given.

    Where much has to act at random for what is missing, noise that a curve makes needless would
    stay beside it and do some of its work.
    """
    noise = first_noise(base.estimate.prepared[0][0], LEVEL)
    states = (base.state, with_given_values(assembly, base.state))
    return [
        fit_by_likelihood(assembly, s, noise, select, WARM, True) for s in states if s is not None
    ]


def _lead_of_model(base: LikelihoodFit, start: LikelihoodFit, odds: float) -> float:
    """What a curve must be worth beside ``start`` to be likelier than ``base`` by the odds."""
    lead = net_log_likelihood(base) - net_log_likelihood(start) + float(np.log(odds))
    return max(lead, 0.0)


def _is_likelier_alone(passed: AcceptedCandidate, base: LikelihoodFit, odds: float) -> bool:
    """Whether a curve alone makes the blocks that select more likely than the model as it is."""
    return net_log_likelihood(passed.rival.fit) > net_log_likelihood(base) + np.log(odds)


def _added_labels(assembly: Assembly, state: FitState) -> tuple[str, ...]:
    """Compiled labels of what a study has added to its seed."""
    return tuple(x for x in state.labels if x not in assembly.problem.model.labels)


def _fit_seed_alone(assembly: Assembly, state: FitState, masks: Masks) -> LikelihoodFit | None:
    """The seed on the blocks that select; nothing where the state has nothing beyond it."""
    beyond = _added_labels(assembly, state)
    if not beyond:
        return None
    return fit_by_likelihood(
        assembly, drop_effects(assembly, state, beyond), None, masks, WARM, True
    )


def _coefficient_columns(assembly: Assembly, group: CandidateColumns) -> list[tuple[int, ...]]:
    """The columns of a curve's coefficients, on few knots and on more."""
    levels = _knot_levels(assembly, group.variant)
    finest = max(levels.values())
    return [
        tuple(i for i, k in enumerate(group.keys) if levels[k] <= most)
        for most in range(finest + 1)
    ]


def _knot_levels(assembly: Assembly, variant: Variant) -> dict[str, int]:
    """How fine the knots of a curve's coefficients are, by their names."""
    effect = variant.effect
    pairs = effect.keys(assembly.problem.model.system.place(effect))
    return {key: LEVELS[p.name] for key, p in pairs if p.name in LEVELS}


def _refine_knots(whole: WholeRecordFit, label: str, progress: Progress) -> WholeRecordFit:
    """The model with its curve on more knots, where these are worth their penalty.

    All are tried: a bump between coarse knots is none of the curves on a few more.
    """
    best = _with_worthy_knots(whole.assembly, whole.fit, label, progress)
    if best is whole.fit:
        return whole
    return compare_whole_record_fit(whole.assembly, best, whole.refitted.retired, progress)


def _with_worthy_knots(
    own: Assembly, fit: LikelihoodFit, label: str, progress: Progress
) -> LikelihoodFit:
    """The fit with its curve on the knots that are worth their penalty."""
    levels, best = _knot_levels(own, own.variant(label)), fit
    for most in range(1 + max(levels.values())):
        more = {k for k in best.state.held if levels.get(k, most + 1) <= most}
        if not more:
            continue
        progress("trying the curve on more knots")
        held = tuple(k for k in best.state.held if k not in more)
        again = fit_by_likelihood(own, replace(best.state, held=held), rough=True)
        price = schwarz_penalty(len(more), best.estimate.prepared)
        if again.log_likelihood > best.log_likelihood + price:
            best = again
    return best


def _as_curve_fit(whole: WholeRecordFit, label: str) -> CurveFit:
    """The fit of a model in the form from which the shape of its learned effect is read."""
    own, at = whole.assembly, whole.fit.estimate
    learned, count = own.variant(label).effect, len(at.prepared[0][0].states)
    assert isinstance(learned, Learned)
    state = whole.fit.state
    runs = predict_cases([(at.prepared, at.noise)], at.keys, keep=True)[0]
    records = [(task.series.record, p.done) for (task, _), p in zip(at.prepared, runs, strict=True)]
    system, row = own.problem.model.system, state.values[0]
    states = np.concatenate([p.means[: p.done, :count] for p in runs])
    names = [i.name for i in system.inputs]
    names = [n for n in names if all(n in r.inputs for r, _ in records)]
    followed = {n: np.concatenate([r.inputs[n][:done] for r, done in records]) for n in names}
    followed[TIME] = np.concatenate([r.dt * np.arange(done) for r, done in records])
    columns = np.concatenate([
        sample_inputs(task.series.inputs, task.series.substeps)[: p.done]
        for (task, _), p in zip(at.prepared, runs, strict=True)
    ])  # fmt: skip
    given = [row[own.study.index(f"system.{p.name}")] for p in system.parameters]
    followed |= {
        a.name: auxiliary_along(system, a.name, states[:, : len(system.states)], columns, given)
        for a in system.auxiliaries
    }
    return CurveFit(
        own, learned, _added_labels(own, state), row,
        tuple(own.study.index(k) for k in at.keys), _covariance(runs), states, followed,
    )  # fmt: skip


def _covariance(runs: Sequence[Prediction]) -> Array:
    """Covariance of the moving parameters, V = (X^T X + e^2)^-1, X the whitened unit slopes.

    With e of a thousandth a coefficient that no motion shows has a large doubt, but a finite one.
    """
    columns = np.concatenate([p.columns.reshape(-1, p.columns.shape[2]) for p in runs])
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = np.inf
    unit = columns / size
    inverse = np.linalg.pinv(unit.T @ unit + _UNSEEN**2 * np.eye(len(size)))
    return inverse / np.outer(size, size)
