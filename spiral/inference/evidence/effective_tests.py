"""The largest statistic over a grid of shapes: how many tests it amounts to.

A gap, a width or a frequency exists only where its amplitude does, so a candidate with such a shape
is scored by the best of several values (Davies 1987), and the smallest of several p-values is no
p-value. Its null distribution is taken from a bootstrap: the blocks' scores of all values of the
grid, from one residual, get random signs together, so that their dependence is kept:

    W*_v = t_v' M_v^-1 t_v,    t_v = sum_b xi_b s_vb,    M_v = sum_b s_vb s_vb',    xi_b = +-1.

The smallest of the p-values follows 1 - (1 - p)^m with m between 1 (values that say the same) and
their number (Bonferroni); m is the maximum-likelihood estimate -n / sum log(1 - p*). It holds in
the far tail too, where no bootstrap can count. (Dudbridge and Koeleman 2004; wild bootstrap: Liu
1988.)
"""

from __future__ import annotations

import numpy as np
from scipy import special

from spiral.engine.score import MINIMUM_BLOCKS, ScoreTable, project_group
from spiral.types.record import Array

_DRAWS = 999


def effective_tests(
    table: ScoreTable, groups: list[tuple[int, ...]], best: int, rng: np.random.Generator
) -> float:
    """The number m of independent tests that the best of several groups of columns amounts to.

    Parameters
    ----------
    groups : the columns of each value of the grid; ``best`` the one with the largest statistic,
        after whose step the residual is taken.

    With too few blocks for a bootstrap it is the number of groups (Bonferroni).
    """
    if len(groups) == 1:
        return 1.0
    scores = _block_scores(table, groups, best)
    if len(table.blocks) < MINIMUM_BLOCKS // 2 or not scores:
        return float(len(groups))
    signs = rng.choice([-1.0, 1.0], size=(_DRAWS, len(table.blocks)))
    largest: dict[int, Array] = {}  # by rank: the largest statistic has the smallest p-value
    for score in scores:
        spread = np.linalg.pinv(score.T @ score)
        total = signs @ score
        wald = np.einsum("di,ij,dj->d", total, spread, total)
        rank = score.shape[1]
        largest[rank] = np.maximum(largest.get(rank, 0.0), wald)
    smallest = np.min([special.chdtrc(rank, wald) for rank, wald in largest.items()], axis=0)
    tests = -_DRAWS / float(np.sum(np.log1p(-np.minimum(smallest, 1 - 1e-12))))
    return float(np.clip(tests, 1.0, len(groups)))


def _block_scores(table: ScoreTable, groups: list[tuple[int, ...]], best: int) -> list[Array]:
    """(blocks, rank) of every group with a rank, from the residual after the best one's step.

    Those that are no numbers are left out: slopes of a motion that runs away.
    """
    if not len(table.blocks):
        return []
    chosen = list(groups[best])
    step = project_group(table, chosen).step
    scores = []
    for group in (list(g) for g in groups):
        part = project_group(table, group)
        if not part.rank:
            continue
        score = table.block_scores(group, chosen, step) @ part.basis
        if np.isfinite(score).all():
            scores.append(score)
    return scores
