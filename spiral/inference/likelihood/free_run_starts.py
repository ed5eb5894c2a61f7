"""Initial states of free runs: from a smoother over the record, refined by least squares.

Where the smoother begins, hidden states x_h are those that the fitted records show beside such
readings: their conditional mean given the measured states x_m at the first sample,

    E[x_h | x_m] = m_h + C_hm C_mm^-1 (x_m - m_m),

m and C the means and covariances of the filtered states over the first fitted record. Of a machine
that has no place of its own (a link behind a gear) the hidden position is that of the measured one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.setup import smoothed_states
from spiral.engine.filter.task import FilterInput
from spiral.engine.fit import fit
from spiral.engine.growth import Stage, layouts_for
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.noise import NoiseModel
from spiral.engine.likelihood.predict import predict_readings
from spiral.engine.study import Point
from spiral.inference.evidence.assembly import (
    Assembly,
    columns_with_bounds,
    nuisance_keys,
    with_records,
)
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.free_run import FreeRun, free_run_from_stage
from spiral.inference.evidence.horizons import filter_task, tracked_deviations
from spiral.inference.likelihood.continued import continued_start
from spiral.inference.likelihood.fitting import force_levels
from spiral.inference.likelihood.initial_states import set_likely_initial_state
from spiral.types.model import Model
from spiral.types.record import Array

_STEPS = 8  # of least squares that refine a start
_SHORTEST = 16  # samples of a settling part
_ALIKE = 1e-9  # of the largest, singular values of measured states that move together


@dataclass(frozen=True)
class UsualStates:
    """Hidden states as the fitted records show them beside the measured ones.

    ``means`` (n,) of all states; ``slopes`` (n, n) of the conditional mean, zero but in rows of
    hidden and columns of measured ones; ``hidden`` (n,).
    """

    means: Array
    slopes: Array
    hidden: Array

    def beside(self, start: Array) -> Array:
        """(n,) a first state, hidden ones as usual beside its measured ones."""
        told = self.means + self.slopes @ (start - self.means)
        return np.where(self.hidden, told, start)


def free_runs(
    assembly: Assembly, state: FitState, model: Model, settle: float | None,
    usual: UsualStates | None, fitted: Assembly | None = None,
) -> tuple[FreeRun, tuple[Array, ...]]:  # fmt: skip
    """Free runs over the records of a study, and their initial states (1, n).

    These are estimated from the first ``settle`` seconds of each record (all of it where that is
    left out), hidden ones starting from ``usual`` states. Where records go on from some that were
    ``fitted``, they begin where those end, if that fits the settling part as well.
    """
    series = assembly.study.series
    settled = tuple(
        0 if settle is None else min(max(round(settle / s.dt), _SHORTEST), s.samples // 2)
        for s in series
    )
    heads = assembly
    if settle is not None:
        parts = tuple(s.record.stretch(0, n) for s, n in zip(series, settled, strict=True))
        heads = with_records(assembly, parts, series[0].substeps)
    rows = state.values if settle is None else np.repeat(state.values[:1], len(series), axis=0)
    starts, before, values = [], {}, rows.copy()
    followed = tracked_nuisances(assembly, state, model)
    for r, head in enumerate(heads.study.series):
        task = filter_task(heads, model, rows[r], head.record, head.substeps)
        if usual is not None and len(usual.means) == len(task.states):
            task = replace(task, start=usual.beside(task.start))
        if settle is None and state.starts is not None:
            task = replace(task, start=state.starts[r])
        if not followed and state.noise is not None:
            task = set_likely_initial_state(task, state.noise)
        if fitted is not None and not followed:
            before[r] = continued_start(fitted, state, model, head.record, task)
        means = _smoothed_means(task, state.noise, followed, settle is not None)
        starts.append(means[0][None, : len(task.states)].copy())
        for place, key in enumerate(followed):
            values[r, task.keys.index(key)] = means[-1, len(task.states) + place]
    begun, refined = _refine_initial_states(heads, state, Point(values, tuple(starts)))
    stages = (_begun_before(heads, state, refined, before), refined, begun)
    return _first_finite_run(assembly, [s for s in stages if s is not None], settled)


def _first_finite_run(
    assembly: Assembly, stages: Sequence[Stage], settled: tuple[int, ...]
) -> tuple[FreeRun, tuple[Array, ...]]:
    """The free run from the first of several starts from which none runs away, else the last."""
    stage, *others = stages
    run = free_run_from_stage(assembly, stage, settled)
    if others and not all(np.isfinite(p).all() for p in run.predicted):
        return _first_finite_run(assembly, others, settled)
    return run, stage.fitted.point.starts


def usual_states(estimate: MaximumLikelihood) -> UsualStates | None:
    """Hidden states beside measured ones over the first fitted record; nothing where it is lost.

    A filter that starts a hidden state at zero (no substrate, say) may be led to where the model
    diverges.
    """
    task, settings = estimate.prepared[0]
    run = predict_readings(task, settings, estimate.noise, keep=True)
    if not run.whole:
        return None
    states = run.means[:, : len(task.states)]
    hidden = np.array([n not in task.compiled.traced.channels for n in task.states])
    means, slopes = states.mean(axis=0), np.zeros((len(hidden), len(hidden)))
    spread = states.std(axis=0)
    spread[spread == 0.0] = 1.0  # a state that does not move tells of no other
    apart = (states - means) / spread
    if hidden.any() and not hidden.all():
        told = np.linalg.lstsq(apart[:, ~hidden], apart[:, hidden], rcond=_ALIKE)[0].T
        slopes[np.ix_(hidden, ~hidden)] = told * np.divide.outer(spread[hidden], spread[~hidden])
    return UsualStates(means, slopes, hidden)


def _smoothed_means(
    task: FilterInput, noise: NoiseModel | None, tracked: tuple[str, ...], anywhere: bool
) -> Array:
    """Smoothed means over the record, (samples, states and tracked parameters).

    ``anywhere`` : nothing is known of the record yet, so its phase origin is sought all around.
    """
    levels = None if noise is None else force_levels(noise)
    given = {} if anywhere else tracked_deviations(tracked)
    return smoothed_states(task, levels, tracked, given)


def _refine_initial_states(heads: Assembly, state: FitState, point: Point) -> tuple[Stage, Stage]:
    """The initial states and nuisances as they are, and refined by least squares if better.

    Both are returned, as the refined ones may diverge after a head that hardly determines a hidden
    state.
    """
    study = heads.study
    whole = max(s.samples for s in study.series)
    layouts = layouts_for(study, whole, (None,) * len(study.series))
    moving, bounds = columns_with_bounds(heads, nuisance_keys(heads, state.labels))
    with np.errstate(all="ignore"):
        begun = fit(study, layouts, point, moving, bounds, iterations=0)
        refined = fit(study, layouts, point, moving, bounds, iterations=_STEPS)
    as_it_is = Stage(whole, layouts, begun)
    return as_it_is, Stage(whole, layouts, refined) if refined.cost <= begun.cost else as_it_is


def _begun_before(
    heads: Assembly, state: FitState, refined: Stage, before: Mapping[int, Array | None]
) -> Stage | None:
    """The records begun where those before them end; nothing where the refined starts fit better.

    By more than ``settings.chi2_limit`` times the squares of what they miss.
    """
    known = {r: x for r, x in before.items() if x is not None}
    if not known:
        return None
    point = refined.fitted.point
    starts = tuple(known[r][None] if r in known else x[:1] for r, x in enumerate(point.starts))
    study = heads.study
    moving, bounds = columns_with_bounds(heads, nuisance_keys(heads, state.labels))
    with np.errstate(all="ignore"):
        begun = fit(study, refined.layouts, Point(point.values, starts), moving, bounds,
                    iterations=0)  # fmt: skip
    enough = heads.problem.settings.chi2_limit * refined.fitted.cost
    return Stage(refined.length, refined.layouts, begun) if begun.cost <= enough else None


def tracked_nuisances(assembly: Assembly, state: FitState, model: Model) -> tuple[str, ...]:
    """Parameters of single records that the model has and the filter tracks."""
    known = dict(model.pairs)
    return tuple(k for k in nuisance_keys(assembly, state.labels) if k in known)
