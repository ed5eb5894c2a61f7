"""Changes of parameters with variables: those that score best, and those that lead.

A change may stand for many an effect, and is asked after the catalog. It is asked at once where it
scores better than every candidate and the best of these leaves more than noise: the truth, where
the catalog has it, is outdone by no change (a stiffness that follows its own deflection is a
quadratic spring), and what stands in for a change is.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

from spiral.inference.evidence.assembly import Assembly, Variant
from spiral.inference.evidence.fit_state import Masks
from spiral.inference.evidence.scoring import RankedCandidate, Ranking
from spiral.inference.likelihood.alternative_fits import fits_at_given_values
from spiral.inference.likelihood.candidates import Race
from spiral.inference.likelihood.fitting import LikelihoodFit, is_random_force_small
from spiral.inference.likelihood.scores import (
    FilteredRecords,
    rank_variants,
    repeating_variants,
)
from spiral.inference.likelihood.tolerances import Tolerances
from spiral.inference.problem import Progress
from spiral.inference.strategies.likelihood.admission import offer_effects, race_offered
from spiral.types.effect import Effect, ParameterEffect, is_periodic_change, is_plain_change

_CHANGES = 5  # pairs of a parameter and what it follows, for which every form is tried
_LEADING = 2  # of these where they lead


@dataclass(frozen=True)
class PromisingChanges:
    """Changes of parameters by their score beside any model of a study, computed once for each.

    Candidates, laws and curves ask for them beside the same model. ``tolerances`` : what known
    values explain there that are a little off.
    """

    assembly: Assembly
    select: Masks
    tolerances: Tolerances = field(default_factory=Tolerances)
    known: list[tuple[LikelihoodFit, Ranking | None, tuple[Effect, ...]]] = field(
        default_factory=list
    )
    held: list[tuple[LikelihoodFit, list[LikelihoodFit]]] = field(default_factory=list)

    def beside(self, base: LikelihoodFit) -> tuple[Effect, ...]:
        """Changes of every form at the places that score best beside a model.

        A curve (``bare``) is one of the forms, and no plain one.
        """
        return self._score_beside(base)[1]

    def at_given_values(self, base: LikelihoodFit, progress: Progress) -> list[LikelihoodFit]:
        """Fits at the values given, from which a random force has carried those of a model."""
        if is_random_force_small(base):
            return []
        for fit, held in self.held:
            if fit is base:
                return held
        held = fits_at_given_values(self.assembly, base.state, self.select, progress)
        self.held.append((base, held))
        return held

    def _score_beside(self, base: LikelihoodFit) -> tuple[Ranking | None, tuple[Effect, ...]]:
        for fit, ranked, changes in self.known:
            if fit is base:
                return ranked, changes
        ranked = _rank_plain_changes(self.assembly, base, self.select)
        places = () if ranked is None else (r.variant.original.port for r in ranked.ranked)
        best = {*itertools.islice(dict.fromkeys(places), _CHANGES)}
        changes = tuple(e for e in self.assembly.problem.changes() if e.port in best)
        self.known.append((base, ranked, changes))
        return ranked, changes

    def race_leading(
        self, base: LikelihoodFit, candidates: Ranking, progress: Progress, most: int, lead: float
    ) -> tuple[Race, Ranking] | None:  # fmt: skip
        """The race of changes where one scores better than every candidate; else nothing.

        A change of several amplitudes (a parabola) shows no lead: it is to be compared with as many
        candidates, of which it may be the sum (a spring's k (1 + a x + b x^2) is a quadratic and a
        cubic spring), and to first order a change of one amplitude scores as its larger part does.
        One that repeats leads with each of its amplitudes: no candidates add up to it.
        ``lead`` : times the best candidate's gain that its own has to be.
        """
        ranked, changes = self._score_beside(base)
        if ranked is None:
            return None
        least = min((r.rank for r in candidates.ranked), default=0.0)
        enough = lead * max((r.score.gain for r in candidates.ranked), default=0.0)
        leading = (
            r.variant.original.port for r in ranked.ranked
            if (len(r.columns) == 1 or is_periodic_change(r.variant.original))
            and r.score.gain >= len(r.columns) * enough and r.rank < min(least, 0.0)
        )  # fmt: skip
        best = {*itertools.islice(dict.fromkeys(leading), _LEADING)}
        forms = tuple(e for e in changes if e.port in best and not e.bare)
        if not forms:
            return None
        progress("trying changes of parameters that score better than any candidate")
        offered = offer_effects(self.assembly, forms)
        contest = race_offered(offered, base, self.select, progress, most)
        if contest is None:
            return None
        return replace(with_every_form(*contest), tolerances=self.tolerances), contest[1]


def _rank_plain_changes(assembly: Assembly, base: LikelihoodFit, select: Masks) -> Ranking | None:
    """Plain forms of all changes, and what repeats, by their score.

    Plain ones have no shapes to be searched: a line, a parabola, a power and an exponential show
    what any smooth change would.
    """
    changes = assembly.problem.changes()
    plain = tuple(e for e in changes if is_plain_change(e) or is_periodic_change(e))
    offered = offer_effects(assembly, plain)

    def variants(filtered: FilteredRecords) -> list[Variant]:
        return [*offered.offered, *repeating_variants(filtered, offered.offered)]

    return rank_variants(offered, base, base.estimate.noise, select, variants)


def with_every_form(race: Race, ranked: Ranking) -> Race:
    """The race with every form of the change that leads it, in which some may not have taken part.

    To first order all forms of a change are one: their scores do not tell which is the better.
    """
    leader = race.runners[0].ranked.variant.original if race.runners else None
    if not isinstance(leader, ParameterEffect):
        return race
    refitted = {r.label for r in race.runners}
    forms: dict[str, RankedCandidate] = {}
    for each in ranked.ranked:
        effect = each.variant.original
        if effect.port == leader.port and effect.label not in refitted:
            forms.setdefault(effect.label, each)
    return race.with_candidates(tuple(forms.values()))
