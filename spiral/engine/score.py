"""Scores of candidates: what each would explain beyond active parameters and nuisances.

With R the triangle of one pass over [active | candidates | r], a candidate g has

    gain  = |Q_g^T z|^2                                the fall of the sum of squares,
    F     = (gain / q) / (rest / dof)                  classical partial F,
    Wald  = d^T V^-1 d / q                             robust,

d being one Gauss-Newton step and V = H^-1 M H^-1 its covariance from the residual *after* that
step, M = sum over blocks s_b s_b^T with s_b = J_b^T e_b. Blocks are at least as long as the
residual's correlation time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from spiral.engine.blocks import Blocks
from spiral.engine.sensitivities import Reduction
from spiral.engine.statistics import autocorrelation
from spiral.types.record import Array

MINIMUM_BLOCKS = 40
MOST_BLOCKS = 512  # keeps memory bounded whatever the record's length
_RANK = 1e-7
_NOTHING = 1e-30  # share of a group's largest column: less than units can account for


@dataclass(frozen=True)
class Score:
    """Evidence for one group of columns.

    ``step`` the Gauss-Newton step; ``gain`` in sigma^2; ``explains`` the share of the residual
    energy; ``log_p`` natural logarithms of the p-values; ``alias`` the largest
    cosine between the group's signatures and the active ones; ``rank`` its independent directions.
    """

    columns: tuple[int, ...]
    step: Array
    gain: float
    explains: float
    statistic: float
    log_p: float
    wald: float
    wald_log_p: float
    effect_size: float
    alias: float
    rank: int = 1


@dataclass(frozen=True)
class ScoreTable:
    """A pass prepared for scoring: candidates' triangle with the active columns projected out.

    ``taken`` (active, candidates + 1) is what of each active column is in every other one and in r;
    ``blocks`` are rows of [active | candidates | r] as they are.
    """

    triangle: Array
    target: Array
    norms: Array
    rest: float
    samples: int
    dof: int
    blocks: Blocks
    taken: Array

    def block_scores(self, group: Sequence[int], chosen: Sequence[int], step: Array) -> Array:
        """(blocks, group): J_b^T e_b, e the residual after a ``step`` of the ``chosen`` columns."""
        active = len(self.taken)
        others = [*range(active), *(active + c for c in chosen), -1]
        head = self.taken[:, chosen] @ step - self.taken[:, -1]
        weights = np.concatenate([head, -step, np.ones(1)])
        own = [*range(active), *(active + c for c in group)]
        products = self.blocks.products(own, others, weights)
        return products[:, active:] - products[:, :active] @ self.taken[:, group]


def build_score_table(reduction: Reduction, active: int) -> ScoreTable:
    """Project the first ``active`` columns out of all others."""
    triangle = reduction.triangle
    norms = np.linalg.norm(triangle[:, :-1], axis=0)
    inner = triangle[active:, active:]
    rest = float(inner[:, -1] @ inner[:, -1])
    dof = reduction.samples - reduction.nuisances - active
    return ScoreTable(
        inner[:, :-1], inner[:, -1], norms[active:], rest, reduction.samples, dof,
        reduction.blocks, _taken_by_active(triangle[:active], active),
    )  # fmt: skip


def _taken_by_active(triangle: Array, active: int) -> Array:
    """(active, others) least-squares weights of the active columns in each of the others."""
    if active == 0:
        return np.zeros((0, triangle.shape[1]))
    scale = np.linalg.norm(triangle[:, :active], axis=0)
    scale[scale == 0] = 1.0
    head, *_ = np.linalg.lstsq(triangle[:, :active] / scale, triangle[:, active:], rcond=1e-12)
    return head / scale[:, None]


def score(table: ScoreTable, columns: tuple[int, ...], one_sided: tuple[bool, ...]) -> Score:
    """Evidence for the candidates' columns (indices among the candidates).

    One-sided columns that step out of their side are dropped from the group; the p-value of a
    group with a single one-sided column is halved.
    """
    kept = list(columns)
    while True:
        group = project_group(table, kept)
        wrong = [
            c
            for c, d in zip(kept, group.step, strict=True)
            if one_sided[columns.index(c)] and d < 0
        ]
        if not wrong:
            break
        kept = [c for c in kept if c not in wrong]
    full = np.zeros(len(columns))
    for c, d in zip(kept, group.step, strict=True):
        full[columns.index(c)] = d
    halved = np.log(0.5) if len(columns) == 1 and one_sided[0] and kept else 0.0
    q, dof = max(group.rank, 1), max(table.dof - group.rank, 1)
    rest = max(table.rest - group.gain, 1e-300)
    statistic = (group.gain / q) / (rest / dof)
    log_p = log_tail(statistic, q, dof)
    wald, wald_log_p = _wald_statistic(table, kept, group)
    if 0 < len(table.blocks) < MINIMUM_BLOCKS // 2:
        wald, wald_log_p = statistic, log_p  # too short for a robust test; the gates remain
    return Score(
        columns, full, group.gain, group.gain / max(table.rest, 1e-300), statistic,
        log_p + halved, wald, wald_log_p + halved,
        float(np.sqrt(group.gain / max(table.samples, 1))), group.alias, group.rank,
    )  # fmt: skip


def log_tail(statistic: float, q: int, dof: int) -> float:
    """Logarithm of the F distribution's upper tail (``scipy.stats.f.logsf``, unchecked)."""
    with np.errstate(divide="ignore"):
        return float(np.log(special.fdtrc(q, dof, max(statistic, 0.0))))


