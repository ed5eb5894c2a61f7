"""The gate that ends the loop: whether the residual is white (Ljung-Box)."""

from __future__ import annotations

import numpy as np

from spiral.engine.gate import Gate, Judgement, Trial


class LjungBox(Gate):
    """Q = N (N + 2) sum_k rho_k^2 / (N - k) against chi^2_{1-alpha}(m) (paper, eq. ljungbox).

    The residual is white, and the loop ends, where Q stays below the quantile in every equation;
    Q is taken of all samples in order of time. The paper calls it a test of the validation
    residual in its introduction and of r^(n) in its algorithm; samples of an interleaved split are
    no time series, so it is r^(n) here. Differentiation colours white noise, so this test cannot
    pass on estimated accelerations; Q/N says how much is left whatever N.

    Fields
    ------
    lags : m. alpha : level of the test.
    """

    guard = True
    lags: int = 40
    alpha: float = 0.05

    def judge(self, trial: Trial) -> Judgement:
        """All candidates where structure is left; none where every equation's residual is white."""
        from scipy import stats
        from statsmodels.stats.diagnostic import acorr_ljungbox

        critical = float(stats.chi2.ppf(1 - self.alpha, self.lags))
        statistics = []
        for number in np.unique(trial.record):
            part = trial.residual[trial.record == number]
            for series in part.T:
                table = acorr_ljungbox(series, lags=[self.lags])
                statistics.append((float(table["lb_stat"].iloc[0]), len(series)))
        white = all(q < critical for q, _ in statistics)
        log = {
            "statistic": max(q for q, _ in statistics),
            "critical": critical,
            "lags": self.lags,
            "effect_size": max(q / n for q, n in statistics),
            "white": white,
        }
        if white:
            return Judgement((), log, "white")
        return Judgement(trial.kept, log)
