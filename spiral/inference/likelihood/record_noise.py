"""Records whose sensors are not equally noisy: another range, another day, another amplifier.

One size of white noise for all would be too large for the quiet records and too small for the loud
ones, whose noise random forces would then have to make. With s_r the noise that record r declares,
or shows without a model (``types.noise``), its white noise has the variance

    a^2 s_r^2 / mean_q s_q^2        (mean over the fitted records q)

a the size that the likelihood decides. It is taken where that is likelier for all records.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spiral.inference.evidence.assembly import Assembly, with_records
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.likelihood.fitting import WORTH, LikelihoodFit
from spiral.inference.likelihood.outliers import fit_without_outliers
from spiral.inference.problem import Problem, Progress
from spiral.types.record import Record

_ALIKE = 1.3  # ratio of two records' noise up to which they count as equally noisy


def fit_with_own_noise_levels(
    assembly: Assembly, state: FitState, fit: LikelihoodFit, progress: Progress
) -> tuple[Assembly, LikelihoodFit] | None:
    """The study and its fit with noise of its own in each record; nothing if it is not likelier.

    ``state`` is where fits start, ``fit`` the one with the same noise in all records.
    """
    problem = _with_loudness(assembly.problem)
    if problem is None:
        return None
    progress("fitting with noise of its own in each record")
    other = with_records(assembly, problem.records, assembly.study.series[0].substeps)
    other, own = fit_without_outliers(replace(other, problem=problem), state, progress)
    likelier = own.estimate.finite and own.log_likelihood > fit.log_likelihood + WORTH
    return (other, own) if likelier or not fit.estimate.finite else None


def _with_loudness(problem: Problem) -> Problem | None:
    """The problem with each record's noise over the mean; nothing where all are alike."""
    if len(problem.records) < 2 or any(r.loudness for r in problem.records):
        return None
    channels = problem.model.system.observed
    seen = {c: np.array([r.sigma()[c] for r in problem.records]) for c in channels}
    known = {c: s for c, s in seen.items() if s.min() > 0 and s.max() > _ALIKE * s.min()}
    if not known:
        return None
    mean = {c: float(np.mean(s**2)) for c, s in known.items()}

    def weighed(record: Record) -> Record:
        own = record.sigma()
        return replace(record, loudness={c: own[c] ** 2 / m for c, m in mean.items()})

    records, test = (tuple(map(weighed, some)) for some in (problem.records, problem.test))
    return replace(problem, records=records, test=test)
