"""A study's state fitted by the likelihood of its one-step predictions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.setup import prepared as filter_prepared
from spiral.engine.filter.task import begun_within, linearised, task_with
from spiral.engine.likelihood.fit import Kept, Maximum, maximise
from spiral.engine.likelihood.noise import NoiseModel, acting_on, first_noise, limits
from spiral.engine.likelihood.predict import (
    Masks,
    Prepared,
    predicted,
)
from spiral.engine.statistics import Whiteness, whiteness
from spiral.inference.evidence.assembly import Assembly, with_steps
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.horizons import doubts
from spiral.inference.evidence.scales import spread_out
from spiral.inference.evidence.spectrum import shortest_time
from spiral.types.record import Array

LEVEL = 0.3  # first process noise: the filter follows a model that is wrong by so much of a rate
WARM = 6  # scoring steps from the values on all samples to those on the selecting half
LEAST = 1.5  # times its least value from which a random force is one
LITTLE = 0.05  # share up to which what acts at random is little
_FAINT = 0.1  # of what one step misses: white noise below makes next to nothing of it
WORTH = 1.0  # log-likelihood for which they are looked for once more
_ADVANCE = 0.3  # rad, largest phase advance of the fastest mode in one integration step
MOST_SUBSTEPS = 32
_FURTHEST = 1e9  # times its given value


@dataclass(frozen=True)
class LikelihoodFit:
    """A state of a study with its most likely values, and the estimate that has them."""

    state: FitState
    estimate: Maximum

    @property
    def height(self) -> float:
        """Its log-likelihood."""
        return self.estimate.log_likelihood


def taken_on(
    assembly: Assembly, found: LikelihoodFit, noise: NoiseModel | None = None, rough: bool = False,
    least: float = -np.inf,
) -> LikelihoodFit:  # fmt: skip
    """A fit taken on from where it is, with its own noise or another, to its very maximum.

    ``rough`` and ``least`` as in ``maximise``.
    """
    at = found.estimate
    bounds, noise = bounds_of(assembly, at.keys, found.state.substeps), noise or at.noise
    estimate = maximise(at.prepared, at.keys, noise, bounds, rough=rough, kept=at.kept, least=least)
    return LikelihoodFit(with_estimate(found.state, estimate), estimate)


def tracked(assembly: Assembly, state: FitState) -> tuple[str, ...]:
    """Parameters that belong to a record; the filter follows them."""
    known = dict(assembly.problem.model.pairs)
    keys = state.keys(assembly)
    return tuple(k for k in keys if k in known and known[k].scope == "record")


def moving(assembly: Assembly, state: FitState) -> tuple[str, ...]:
    """Parameters that the likelihood decides: all that a fit moves but those that are tracked."""
    followed = tracked(assembly, state)
    return tuple(k for k in state.keys(assembly) if k not in followed)


def bounds_of(
    assembly: Assembly, keys: tuple[str, ...], substeps: int = 1
) -> dict[str, tuple[float, float]]:
    """Lowest and highest values by name.

    A time of an effect's own states ends where the integration ``substeps`` per sample carry it:
    states that are stiff would stop every step of the fit. A value that the record does not tell
    ends at ``_FURTHEST`` times what was given, beyond which squares are no numbers any more.
    """
    given = assembly.problem.model.values
    traced = assembly.study.compiled.traced
    known = dict(zip(traced.keys, traced.parameters, strict=True))
    steps = (s.dt / max(s.substeps, substeps) for s in assembly.study.series)
    shortest, found = shortest_time(min(steps)), {}
    for key in keys:
        one = known[key]
        low, high = (-np.inf if one.lower is None else one.lower), one.upper
        low = shortest if one.spectrum and one.unit == "s" else low
        most = _FURTHEST * abs(given.get(key) or np.inf)
        found[key] = (max(float(low), -most), most if high is None else min(float(high), most))
    return found


def subjects(assembly: Assembly, state: FitState, like: Prepared | None = None) -> Prepared:
    """Every record with the state's values and integration steps.

    ``like`` : whose scales of the states are taken, so that sizes of the noise mean the same.
    """
    model, traced = assembly.problem.model, assembly.study.compiled.traced
    followed = tracked(assembly, state)
    compiled = assembly.study.compiled
    rows = np.ascontiguousarray(state.values[:, : len(traced.keys)])
    known = doubts(followed) if state.noise is not None else {}
    begins = state.starts or (None,) * len(rows)
    spreads = state.spreads if state.starts and state.spreads else (None,) * len(rows)
    others = (None,) * len(rows) if like is None else tuple(task for task, _ in like)
    tasks = [
        task_with(model, compiled, row.copy(), series.record, start, series=series, like=other)
        for row, start, series, other in zip(
            rows, begins, integrated(assembly, state).study.series, others, strict=True
        )
    ]
    moved = moving(assembly, state)
    return tuple(
        filter_prepared(replace(begun_within(t, spread), moved=moved), followed, known)
        for t, spread in zip(tasks, spreads, strict=True)
    )


def integrated(assembly: Assembly, state: FitState) -> Assembly:
    """The study with at least a state's steps per sample, its inputs run as the state says."""
    substeps = max(state.substeps, assembly.study.series[0].substeps)
    if not state.between and substeps == assembly.study.series[0].substeps:
        return assembly
    problem = assembly.problem.running(state.between)
    return with_steps(replace(assembly, problem=problem), substeps)


