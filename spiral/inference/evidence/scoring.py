"""Scores of every candidate that is not active, in one pass over a stage's windows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.growth import Stage
from spiral.engine.score import (
    Score,
    ScoreTable,
    block_samples,
    correlation_samples,
    score,
    tabulate,
)
from spiral.engine.sensitivities import reduce, residuals
from spiral.inference.evidence.assembly import (
    ORIGIN,
    Assembly,
    Variant,
    columns,
)
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.gridnull import effective_tests
from spiral.inference.evidence.inseparable import inseparable


@dataclass(frozen=True)
class Ranked:
    """A candidate's best variant with its evidence; the smallest ``rank`` (BIC) is best.

    ``tests`` is the number of independent tests that its shapes amount to (``gridnull``);
    ``tied`` are effects of the model that can take over part of it, all of it where ``whole``;
    ``held`` are amplitudes that then stay at zero.
    """

    variant: Variant
    columns: tuple[int, ...]
    score: Score
    rank: float
    tests: float = 1.0
    tied: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    whole: bool = False

    @property
    def log_p(self) -> tuple[float, float]:
        """Classical and robust p-value (logarithms), corrected for the values tried."""
        more = float(np.log(self.tests))
        return min(self.score.log_p + more, 0.0), min(self.score.wald_log_p + more, 0.0)


@dataclass(frozen=True)
class Evidence:
    """Candidates at one window length, best first, with the pass they were scored in."""

    stage: Stage
    ranked: tuple[Ranked, ...]
    table: ScoreTable
    block: int


def score_stage(assembly: Assembly, standing: FitState, stage: Stage) -> Evidence:
    """Score all candidates that are not active, in one pass."""
    keys = standing.keys(assembly)
    present = _labels(assembly, standing)
    absent = [v for v in assembly.variants if v.original.label not in present]
    groups = [(v, tested_keys(assembly, v)) for v in absent]
    candidate_keys = tuple(k for _, g in groups for k in g)
    residual = residuals(assembly.study, stage.layouts, stage.fitted.point)
    counted = sum(int(np.any(r != 0, axis=1).sum()) for r in residual)
    block = block_samples(correlation_samples(residual), counted)
    moving, _ = columns(assembly, (*keys, *candidate_keys))
    active, _ = columns(assembly, keys)
    reduction = reduce(assembly.study, stage.layouts, stage.fitted.point, moving, block)
    table = tabulate(reduction, active.count)
    ranks: dict[str, list[Ranked]] = {}
    for variant, owners, found in scored(assembly, table, groups):
        tied = inseparable(reduction.triangle, active.count, found.columns)
        names = [_owner(assembly, int(moving.index[i])) for i in tied.with_]
        ranked = Ranked(
            variant, found.columns, found, bic(table, found), variant.searched,
            tuple(dict.fromkeys(names)), tuple(owners[i] for i in tied.held), tied.whole,
        )  # fmt: skip
        ranks.setdefault(variant.original.label, []).append(ranked)
    best = [_best(table, variants) for variants in ranks.values()]
    return Evidence(stage, tuple(sorted(best, key=lambda r: r.rank)), table, block)


def scored(
    assembly: Assembly, table: ScoreTable, groups: list[tuple[Variant, tuple[str, ...]]]
) -> Iterator[tuple[Variant, tuple[str, ...], Score]]:
    """Each variant with the keys of its columns (one for each record) and their score."""
    parameters, first = assembly.study.compiled.traced.parameters, 0
    for variant, group in groups:
        index = columns(assembly, group)[0].index
        sides = tuple(parameters[i].lower == 0.0 and variant.companion is None for i in index)
        found = score(table, tuple(range(first, first + len(sides))), sides)
        first += len(sides)
        yield variant, tuple(assembly.study.keys[i] for i in index), found


def _owner(assembly: Assembly, index: int) -> str:
    """The effect that an active column belongs to; phase and its correction are the unbalance's."""
    keys = assembly.study.keys
    owner = keys[index].rsplit(".", 1)[0] if index < len(keys) else "system"
    if owner == "system":
        return "unbalance" if index >= len(keys) or keys[index] == ORIGIN else "system"
    known = {v.label: v.original.label for v in assembly.variants}
    return known.get(owner, owner)


def _best(table: ScoreTable, variants: list[Ranked]) -> Ranked:
    """The best value of a candidate's shapes, and how many tests choosing it amounts to."""
    best = min(range(len(variants)), key=lambda i: variants[i].rank)
    groups = [r.columns for r in variants]
    tests = effective_tests(table, groups, best, np.random.default_rng(0))
    return replace(variants[best], tests=tests * variants[best].tests)


def _labels(assembly: Assembly, standing: FitState) -> set[str]:
    """Real names of the candidates that are active."""
    return {v.original.label for v in assembly.variants if v.label in standing.labels}


def tested_keys(assembly: Assembly, variant: Variant) -> tuple[str, ...]:
    """Amplitudes of a variant, and of its companion."""
    owners = [variant.label] + ([variant.companion.label] if variant.companion else [])
    names = {p.name for p in variant.effect.amplitudes()}
    traced = assembly.study.compiled.traced
    return tuple(
        k
        for owner in owners
        for k, p in zip(traced.keys, traced.parameters, strict=True)
        if k.rsplit(".", 1)[0] == owner and p.name in names
    )


def bic(table: ScoreTable, scored: Score) -> float:
    """N log(1 - gain / rest) + q log N: twice the negative log-likelihood gain, plus its price."""
    left = max(1.0 - scored.gain / max(table.rest, 1e-300), 1e-12)
    return table.samples * float(np.log(left)) + scored.rank * float(np.log(table.samples))
