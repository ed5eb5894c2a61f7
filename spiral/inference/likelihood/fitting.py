"""Maximum-likelihood fits of a model, by its one-step predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import (
    FilterInput,
    build_task,
    motion_scales,
    with_start_spread,
)
from spiral.engine.likelihood.fit import MaximumLikelihood, SlopeCache, maximise_likelihood
from spiral.engine.likelihood.noise import (
    LEAST_FORCE,
    NoiseModel,
    NoiseTerm,
    drop_inapplicable_forces,
    first_noise,
    size_limits,
)
from spiral.engine.likelihood.predict import (
    FilterInputs,
    Masks,
    Prediction,
    predict_cases,
    predict_readings,
)
from spiral.engine.likelihood.rates import rates_along
from spiral.engine.resting import state_jacobian
from spiral.engine.series import sample_inputs, steps_per_sample
from spiral.engine.statistics import Whiteness, whiteness
from spiral.inference.evidence.assembly import Assembly, with_steps
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.horizons import tracked_deviations
from spiral.inference.evidence.scales import covering_samples
from spiral.inference.evidence.spectrum import shortest_time_constant
from spiral.inference.nearness import has_little_colour
from spiral.types.label import owner_of
from spiral.types.noise import FORCES
from spiral.types.record import Array

LEVEL = 0.3  # first process noise: the filter follows a model that is wrong by so much of a rate
_USUAL, _PATIENT = 40, 100  # scoring steps of a rough fit, and of one to the very maximum, at most
WARM = 6  # scoring steps of a fit on some blocks that starts from a fit of all samples
_LEAST = 1.5  # times its lower limit, up to which the size of a random force counts as none
_TRACKED = 2  # runs of a filter that tell the scales of a motion
LITTLE = 0.05  # random force up to which it is small, as a share of the model's own
_FAINT = 0.1  # share of the innovations' rms under which white noise counts as vanished
WORTH = 1.0  # gain in log-likelihood from which other initial states or starts are taken
_STILL = 0.05  # share of the motion of what a state follows under which it hardly moves
_FURTHEST = 1e9  # times its given value: the bound of every parameter


@dataclass(frozen=True)
class LikelihoodFit:
    """A maximum-likelihood fit: the study's state at the maximum, and the maximum itself."""

    state: FitState
    estimate: MaximumLikelihood

    @property
    def log_likelihood(self) -> float:
        """Its log-likelihood."""
        return self.estimate.log_likelihood


def continue_fit(
    assembly: Assembly, fit: LikelihoodFit, noise: NoiseModel | None = None, rough: bool = False,
    least: float = -np.inf,
) -> LikelihoodFit:  # fmt: skip
    """A fit continued to the maximum of its likelihood, with its own noise model or ``noise``.

    ``rough`` and ``least`` as in ``maximise_likelihood``. One that is not rough is given as many
    steps as it takes along a bent valley, in which values make up for one another.
    """
    at = fit.estimate
    bounds, noise = parameter_bounds(assembly, at.keys, fit.state.substeps), noise or at.noise
    steps = _USUAL if rough else _PATIENT
    estimate = maximise_likelihood(
        at.prepared, at.keys, noise, bounds, steps=steps, rough=rough, kept=at.kept, least=least
    )
    return LikelihoodFit(with_estimate(fit.state, estimate), estimate)


def per_record_parameters(assembly: Assembly, state: FitState) -> tuple[str, ...]:
    """Parameters of single records (a phase's origin), which the filter tracks as states."""
    known = dict(assembly.problem.model.pairs)
    keys = state.keys(assembly)
    return tuple(k for k in keys if k in known and known[k].scope == "record")


def free_parameters(assembly: Assembly, state: FitState) -> tuple[str, ...]:
    """Parameters that the likelihood estimates: all that a fit moves but the tracked ones."""
    followed = per_record_parameters(assembly, state)
    return tuple(k for k in state.keys(assembly) if k not in followed)


