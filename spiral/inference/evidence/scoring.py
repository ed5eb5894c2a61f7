"""Scores of every candidate that is not active, in one pass over a stage's windows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.score import Score, ScoreTable, build_score_table, residual_block_samples, score
from spiral.engine.sensitivities import Reduction, reduce_windows, residuals
from spiral.engine.study import ORIGIN, ParameterColumns, column_owner
from spiral.inference.evidence.assembly import (
    Assembly,
    Variant,
    columns_with_bounds,
)
from spiral.inference.evidence.effective_tests import effective_tests
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.inseparable import inseparable_part
from spiral.types.label import owner_of

_NEAR = 0.8  # share of the best variant's gain from which another scores nearly as well


@dataclass(frozen=True)
class RankedCandidate:
    """A candidate's best variant with its evidence; the smallest ``rank`` (BIC) is best.

    ``tests`` is the number of independent tests that its shapes amount to (``effective_tests``);
    ``tied`` are effects of the model that can take over part of it, all of it where ``whole``;
    ``held`` are amplitudes that then stay at zero; ``others`` values of its shapes that score
    nearly as well.
    """

    variant: Variant
    columns: tuple[int, ...]
    score: Score
    rank: float
    tests: float = 1.0
    tied: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    whole: bool = False
    others: tuple[RankedCandidate, ...] = ()

    @property
    def log_p(self) -> tuple[float, float]:
        """Classical and robust p-value (logarithms), corrected for the values tried."""
        more = float(np.log(self.tests))
        return min(self.score.log_p + more, 0.0), min(self.score.wald_log_p + more, 0.0)


@dataclass(frozen=True)
class Ranking:
    """Candidates, best first, with the table that they were scored in; ``block`` in samples."""

    ranked: tuple[RankedCandidate, ...]
    table: ScoreTable
    block: int


@dataclass(frozen=True)
class Evidence(Ranking):
    """Candidates at one window length, with the stage whose fit they were scored along."""

    stage: Stage


@dataclass(frozen=True)
class CandidateColumns:
    """A candidate's columns in a pass, one for each key (each record's own where it has one).

    ``sides`` say which of them can only be positive.
    """

    variant: Variant
    keys: tuple[str, ...]
    sides: tuple[bool, ...]


def score_stage(assembly: Assembly, fit_state: FitState, stage: Stage) -> Evidence:
    """Score all candidates that are not active, in one pass."""
    keys = fit_state.keys(assembly)
    groups = [column_group(assembly, v) for v in inactive_variants(assembly, fit_state)]
    candidate_keys = tuple(k for g in groups for k in dict.fromkeys(g.keys))
    residual = residuals(assembly.study, stage.layouts, stage.fitted.point)
    block = residual_block_samples(residual)
    moving, _ = columns_with_bounds(assembly, (*keys, *candidate_keys))
    active, _ = columns_with_bounds(assembly, keys)
    reduction = reduce_windows(assembly.study, stage.layouts, stage.fitted.point, moving, block)
    ranking = rank_groups(reduction, column_owners(assembly, active), groups, block)
    return Evidence(ranking.ranked, ranking.table, block, stage)


def inactive_variants(assembly: Assembly, fit_state: FitState) -> list[Variant]:
    """Variants of the candidates that are not active."""
    present = active_labels(assembly, fit_state)
    return [v for v in assembly.variants if v.original.label not in present]


def column_group(assembly: Assembly, variant: Variant) -> CandidateColumns:
    """The columns of a compiled variant's amplitudes."""
    parameters = assembly.study.compiled.traced.parameters
    index = columns_with_bounds(assembly, amplitude_keys(assembly, variant))[0].index
    sides = tuple(parameters[i].lower == 0.0 and variant.companion is None for i in index)
    return CandidateColumns(variant, tuple(assembly.study.keys[i] for i in index), sides)


def column_owners(assembly: Assembly, active: ParameterColumns) -> list[str]:
    """The effect that each active column belongs to."""
    return [_column_owner(assembly, int(i)) for i in active.index]


Parts = Callable[[CandidateColumns], Sequence[tuple[int, ...]]]
"""Subsets of a candidate's columns (positions), each of which may be taken by itself."""


