"""A winner of the race on the blocks that did not select it.

There it must predict better than the model as it is, both with their values from the blocks that
select; and by Wilks' test, both refitted there, significantly so, for as many tests as values of
its shapes were tried.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from scipy import special

from spiral.engine.likelihood.fit import Maximum, maximise
from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.candidates import Rival
from spiral.inference.likelihood.fitting import LikelihoodFit, bounds_of

_STEPS = 12  # scoring steps, at most


@dataclass(frozen=True)
class Judged:
    """The winner on the blocks that did not select, in log-likelihood.

    ``predicted`` its gain where both models have their values from the blocks that did, the noise
    of each as these blocks have it; ``refitted`` where both have their most likely values;
    ``terms`` the parameters that it has beyond
    the model as it is; ``searched`` among how many values its shapes were looked for.
    """

    predicted: float
    refitted: float
    terms: int
    searched: int

    def passes(self, level: float) -> bool:
        """Whether it holds there, at a level of error."""
        return self.predicted > 0 and self.p_value < level

    @property
    def p_value(self) -> float:
        """Of Wilks' test, for as many tests as shapes were searched among."""
        single = float(special.chdtrc(self.terms, 2 * max(self.refitted, 0.0)))
        return min(self.searched * single, 1.0)


@dataclass(frozen=True)
class Unselected:
    """A model on the blocks that did not select: with its values from the others, and with its own.

    The noise is as these blocks have it.
    """

    carried: Maximum
    refitted: Maximum


def unselected(fit: LikelihoodFit, assembly: Assembly, masks: Masks) -> Unselected:
    """A fit on other blocks than its own; ``assembly`` is the study in whose terms it is."""
    carried = most_likely(fit.estimate, masks, {})
    bounds = bounds_of(assembly, fit.estimate.keys, fit.state.substeps)
    return Unselected(carried, most_likely(carried, masks, bounds))


def judged(base: LikelihoodFit, ours: Unselected, rival: Rival, masks: Masks) -> Judged:
    """A winner against the model as it is on other blocks than those that chose it.

    Parameters
    ----------
    base : the model as it is; ours : the same on the blocks that did not select. masks : these.
    """
    theirs = unselected(rival.fit, rival.assembly, masks)
    freed = set(rival.fit.state.freed) - set(base.state.freed)
    terms = len(rival.ranked.columns) + len(freed)
    searched = rival.ranked.variant.searched if freed else 1
    predicted, refitted_ = (
        b.log_likelihood - a.log_likelihood
        for a, b in ((ours.carried, theirs.carried), (ours.refitted, theirs.refitted))
    )
    return Judged(predicted, refitted_, terms, searched)


def most_likely(at: Maximum, masks: Masks, bounds: Mapping[str, tuple[float, float]]) -> Maximum:
    """A model at its most likely on some blocks, by its noise and what has bounds, from here on."""
    return maximise(at.prepared, tuple(bounds), at.noise, bounds, masks, _STEPS, kept=at.kept)