def parameter_bounds(
    assembly: Assembly, keys: tuple[str, ...], substeps: int = 1
) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of every parameter, by name.

    A time constant of an effect's own states is at least the shortest that ``substeps``
    integration steps per sample resolve: stiff states would stop every step of the fit. A value
    that the record does not determine stays within ``_FURTHEST`` times the one given, beyond which
    squares overflow.
    """
    given = assembly.problem.model.given_values
    traced = assembly.study.compiled.traced
    known = dict(zip(traced.keys, traced.parameters, strict=True))
    steps = (s.dt / max(s.substeps, substeps) for s in assembly.study.series)
    shortest, bounds = shortest_time_constant(min(steps)), {}
    for key in keys:
        one = known[key]
        low, high = (-np.inf if one.lower is None else one.lower), one.upper
        timed = one.role == "shape" and one.unit == "s" and (one.spectrum or one.grid)
        low = shortest if timed else low
        most = _FURTHEST * abs(given.get(key) or np.inf)
        bounds[key] = (max(float(low), -most), most if high is None else min(float(high), most))
    return bounds


def prepare_filter_tasks(
    assembly: Assembly, state: FitState, like: FilterInputs | None = None
) -> FilterInputs:
    """A filter task for every record, with the state's values and integration steps.

    ``like`` : tasks whose scales of the states are taken, so that sizes of the noise mean the same;
    left out, those of the whole records for stretches of such.
    """
    model, traced = assembly.problem.model, assembly.study.compiled.traced
    followed = per_record_parameters(assembly, state)
    compiled = assembly.study.compiled
    rows = np.ascontiguousarray(state.values[:, : len(traced.keys)])
    known = tracked_deviations(followed) if state.noise is not None else {}
    begins = state.starts or (None,) * len(rows)
    spreads = state.spreads if state.starts and state.spreads else (None,) * len(rows)
    others: tuple[FilterInput | None, ...] = (None,) * len(rows)
    if like is not None:
        others = tuple(task for task, _ in like)
    elif assembly.excerpt is not None:
        others = assembly.excerpt.scales
    tasks = [
        build_task(model, compiled, row.copy(), series.record, start, series=series, like=other)
        for row, start, series, other in zip(
            rows,
            begins,
            apply_integration_settings(assembly, state).study.series,
            others,
            strict=True,
        )
    ]
    tasks = [_with_tracked_scales(t) if t.astray else t for t in tasks]
    moved = free_parameters(assembly, state)
    return tuple(
        filter_prepared(replace(with_start_spread(t, spread), moved=moved), followed, known)
        for t, spread in zip(tasks, spreads, strict=True)
    )


def _with_tracked_scales(task: FilterInput) -> FilterInput:
    """The task with scales of the motion that a filter tracks, in place of those of a free run.

    The filter doubts the model much, and follows the readings whatever the values are; it is run
    twice, since its noise is a share of the scales. The task as it is where it runs away.
    """
    for _ in range(_TRACKED):
        own, settings = filter_prepared(with_start_spread(task, None), ())
        run = predict_readings(own, settings, first_noise(own, LEVEL), keep=True)
        if not run.whole:
            break
        means = np.ascontiguousarray(run.means[run.done // 10 :, : len(task.states)])
        centre, scales, rates = motion_scales(means, task.series.dt)
        inputs = sample_inputs(task.inputs, task.series.substeps)[-len(means) :]
        moving = rates_along(task.compiled, means, inputs, task.values).std(axis=0)
        rates = np.where(moving > 0, moving, rates)  # without the filter's corrections
        task = replace(task, centre=centre, scales=scales, rates=rates)
    return task


def apply_integration_settings(assembly: Assembly, state: FitState) -> Assembly:
    """The study with a state's interpolation of inputs and at least its integration steps."""
    substeps = max(state.substeps, assembly.study.series[0].substeps)
    if not state.between and substeps == assembly.study.series[0].substeps:
        return assembly
    problem = assembly.problem.running(state.between)
    return with_steps(replace(assembly, problem=problem), substeps)


def required_substeps(fit: LikelihoodFit) -> int:
    """Integration steps per sample for the fastest mode all along the motion."""
    steps = 1
    for task, settings in fit.estimate.prepared:
        run = predict_readings(task, settings, fit.estimate.noise, keep=True)
        states = run.means[: run.done, : len(task.states)]
        inputs = sample_inputs(task.inputs, task.series.substeps)
        for k in covering_samples(states):
            matrix = state_jacobian(task.compiled, task.values, inputs[k], states[k])
            rates, exact_to = np.linalg.eigvals(matrix), task.model.system.exact_to
            steps = max(steps, steps_per_sample(rates, task.series.dt, exact_to))
    return steps


