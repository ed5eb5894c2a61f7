"""The seed fitted from several starts; the likelihood of the whole records decides.

1. the values given, or the balance of forces through the measured motion (``initial_fit_state``),
   hidden states from zero, once more with those of first order from where they rest, and with all
   of them from where a smoother with a wide doubt finds them at these values;
2. a fit on windows of 64 and 256 samples, which bears values that are far off where the motion is
   measured;
3. the first again with process noise ten times smaller and ten times larger to begin with;
4. where values of the best have run away, those held as they were given, and then let go;
5. where noise turns out to be of another kind, or other values may have something to find
   (``is_start_settled``), the first again with the noise that is known by then;
6. where they still may, the best so far with all that is left taken for sensor noise.

Each is taken a few steps, and the most likely one to its maximum; then the others that lead
elsewhere are taken on while their steps promise to come as high, since one that begins nearer may
climb more slowly. The next start is tried only while the best so far does not explain the records
(its fit did not converge, or it needs a random force that is no small one) and no two of them
agree.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from spiral.engine.filter.task import FilterInput, resting_first_state
from spiral.engine.likelihood.fit import ROUGH
from spiral.engine.likelihood.noise import NoiseModel, NoiseTerm, first_noise, size_limits
from spiral.engine.likelihood.predict import (
    FilterInputs,
    Prediction,
    log_likelihood,
    predict_cases,
)
from spiral.engine.series import MOST_STABLE, MOST_SUBSTEPS
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.comparison import last_stage
from spiral.inference.evidence.fit_state import FitState, all_samples, stage_lengths
from spiral.inference.likelihood.excerpts import excerpt_study, whole_state
from spiral.inference.likelihood.fitting import (
    LEVEL,
    WORTH,
    LikelihoodFit,
    continue_fit,
    fit_by_likelihood,
    free_parameters,
    has_noiseless_sensor,
    is_acting,
    is_random_force_small,
    is_start_settled,
    is_white,
    prepare_filter_tasks,
    reading_count,
    required_substeps,
    schwarz_penalty,
)
from spiral.inference.likelihood.initial_states import far_initial_states, refit_initial_states
from spiral.inference.likelihood.needless_noise import drop_needless_noise
from spiral.inference.likelihood.noise_selection import select_noise_model
from spiral.inference.likelihood.noise_terms import initial_drift_size
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.types.noise import CORRELATED, FORCES

_HEAT = 8  # scoring steps of each start
_SAME = 0.02  # log-likelihood a reading up to which two starts have led to one place
_ALIKE = 0.1  # share of a size up to which two fits have the same noise
_WINDOWS = 2  # window lengths of a start from windows
_SHOWN = 0.1  # standard errors by which steps of half the length may move an estimate
_AWAY = 100.0  # factor from the given value beyond which a fitted one has run away
_QUIET = 1e-3  # level of a random force that does next to nothing
_MUCH_FINER = 4  # times as many integration steps as a fit's modes want, from which it takes fewer
_RELAXED = 4.0  # samples over which coloured noise of a sensor is correlated, to begin with


def best_fit(assembly: Assembly, state: FitState, progress: Progress) -> LikelihoodFit:
    """The fit from the most likely of several starts, on sufficiently fine integration steps.

    Of long records the starts are taken on an excerpt, and the records go on from the likeliest.
    """
    if (made := excerpt_study(assembly, state)) is not None:
        part, begun = made
        fit = fit_whole_from_excerpt(assembly, part, best_fit(part, begun, progress), progress)
        if fit.estimate.finite:
            return fit
    tried: list[LikelihoodFit] = []
    for begin, level in _start_states(assembly, state, progress):
        noise = first_noise(prepare_filter_tasks(assembly, begin)[0][0], level)
        fit = fit_by_likelihood(assembly, begin, noise, steps=_HEAT, rough=True)
        agrees = bool(tried) and _lead_to_one_place(fit, _likeliest(tried))
        tried.append(fit)
        if agrees or _explains_records(_likeliest(tried)):
            break
    best = _likeliest(tried)
    best = _likeliest([best, *_refit_runaway_values(assembly, state, best, progress)])
    progress("most likely values of the model as it is")
    fit = fit_by_likelihood(assembly, best.state, rough=True)
    fit = _take_others_on(assembly, fit, [t for t in tried if t is not best])
    return refit_initial_states(assembly, refit_on_wanted_steps(assembly, fit))


def fit_whole_from_excerpt(
    assembly: Assembly, part: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """A fit to an excerpt (``part``) taken on with the whole records, on the steps they want."""
    progress("most likely values for the whole records")
    begun = whole_state(part, fit.state)
    fit = fit_by_likelihood(assembly, begun, fit.estimate.noise, rough=True)
    if not fit.estimate.finite:
        return fit
    return refit_initial_states(assembly, refit_on_wanted_steps(assembly, fit))


def _likeliest(fits: Sequence[LikelihoodFit]) -> LikelihoodFit:
    return max(fits, key=lambda f: f.log_likelihood)


def _explains_records(fit: LikelihoodFit) -> bool:
    return fit.estimate.converged and is_random_force_small(fit)


def _lead_to_one_place(one: LikelihoodFit, other: LikelihoodFit) -> bool:
    apart = abs(one.log_likelihood - other.log_likelihood)
    return apart < _SAME * reading_count(one.estimate.prepared)


def _ends_at_same_values(one: LikelihoodFit, other: LikelihoodFit) -> bool:
    """Whether the values of one fit are those of another, as nearly as rough fits are made.

    By the information I of the other, 1/2 d^T I d is the log-likelihood between them where it is a
    parabola. A value that has run away (a heat capacity of 1e159) has no finite error and costs
    nothing; with it LAPACK would not come to an end.
    """
    at = other.estimate
    if not one.estimate.finite or at.regression is None:
        return False
    apart = np.array([one.estimate.values[k] - v for k, v in at.values.items()])
    inverse = at.regression.inverse[: len(apart)]
    told = np.isfinite(inverse).all(axis=1)
    if not np.isfinite(apart[told]).all():
        return False
    deviations = np.linalg.lstsq(inverse[told], apart[told], rcond=None)[0]
    return 0.5 * float(deviations @ deviations) < 2 * ROUGH * reading_count(at.prepared)


def _take_others_on(
    assembly: Assembly, fit: LikelihoodFit, others: Sequence[LikelihoodFit]
) -> LikelihoodFit:
    """The fit, or that from another start, taken on while its steps promise to come as high."""
    for other in sorted(others, key=lambda f: -f.log_likelihood):
        if other.estimate.finite and not _lead_to_one_place(other, fit):
            again = fit_by_likelihood(
                assembly, other.state, rough=True, least=fit.log_likelihood + WORTH
            )
            fit = again if again.log_likelihood > fit.log_likelihood + WORTH else fit
    return fit


def _refit_runaway_values(
    assembly: Assembly, state: FitState, fit: LikelihoodFit, progress: Progress
) -> list[LikelihoodFit]:
    """The fit with runaway values first held and then freed, as a list; empty without runaways.

    A value far beyond what was given (a heat capacity without end) has no slope left there, and
    others make up for it. It is held as given while the others find theirs, and then let go.
    """
    lost = far_from_given(assembly, fit.state, _AWAY)
    if not lost:
        return []
    progress("starting again with runaway values held")
    holding = replace(state, held=(*state.held, *lost))
    noise = first_noise(prepare_filter_tasks(assembly, holding)[0][0], LEVEL)
    first = fit_by_likelihood(assembly, holding, noise, rough=True)
    if not first.estimate.finite:
        return []
    free = replace(first.state, held=state.held)
    return [fit_by_likelihood(assembly, free, noise, rough=True)]


def far_from_given(assembly: Assembly, state: FitState, factor: float) -> tuple[str, ...]:
    """The free parameters that are by more than a factor larger or smaller than they were given."""
    known, index = assembly.problem.model.given_values, assembly.study.index
    keys = [k for k in free_parameters(assembly, state) if known.get(k)]
    shares = {k: float(state.values[0, index(k)]) / known[k] for k in keys}
    return tuple(k for k, x in shares.items() if not 1 / factor <= x <= factor)


def is_noise_settled(assembly: Assembly, fit: LikelihoodFit) -> bool:
    """Whether sensor noise alone has nothing to find: no start has, and every sensor has noise."""
    return is_start_settled(assembly, fit) and not has_noiseless_sensor(fit)


def _ends_beside_same_noise(one: LikelihoodFit, other: LikelihoodFit) -> bool:
    """Whether two fits lead to one place, with noise of the same terms and nearly the same sizes.

    What differs then is how far they have crept along a valley of the likelihood.
    """
    task, mine, others = one.estimate.prepared[0][0], one.estimate.noise, other.estimate.noise
    if mine.terms != others.terms or not _lead_to_one_place(one, other):
        return False
    return all(
        abs(size - others.values[name])
        <= _ALIKE * max(size, others.values[name]) + size_limits(task, name)[0] / _ALIKE
        for name, size in mine.values.items()
    )


def restart_from_sensor_noise(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress, begun: LikelihoodFit | None = None
) -> LikelihoodFit:
    """The fit restarted with all of its residual taken for sensor noise, if that is likelier.

    Noise of a sensor and a random force on what it measures look alike over few samples: a fit may
    end where one of them does the work of the other, and what is left is then not white, or white
    beside a sensor without any noise. Noise that is not white looks like motion, so the noise model
    is selected from there as well; but not where that is the place from which it was selected
    before (``begun``).
    """
    if not fit.estimate.finite or is_noise_settled(assembly, fit):
        return fit
    progress("starting again with sensor noise alone")
    again = fit_by_likelihood(assembly, fit.state, sensor_noise_only(fit), rough=True)
    if begun is not None and _ends_beside_same_noise(again, begun):
        return fit
    if not is_white(assembly, again):
        again = select_noise_model(assembly, again, progress)
    fewer = len(fit.estimate.noise.names) - len(again.estimate.noise.names)
    gain = again.log_likelihood - fit.log_likelihood
    return again if gain + schwarz_penalty(max(fewer, 0), fit.estimate.prepared) > 0 else fit


def restart_without_forces(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit with noise of a sensor that has a memory in place of all random forces, if likelier.

    A slow state that is pushed at random and a sensor of it that drifts both wander; a state that
    relaxes under a random flow and coloured noise of its sensor look much alike. Beside either
    the misses are white, and values that were fitted beside the one do not suit the other, so that
    they are fitted with it. It has to be likelier by the odds of any other noise, and fewer sizes
    are no merit: beside a missing effect forces leave more room for it than a sensor does.
    """
    at = fit.estimate
    task, noise = at.prepared[0][0], at.noise
    forces = [t for t in noise.terms if t.kind in FORCES]
    if not any(is_acting(task, noise, t) for t in forces) or not is_white(assembly, fit):
        return fit
    least = {t.size: size_limits(task, t.size)[0] for t in forces if t.kind == "force"}
    still = noise.without(*CORRELATED).with_values(least)
    enough = fit.log_likelihood + float(np.log(DECISIVE_ODDS))
    best = fit
    for term, sizes in _sensor_memories(task, sensor_noise_only(fit)):
        if term in noise.terms:
            continue
        what = "a drift" if term.kind == "drift" else "coloured noise"
        progress(f"trying {what} of sensor {term.where} in place of random forces")
        other = still.with_terms((term,), sizes)
        again = continue_fit(assembly, fit, other, rough=True, least=enough)
        if again.log_likelihood > max(enough, best.log_likelihood) and is_white(assembly, again):
            best = again
    return best