def finer(found: LikelihoodFit) -> int:
    """Integration steps per sample that the motion asks for: |eigenvalue| dt of 0.3 along it."""
    fastest = 0.0
    for task, settings in found.estimate.prepared:
        run = predicted(task, settings, found.estimate.noise, keep=True)
        states = run.means[: run.done, : len(task.states)]
        inputs = task.inputs[:: 2 * task.series.substeps]
        for k in spread_out(states):
            matrix = linearised(task.compiled, task.values, inputs[k], states[k])
            fastest = max(fastest, float(np.abs(np.linalg.eigvals(matrix)).max()) * task.series.dt)
    return int(np.clip(np.ceil(fastest / _ADVANCE), 1, MOST_SUBSTEPS))


def refitted(
    assembly: Assembly,
    state: FitState,
    noise: NoiseModel | None = None,
    masks: Masks = None,
    steps: int = 40,
    rough: bool = False,
    kept: Kept | None = None,
    differences: bool = True,
    like: Prepared | None = None,
    least: float = -np.inf,
) -> LikelihoodFit:
    """The most likely values of a state's parameters and of its noise.

    Parameters
    ----------
    noise : to start from; left out, the state's own, or white noise as the record has it with
        much process noise.
    masks : samples of each record that count. steps : at most so many; ``rough``, ``kept``
        ``differences`` and ``least`` as in ``maximise``; ``like`` as in ``subjects``.
    """
    prepared = subjects(assembly, state, like)
    noise = acting_on(prepared[0][0], noise or state.noise or first_noise(prepared[0][0], LEVEL))
    keys = moving(assembly, state)
    bounds = bounds_of(assembly, keys, state.substeps)
    estimate = maximise(
        prepared, keys, noise, bounds, masks, steps,
        rough=rough, kept=kept, differences=differences, least=least,
    )  # fmt: skip
    return LikelihoodFit(with_estimate(state, estimate), estimate)


def with_estimate(state: FitState, estimate: Maximum) -> FitState:
    """The state with an estimate's values and noise."""
    values = state.values.copy()
    for row, (task, _) in zip(values, estimate.prepared, strict=True):
        row[: len(task.keys)] = task.values
    return replace(state, values=values, noise=estimate.noise)


def explains(found: LikelihoodFit) -> bool:
    """Whether no more than a small random force acts beside the model."""
    return largest_force(found.estimate.noise) <= LITTLE