def fit_by_likelihood(
    assembly: Assembly,
    state: FitState,
    noise: NoiseModel | None = None,
    masks: Masks = None,
    steps: int = 40,
    rough: bool = False,
    kept: SlopeCache | None = None,
    differences: bool = True,
    like: FilterInputs | None = None,
    least: float = -np.inf,
) -> LikelihoodFit:
    """The maximum-likelihood values of a state's parameters and of its noise model.

    Parameters
    ----------
    noise : to start from; left out, the state's own, or white noise as the record has it with
        much process noise.
    masks : samples of each record that count. steps : at most so many; ``rough``, ``kept``
        ``differences`` and ``least`` as in ``maximise_likelihood``; ``like`` as in
        ``prepare_filter_tasks``.
    """
    prepared = prepare_filter_tasks(assembly, state, like)
    noise = drop_inapplicable_forces(
        prepared[0][0], noise or state.noise or first_noise(prepared[0][0], LEVEL)
    )
    keys = free_parameters(assembly, state)
    bounds = parameter_bounds(assembly, keys, state.substeps)
    estimate = maximise_likelihood(
        prepared, keys, noise, bounds, masks, steps,
        rough=rough, kept=kept, differences=differences, least=least,
    )  # fmt: skip
    return LikelihoodFit(with_estimate(state, estimate), estimate)


def with_estimate(state: FitState, estimate: MaximumLikelihood) -> FitState:
    """The state with an estimate's values and noise."""
    values = state.values.copy()
    for row, (task, _) in zip(values, estimate.prepared, strict=True):
        row[: len(task.keys)] = task.values
    return replace(state, values=values, noise=estimate.noise)


def is_random_force_small(fit: LikelihoodFit) -> bool:
    """Whether the largest random force beside the model is at most ``LITTLE``, or there is none."""
    return largest_force(fit.estimate.noise) <= LITTLE


def largest_force(noise: NoiseModel) -> float:
    """The largest random force, as a share of the model's own forces; zero where there is none."""
    return max((noise.values[t.size] for t in noise.terms if t.kind in FORCES), default=0.0)


def restart_vanished_noise(
    assembly: Assembly, fit: LikelihoodFit, masks: Masks = None, steps: int = 40
) -> LikelihoodFit:
    """The fit with vanished noise terms started again from finite sizes, if that is more likely.

    Sizes are on a logarithmic scale, on which one near zero has no slope: noise of a sensor that a
    large random force has made superfluous never comes back by itself when the model no longer
    needs that force. Nothing is tried where the model explains the records and leaves white noise.
    """
    if not fit.estimate.finite or (is_random_force_small(fit) and is_white(assembly, fit)):
        return fit
    sizes = _vanished_noise_sizes(fit.estimate)
    if not sizes:
        return fit
    at = fit.estimate
    noise = at.noise.with_values(sizes)
    again = fit_by_likelihood(
        assembly, fit.state, noise, masks, steps, rough=True, like=at.prepared
    )
    return again if again.log_likelihood > fit.log_likelihood else fit


def has_noiseless_sensor(fit: LikelihoodFit) -> bool:
    """Whether a sensor would have no noise, beside a force that acts at random."""
    noise, task = fit.estimate.noise, fit.estimate.prepared[0][0]
    vanished = _vanished_noise_sizes(fit.estimate)
    quiet = any(t.size in vanished for t in noise.terms if t.kind == "white")
    return quiet and any(t.kind in FORCES and is_acting(task, noise, t) for t in noise.terms)


def is_acting(task: FilterInput, noise: NoiseModel, term: NoiseTerm) -> bool:
    """Whether a term's size is above its least value, at which it does nothing."""
    return noise.values[term.size] > _LEAST * size_limits(task, term.size)[0]


def _vanished_noise_sizes(at: MaximumLikelihood) -> dict[str, float]:
    """Sizes to start again from, of white noise and white forces that have vanished."""
    task = at.prepared[0][0]
    rms = np.sqrt(np.mean(np.concatenate([p.misses for p in at.predictions]) ** 2, axis=0))
    missed = dict(zip(task.compiled.traced.channels, rms, strict=True))
    sizes = {}
    for term in at.noise.terms:
        size = at.noise.values[term.size]
        if term.kind == "white" and size < _FAINT * missed[term.where]:
            sizes[term.size] = 0.5 * float(missed[term.where])
        elif term.kind == "force" and size < _LEAST * size_limits(task, term.size)[0]:
            sizes[term.size] = LEVEL
    return sizes


def force_levels(noise: NoiseModel) -> dict[str, float]:
    """Levels of the random forces by group."""
    return {t.where: noise.values[t.size] for t in noise.terms if t.kind == "force"}


def with_tracked_values(fit: LikelihoodFit) -> FitState:
    """The state with the tracked parameters as filtered at the end of each record."""
    values = fit.state.values.copy()
    for row, (task, settings) in zip(values, fit.estimate.prepared, strict=True):
        if not settings.tracked:
            continue
        run = predict_readings(task, settings, fit.estimate.noise, keep=True)
        for place, key in enumerate(settings.tracked):
            row[task.keys.index(key)] = run.means[-1, len(task.states) + place]
    return replace(fit.state, values=values)