def _sensor_memories(
    task: FilterInput, alone: NoiseModel
) -> Iterator[tuple[NoiseTerm, dict[str, float]]]:
    """Noise of each sensor that has a memory, and sizes to begin with.

    ``alone`` : white noise of the sensors that makes up for all that the model misses.
    """
    for channel in task.compiled.traced.channels:
        drift, coloured = NoiseTerm("drift", channel), NoiseTerm("coloured", channel)
        yield drift, {drift.size: initial_drift_size(task, channel)}
        size, time = alone.values[f"white.{channel}"], _RELAXED * task.series.dt
        yield coloured, {coloured.size: size, coloured.time: time}


def with_given_values(assembly: Assembly, state: FitState) -> FitState | None:
    """The state with its free parameters at the given values; nothing where none was given.

    Its integration steps are those of the study, which suit these values.
    """
    known = assembly.problem.model.given_values
    keys = [k for k in free_parameters(assembly, state) if np.isfinite(known.get(k, np.nan))]
    values = state.values.copy()
    for key in keys:
        values[:, assembly.study.index(key)] = known[key]
    given = replace(state, values=values, starts=None, spreads=None, substeps=1)
    return given if keys else None


def restart_from_given_values(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit restarted from the given values with the noise known by now, if that is likelier.

    While noise of a kind that nobody knows yet (a sensor that drifts) looks like motion, values may
    go where they explain it (an absorber that does not move) and do not come back by themselves.
    Neither does a value that ran away (a stiffness without end) while an effect was missing. Its
    forces are as they are by now, and as a first start has them; the noise model is selected from
    the likelier end. Nothing is tried where the model explains the records beside white noise with
    values that are no hundred times the given ones.
    """
    at = fit.estimate
    usual = all(term.kind in ("white", "force") for term in at.noise.terms)
    given = with_given_values(assembly, fit.state)
    explained = usual and is_random_force_small(fit) and is_start_settled(assembly, fit)
    if (
        not at.finite
        or given is None
        or (explained and not far_from_given(assembly, fit.state, _AWAY))
    ):
        return fit
    progress("starting again from the values given, with the noise that is known by now")
    first = first_noise(at.prepared[0][0], LEVEL)
    noises = (at.noise, at.noise.with_values(first.values))
    fits = [
        fit_by_likelihood(assembly, given, noise, rough=True, like=at.prepared) for noise in noises
    ]
    again = max(fits, key=lambda f: f.log_likelihood)
    if not _ends_at_same_values(again, fit):
        again = select_noise_model(assembly, again, progress)
    if not again.log_likelihood > fit.log_likelihood + WORTH:
        return fit
    return drop_needless_noise(assembly, refit_initial_states(assembly, again), progress)


def sensor_noise_only(fit: LikelihoodFit) -> NoiseModel:
    """A noise model of sensor noise alone, as large as the nearly uncorrected model's error."""
    prepared = fit.estimate.prepared
    little_noise = first_noise(prepared[0][0], _QUIET, prepared[0][0].series.y.std(axis=0))
    parts = predict_cases([(prepared, little_noise)])[0]
    seen = parts if all(p.whole for p in parts) else fit.estimate.predictions
    misses = np.concatenate([p.misses for p in seen])
    return first_noise(prepared[0][0], _QUIET, np.sqrt(np.mean(misses**2, axis=0)))


def white_noise_only(fit: LikelihoodFit) -> NoiseModel:
    """White noise of the sensors without any random force, beside which a model runs freely."""
    noise = sensor_noise_only(fit)
    return noise.select_terms(t for t in noise.terms if t.kind == "white")


def refit_on_wanted_steps(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit on integration steps as its motion and the likelihood want them.

    Its fastest mode along the motion wants steps of some length; values on the way here may have
    wanted much shorter ones, which cost as much more time. What is passed between samples (a
    friction's width) may want shorter ones: steps are halved as long as that alone, with the same
    values, makes the records likelier. What coarse steps do wrong is otherwise taken for noise.
    """
    if not fit.estimate.finite:
        return fit
    wanted, steps = required_substeps(fit), fit.estimate.prepared[0][0].series.substeps
    least = assembly.study.series[0].substeps
    if wanted > steps or _MUCH_FINER * max(wanted, least) <= steps:
        fit = _refit_with_steps(assembly, fit, wanted)
    while (halved := _likelier_steps(assembly, fit)) is not None:
        again = _refit_with_steps(assembly, fit, halved)
        if not again.log_likelihood > fit.log_likelihood:
            break
        fit = again
    return fit


def without_noise_of_steps(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit on the steps that it wants, without noise that made up for coarser ones."""
    again = refit_on_wanted_steps(assembly, fit)
    return fit if again is fit else drop_needless_noise(assembly, again, progress)


def _refit_with_steps(assembly: Assembly, fit: LikelihoodFit, substeps: int) -> LikelihoodFit:
    """The fit continued with so many integration steps per sample, where it stays finite."""
    finer_state = replace(fit.state, substeps=substeps)
    again = fit_by_likelihood(assembly, finer_state, rough=True)
    if not again.estimate.finite:  # sizes of its noise may mean something else: on the same scales
        again = fit_by_likelihood(assembly, finer_state, rough=True, like=fit.estimate.prepared)
    return again if again.estimate.finite else fit


def _likelier_steps(assembly: Assembly, fit: LikelihoodFit) -> int | None:
    """Integration steps halved for as long as a fit's own values get likelier; nothing if never."""
    likeliest, best, like = None, fit.log_likelihood, fit.estimate.prepared
    steps = 2 * like[0][0].series.substeps
    while trial := _predict_on_steps(assembly, fit, steps, MOST_STABLE, like):
        if not log_likelihood(trial) > best + WORTH:
            break
        likeliest, best, steps = steps, log_likelihood(trial), 2 * steps
    return likeliest


def _predict_on_steps(
    assembly: Assembly, fit: LikelihoodFit, steps: int, most: int, like: FilterInputs | None = None
) -> tuple[Prediction, ...]:
    """The records predicted with so many integration steps per sample, at the same values.

    No predictions where that are more than ``most``, or where the filter runs away. ``like`` as in
    ``prepare_filter_tasks``.
    """
    if steps > most:
        return ()
    state = replace(fit.state, substeps=steps)
    trial = predict_cases([(prepare_filter_tasks(assembly, state, like), fit.estimate.noise)])[0]
    return trial if all(p.whole for p in trial) else ()


def refine_integration_steps(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit on integration steps whose error is negligible in every parameter.

    Steps of half the length change the whitened misses by d, and with them the estimates by
    V X^T d, X the misses' slopes and V the inverse of their information; where that is a share of a
    standard error that counts, the fit goes on with the shorter ones.
    """
    while fit.estimate.finite and fit.estimate.keys:
        at, keys, solved = fit.estimate, fit.estimate.keys, fit.estimate.regression
        steps = 2 * at.prepared[0][0].series.substeps
        trial = _predict_on_steps(assembly, fit, steps, MOST_SUBSTEPS)
        if solved is None or not trial:
            break
        inverse = solved.inverse[: len(keys)]
        pulled = sum(
            (np.einsum("kjp,kj->p", p.columns, (t.misses - p.misses) * p.weight)
             for p, t in zip(at.predictions, trial, strict=True)), np.zeros(len(keys)),
        )  # fmt: skip
        moved = np.abs(inverse @ (inverse.T @ pulled)) / np.array(list(at.errors.values()))
        if not np.max(moved) > _SHOWN:
            break
        again = fit_by_likelihood(assembly, replace(fit.state, substeps=steps), at.noise)
        if not again.estimate.finite:
            break
        fit = again
    return fit


def _start_states(
    assembly: Assembly, state: FitState, progress: Progress
) -> Iterator[tuple[FitState, float]]:
    progress("starting from the values given")
    yield state, LEVEL
    tasks = [task for task, _ in prepare_filter_tasks(assembly, state)]
    far = far_initial_states(assembly, state, first_noise(tasks[0], LEVEL))
    if far is not None:
        progress("starting again with hidden states from where they may have begun")
        yield far, LEVEL
    rests = [resting_first_state(task) for task in tasks]
    if all(x is not None for x in rests):
        progress("starting again with hidden states at rest")
        starts = tuple(x for x in rests if x is not None)
        yield replace(state, starts=starts, spreads=None), LEVEL
    progress("starting again from short windows")
    near = _fit_on_windows(assembly, state)
    if near is not None:
        yield near, LEVEL
    for factor in (0.1, 10.0):
        progress("starting again with another random force")
        yield state, LEVEL * factor


def _fit_on_windows(assembly: Assembly, state: FitState) -> FitState | None:
    lengths = [n for n in stage_lengths(assembly) if n >= state.shortest][:_WINDOWS]
    stage = last_stage(assembly, state, all_samples(assembly), lengths)
    values = stage.fitted.point.values
    if not np.all(np.isfinite(values)):
        return None
    return replace(state, values=values)
