"""Gates on t with standard errors that allow for coloured residuals (beside Gate 1)."""

from __future__ import annotations

import numpy as np

from spiral.engine.gate import Gate, Judgement, Trial
from spiral.engine.leastsquares import t_values
from spiral.inference.paper.robust import automatic_lags, bootstrap_errors, hac_errors


class HacT(Gate):
    """|t| with Newey-West errors, V = (X'X)^-1 [sum_l w_l (G_l + G_l')] (X'X)^-1; Bonferroni.

    G_l = sum_t u_t u_{t-l}', u_t = sum_c x_tc e_tc over the equations, w_l = 1 - l/(m + 1). The
    honest companion of a plain t: differentiation colours the noise, and OLS errors are then
    several times too small.

    Fields
    ------
    alpha : family-wise error. lags : m; 0 takes the residual's correlation time, at least
    4 (N/100)^(2/9).
    """

    alpha: float = 0.05
    lags: int = 0

    def judge(self, trial: Trial) -> Judgement:
        """The terms whose robust t passes."""
        lags = self.lags or automatic_lags(trial)
        fit = trial.fitted(trial.kept)
        t = t_values(fit.b, hac_errors(trial, trial.kept, fit, lags))[trial.active.shape[2] :]
        return _judge_robust_t(trial, t, self.alpha, {"lags": lags})


class BlockBootstrapT(Gate):
    """|t| with errors from a block bootstrap of the scores, Bonferroni over L.

    Blocks of consecutive samples are drawn with replacement; each draw gives
    b* = b + (X'X)^-1 sum_blocks u, and the spread of b* is the error.

    Fields
    ------
    alpha : family-wise error. block : samples; 0 takes four correlation times. draws : resamples.
    """

    alpha: float = 0.05
    block: int = 0
    draws: int = 400

    def judge(self, trial: Trial) -> Judgement:
        """The terms whose robust t passes."""
        block = self.block or 4 * automatic_lags(trial)
        fit = trial.fitted(trial.kept)
        errors = bootstrap_errors(trial, trial.kept, fit, block, self.draws)
        t = t_values(fit.b, errors)[trial.active.shape[2] :]
        return _judge_robust_t(trial, t, self.alpha, {"block": block, "draws": self.draws})


def _judge_robust_t(trial: Trial, t: np.ndarray, alpha: float, log: dict) -> Judgement:
    from scipy import stats

    critical = float(stats.norm.isf(alpha / (2 * len(trial.names))))
    pairs = list(zip(trial.kept, t, strict=True))
    kept = tuple(k for k, value in pairs if abs(value) > critical)
    log = {**log, "critical": critical, "t": {trial.names[k]: float(v) for k, v in pairs}}
    refused = {
        trial.names[k]: f"robust |t| = {abs(v):.3g}, {critical:.3g} needed"
        for k, v in pairs
        if k not in kept
    }
    return Judgement(kept, log, "" if kept else "no_robust_t", refused)