def rank_groups(
    reduction: Reduction, owners: Sequence[str], groups: Sequence[CandidateColumns], block: int,
    parts: Parts | None = None,
) -> Ranking:  # fmt: skip
    """Candidates, best first, by their evidence in a pass over [active | candidates | residual].

    ``owners`` are the effects of the active columns. Of each candidate the best variant is kept,
    and of its ``parts`` the best; what is in none of them does nothing here and is held.
    """
    active = len(owners)
    table = build_score_table(reduction, active)
    keys = [k for g in groups for k in g.keys]
    ranks: dict[str, list[RankedCandidate]] = {}
    for group, candidate_score in score_groups(table, groups, parts):
        variant = group.variant
        tied = inseparable_part(reduction.triangle, active, candidate_score.columns)
        names = dict.fromkeys(owners[i] for i in tied.with_)
        inside = tuple(keys[i] for i in candidate_score.columns)
        held = [inside[i] for i in tied.held] + [k for k in group.keys if k not in inside]
        ranked = RankedCandidate(
            variant,
            candidate_score.columns,
            candidate_score,
            bic(table, candidate_score),
            variant.searched,
            tuple(names),
            tuple(dict.fromkeys(held)),
            tied.whole,
        )
        ranks.setdefault(variant.original.label, []).append(ranked)
    best = [_best_variant(table, variants) for variants in ranks.values()]
    return Ranking(tuple(sorted(best, key=lambda r: r.rank)), table, block)


def score_groups(
    table: ScoreTable, groups: Sequence[CandidateColumns], parts: Parts | None = None
) -> Iterator[tuple[CandidateColumns, Score]]:
    """Each candidate's columns with their score, or each of its parts that the records show."""
    first = 0
    for group in groups:
        whole = tuple(range(len(group.sides)))
        seen = [tuple(i for i in some if table.norms[first + i] > 0)
                for some in parts(group)] if parts else [whole]  # fmt: skip
        for some in dict.fromkeys(seen):
            if some:
                at = tuple(first + i for i in some)
                yield group, score(table, at, tuple(group.sides[i] for i in some))
        first += len(whole)


def _column_owner(assembly: Assembly, index: int) -> str:
    """The effect that an active column belongs to; phase and its correction are the unbalance's."""
    keys = assembly.study.keys
    owner = column_owner(keys[index] if index < len(keys) else ORIGIN)
    known = {v.label: v.original.label for v in assembly.variants}
    return known.get(owner, owner)


def _best_variant(table: ScoreTable, variants: list[RankedCandidate]) -> RankedCandidate:
    """The best value of a candidate's shapes, and how many tests choosing it amounts to."""
    best = min(range(len(variants)), key=lambda i: variants[i].rank)
    groups = [r.columns for r in variants]
    tests = effective_tests(table, groups, best, np.random.default_rng(0))
    least = _NEAR * variants[best].score.gain
    near = [r for i, r in enumerate(variants) if i != best and r.score.gain > least]
    return replace(
        variants[best], tests=tests * variants[best].tests,
        others=tuple(sorted(near, key=lambda r: r.rank)),
    )  # fmt: skip


def active_labels(assembly: Assembly, fit_state: FitState) -> set[str]:
    """Real names of the candidates that are active."""
    return {v.original.label for v in assembly.variants if v.label in fit_state.labels}


def amplitude_keys(assembly: Assembly, variant: Variant) -> tuple[str, ...]:
    """Amplitudes of a variant, and of its companion."""
    owners = [variant.label] + ([variant.companion.label] if variant.companion else [])
    names = {p.name for p in variant.effect.amplitudes()}
    traced = assembly.study.compiled.traced
    return tuple(
        k
        for owner in owners
        for k, p in zip(traced.keys, traced.parameters, strict=True)
        if owner_of(k) == owner and p.name in names
    )


def bic(table: ScoreTable, scored: Score) -> float:
    """N log(1 - gain / rest) + q log N: minus twice the log-likelihood gain, plus the penalty."""
    left = max(1.0 - scored.gain / max(table.rest, 1e-300), 1e-12)
    return table.samples * float(np.log(left)) + scored.rank * float(np.log(table.samples))