def predicted_states(fit: LikelihoodFit) -> tuple[Array, ...]:
    """(samples, n) states of the system that the filter predicts before each reading, by record.

    An empty tuple where a filter diverges.
    """
    parts = [(t, predict_readings(t, s, fit.estimate.noise, keep=True))
             for t, s in fit.estimate.prepared]  # fmt: skip
    if not all(p.whole for _, p in parts):
        return ()
    return tuple(p.expected[:, : len(t.model.system.states)] for t, p in parts)


def has_still_state(fit: LikelihoodFit, label: str) -> bool:
    """Whether an own state of an effect that follows something (``State.like``) hardly moves.

    Its deviation is under ``_STILL`` of that of the input, state or reading that it follows, in
    every record: a lag of years and a limit of no speed hold what was at first.
    """
    like = fit.estimate.prepared[0][0].compiled.traced.like
    still = {own: followed for own, followed in like if owner_of(own) == label}
    for task, settings in fit.estimate.prepared if still else ():
        run = predict_readings(task, settings, fit.estimate.noise, keep=True)
        means = run.means[: run.done, : len(task.states)]
        inputs = sample_inputs(task.inputs, task.series.substeps)
        shown = dict(zip(task.compiled.traced.inputs, inputs.T, strict=True))
        shown |= dict(zip(task.compiled.traced.channels, task.series.y.T, strict=True))
        shown |= dict(zip(task.states, means.T, strict=True))
        still = {
            own: followed for own, followed in still.items()
            if np.std(shown[own]) < _STILL * np.std(shown[followed])
        }  # fmt: skip
    return bool(still)


def innovations(fit: LikelihoodFit) -> tuple[Array, ...]:
    """Whitened innovations (samples, channels) of every record."""
    return tuple(p.whitened for p in fit.estimate.predictions)


def innovation_whiteness(assembly: Assembly, fit: LikelihoodFit) -> Whiteness:
    """The whiteness test of the innovations."""
    return whiteness(innovations(fit), assembly.problem.settings.lags)


def is_white(assembly: Assembly, fit: LikelihoodFit) -> bool:
    """Whether the innovations are white at ``settings.whiteness_level``."""
    return innovation_whiteness(assembly, fit).p >= assembly.problem.settings.whiteness_level


def is_start_settled(assembly: Assembly, fit: LikelihoodFit) -> bool:
    """Whether no other start has anything to find: what is left is small, or is no motion.

    The innovations are white, or their colour is smaller than any effect that counts (in a long
    record any colour is significant); or the model follows the records without correction.
    """
    tested = innovation_whiteness(assembly, fit)
    little = has_little_colour(tested.p, tested.effect, assembly.problem.settings)
    return little or is_uncorrected_motion_right(fit, assembly.problem.settings.chi2_limit)


def is_uncorrected_motion_right(fit: LikelihoodFit, limit: float) -> bool:
    """Whether the model misses hardly more where nothing corrects it.

    At the same values, with white noise as large as the innovations and no random force, the misses
    of every channel have at most ``limit`` times the innovations' energy. What forces and coloured
    noise hide is then smaller than the noise, and other values have nothing larger to find.
    """
    if not fit.estimate.finite:
        return False
    prepared, before = fit.estimate.prepared, _miss_energies(fit.estimate.predictions)
    seen = np.sum([np.sum(p.spreads > 0, axis=0) for p in fit.estimate.predictions], axis=0)
    alone = first_noise(prepared[0][0], LEAST_FORCE, np.sqrt(before / np.maximum(seen, 1)))
    parts = predict_cases([(prepared, alone)])[0]
    held = all(p.whole for p in parts)
    return held and bool(np.all(_miss_energies(parts) <= limit * before))


def _miss_energies(parts: Sequence[Prediction]) -> Array:
    """(channels,) summed squares of what is missed, over all records."""
    return np.sum([np.sum(p.misses**2, axis=0) for p in parts], axis=0)


def net_log_likelihood(fit: LikelihoodFit) -> float:
    """Log-likelihood less Schwarz's penalty of all that moves."""
    return fit.log_likelihood - schwarz_penalty(len(fit.estimate.keys), fit.estimate.prepared)


def schwarz_penalty(parameters: int, prepared: FilterInputs) -> float:
    """Schwarz's penalty of q parameters in log-likelihood: q / 2 log N, with N readings."""
    return 0.5 * parameters * float(np.log(reading_count(prepared)))


def longest(prepared: FilterInputs) -> int:
    """The samples of the longest record."""
    return max((task.series.samples for task, _ in prepared), default=0)


def reading_count(prepared: FilterInputs) -> int:
    """The number N of readings in all records."""
    return sum(task.series.y.size for task, _ in prepared)
