"""Candidates that a linear step from zero amplitude cannot see, scored by their refit.

A rim over which a tank spills, or a limit at which a sensor stops, has no small version: far from
zero lies another basin. Where the model is far off such candidates are refitted from a tenth of
their bounds (``admission.admit_candidate``), and the fall of the cost that the refit reaches
replaces that of the linear step, where it is larger:

    F    = (fall / q) / (rest / dof),
    Wald = (g / se(g))^2 / q,

q counting amplitudes and shapes, d = a - b being the change of the residual, g = sum a d / sum d^2
its weight and se(g) from block sums, as in ``spiral.engine.statistics.paired_errors``. Every shape
started from counts as a test.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.engine.score import log_tail
from spiral.engine.sensitivities import residuals
from spiral.engine.statistics import paired_errors
from spiral.inference.evidence.admission import admit_candidate, far_start_variants
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.scoring import Evidence, RankedCandidate, bic
from spiral.types.record import Array


def rescore_from_far_starts(
    assembly: Assembly, fit_state: FitState, evidence: Evidence
) -> Evidence:
    """The evidence with refits in place of linear steps for candidates with a second basin."""
    stage = evidence.stage
    before = residuals(assembly.study, stage.layouts, stage.fitted.point)
    rescored = [
        _rescore_candidate(assembly, fit_state, evidence, r, before) for r in evidence.ranked
    ]
    return replace(evidence, ranked=tuple(sorted(rescored, key=lambda r: r.rank)))


def _rescore_candidate(
    assembly: Assembly,
    fit_state: FitState,
    evidence: Evidence,
    ranked: RankedCandidate,
    before: tuple[Array, ...],
) -> RankedCandidate:
    variants = far_start_variants(
        assembly, fit_state, evidence.stage, ranked.variant.original.label
    )
    if not variants:
        return ranked
    admitted = admit_candidate(assembly, fit_state, evidence.stage, ranked)
    gain = evidence.stage.fitted.cost - admitted.stage.fitted.cost
    if not gain > ranked.score.gain:
        return ranked
    table, shapes = evidence.table, len(admitted.variant.tuned)
    q = max(ranked.score.rank + shapes, 1)
    dof, rest = max(table.dof - q, 1), max(table.rest - gain, 1e-300)
    statistic = (gain / q) / (rest / dof)
    after = residuals(assembly.study, admitted.stage.layouts, admitted.stage.fitted.point)
    wald, wald_log_p = _refit_wald(before, after, evidence.block, q)
    score = replace(
        ranked.score,
        gain=gain,
        explains=gain / table.rest,
        statistic=statistic,
        log_p=log_tail(statistic, q, dof),
        wald=wald,
        wald_log_p=wald_log_p,
        effect_size=float(np.sqrt(gain / max(table.samples, 1))),
        rank=q,
    )
    tests = max(ranked.tests, float(len(variants) + 1))
    return replace(ranked, score=score, rank=bic(table, score), tests=tests)


def _refit_wald(
    before: tuple[Array, ...], after: tuple[Array, ...], block: int, q: int
) -> tuple[float, float]:
    """The robust statistic of a refit, and the logarithm of its p-value (blocks as cases)."""
    paired = paired_errors(before, after, block)
    count = sum(int(np.any(b != 0, axis=1).sum()) for b in before) // block
    if count <= q or paired.share <= 0 or not np.isfinite(paired.t) or not paired.t:
        return 0.0, 0.0
    spread = (paired.share - 0.5) / paired.t
    wald = (paired.share / spread) ** 2 / q
    return wald, log_tail(wald * (count - q) / (count - 1), q, count - q)
