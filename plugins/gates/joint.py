"""Gate 2: whether the batch explains more, and predicts better."""

from __future__ import annotations

import numpy as np

from spiral.engine.gate import Gate, Judgement, Trial
from spiral.engine.leastsquares import Fit, partial_f, solve_triangle, triangle
from spiral.types.record import Array

_BLOCK = 64  # samples that go into one fold together


class PartialF(Gate):
    """F = [(RSS_0 - RSS_1)/q] / [RSS_1/(N - p)] > F_{1-alpha, q, N-p} for the whole batch.

    Both models fitted to the training samples (paper, eq. Ftest).

    Fields
    ------
    alpha : level of the test.
    """

    alpha: float = 0.05

    def judge(self, trial: Trial) -> Judgement:
        """The whole batch or nothing."""
        from scipy import stats

        after = trial.fitted(trial.kept)
        value, p = partial_f(trial.before, after)
        q = max(after.parameters - trial.before.parameters, 1)
        critical = float(stats.f.isf(self.alpha, q, after.dof))
        log = {"statistic": value, "critical": critical, "p_value": p, "terms": q}
        if value > critical:
            return Judgement(trial.kept, log)
        text = f"Gate 2: F = {value:.3g}, {critical:.3g} needed"
        refused = {trial.names[k]: text for k in trial.kept}
        return Judgement((), log, "gate_2_f_not_significant", refused)


class ValidationRollback(Gate):
    """The batch is discarded where RMSE = sqrt(mean (z - X b)^2) rises on the validation samples.

    Both models are fitted to the training samples.
    """

    def judge(self, trial: Trial) -> Judgement:
        """The whole batch or nothing."""
        held = ~trial.train
        before = trial.rmse(trial.before, (), held)
        after = trial.rmse(trial.fitted(trial.kept), trial.kept, held)
        log = {"rmse_before": before, "rmse_after": after, "rolled_back": not after <= before}
        if after <= before:
            return Judgement(trial.kept, log)
        text = f"rolled back: validation error {before:.4g} -> {after:.4g}"
        return Judgement((), log, "rolled_back", {trial.names[k]: text for k in trial.kept})


class KfoldMajority(Gate):
    """Refinement 2: K = 7 folds; a term passes where partial F and RMSE agree in most of them.

    In each fold the batch is fitted to the other folds' training samples, with and without the
    term: its partial F must be significant there and the RMSE on the fold must not rise. Folds
    hold blocks of 64 samples, dealt out by amplitude, so that each fold sees every amplitude and
    neighbouring samples are not spread over fit and fold.

    Fields
    ------
    folds : K. alpha : level of F.
    """

    folds: int = 7
    alpha: float = 0.05

    def judge(self, trial: Trial) -> Judgement:
        """The terms with a majority."""
        x, y = trial.rows(trial.kept, trial.train)
        rows = np.column_stack([x, y])
        fold = np.repeat(self._deal_folds(trial), trial.target.shape[1])
        parts = [triangle([rows[fold == f]]) for f in range(self.folds)]
        width = trial.active.shape[2]
        votes = np.zeros(len(trial.kept), dtype=int)
        for held in range(self.folds):
            others = [p for i, p in enumerate(parts) if i != held]
            upper, _ = triangle([r for r, _ in others])
            votes += self._fold_votes(upper, sum(n for _, n in others), parts[held][0], width)
        needed = self.folds // 2 + 1
        pairs = list(zip(trial.kept, votes, strict=True))
        kept = tuple(k for k, v in pairs if v >= needed)
        log = {
            "folds": self.folds,
            "needed": needed,
            "votes": {trial.names[k]: int(v) for k, v in pairs},
        }
        refused = {
            trial.names[k]: f"passes in {v} of {self.folds} folds, {needed} needed"
            for k, v in pairs
            if v < needed
        }
        return Judgement(kept, log, "" if kept else "no_term_passes_a_refinement", refused)

    def _deal_folds(self, trial: Trial) -> Array:
        """(training samples,) number of the fold of each."""
        amplitude = trial.amplitude[trial.train]
        block = np.arange(len(amplitude)) // _BLOCK
        sizes = np.bincount(block, amplitude**2) / np.bincount(block)
        order = np.argsort(sizes, kind="stable")
        fold = np.empty(len(sizes), dtype=int)
        fold[order] = np.arange(len(sizes)) % self.folds
        return fold[block]

    def _fold_votes(self, upper: Array, rows: int, held: Array, width: int) -> Array:
        """Whether each term passes in one fold."""
        from scipy import stats

        count = upper.shape[1] - 1
        every = tuple(range(count))
        whole = solve_triangle(upper, rows, every)
        error = _squared_error(held, whole, every)
        votes = np.zeros(count - width, dtype=int)
        for i in range(width, count):
            others = tuple(j for j in every if j != i)
            without = solve_triangle(upper, rows, others)
            value, _ = partial_f(without, whole)
            significant = value > stats.f.isf(self.alpha, 1, whole.dof)
            votes[i - width] = significant and error <= _squared_error(held, without, others)
        return votes


def _squared_error(held: Array, fit: Fit, columns: tuple[int, ...]) -> float:
    """Sum of squares on held rows, from their triangle."""
    return float(np.sum((held[:, -1] - held[:, list(columns)] @ fit.b) ** 2))
