"""The likelihood of a filter's innovations as a gate."""

from __future__ import annotations

import numpy as np

from spiral.engine.gate import Gate, Judgement, Trial
from spiral.inference.problem import DECISIVE_ODDS
from spiral.types.errors import ConfigError


class Innovation(Gate):
    """G = 2 [log L_1 - log L_0] > chi^2_{1-alpha/L, q}, L the likelihood of a filter's innovations.

    The effect may act on hidden states: the filter carries it to the channels. Candidates are first
    ranked by the score test (the fall of |e|^2 for one step, e the whitened innovations); the best
    and its rivals are then refitted, each with its own process noise, and the one that makes the
    record most likely (less q log N) is let through, alone. The paper's loop through its EKF.

    Fields
    ------
    alpha : family-wise error over the L candidates of one round. rivals : refitted beside the
        first. share : least share of the first one's score to be a rival. odds : ratio of
        likelihoods under which two of them are not told apart.
    """

    likelihood = True
    alpha: float = 0.01
    rivals: int = 4
    share: float = 0.3
    odds: float = DECISIVE_ODDS

    def judge(self, trial: Trial) -> Judgement:
        """The candidate with the highest likelihood, or none.

        Raises
        ------
        ConfigError : evidence without a likelihood (derivatives).
        """
        if trial.gain is None:
            raise ConfigError(
                "gate=innovation on differentiated data", "evidence with a likelihood",
                "strategy=innovation",
            )  # fmt: skip
        groups = trial.groups or tuple((k,) for k in trial.kept)
        asked = [g for g in groups if set(g) <= set(trial.kept)]
        scores = trial.falls(asked)
        level = self.alpha / max(trial.tests, len(groups))
        promising = [g for g in asked if _p_value(scores[g], len(g)) < level]
        promising.sort(key=lambda g: scores[g], reverse=True)
        close = [g for g in promising if scores[g] >= self.share * scores[promising[0]]]
        gains = {g: trial.gain(g) for g in close[: self.rivals + 1]}
        return self._choose_most_likely(trial, asked, scores, gains, level)

    def _choose_most_likely(
        self,
        trial: Trial,
        asked: list[tuple[int, ...]],
        scores: dict[tuple[int, ...], float],
        gains: dict[tuple[int, ...], float],
        level: float,
    ) -> Judgement:
        price = np.log(trial.target.size)
        worth = {g: v - len(g) * price for g, v in gains.items() if _p_value(v, len(g)) < level}
        best = max(worth, key=lambda g: worth[g], default=())
        near = 2 * np.log(self.odds)
        alike = [g for g in worth if g != best and worth[best] - worth[g] < near]
        names = {g: ", ".join(trial.names[k] for k in g) for g in asked}
        log = {
            "score": {names[g]: float(v) for g, v in scores.items()},
            "gain": {names[g]: float(v) for g, v in gains.items()},
            "level": level,
            "alike": [trial.names[g[0]] for g in alike],
        }
        refused = {
            names[g]: f"2 log L rises by {gains[g]:.4g}"
            + (f", that of {names[best]} by {gains[best]:.4g}" if best else ": not significant")
            for g in gains
            if g != best
        }
        reason = "" if best else "likelihood_not_higher"
        return Judgement(tuple(sorted(best)), log, reason, refused)


def _p_value(gain: float, terms: int) -> float:
    from scipy import stats

    return float(stats.chi2.sf(gain, terms))
