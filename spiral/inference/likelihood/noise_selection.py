"""Selection of the noise model: terms tried one at a time, kept by likelihood.

From white measurement noise and a white random force upwards: coloured measurement noise, noise
behind a low-pass, a sensor that drifts, a force with a correlation time. A term is kept where

    2 (log L_1 - log L_0) > q log N + 2 log(1 / alpha)

q its sizes and times, N the readings (Schwarz's criterion, with odds of 1 / alpha to one); the best
is taken first, until none is worth its penalty. Later, terms that are no longer worth theirs go.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from spiral.engine.filter.noise import driven_states, noise_groups
from spiral.engine.filter.setup import prepare_filter as filter_prepared
from spiral.engine.filter.task import FilterInput, build_task
from spiral.engine.likelihood.fit import MaximumLikelihood, maximise_likelihood
from spiral.engine.likelihood.noise import EXTRA, STEEPEST, NoiseModel, NoiseTerm
from spiral.engine.likelihood.predict import FilterInputs, log_likelihood, predict_cases
from spiral.engine.threads import run_in_threads
from spiral.inference.evidence.assembly import Assembly
from spiral.inference.evidence.horizons import liveliest_stretch, tracked_deviations
from spiral.inference.likelihood.fitting import (
    LITTLE,
    LikelihoodFit,
    continue_fit,
    is_acting,
    is_uncorrected_motion_right,
    is_white,
    longest,
)
from spiral.inference.likelihood.needless_noise import drop_idle_terms, noise_penalty
from spiral.inference.likelihood.noise_terms import (
    GUST_TIMES,
    AdditionalNoise,
    additional_noise_terms,
    initial_correlation_time,
    initial_drift_size,
    vibration_terms,
)
from spiral.inference.problem import DECISIVE_ODDS, Progress
from spiral.types.noise import COLOURED, CORRELATED, FILTERED, FORCES, Kind

_LOOK, _TUNE = 2, 10  # scoring steps of a first look at a term, and of those that keep up
_TUNE_FIRST = 4  # of the latter before a term may be given up
_KEEP = 0.7  # share of the best gain at first look that keeps up
_ROUNDS = 2
_GUST_SIZES = (1e-4, 1e-3, 4e-3, 0.015, 0.05)  # of a gust beside forces that are there already
_SWELL_SIZES = (0.01, 0.1)  # of a force in place of a sensor that rings
_MOST_APART = 6  # states of a group whose forces are told apart: each costs slopes of its own
_MOST_STEEP = 12  # states of a steeper force: with n of them a sample costs n^3


class _TermTrial(NamedTuple):
    """A term fitted briefly: its gain less its penalty, the noise model with it, its kind."""

    gain: float
    noise: NoiseModel
    kind: Kind


def select_noise_model(assembly: Assembly, fit: LikelihoodFit, progress: Progress) -> LikelihoodFit:
    """The fit with the noise model that its records prefer, parameters and sizes refitted together.

    Terms are added only while the innovations are not white. The best of each kind are compared
    after the parameters have followed: values that were fitted beside a random force suit a force,
    and a sensor that drifts is then told as one.
    """
    if not fit.estimate.finite:
        return fit
    begun = fit.estimate.noise.terms
    for _ in range(_ROUNDS):
        if is_white(assembly, fit):
            break
        progress("trying noise models")
        best = _best_additional_terms(fit.estimate)
        if not best:
            break
        fits = _continue_with_each(assembly, fit, best)
        fit = max(fits, key=lambda f: worth_beside(f.estimate, fit.estimate))
    if fit.estimate.finite and not is_white(assembly, fit):
        apart = _best_noise_model(fit.estimate, list(_separate_forces(fit.estimate)))
        fit = fit if apart is None else continue_fit(assembly, fit, apart.noise, rough=True)
    if fit.estimate.finite and fit.estimate.noise.has_kind("vibration"):
        rung = _best_noise_model(fit.estimate, list(_forces_for_vibration(fit.estimate)))
        fit = fit if rung is None else continue_fit(assembly, fit, rung.noise, rough=True)
    if fit.estimate.noise.terms != begun:
        fit = drop_idle_terms(assembly, fit)
    return _select_force_location(assembly, fit)


def _continue_with_each(
    assembly: Assembly, fit: LikelihoodFit, noises: Sequence[NoiseModel]
) -> list[LikelihoodFit]:
    """The fit continued with each of several noise models, the most promising first.

    Others are taken on while their steps promise to be worth as much as the first.
    """
    first, *others = noises
    leader = continue_fit(assembly, fit, first, rough=True)
    at = fit.estimate.prepared

    def follow(noise: NoiseModel) -> LikelihoodFit:
        least = leader.log_likelihood + noise_penalty(noise, leader.estimate.noise, at)
        return continue_fit(assembly, fit, noise, rough=True, least=least)

    return [leader, *run_in_threads(follow, others, longest(at))]


def reselect_noise_model(
    assembly: Assembly, fit: LikelihoodFit, progress: Progress
) -> LikelihoodFit:
    """The fit with its noise model selected once more from white noise, if that is likelier.

    Terms come and go one at a time. One that did the work of an effect (a drift that of a leak)
    stays, where with the effect in the model noise of another kind is right.
    """
    noise = fit.estimate.noise
    if not fit.estimate.finite or not any(noise.has_kind(kind) for kind in EXTRA):
        return fit
    white = noise.replace_with_white(*EXTRA)
    if is_uncorrected_motion_right(fit, assembly.problem.settings.chi2_limit):
        return fit  # none of it does the work of motion
    progress("selecting the noise model anew")
    again = select_noise_model(assembly, continue_fit(assembly, fit, white, rough=True), progress)
    decisive = float(np.log(DECISIVE_ODDS))
    return again if worth_beside(again.estimate, fit.estimate) > decisive else fit


def select_sensor_drift(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with a sensor that drifts, where misses are not white and that is likelier.

    Stretches of a record are too short to show a drift that is slow enough.
    """
    at = fit.estimate
    if not at.finite or is_white(assembly, fit):
        return fit
    task = at.prepared[0][0]
    terms = (NoiseTerm("drift", c) for c in task.compiled.traced.channels)
    drifts = [
        at.noise.with_terms((t,), {t.size: initial_drift_size(task, t.where)})
        for t in terms if t not in at.noise.terms
    ]  # fmt: skip
    best = _best_noise_model(at, drifts)
    return fit if best is None else continue_fit(assembly, fit, best.noise, rough=True)


