"""A random force around a frequency (waves, eddies, a road), where misses are white with no other.

    z'' = -2 d w0 z' - w0^2 z + w,    added to a rate: z' / w0, or a band-pass of more poles

A white force and one with a correlation time have most of what they have at low frequencies. One
that does not leaves coloured misses beside either, and what stands in for it spoils values. It
would also do the work of a resonance that the model lacks, so that it is tried last, where no
candidate, law or curve explains what is left.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm
from spiral.engine.likelihood.predict import log_likelihood, predict_cases
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.likelihood.fitting import LikelihoodFit, is_white
from spiral.inference.likelihood.noise_selection import (
    raise_filter_order,
    shared_groups,
    small_groups,
)
from spiral.inference.likelihood.smaller_forces import fit_beside_small_forces, likeliest_noises
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.types.noise import COLOURED, CORRELATED

_FREQUENCIES = 10  # to begin with, from two periods in the record to a fifth of the rate
_SIZES = (0.01, 0.05)  # to begin with, shares of the rate's deviation
_DAMPING = 0.3
_TUNED = 3  # starts that are tuned, the likeliest ones


def add_resonant_force(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit | None:
    """The fit beside a random force around a frequency, where that is likelier by the odds.

    It takes the place of all other correlated forces and of noise of sensors that is not white,
    which were selected since misses were not white without it, or acts beside them. No force may be
    larger with it than ``settings.random_limit``. Nothing where misses are white already, or where
    it is not taken.
    """
    at = fit.estimate
    if not at.finite or at.noise.has_kind("swell") or is_white(assembly, fit):
        return None
    progress("trying a random force around a frequency")
    starts = list(_resonant_force_models(at))
    heights = [log_likelihood(p) for p in predict_cases([(at.prepared, n) for n in starts])]
    first = [starts[i] for i in np.argsort(heights)[::-1][:_TUNED]]
    steep = map(raise_filter_order, likeliest_noises(at.prepared, first))
    odds, limit = float(np.log(DECISIVE_ODDS)), assembly.problem.settings.random_limit
    fits = fit_beside_small_forces(assembly, fit, steep, odds, limit)
    return max(fits, key=lambda f: f.log_likelihood, default=None)


def _resonant_force_models(at: MaximumLikelihood) -> Iterator[NoiseModel]:
    """Noise models with a force around one of several frequencies, on each group or state."""
    task, noise = at.prepared[0][0], at.noise
    dt, length = task.series.dt, task.series.dt * task.series.samples
    bare = noise.replace_with_white(*COLOURED, *CORRELATED, "drift")
    begun = (noise,) if bare.terms == noise.terms else (noise, bare)
    states = (task.states[i] for s in shared_groups(task).values() for i in s)
    for where in (*small_groups(task), *states):
        one = NoiseTerm("swell", where)
        for hertz in np.geomspace(2.0 / length, 0.2 / dt, _FREQUENCIES):
            for size in _SIZES:
                values = {one.size: size, one.time: 1.0 / (2.0 * np.pi * float(hertz))}
                for other in begun:
                    yield other.with_terms((one,), {**values, one.damping: _DAMPING})
