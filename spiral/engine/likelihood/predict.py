"""One-step predictions of prepared records under a model of their noise, and their likelihood.

    log L = -1/2 sum_kj (log 2 pi s_kj + e_kj^2 / s_kj)

over samples k and channels j, each predicted from all that came before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from spiral.engine.filter.algebra import compiled_algebra
from spiral.engine.filter.extended import FilterInputs, FilterSettings, tracked_indices
from spiral.engine.filter.lane_algebra import compiled_lane_algebra
from spiral.engine.filter.long_steps import MANY_STATES, LongSteps, long_steps_of
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.noise import NoiseModel, hold_idle_sizes, noise_matrices
from spiral.engine.series import Series
from spiral.engine.threads import run_in_threads
from spiral.physics.flow import Flow, compile_flow
from spiral.physics.lanes import LANES
from spiral.physics.linearity import jacobian_names
from spiral.physics.slope_bounds import SlopeBounds, compile_slope_bounds, no_slope_bounds
from spiral.types.record import Array

RUNAWAY = -1e300
_MOST_KEPT = 8_000_000  # slopes of the flow over all samples that are kept: 64 MB


@dataclass(frozen=True)
class Prediction:
    """One record predicted sample by sample.

    ``misses`` and ``spreads`` (samples, channels): e and its variance s, 0 where nothing was
    measured; ``slopes`` (samples, channels, parameters) of the predictions. Where they were asked
    for, ``means`` (samples, N) of states, tracked parameters and noise states after each sample,
    ``gains`` K and ``rows`` c (samples, channels, N), ``transitions`` F (samples, N, N), and
    ``flows``, its part (samples, states, states and tracked) that is the model's, if it changes.
    ``volume`` is 1/2 log(|P'| / |P|) of ``FilterSettings``, added to the first sample's
    log-likelihood: so a filter with a narrowed initial covariance P' compares with one that begins
    with the machine's own P (Laplace).
    """

    misses: Array
    spreads: Array
    slopes: Array
    means: Array
    transitions: Array
    gains: Array
    rows: Array
    flows: Array
    done: int
    volume: float = 0.0

    @property
    def whole(self) -> bool:
        """Whether the filter stayed with the record to its end."""
        return self.done == len(self.misses)

    @cached_property
    def whitened(self) -> Array:
        """(samples, channels) e / s^(1/2); 0 where nothing was measured."""
        return self.misses * self.weight

    @property
    def expected(self) -> Array:
        """(samples, N) means before each sample's readings, where ``means`` and gains were kept."""
        return self.means - np.einsum("kj,kji->ki", self.misses, self.gains)

    @property
    def columns(self) -> Array:
        """(samples, channels, parameters) d / s^(1/2)."""
        return self.slopes * self.weight[..., None]

    @cached_property
    def sample_log_likelihoods(self) -> Array:
        """(samples,) log-likelihood of each sample; -inf from where the filter ran away."""
        seen = self.spreads > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            each = np.where(seen, np.log(2 * np.pi * self.spreads) + self.whitened**2, 0.0)
        total = -0.5 * each.sum(axis=1)
        total[:1] += self.volume
        total[self.done :] = -np.inf
        return total

    @cached_property
    def weight(self) -> Array:
        """(samples, channels) 1 / s^(1/2), 0 where nothing was measured."""
        with np.errstate(divide="ignore"):
            return np.where(self.spreads > 0, 1 / np.sqrt(self.spreads), 0.0)


def predict_readings(
    task: FilterInput, settings: FilterSettings, noise: NoiseModel, keys: Sequence[str] = (),
    keep: bool = False, carry: bool = False,
) -> Prediction:  # fmt: skip
    """Predict a record, with slopes by ``keys``; ``keep`` means, gains, rows, ``carry`` F too."""
    from spiral.engine.filter.long_steps_kernel import advance_long
    from spiral.engine.likelihood.kernel import predict_record

    tracked = tracked_indices(task, settings.tracked)
    both = np.concatenate([tracked, tracked_indices(task, tuple(keys))]).astype(np.int64)
    flow, compiled = _task_flow(task, settings, tuple(keys)), compiled_algebra()
    parts = noise_matrices(task, settings, noise)
    white = _white_variances(parts.r, task.series)
    samples, m = task.series.y.shape
    size, kept = len(parts.q), samples if keep or carry else 0
    more = samples if carry else 0
    first = np.concatenate([settings.start, task.values[tracked]])
    constant, states = _is_transition_constant(task, settings), len(task.states)
    changes = len(tracked) > 0 or not constant
    few = samples * states * len(first) <= _MOST_KEPT
    changing = samples if keep and changes and few else 0
    arrays = (
        np.zeros((samples, m)), np.zeros((samples, m)), np.zeros((samples, m, len(keys))),
        np.zeros((kept, size)), np.zeros((more, size, size)), np.zeros((kept, m, size)),
        np.zeros((kept, m, size)), np.zeros((changing, states, len(first))),
    )  # fmt: skip
    series = task.series
    y = series.y if series.seen is None else np.where(series.seen, series.y, np.nan)
    watched = _watched_slopes(task, settings, len(both), constant)
    done = predict_record(
        flow.advance, watched.advance, watched.count, flow.output,
        compiled.product, compiled.lower, compiled.sparse, compiled.absorb,
        np.concatenate([first, np.zeros(size - len(first))]),
        parts.p, task.values.copy(), both, len(tracked), task.inputs, series.substeps, series.dt,
        np.ascontiguousarray(y), white, parts.q, parts.phi,
        parts.seen, parts.driven, constant, advance_long,
        *_steps_of(task, settings, tuple(keys)).fields, *arrays,
    )  # fmt: skip
    return Prediction(*arrays, int(done), settings.volume)


def _white_variances(variance: Array, series: Series) -> Array:
    """(samples or 1, channels) variance of the white noise of each reading."""
    return variance[None, :] if series.grown is None else variance * series.grown


def _task_flow(task: FilterInput, settings: FilterSettings, keys: tuple[str, ...] = ()) -> Flow:
    """The flow of a task with slopes by tracked parameters and these; one for all that it moves."""
    return compile_flow(task.compiled.traced, (*settings.tracked, *_moved_keys(task, keys)))


def _steps_of(task: FilterInput, settings: FilterSettings, keys: tuple[str, ...] = ()) -> LongSteps:
    """Long steps of a task with slopes as ``_task_flow`` has them."""
    return long_steps_of(task, settings.tracked, _moved_keys(task, keys))


def _moved_keys(task: FilterInput, keys: tuple[str, ...]) -> tuple[str, ...]:
    """The parameters that a task's slopes are compiled for: all that move in it, these first."""
    return task.moved if task.moved[: len(keys)] == keys else keys


def _watched_slopes(
    task: FilterInput, settings: FilterSettings, moved: int, constant: bool
) -> SlopeBounds:
    """What tells samples of one transition from others, where that may save most of the columns.

    ``moved`` : parameters that the columns beside those of the states are of. None where F is
    ``constant``, and made once in any case, or where a tracked parameter may change it.
    """
    few = len(task.states) < max(MANY_STATES, 2 * moved)
    if few or constant or settings.tracked:
        return no_slope_bounds()
    return compile_slope_bounds(task.compiled.traced)


def _is_transition_constant(task: FilterInput, settings: FilterSettings) -> bool:
    """Whether F is the same at every sample: rates linear in the states, nothing else moves."""
    named = jacobian_names(task.compiled.traced)
    moved = {*settings.tracked, *task.series.changing_inputs(task.compiled.traced.inputs)}
    return named is not None and named.isdisjoint(moved)


def vary_noise(
    task: FilterInput, settings: FilterSettings, noise: NoiseModel, others: Sequence[NoiseModel],
    run: Prediction,
) -> list[tuple[Array, Array]]:  # fmt: skip
    """Innovations and variances of one record under another noise model, along a filtered motion.

    ``others`` have the terms of ``noise``, which is that of the run, with other values.
    """
    from spiral.engine.filter.long_steps_kernel import advance_long
    from spiral.engine.likelihood.variation_kernel import vary_record

    tracked = tracked_indices(task, settings.tracked)
    first = noise_matrices(task, settings, noise)
    parts = [noise_matrices(task, settings, n) for n in hold_idle_sizes(task, noise, others)]
    p, q, phi = (_in_lanes([getattr(m, a) for m in parts]) for a in ("p", "q", "phi"))
    r = _in_lanes([_white_variances(m.r, task.series) for m in parts])
    misses, spreads = (np.zeros((len(r), *run.misses.shape, LANES)) for _ in range(2))
    series = task.series
    constant = _is_transition_constant(task, settings)
    watched = _watched_slopes(task, settings, len(tracked), constant)
    compiled = compiled_lane_algebra()
    vary_record(
        _task_flow(task, settings).advance, watched.advance, watched.count, compiled.advance,
        compiled.absorb, task.values.copy(), tracked, task.inputs, series.substeps, series.dt,
        first.phi, first.driven, constant, advance_long, *_steps_of(task, settings).fields,
        run.means, run.gains, run.rows, run.flows, run.misses, run.spreads, p, r, q, phi, misses,
        spreads,
    )  # fmt: skip
    lanes = [divmod(j, LANES) for j in range(len(others))]
    return [(misses[b, ..., v].copy(), spreads[b, ..., v].copy()) for b, v in lanes]


def _in_lanes(matrices: Sequence[Array]) -> Array:
    """(blocks, rows, columns, lanes), four matrices to a block, the last one again where few."""
    blocks = -(-len(matrices) // LANES)
    full = [*matrices, *[matrices[-1]] * (blocks * LANES - len(matrices))]
    shape = (blocks, LANES, *matrices[0].shape)
    return np.ascontiguousarray(np.moveaxis(np.reshape(full, shape), 1, -1))


def predict_cases(
    cases: Sequence[tuple[FilterInputs, NoiseModel]], keys: Sequence[str] = (), keep: bool = False
) -> list[tuple[Prediction, ...]]:
    """Every record of every case; cases run side by side, and know nothing of one another."""
    jobs = [(task, settings, noise) for prepared, noise in cases for task, settings in prepared]

    def predict_job(job: tuple[FilterInput, FilterSettings, NoiseModel]) -> Prediction:
        return predict_readings(*job, keys, keep)

    samples = max((task.series.samples for task, _, _ in jobs), default=0)
    with np.errstate(all="ignore"):
        flat, grouped, at = run_in_threads(predict_job, jobs, samples), [], 0
    for prepared, _ in cases:
        grouped.append(tuple(flat[at : at + len(prepared)]))
        at += len(prepared)
    return grouped


Masks = Sequence[Array | None] | None
"""(samples,) True for the samples of each record that count; none where all do."""


def log_likelihood(parts: Sequence[Prediction], masks: Masks = None) -> float:
    """Sum over records, or over the samples of their masks; ``RUNAWAY`` where one ran away."""
    if not all(p.whole for p in parts):
        return RUNAWAY
    rows = [p.sample_log_likelihoods for p in parts]
    if masks is not None:
        rows = [h if m is None else h[m] for h, m in zip(rows, masks, strict=True)]
    total = float(sum(h.sum() for h in rows))
    return total if np.isfinite(total) else RUNAWAY


def total_log_likelihood(prepared: FilterInputs, noise: NoiseModel) -> float:
    """Log-likelihood of all samples at the values and the noise that are given."""
    return log_likelihood(predict_cases([(prepared, noise)])[0])