@dataclass(frozen=True)
class ProjectedGroup:
    """A group of columns after the active ones are projected out.

    ``step`` the least-squares step; ``gain`` its fall of the sum of squares; ``alias`` the cosine
    to what is active; ``rank`` the independent directions that are left, spanned by ``basis``
    (columns, rank) in the parameters.
    """

    step: Array
    gain: float
    alias: float
    rank: int
    basis: Array


def project_group(table: ScoreTable, kept: list[int]) -> ProjectedGroup:
    """Step, gain and independent directions of some columns; rank 0 where nothing is left."""
    none = ProjectedGroup(np.zeros(len(kept)), 0.0, 1.0, 0, np.zeros((len(kept), 0)))
    if not kept:
        return none
    group = table.triangle[:, kept]
    before = np.where(table.norms[kept] == 0, 1.0, table.norms[kept])
    after = np.linalg.norm(group, axis=0)
    alias = float(np.sqrt(max(0.0, 1.0 - float(np.min(after / before)) ** 2)))
    own = after / before >= _RANK  # what is left of the others is rounding
    own &= before >= _NOTHING * np.max(before)  # and so are columns that no motion reaches
    if not own.any():
        return none
    scale = np.where(own, after, np.inf)
    left, sizes, right = np.linalg.svd(group / scale, full_matrices=False)
    large = sizes > _RANK * sizes[0]
    along = left[:, large].T @ table.target
    basis = right[large].T / scale[:, None] / sizes[large]
    return ProjectedGroup(basis @ along, float(along @ along), alias, int(large.sum()), basis)


def _wald_statistic(
    table: ScoreTable, kept: list[int], group: ProjectedGroup
) -> tuple[float, float]:
    """Robust Wald statistic over q, and the log of its p-value (Hotelling, blocks as cases)."""
    count, q = len(table.blocks), group.rank
    if not q or count < MINIMUM_BLOCKS // 2 or not np.any(group.step):
        return 0.0, 0.0
    scores = table.block_scores(kept, kept, group.step) @ group.basis
    meat = scores.T @ scores * count / (count - 1)
    inner = table.triangle[:, kept]
    bread = (inner @ group.basis).T @ (inner @ group.step)
    try:
        wald = float(bread @ np.linalg.solve(meat, bread)) / q
    except np.linalg.LinAlgError:
        return 0.0, 0.0
    ratio = wald * (count - q) / (count - 1)
    return wald, log_tail(ratio, q, count - q)


def cosine(table: ScoreTable, first: tuple[int, ...], second: tuple[int, ...]) -> float:
    """Cosine of the smallest principal angle between two groups of signatures."""
    from scipy.linalg import subspace_angles

    groups = [table.triangle[:, list(g)] for g in (first, second)]
    if any(np.linalg.norm(g) == 0 for g in groups):
        return 1.0
    scaled = [g / np.maximum(np.linalg.norm(g, axis=0), 1e-300) for g in groups]
    return float(np.cos(np.min(subspace_angles(*scaled))))


def correlation_samples(residuals: tuple[Array, ...]) -> int:
    """Lag after which the residuals' autocorrelation stays below 0.1, largest over channels."""
    longest = 1
    for values in residuals:
        for channel in values.T:
            energy = float(channel @ channel)
            if energy == 0 or not np.isfinite(energy):
                continue
            rho = autocorrelation(channel, len(channel) // 4 - 1)
            counted = np.count_nonzero(channel)
            above = np.flatnonzero(np.abs(rho) > max(0.1, 3.0 / np.sqrt(counted)))
            longest = max(longest, int(above[-1]) + 1 if len(above) else 1)
    return longest


def block_samples(correlation: int, counted: int) -> int:
    """Samples in a block: a power of two above the correlation time, 40 to 512 blocks."""
    most = max(counted // MINIMUM_BLOCKS, 4)
    wanted = 2 ** int(np.ceil(np.log2(max(32, 2 * correlation, counted / MOST_BLOCKS))))
    return int(min(wanted, 2 ** int(np.log2(most))))


def residual_block_samples(residual: tuple[Array, ...]) -> int:
    """Samples in a block over which these residuals are no longer alike."""
    counted = sum(int(np.any(r != 0, axis=1).sum()) for r in residual)
    return block_samples(correlation_samples(residual), counted)