def _select_force_location(assembly: Assembly, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with a force on one state in place of its group, or a correlated one, if likelier.

    What disturbs one coordinate, or lasts, leaves misses that are white, or nearly, with a white
    force of one size on all of its group too; but then it is no smaller and no other force, and
    candidates are judged beside noise that is not there. It is taken by the same odds. Where
    misses are not white ``_separate_forces`` has been tried.
    """
    for _ in range(_ROUNDS):
        at = fit.estimate
        if not at.finite or not is_white(assembly, fit):
            break
        best = _best_noise_model(at, list(_alternative_forces(at)))
        if best is None:
            break
        fit = continue_fit(assembly, fit, best.noise, rough=True)
    return fit


def _alternative_forces(at: MaximumLikelihood) -> Iterator[NoiseModel]:
    """Noise models in which a force acts on one state of its group alone, or is correlated.

    One that is not small may be another: white on states that no sensor sees, it is coloured where
    it reaches the readings, as a smaller one that lasts is on a state that is measured.
    """
    task, noise = at.prepared[0][0], at.noise
    shared = shared_groups(task)
    for term in (t for t in noise.terms if t.kind in FORCES):
        if not is_acting(task, noise, term):
            continue
        size = noise.values[term.size]
        others = noise.select_terms(t for t in noise.terms if t is not term)
        states = [task.states[i] for i in shared.get(term.where, ())]
        times = {k: v for k, v in noise.values.items() if k in (term.time, term.damping)}
        for one in (replace(term, where=state) for state in states):
            yield others.with_terms((one,), {**times, one.size: size})
        if term.kind in CORRELATED or noise.has_kind("gust"):
            continue
        near = (term.where, *states) if size <= LITTLE else force_places(task)
        for one in (NoiseTerm("gust", where) for where in near):
            yield others.with_terms(
                (one,), {one.size: size, one.time: initial_correlation_time(task, GUST_TIMES[0])}
            )


def _forces_for_vibration(at: MaximumLikelihood) -> Iterator[NoiseModel]:
    """Noise models with a force around the frequency at which a sensor would ring, in its place.

    Through a machine of one coordinate both look much alike.
    """
    noise = at.noise
    others = noise.without("vibration")
    for term in (t for t in noise.terms if t.kind == "vibration"):
        around = {
            "swell.time": noise.values[term.time],
            "swell.damping": noise.values[term.damping],
        }
        for one in (NoiseTerm("swell", where) for where in small_groups(at.prepared[0][0])):
            for size in _SWELL_SIZES:
                yield others.with_terms((one,), {**around, one.size: size})


def small_groups(task: FilterInput) -> tuple[str, ...]:
    """Groups of at most ``_MOST_APART`` states: a force around a frequency has two of each."""
    return tuple(n for n, states in noise_groups(task).items() if len(states) <= _MOST_APART)


def shared_groups(task: FilterInput) -> dict[str, tuple[int, ...]]:
    """Groups of two to ``_MOST_APART`` states, of which a force may act on one alone."""
    return {n: s for n, s in noise_groups(task).items() if 2 <= len(s) <= _MOST_APART}


def force_places(task: FilterInput) -> tuple[str, ...]:
    """Where a random force may act: on all states of a group, or on one of a small group."""
    alone = (task.states[i] for states in shared_groups(task).values() for i in states)
    return (*noise_groups(task), *alone)


def _separate_forces(at: MaximumLikelihood) -> Iterator[NoiseModel]:
    """Noise models with a force on each state, in place of, or beside, one for a group of states.

    What disturbs one coordinate of several (a gust on the cabin, not on the drive) leaves coloured
    misses of all where they share one size, and is not worth a size for all where it acts on one.
    """
    task, noise = at.prepared[0][0], at.noise
    shared = shared_groups(task)
    for term in noise.terms:
        if term.kind not in FORCES or term.where not in shared:
            continue
        size, each = noise.values[term.size], tuple(
            replace(term, where=task.states[i]) for i in shared[term.where]
        )  # fmt: skip
        if is_acting(task, noise, term):
            others = noise.select_terms(t for t in noise.terms if t is not term)
            kept = {k: v for k, v in noise.values.items() if k != term.size}
            yield others.with_terms(each, kept | {t.size: size for t in each})
    for state in (task.states[i] for s in shared.values() for i in s if not noise.has_kind("gust")):
        one = NoiseTerm("gust", state)
        time = initial_correlation_time(task, GUST_TIMES[0])
        begun = _likeliest_size(at, noise.with_terms((one,), {one.time: time}), one.size)
        if begun is not None:
            yield begun


def _likeliest_size(at: MaximumLikelihood, noise: NoiseModel, name: str) -> NoiseModel | None:
    """The noise with the likeliest of a few sizes of one term; nothing where none is likelier.

    Beside sizes that are at their maximum a further term is of use only where the likelihood rises
    with it from zero.
    """
    trials = [noise.with_values({name: size}) for size in _GUST_SIZES]
    best, height = likeliest_noise(at.prepared, trials)
    return best if height > at.log_likelihood else None


def likeliest_noise(
    prepared: FilterInputs, trials: Sequence[NoiseModel]
) -> tuple[NoiseModel, float]:
    """The likeliest of some noise models as they are, and its log-likelihood."""
    parts = predict_cases([(prepared, trial) for trial in trials])
    heights = [log_likelihood(p) for p in parts]
    best = int(np.argmax(heights))
    return trials[best], heights[best]


def _best_additional_terms(at: MaximumLikelihood) -> list[NoiseModel]:
    """The noise with the additional term that gains most beyond its penalty, for each kind of term.

    Terms are looked at on the part of the records that moves most; what keeps up there, and the
    best of each kind, is judged on all, and where noise of a sensor leads its other kinds are, too:
    few steps do not tell a line from a steep low-pass. Where none of it pays for its penalty, the
    best correlated force is judged, too: it begins beside a white one that already does its work,
    and a few steps do not tell what it is worth.
    """
    part = _liveliest_part(at)
    now = maximise_likelihood(part, (), at.noise, steps=_LOOK)

    def look_at(addition: AdditionalNoise) -> _TermTrial:
        trials = [now.noise.with_terms(addition.terms, start) for start in addition.starts]
        look = maximise_likelihood(part, (), trials[0], steps=_LOOK)
        if len(trials) > 1 and look.log_likelihood < now.log_likelihood:
            begin, _ = likeliest_noise(part, trials[1:])
            again = maximise_likelihood(part, (), begin, steps=_LOOK)
            look = max(look, again, key=lambda one: one.log_likelihood)
        gain = look.log_likelihood - noise_penalty(look.noise, at.noise, part) - now.log_likelihood
        return _TermTrial(gain, look.noise, addition.terms[0].kind)

    offered = (*additional_noise_terms(now), *vibration_terms(now))
    looks = run_in_threads(look_at, offered, longest(part))
    best = max(looks, key=lambda x: x.gain, default=None)
    if best is None:
        return []
    leads = {look.kind: look for look in sorted(looks, key=lambda x: x.gain)}
    kept = [
        x for x in looks
        if x.gain > 0 and (
            x.gain >= _KEEP * best.gain or {x.kind, best.kind} <= {*COLOURED} or x is leads[x.kind]
        )
    ]  # fmt: skip
    chosen = _likeliest_of_each_kind(at, kept)
    if not chosen and "gust" in leads and leads["gust"] not in kept:
        chosen = _likeliest_of_each_kind(at, [leads["gust"]])
    return chosen


def _likeliest_of_each_kind(at: MaximumLikelihood, looks: Sequence[_TermTrial]) -> list[NoiseModel]:
    """Of each kind the noise model that gains most on all records, where it does so by the odds.

    The kind that gains most comes first.
    """
    kinds = dict.fromkeys(x.kind for x in looks)
    of_kind = [[x.noise for x in looks if x.kind == kind] for kind in kinds]
    best = run_in_threads(lambda n: _best_noise_model(at, n), of_kind, longest(at.prepared))
    ranked = sorted((b for b in best if b is not None), key=lambda b: -worth_beside(b, at))
    return [b.noise for b in ranked]


def worth_beside(trial: MaximumLikelihood, at: MaximumLikelihood) -> float:
    """Log-likelihood that a fit gains over ``at``, less the penalty of what its noise has more."""
    if not trial.finite:
        return -np.inf
    penalty = noise_penalty(trial.noise, at.noise, at.prepared)
    return trial.log_likelihood - at.log_likelihood - penalty


def _best_noise_model(
    at: MaximumLikelihood, noises: Sequence[NoiseModel]
) -> MaximumLikelihood | None:
    """The noise model that gains most beyond its penalty on all records, if by the odds."""
    chosen, worth, raised = None, float(np.log(DECISIVE_ODDS)), False
    for noise in noises:
        enough = at.log_likelihood + noise_penalty(noise, at.noise, at.prepared) + worth
        steep = any(noise.has_kind(k) > at.noise.has_kind(k) for k in FILTERED)  # may get steeper
        trial = tune_noise(at.prepared, noise, -np.inf if steep else enough)
        trial = raise_filter_order(trial) if steep else trial
        if worth_beside(trial, at) > worth:
            chosen, worth, raised = trial, worth_beside(trial, at), steep
    return chosen if chosen is None or raised else raise_filter_order(chosen)


def tune_noise(
    prepared: FilterInputs, noise: NoiseModel, least: float = -np.inf
) -> MaximumLikelihood:
    """A noise model fitted alone, for a few scoring steps on the whole records.

    ``least`` is the log-likelihood from which it is of use, asked after the first steps.
    """
    begun = maximise_likelihood(prepared, (), noise, steps=_TUNE_FIRST, rough=True)
    if begun.converged or not begun.finite:
        return begun
    steps = _TUNE - _TUNE_FIRST
    return maximise_likelihood(
        prepared, (), begun.noise, steps=steps, rough=True, kept=begun.kept, least=least
    )


def raise_filter_order(at: MaximumLikelihood) -> MaximumLikelihood:
    """The noise with the low-pass or band-pass of the likeliest order; unchanged if it has none.

    Anti-alias filters are of fourth to eighth order. Behind one every further order makes the next
    sample much more certain, which a random force would explain otherwise. So does a band whose
    edges are steep, as of a shaker or of waves.
    """
    for kind in FILTERED:
        while (steeper := tune_next_order(at, kind, 2, STEEPEST)) is not None:
            at = steeper
    return at


def tune_next_order(
    at: MaximumLikelihood, kind: Kind, step: int, highest: int
) -> MaximumLikelihood | None:
    """The noise with terms of one kind of an order higher by ``step``, tuned alone.

    Nothing where there are none, the order or its states are too many, or it is not likelier by the
    odds of any other noise.
    """
    raised = [t for t in at.noise.terms if t.kind == kind]
    if not at.finite or not raised:
        return None
    order, task = raised[0].order + step, at.prepared[0][0]
    pushed = sum(len(driven_states(task, t.where)) for t in raised if kind in FORCES)
    if order > highest or order * pushed > _MOST_STEEP:
        return None
    terms = tuple(replace(t, order=order) if t in raised else t for t in at.noise.terms)
    more = tune_noise(at.prepared, replace(at.noise, terms=terms))
    return more if more.log_likelihood > at.log_likelihood + np.log(DECISIVE_ODDS) else None


def _liveliest_part(at: MaximumLikelihood) -> FilterInputs:
    """The liveliest stretch of the records, at the values of an estimate."""
    r, start, stop = liveliest_stretch([task.series for task, _ in at.prepared])
    task, settings = at.prepared[r]
    if start == 0 and stop == task.series.samples:
        return (at.prepared[r],)
    record = task.series.record.stretch(start, stop)
    short = build_task(
        task.model, task.compiled, task.values.copy(), record, substeps=task.series.substeps
    )
    short = replace(short, moved=task.moved)
    return (filter_prepared(short, settings.tracked, tracked_deviations(settings.tracked)),)
