"""Sums over blocks of a regression's rows: by rows, by Gram matrices, and by projecting first."""

import numpy as np
import pytest

from spiral.engine.blocks import NO_BLOCKS, GramBlocks, RowBlocks
from spiral.engine.score import build_score_table
from spiral.engine.sensitivities import Reduction

ACTIVE, CANDIDATES, LENGTHS = 3, 6, (40, 17, 1, 92)


@pytest.fixture(name="rows")
def _rows():
    """Rows [active | candidates | r], one candidate nearly active, one active column scaled."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(sum(LENGTHS), ACTIVE + CANDIDATES + 1))
    rows[:, 1] *= 1e6
    rows[:, ACTIVE] += 5 * rows[:, 0]
    return rows


def _table(rows, blocks):
    triangle = np.linalg.qr(rows, mode="r")
    return build_score_table(Reduction(triangle, 1.0, len(rows), 0, (), blocks), ACTIVE)


def _pieces(rows):
    ends = np.cumsum(LENGTHS)
    return [rows[end - n : end] for n, end in zip(LENGTHS, ends, strict=True)]


def _row_blocks(rows):
    ends = np.cumsum(LENGTHS)
    return RowBlocks(np.ascontiguousarray(rows.T), ends - np.array(LENGTHS))


@pytest.mark.parametrize(("group", "chosen"), [([0], [0]), ([1, 4], [1, 4]), ([2], [5, 0])])
def test_scores_of_blocks_are_those_of_projected_rows(rows, group, chosen):
    """s_b = X_b^T (r_b - X_b d) with all active columns projected out of X and r beforehand."""
    step = np.linspace(0.3, -0.7, len(chosen))
    head = np.linalg.lstsq(rows[:, :ACTIVE], rows[:, ACTIVE:], rcond=None)[0]
    own = rows[:, ACTIVE:] - rows[:, :ACTIVE] @ head
    expected = [p[:, group].T @ (p[:, -1] - p[:, chosen] @ step) for p in _pieces(own)]
    grams = GramBlocks(np.array([p.T @ p for p in _pieces(rows)]))
    for blocks in (_row_blocks(rows), grams):
        table = _table(rows, blocks)
        assert len(table.blocks) == len(LENGTHS)
        np.testing.assert_allclose(
            table.block_scores(group, chosen, step), expected, rtol=1e-9, atol=1e-8
        )


def test_scores_of_all_blocks_together_vanish_after_the_least_squares_step(rows):
    table = _table(rows, _row_blocks(rows))
    step = np.linalg.lstsq(table.triangle[:, [1, 3]], table.target, rcond=None)[0]
    summed = table.block_scores([1, 3], [1, 3], step).sum(axis=0)
    np.testing.assert_allclose(summed, 0.0, atol=1e-9)


def test_without_blocks_there_are_no_scores(rows):
    table = _table(rows, NO_BLOCKS)
    assert len(table.blocks) == 0
