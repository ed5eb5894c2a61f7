"""Tests the winner of the race on the blocks that took no part in its selection.

It must predict these blocks better than the model as it is, both with their values from the
selecting blocks; and, both refitted there, be significantly likelier by Wilks' test, corrected for
the number of values of its shapes that were tried.

Where what the model as it is leaves is not white, no noise model having made it so, the likelihood
counts one surprise many times, and anything that bends with it seems to help. Both then follow
their own past besides (``engine.likelihood.autoregression``), and the smaller gain counts: an
effect must explain more than the record's own past does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from scipy import special

from spiral.engine.likelihood.autoregression import autoregressive_order, coloured_log_likelihood
from spiral.engine.likelihood.fit import MaximumLikelihood, maximise_likelihood
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.likelihood.fitting import LikelihoodFit, parameter_bounds

_STEPS = 12  # scoring steps, at most


@dataclass(frozen=True)
class JudgedWinner:
    """The winner on the blocks that did not select, against the model as it is.

    Fields
    ------
    predicted : gain in log-likelihood, both with the values that the selecting blocks gave them and
        the noise as these blocks have it.
    refitted : gain in log-likelihood, both with their most likely values on these blocks.
    terms : parameters that it has beyond the model as it is.
    searched : among how many values its shapes were looked for.
    """

    predicted: float
    refitted: float
    terms: int
    searched: int

    def passes(self, level: float) -> bool:
        """Whether it predicts better and is significant at ``level``."""
        return self.predicted > 0 and self.p_value < level

    @property
    def p_value(self) -> float:
        """Of Wilks' test, for as many tests as shapes were searched among."""
        single = float(special.chdtrc(self.terms, 2 * max(self.refitted, 0.0)))
        return min(self.searched * single, 1.0)


@dataclass(frozen=True)
class JudgingFits:
    """A model on the judging blocks: with values from the selecting ones, and refitted.

    The noise is as these blocks have it.
    """

    carried: MaximumLikelihood
    refitted: MaximumLikelihood

    def order(self, masks: Masks) -> int:
        """How many samples of its own past what the model leaves follows; 0 where it is white."""
        if not self.refitted.finite:
            return 0
        return autoregressive_order(self.refitted.predictions, masks)


def fit_on_judging_blocks(fit: LikelihoodFit, assembly: Assembly, masks: Masks) -> JudgingFits:
    """A fit evaluated and refitted on other blocks; ``assembly`` is its own study."""
    carried = maximise_on_blocks(fit.estimate, masks, {})
    bounds = parameter_bounds(assembly, fit.estimate.keys, fit.state.substeps)
    return JudgingFits(carried, maximise_on_blocks(carried, masks, bounds))


def judge_winner(
    base: LikelihoodFit, ours: JudgingFits, rival: Rival, masks: Masks
) -> JudgedWinner:
    """The winner compared with the model as it is on the blocks that did not select it.

    Parameters
    ----------
    base : the model as it is; ours : the same on the blocks that did not select. masks : these.
    """
    theirs = fit_on_judging_blocks(rival.fit, rival.assembly, masks)
    freed = set(rival.fit.state.freed) - set(base.state.freed)
    terms = len(rival.ranked.columns) + len(freed)
    searched = rival.ranked.variant.searched if freed else 1
    order = ours.order(masks)
    predicted, refitted_ = (
        _least_gain(a, b, order, masks)
        for a, b in ((ours.carried, theirs.carried), (ours.refitted, theirs.refitted))
    )
    return JudgedWinner(predicted, refitted_, terms, searched)


def _least_gain(
    ours: MaximumLikelihood, theirs: MaximumLikelihood, order: int, masks: Masks
) -> float:
    """Gain in log-likelihood, the lesser of those beside white and beside coloured innovations."""
    gain = theirs.log_likelihood - ours.log_likelihood
    if order == 0 or not (ours.finite and theirs.finite):
        return gain
    coloured = [coloured_log_likelihood(at, order, masks) for at in (ours, theirs)]
    return min(gain, coloured[1] - coloured[0])


def maximise_on_blocks(
    at: MaximumLikelihood, masks: Masks, bounds: Mapping[str, tuple[float, float]]
) -> MaximumLikelihood:
    """The maximum on some blocks, from ``at`` on, over noise and the parameters in ``bounds``."""
    return maximise_likelihood(
        at.prepared, tuple(bounds), at.noise, bounds, masks, _STEPS, kept=at.kept
    )
