"""What known values would explain if they were a little off.

A mass that was weighed, a catalog's capacitance are right within something, and in a good record
half a percent shows: as a small store or a little more damping, whatever moves alike. With a normal
prior of ``TOLERANCE`` on the relative error d_i of each known value, A the slopes of the whitened
misses e by d,

    log-likelihood = max_d  -1/2 |e - A d|^2 - 1/2 |d|^2 / TOLERANCE^2  + 1/2 |e|^2.

What an effect explains beyond that is no known value's doing. Where it counts the model is fitted
with these values as well: sizes of noise that made up for them shrink.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.likelihood.predict import Masks
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.scoring import RankedCandidate, Ranking
from spiral.inference.likelihood.fitting import WARM, LikelihoodFit, fit_by_likelihood
from spiral.inference.problem import DECISIVE_ODDS
from spiral.types.effect import is_other_value
from spiral.types.formatting import percent
from spiral.types.port import varied_key

TOLERANCE = 0.005  # standard deviation of a known value, as a share of it


@dataclass(frozen=True)
class Tolerances:
    """What known values explain within their tolerance.

    ``log_likelihood`` : its gain. ``errors`` : the relative error of each that gains it, by name.
    """

    log_likelihood: float = 0.0
    errors: tuple[tuple[str, float], ...] = ()

    def refuses(self, worth: float) -> str:
        """Why an effect that is worth so much is none; empty where it is likelier by the odds.

        Nothing is refused where the known values are most likely as they were given.
        """
        odds = float(np.log(DECISIVE_ODDS))
        if self.log_likelihood <= odds or worth > self.log_likelihood + odds:
            return ""
        largest = sorted(self.errors, key=lambda e: -abs(e[1]))[:3]
        words = ", ".join(f"{name} by {percent(abs(error))}" for name, error in largest)
        return f"it explains no more than known values that are a little off ({words})"


def tolerances_of(ranking: Ranking) -> Tolerances:
    """What the known parameters among the candidates (``other_value``) explain, off a little."""
    known = list(_known_values(ranking))
    if not known:
        return Tolerances()
    table = ranking.table
    a = table.triangle[:, [c for _, one in known for c in one.columns]]
    stiff = a.T @ a + np.eye(a.shape[1]) / TOLERANCE**2
    errors = np.linalg.solve(stiff, a.T @ table.target)
    gain = 0.5 * float(table.target @ (a @ errors))
    return Tolerances(gain, tuple(zip((n for n, _ in known), errors.tolist(), strict=True)))


def _known_values(ranking: Ranking) -> Iterator[tuple[str, RankedCandidate]]:
    """The known parameters among the candidates, by the name of their place."""
    for ranked in ranking.ranked:
        effect = ranked.variant.original
        if is_other_value(effect):
            yield effect.port or effect.label, ranked


def refitted_tolerances(
    assembly: Assembly, base: LikelihoodFit, ranking: Ranking, masks: Masks
) -> Tolerances:
    """The same, by a fit with the known values that explain most, where these count.

    ``base`` is the model as it is, fitted to ``masks``; what the fit gains is less the prior's
    1/2 |d|^2 / TOLERANCE^2.
    """
    told = tolerances_of(ranking)
    if told.log_likelihood <= float(np.log(DECISIVE_ODDS)):
        return told
    system, values = assembly.problem.model.system, base.state.values.copy()
    errors = dict(told.errors)
    for name, ranked in _known_values(ranking):
        key = varied_key(system.place(ranked.variant.original))
        values[:, assembly.study.index(key)] *= 1 + errors[name]
    state = replace(base.state, values=values)
    fit = fit_by_likelihood(assembly, state, masks=masks, steps=WARM, rough=True)
    prior = 0.5 * sum((error / TOLERANCE) ** 2 for error in errors.values())
    gain = fit.log_likelihood - base.log_likelihood - prior
    return replace(told, log_likelihood=max(gain, told.log_likelihood))
