"""Comparison of a model fitted by likelihood: free runs, chi2, whiteness of its innovations.

A free run begins where a smoother has the states at the first sample: over the whole of a fitted
record, over the settling part of a test record. Its start is then refined by least squares over
that stretch, where this lowers the error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from spiral.engine.filter.extended import FilterSettings
from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.fit import MaximumLikelihood
from spiral.engine.likelihood.free_spread import free_spread, independent_values
from spiral.engine.likelihood.free_uncertainty import doubt_along_readings, free_doubt
from spiral.engine.likelihood.hidden_force import hidden_force_spread, larger_forces
from spiral.engine.likelihood.noise import NoiseModel, noise_matrices, sensor_autocovariance
from spiral.engine.likelihood.predict import predict_readings
from spiral.engine.resting import state_jacobian
from spiral.inference.disturbances import input_sentences
from spiral.inference.evidence.assembly import Assembly, to_model
from spiral.inference.evidence.comparison import settling_seconds, with_test_records
from spiral.inference.evidence.fit_state import FitState
from spiral.inference.evidence.free_run import FreeRun
from spiral.inference.evidence.horizons import (
    Forecaster,
    errors_at_horizons,
    filter_task,
    misses_ahead,
    tracked_deviations,
)
from spiral.inference.likelihood.departures import (
    describe_departures,
    far_value_sentences,
    reversed_sign_sentences,
)
from spiral.inference.likelihood.exogenous import followed_force_sentences
from spiral.inference.likelihood.fitting import (
    LikelihoodFit,
    apply_integration_settings,
    innovation_whiteness,
    innovations,
    is_white,
    with_tracked_values,
)
from spiral.inference.likelihood.free_fit import (
    FREE_RUN_VALUES_NOTE,
    free_run_sentences,
    refit_by_free_run,
)
from spiral.inference.likelihood.free_run_starts import (
    free_runs,
    tracked_nuisances,
    usual_states,
)
from spiral.inference.likelihood.independence import motion_explained_share
from spiral.inference.likelihood.initial_states import set_likely_initial_state
from spiral.inference.likelihood.reported_noise import ReportedNoise
from spiral.inference.likelihood.stand_ins import one_law_sentences, several_causes_sentences
from spiral.inference.likelihood.timescales import time_scale_sentences
from spiral.inference.problem import Problem, Progress
from spiral.types.horizon import Horizon
from spiral.types.model import Model, correlations_by_name
from spiral.types.noise import NOISE_LAGS, STATIONARY, estimate_noise, expected_noise_estimate
from spiral.types.record import Array, Record
from spiral.types.run import Comparison, Traces

_PERIODS = 3  # of the slowest mode that tell where a record begins
_STILL = 1e-6  # share of the fastest rate under which a mode does not move
_AGREE = 1.25  # ratio within which two estimates of the noise agree


def compare_by_likelihood(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress, halves_agree: bool = True
) -> tuple[FitState, Comparison]:
    """The comparison of a fit with its records, and its state with what belongs to each record.

    Noise and residuals are reported for the most likely values; the model that is shown predicts
    with those of ``refit_by_free_run``, to which ``halves_agree`` is passed.
    """
    estimate, free = fit.estimate, refit_by_free_run(assembly, fit, progress, halves_agree)
    state = with_tracked_values(fit) if estimate.finite else fit.state
    shown = state if free is fit else with_tracked_values(free)
    model = _fitted_model(assembly, shown, free.estimate)
    assembly = apply_integration_settings(assembly, state)
    progress("free run on the test record")
    own, starts = free_runs(assembly, shown, model, None, None)
    names, run, seen, tested = model.system.observed, own, {}, ()
    other = with_test_records(assembly, shown.values)
    if other is not None:
        settle = _settling_time(other, state.settle, free.estimate.prepared[0][0])
        state, shown = replace(state, settle=settle), replace(shown, settle=settle)
        run, starts, unseen = _test_run(other, shown, model, free.estimate, assembly)
        seen, tested = {"unseen": unseen}, run.predicted
    carried = _free_run_uncertainty(
        other or assembly, model, run, starts, free.estimate, estimate.noise
    )
    reported = ReportedNoise(estimate)
    floor = _relative_noise_floor(reported, names, run, other or assembly)
    told = followed_force_sentences(fit) if carried.forces > floor else ()
    return state, Comparison(
        model=model,
        fit_error=_mean_error(own, names),
        test_error=_mean_error(run, names),
        channels=run.errors(names),
        noise_floor=floor,
        horizon=max(s.samples for s in assembly.study.series),
        converged=estimate.converged,
        **_note_fields(assembly.problem, state, model, fit, free, told),
        noise_ratio=_declared_noise_ratio(assembly.problem.records, state.noise),
        **seen,
        **_residual_fields(assembly, fit, own),
        **_noise_fields(assembly, fit, model, reported, carried, run, floor),
        uncertain=0.0 if other is None else carried.doubts,
        traces=Traces(own.predicted, tested, run.settled[0], innovations(fit)),
    )


def _noise_fields(
    assembly: Assembly, fit: LikelihoodFit, model: Model, reported: ReportedNoise,
    carried: _FreeRunTolerance, run: FreeRun, floor: float,
) -> dict[str, Any]:  # fmt: skip
    """Fields of the comparison: noise sizes, departures from the model."""
    sizes, times = reported.sizes(carried.forces, floor)
    white = fit.estimate.finite and is_white(assembly, fit)
    return {
        "random": sizes,
        "random_times": times,
        "disturbed": carried.forces,
        "disturbed_values": carried.values,
        "driven_unseen": all(task.is_driven_unseen for task, _ in fit.estimate.prepared),
        "drifting": reported.error_in_free_run(run),
        "departures": (
            *describe_departures(model, fit.estimate, white, sizes),
            *reported.offsets(model.system),
            *far_value_sentences(fit.estimate, assembly.problem.model.given_values),
        ),
    }


def _fitted_model(assembly: Assembly, state: FitState, estimate: MaximumLikelihood) -> Model:
    """The model of a state, with the standard errors of an estimate."""
    together = correlations_by_name(estimate.keys, estimate.covariance)
    return to_model(
        assembly, state.labels, state.values, estimate.errors, state.freed, state.held, together
    )


def _test_run(
    other: Assembly, state: FitState, model: Model, estimate: MaximumLikelihood, fitted: Assembly
) -> tuple[FreeRun, tuple[Array, ...], tuple[Horizon, ...]]:
    """The free run on the test records, its initial states, and errors at all horizons."""
    run, starts = free_runs(other, state, model, state.settle, usual_states(estimate), fitted)
    forecaster = _make_forecaster(state, tracked_nuisances(other, state, model), starts, estimate)
    return run, starts, errors_at_horizons(other, model, run, forecaster)


def _note_fields(
    problem: Problem, state: FitState, model: Model, fit: LikelihoodFit, free: LikelihoodFit,
    told: tuple[str, ...],
) -> dict[str, Any]:  # fmt: skip
    """Fields of the comparison: notes on records and values, bad samples, input interpolation.

    ``free`` is the fit whose values are shown, in place of ``fit`` where it predicts far better;
    ``told`` what else contradicts the noise.
    """
    about = (model.system.report, *(n for r in problem.records for n in r.remarks))
    said = (*filter(None, about), *input_sentences(state.between))
    given = problem.model.given_values
    return {
        "notes": said if free is fit else (*said, FREE_RUN_VALUES_NOTE),
        "contradictions": (
            *time_scale_sentences(fit.estimate.prepared[0][0], given),
            *reversed_sign_sentences(model, given),
            *several_causes_sentences(model, problem.model.labels),
            *one_law_sentences(model, problem.model.labels),
            *(far_value_sentences(free.estimate, given) if free is not fit else ()),
            *free_run_sentences(fit, free),
            *told,
        ),
        "spoilt": problem.spoilt_sentences(),
        "between": dict(state.between),
    }


@dataclass(frozen=True)
class _FreeRunTolerance:
    """Error that a free run may have, over the deviations of its readings, mean over channels.

    ``forces`` that act at random, which make as many independent ``values``; ``doubts`` of values,
    starts, and forces too small to be seen.
    """

    forces: float = 0.0
    values: float = 1.0
    doubts: float = 0.0


def _free_run_uncertainty(
    other: Assembly, model: Model, run: FreeRun, starts: tuple[Array, ...],
    estimate: MaximumLikelihood, noise: NoiseModel,
) -> _FreeRunTolerance:  # fmt: skip
    """The uncertainty of the free runs ``run``, one for each record of a study, from ``starts``.

    Random forces are those of ``noise``; the uncertainty of values is that of ``estimate``.
    """
    if not estimate.finite:
        return _FreeRunTolerance()
    fitted, spreads, forces, doubts = estimate.prepared[0][0], [], [], []
    larger = larger_forces(estimate)
    for r, series in enumerate(other.study.series):
        begin = starts[r][0][: len(fitted.states)]
        task = filter_task(other, model, run.values[r], series.record, series.substeps, fitted)
        first = run.settled[r]
        own, settings = filter_prepared(replace(task, moved=tuple(estimate.keys)), ())
        settings = replace(settings, start=begin)
        spreads.append(free_spread(own, settings, noise, first))
        spread = spreads[-1].rms
        forces.append(spread[first:] ** 2)
        values = free_doubt(task, begin, estimate.keys, estimate.covariance, estimate.noise, first)
        if run.is_lost(r) and estimate.keys:
            doubting = _doubting_filter(task, (), _told_errors(estimate), estimate)
            grown = doubt_along_readings(*doubting, estimate.noise, first)
            values = np.maximum(values, grown)
        known = (
            spread if estimate.noise is noise else free_spread(own, settings, estimate.noise).rms
        )
        unseen = hidden_force_spread(own, settings, known, larger)[first:]
        doubts.append(values**2 + unseen**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        made, doubted = (
            float(np.mean(np.sqrt(np.mean(np.concatenate(parts), axis=0)) / run.deviations()))
            for parts in (forces, doubts)
        )
    return _FreeRunTolerance(made, independent_values(spreads), doubted)


def _residual_fields(assembly: Assembly, fit: LikelihoodFit, own: FreeRun) -> dict[str, float]:
    """Chi2 and whiteness of the innovations, and what of them follows the motion, by name.

    ``own`` : the free run of the fitted records.
    """
    estimate = fit.estimate
    chi2 = estimate.chi2 if estimate.finite else np.inf
    told = {"chi2_per_dof": chi2, "innovation_chi2": chi2}
    if not estimate.finite:
        return told | {"whiteness_p": 0.0, "whiteness_effect": np.inf}
    seen = innovation_whiteness(assembly, fit)
    shares = _innovation_shares(estimate)
    told |= {"whiteness_p": seen.p, "whiteness_effect": seen.effect * min(_mean(shares), 1.0)}
    if seen.p >= assembly.problem.settings.whiteness_level:
        return told
    followed = motion_explained_share(fit, own) * np.minimum(shares, 1.0)
    return told | {"followed": float(followed.max())}


def _settling_time(other: Assembly, known: float | None, task: FilterInput) -> float:
    """Seconds of each test record from which its initial state is estimated.

    Those known, or asked for, else a tenth of the shortest record, or three periods of the model's
    slowest mode where that is more, up to a third.
    """
    if known is not None:
        return known
    asked = settling_seconds(other)
    if other.problem.settle is not None:
        return asked
    matrix = state_jacobian(task.compiled, task.values, task.mean_inputs, task.centre)
    sizes = np.abs(np.linalg.eigvals(matrix))
    sizes = sizes[sizes > _STILL * sizes.max(initial=0.0)]
    slowest = 2 * np.pi / float(sizes.min()) if len(sizes) else 0.0
    shortest = min(r.samples * r.dt for r in other.problem.test)
    return float(max(asked, min(_PERIODS * slowest, shortest / 3)))


def _make_forecaster(
    state: FitState,
    tracked: tuple[str, ...],
    starts: tuple[Array, ...],
    estimate: MaximumLikelihood,
) -> Forecaster:
    """A forecaster: the filter with the noise of a fit, started from where free runs start.

    It knows the parameters only as well as the fit does, whose errors go together: of a machine
    that integrates, a value that is off within its error would else carry it away from readings
    that it no longer listens to.
    """
    noise = state.noise
    assert noise is not None
    told = _told_errors(estimate)

    def forecast(record: int, task: FilterInput, first: int, steps: int) -> tuple[Array, Array]:
        if begins := bool(np.all(np.isfinite(starts[record]))):
            task = replace(task, start=starts[record][0].copy())
            task = task if tracked else set_likely_initial_state(task, noise)
        for errors in (told, {}) if told else ({},):  # sure of its values where it runs away else
            own, settings = _doubting_filter(task, tracked, errors, estimate)
            if begins:
                settings = replace(settings, start=task.start)
            run = predict_readings(own, settings, noise, keep=True)
            if run.whole:
                parts = noise_matrices(own, settings, noise)
                remembered = parts.seen @ np.linalg.matrix_power(parts.phi, steps)
                return run.misses[first:], misses_ahead(
                    own, settings, run.means, first, steps, remembered
                )
        lost = np.full((task.series.samples - first, task.series.y.shape[1]), np.inf)
        return lost, lost

    return forecast


def _told_errors(estimate: MaximumLikelihood) -> dict[str, float]:
    """Standard errors of the values that are larger than these."""
    values = estimate.values
    return {k: e for k, e in estimate.errors.items() if 0 < e < abs(values[k])}


def _doubting_filter(
    task: FilterInput, tracked: tuple[str, ...], errors: Mapping[str, float],
    estimate: MaximumLikelihood,
) -> tuple[FilterInput, FilterSettings]:  # fmt: skip
    """A filter that doubts values of a fit by their ``errors``, together as the fit does.

    ``tracked`` : parameters of the record, which it tracks as well.
    """
    known = {**tracked_deviations(tracked), **errors}
    own, settings = filter_prepared(task, (*tracked, *errors), known)
    return own, replace(settings, correlation=_error_correlation(estimate, settings.tracked))


def _error_correlation(estimate: MaximumLikelihood, names: tuple[str, ...]) -> Array:
    """(names, names) correlation of the errors of a fit; none with what the fit did not move."""
    together = np.eye(len(names))
    known = [i for i, name in enumerate(names) if name in estimate.keys]
    at = [estimate.keys.index(names[i]) for i in known]
    part = estimate.covariance[np.ix_(at, at)]
    spread = np.sqrt(np.diag(part))
    if np.all(np.isfinite(part)) and np.all(spread > 0):
        together[np.ix_(known, known)] = part / np.outer(spread, spread)
    return together


def _relative_noise_floor(
    reported: ReportedNoise, names: Sequence[str], run: FreeRun, judging: Assembly
) -> float:
    """Measurement noise over the deviation of each channel, mean over channels.

    The fitted noise is scaled by the ratio of model-free noise estimates, test records over fitted
    records (a sensor may be noisier there, or less so), where the model-free estimate agrees with
    what it would tell of the fitted noise, so that it is reliable. Noise that grows with its
    reading is as large as the readings of the test records make it.
    """
    noise, task = reported.estimate.noise, reported.estimate.prepared[0][0]
    sizes, problem = [], judging.problem
    for j, name in enumerate(names):
        fitted = reported.sensor_deviation(name)
        grown = [
            s.grown[first:, j].mean()
            for s, first in zip(judging.study.series, run.settled, strict=True)
            if s.grown is not None
        ]
        if grown:
            white = noise.values.get(f"white.{name}", 0.0) ** 2
            sizes.append(np.sqrt(fitted**2 + white * (np.mean(grown) - 1)))
            continue
        told = expected_noise_estimate(sensor_autocovariance(task, noise, name, NOISE_LAGS))
        sizes.append(fitted * _noisier_in_test(problem, name, told))
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.mean(np.array(sizes) / run.deviations()))


def _noisier_in_test(problem: Problem, name: str, told: float) -> float:
    """Noise of a channel, test over fitted records, by estimates without a model; 1 if unreliable.

    They are reliable where they tell of the fitted records what is ``told`` of the fitted noise.
    """
    for robust in (False, True):
        there, here = (
            np.sqrt(np.mean([_channel_noise(r, name, robust) ** 2 for r in records]))
            for records in (problem.test or problem.records, problem.records)
        )
        if told > 0 and 1 / _AGREE <= here / told <= _AGREE:
            return float(there / here)
    return 1.0


def _channel_noise(record: Record, name: str, robust: bool) -> float:
    """Noise of a channel, declared, or estimated without a model."""
    if not robust or record.noise.get(name):
        return record.sigma()[name]
    return estimate_noise(record.valid_reading(name), robust=True)


def _declared_noise_ratio(records: Sequence[Record], noise: NoiseModel | None) -> float | None:
    """Fitted white noise over what the records declare, rms over channels; nothing if none do."""
    assert noise is not None
    ratios = [
        noise.values[f"white.{name}"] / declared
        for r in records
        for name, declared in r.noise.items()
        if declared
    ]
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None


def _innovation_shares(estimate: MaximumLikelihood) -> Array:
    """(channels,) variance of the misses over that of the sensor's noise.

    Coloured noise that its own past predicts leaves small misses: what is left of its colour in
    them, or follows the motion, is a share of these, and as much smaller a share of the noise.
    """
    task, noise = estimate.prepared[0][0], estimate.noise
    shares = []
    for j, name in enumerate(task.compiled.traced.channels):
        misses = np.concatenate([p.misses[:, j] for p in estimate.predictions])
        size = sum(noise.values.get(f"{k}.{name}", 0.0) ** 2 for k in STATIONARY)
        shares.append(float(np.mean(misses**2)) / size if size > 0 else 1.0)
    return np.array(shares)


def _mean_error(run: FreeRun, names: tuple[str, ...]) -> float:
    """Relative error of a free run, mean over channels."""
    return _mean(e.relative for e in run.errors(names).values())


def _mean(values) -> float:
    return float(np.mean(list(values)))