def largest_force(noise: NoiseModel) -> float:
    """The largest random force beside a model, as a share of its own; none is zero."""
    kinds = ("force", "gust")
    return max((noise.values[t.size] for t in noise.terms if t.kind in kinds), default=0.0)


def reopened(
    assembly: Assembly, found: LikelihoodFit, masks: Masks = None, steps: int = 40
) -> LikelihoodFit:
    """The fit with random terms that have vanished begun again, where that is more likely.

    Sizes are on a logarithmic scale, on which one near zero has no slope: noise of a sensor that a
    large random force has made superfluous never comes back by itself when the model no longer
    needs that force. Nothing is tried where the model explains the records and leaves white noise.
    """
    if not found.estimate.finite or (explains(found) and is_white(assembly, found)):
        return found
    sizes = _vanished(found.estimate)
    if not sizes:
        return found
    at = found.estimate
    noise = at.noise.with_values(sizes)
    again = refitted(assembly, found.state, noise, masks, steps, rough=True, like=at.prepared)
    return again if again.height > found.height else found


def _vanished(at: Maximum) -> dict[str, float]:
    """White noise and white forces that are next to nothing, with sizes to begin again."""
    task = at.prepared[0][0]
    rms = np.sqrt(np.mean(np.concatenate([p.misses for p in at.parts]) ** 2, axis=0))
    missed = dict(zip(task.compiled.traced.channels, rms, strict=True))
    found = {}
    for term in at.noise.terms:
        size = at.noise.values[term.size]
        if term.kind == "white" and size < _FAINT * missed[term.where]:
            found[term.size] = 0.5 * float(missed[term.where])
        elif term.kind == "force" and size < LEAST * limits(task, term.size)[0]:
            found[term.size] = LEVEL
    return found


def force_levels(noise: NoiseModel) -> dict[str, float]:
    """Levels of the random forces by group."""
    return {t.where: noise.values[t.size] for t in noise.terms if t.kind == "force"}


def settled_values(found: LikelihoodFit) -> FitState:
    """The state with what belongs to each record as the filter has it at the record's end."""
    values = found.state.values.copy()
    for row, (task, settings) in zip(values, found.estimate.prepared, strict=True):
        if not settings.tracked:
            continue
        run = predicted(task, settings, found.estimate.noise, keep=True)
        for place, key in enumerate(settings.tracked):
            row[task.keys.index(key)] = run.means[-1, len(task.states) + place]
    return replace(found.state, values=values)


def expected_states(found: LikelihoodFit) -> tuple[Array, ...]:
    """(samples, n) the system's states of every record before each reading.

    None where a filter ran away.
    """
    parts = [(t, predicted(t, s, found.estimate.noise, keep=True))
             for t, s in found.estimate.prepared]  # fmt: skip
    if not all(p.whole for _, p in parts):
        return ()
    return tuple(p.expected[:, : len(t.model.system.states)] for t, p in parts)


def innovations(found: LikelihoodFit) -> tuple[Array, ...]:
    """Whitened misses (samples, channels) of every record."""
    return tuple(p.whitened for p in found.estimate.parts)


def colour(assembly: Assembly, found: LikelihoodFit) -> Whiteness:
    """Whether the misses are white."""
    return whiteness(innovations(found), assembly.problem.settings.lags)


def is_white(assembly: Assembly, found: LikelihoodFit) -> bool:
    """Whether the misses are white at the level of the settings."""
    return colour(assembly, found).p >= assembly.problem.settings.whiteness_level


def price(parameters: int, prepared: Prepared) -> float:
    """What parameters cost in log-likelihood (Schwarz): q / 2 log N, N readings."""
    return 0.5 * parameters * float(np.log(samples_of(prepared)))


def samples_of(prepared: Prepared) -> int:
    """Readings in all records."""
    return sum(task.series.y.size for task, _ in prepared)
