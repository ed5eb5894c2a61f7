"""Maximum likelihood of one-step predictions over parameters and the sizes of the noise together.

With e the whitened misses, X = d / s^(1/2) their slopes by parameters, and by the logarithm of a
size of the noise a: l = d log s / da, w = (d miss / da) / s^(1/2) (forward differences), the
scoring step solves

    |e - X dp + w da|^2 + |(e^2 - 1) / 2^(1/2) - l da / 2^(1/2)|^2 -> min

whose normal equations are the likelihood's slope and its expected information. Steps are damped
(Levenberg and Marquardt) until the likelihood rises. A pass of the filter has X with its gains
held. What is missing there is by differences, one pass each; the slopes by sizes are those of a
filter that is linear along the motion (``vary_noise``). Both change slowly and are kept from
step to step (``SlopeCache``), until a step promises more than it keeps; where sizes alone move,
each step corrects their slopes.

A model that lacks something starts with much process noise, and with it the filter follows the
record however wrong the model is; as parameters find their values the noise falls, and predictions
are judged ever more by the model.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.leastsquares import Fit, solve_triangle, triangle
from spiral.engine.likelihood.information import regression_rows, widening_factors
from spiral.engine.likelihood.noise import NoiseModel, size_limits
from spiral.engine.likelihood.predict import (
    RUNAWAY,
    FilterInputs,
    Masks,
    Prediction,
    log_likelihood,
    predict_cases,
    vary_noise,
)
from spiral.engine.likelihood.slope_cache import SlopeCache, size_slopes
from spiral.engine.likelihood.steps import drop_bounded_columns, next_damped_step
from spiral.engine.score import residual_block_samples
from spiral.engine.threads import run_in_threads
from spiral.physics.lanes import LANES
from spiral.types.record import Array

_DIFFERENCE = 0.05  # of the logarithm of a size, for its slopes
_GROWTH = 4.0  # factor by which a value that cannot be negative grows in one step, at most
_LARGEST = 2.0  # most that the logarithm of a size moves in one step
_ENOUGH = 0.02  # log-likelihood that is not worth another step
ROUGH = 5e-4  # log-likelihood for each reading
_FLOOR = 1.01  # times its least value up to which a size stays there
_MOVE = 1e-3  # standard deviations that whitened misses move in a difference
_TRUE = 0.5  # ratio of gain and promised gain (either way) from which slopes are good enough
_WELL = 0.75  # share of it from which damping falls twice as fast
_STALE = 0.7  # move of the logarithm of a size after which slopes by sizes are made anew
_FRESH = 0.2  # of the same, up to which they count as made here
_DAMPING, _EASE, _STRAIN, _TRIES = 1e-3, 0.2, 10.0, 8
_VAIN = 0.05  # share of ``enough`` that a step must promise to be tried


@dataclass(frozen=True)
class MaximumLikelihood:
    """The maximum of the likelihood, and what was found there.

    Fields
    ------
    prepared : the records at the most likely values.
    noise : the noise model with its most likely sizes.
    keys : the parameters that moved.
    predictions : of every record, with their slopes by ``keys``.
    regression : the last scoring regression, whose inverse is that of the information.
    converged : whether no step was worth more.
    steps : how many were taken.
    sizes : of the noise, that the regression has.
    kept : slopes that a further search may begin with.
    widened : factors on the standard errors, by how much blocks of the record differ.
    """

    prepared: FilterInputs
    noise: NoiseModel
    keys: tuple[str, ...]
    log_likelihood: float
    predictions: tuple[Prediction, ...]
    regression: Fit | None
    converged: bool
    steps: int
    sizes: tuple[str, ...] = ()
    kept: SlopeCache = field(default_factory=SlopeCache)
    widened: tuple[float, ...] = ()

    @property
    def finite(self) -> bool:
        """Whether the filter stayed with every record."""
        return self.log_likelihood > RUNAWAY

    @property
    def values(self) -> dict[str, float]:
        """The parameters that moved."""
        task = self.prepared[0][0]
        return {k: float(task.values[task.keys.index(k)]) for k in self.keys}

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the parameters that moved, from the information, or from blocks."""
        if self.regression is None:
            return {}
        spread = self.regression.spread(1.0)[: len(self.keys)] * (self.widened or 1.0)
        return {k: float(s) for k, s in zip(self.keys, spread, strict=True)}

    @property
    def covariance(self) -> Array:
        """(keys, keys) covariance of the values; widened as their errors are."""
        if self.regression is None:
            return np.full((len(self.keys),) * 2, np.inf)
        part = self.regression.inverse[: len(self.keys)]
        wide = np.array(self.widened or (1.0,) * len(self.keys))
        return (part @ part.T) * np.outer(wide, wide)

    @property
    def noise_errors(self) -> dict[str, float]:
        """Standard errors of the logarithms of the noise's sizes."""
        if self.regression is None:
            return {}
        spread = self.regression.spread(1.0)[len(self.keys) :]
        return {k: float(s) for k, s in zip(self.sizes, spread, strict=False)}

    @property
    def chi2(self) -> float:
        """Mean squared whitened innovation; 1 where the noise model is right."""
        squares = sum(float(np.sum(p.whitened**2)) for p in self.predictions)
        return squares / max(sum(int(np.sum(p.spreads > 0)) for p in self.predictions), 1)


def maximise_likelihood(
    prepared: FilterInputs,
    keys: tuple[str, ...],
    noise: NoiseModel,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    masks: Masks = None,
    steps: int = 40,
    tune: bool = True,
    rough: bool = False,
    kept: SlopeCache | None = None,
    differences: bool = True,
    least: float = -np.inf,
) -> MaximumLikelihood:
    """The most likely values of parameters that all records share, and of the noise.

    Parameters
    ----------
    prepared : records at the values to start from; tracked parameters are found by the filter.
    keys : the parameters that move, none of them tracked.
    bounds : lowest and highest values by name. A value that begins beyond one of them (a time
        before zero, taken from a look-alike) is not held by it: no step would rise.
    tune : whether the noise moves too.
    rough : ends where a step is worth less than ``ROUGH`` a reading. A model that lacks something
        creeps along a valley of the likelihood long after that.
    kept : slopes of another search over these records, to begin with.
    differences : whether slopes by differences are made anew where steps keep less than they
        promise; without, a first look is cheap.
    least : log-likelihood from which the fit is of use. It ends where the steps that are left, each
        worth as much as the last, would not lead there.
    """
    enough = ROUGH * sum(t.series.y.size for t, _ in prepared) if rough else _ENOUGH
    still = not (keys and differences)  # slopes are not made anew
    around = _bounds_around(prepared[0][0], bounds or {})
    search = _Search(keys, around, masks, tune, enough, rough, still)
    parts = predict_cases([(prepared, noise)], keys, keep=tune)[0]
    height = log_likelihood(parts, masks)
    kept = kept if kept is not None and kept.match_records(parts) else SlopeCache()
    at = MaximumLikelihood(prepared, noise, keys, height, parts, None, False, 0, kept=kept)
    damping, fresh = _DAMPING, still
    for left in reversed(range(steps)):
        if not at.finite:
            break
        height = at.log_likelihood
        at, damping, fresh, done = search.take_step(at, damping, fresh)
        gain = at.log_likelihood - height
        if done or (gain > 0 and at.log_likelihood + left * gain < least):
            break
    return at


def _bounds_around(
    task: FilterInput, bounds: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Bounds without those that the values lie beyond."""
    values = dict(zip(task.keys, task.values, strict=True))
    return {
        k: (low if values[k] >= low else -np.inf, high if values[k] <= high else np.inf)
        for k, (low, high) in bounds.items()
    }


def add_standard_errors(at: MaximumLikelihood) -> MaximumLikelihood:
    """The estimate with slopes by differences at its own values, and standard errors of these.

    On the way there slopes are kept from other places, which is good enough for a direction.
    """
    if not at.finite or at.widened:
        return at
    search = _Search(at.keys)
    at = search.with_difference_slopes(at)
    rows = search.rows(at)
    solved = solve_triangle(*triangle(itertools.chain(*rows)))
    factors = widening_factors(
        at.predictions,
        rows,
        solved,
        residual_block_samples(tuple(p.whitened for p in at.predictions)),
    )
    widened = tuple(map(float, factors[: len(at.keys)]))
    return replace(at, regression=solved, sizes=search.sizes(at), widened=widened)


@dataclass(frozen=True)
class _DampedStep:
    """A damped step: where it leads, if it rises, and the damping to go on with.

    ``promised`` its gain by the regression, ``best`` that of the step without damping.
    """

    better: MaximumLikelihood | None
    damping: float
    solved: Fit
    promised: float
    best: float


@dataclass(frozen=True)
class _Search:
    """One search for the maximum: its parameters, bounds and stopping rule."""

    keys: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    masks: Masks = None
    tune: bool = True
    enough: float = _ENOUGH
    rough: bool = False
    still: bool = False

    def take_step(
        self, at: MaximumLikelihood, damping: float, fresh: bool
    ) -> tuple[MaximumLikelihood, float, bool, bool]:
        """One step: the estimate, the damping, whether slopes are of there, whether it is over."""
        at = self.with_size_slopes(at)
        step = self.find_rising_step(at, damping)
        better, damping = step.better, step.damping
        gain = 0.0 if better is None else better.log_likelihood - at.log_likelihood
        sizes, steps = self.sizes(at), at.steps + 1
        faithful = _TRUE * step.promised <= gain <= step.promised / _TRUE
        if better is not None and faithful:
            better = self.with_carried_slopes(at, better)
        at = replace(better or at, regression=step.solved, steps=steps, sizes=sizes)
        over = step.best < self.enough or (fresh and (self.rough or not faithful))
        if (gain < self.enough and over) or (better is None and fresh):
            if at.kept.are_stale(at.noise, sizes, _FRESH):  # stale slopes do not show convergence
                return self.with_size_slopes(at, fresh=True), damping, fresh, False
            return replace(at, converged=True), damping, fresh, True
        if better is None:  # no step rises, however short
            return self.with_difference_slopes(at), _DAMPING, True, False
        if faithful:
            return at, damping, self.still, False
        return (at if fresh else self.with_difference_slopes(at)), damping, True, False

    def sizes(self, at: MaximumLikelihood) -> tuple[str, ...]:
        """The sizes that move: those at their least value stay there."""
        task = at.prepared[0][0]
        names = at.noise.names if self.tune else ()
        return tuple(n for n in names if at.noise.values[n] > _FLOOR * size_limits(task, n)[0])

    def with_carried_slopes(
        self, at: MaximumLikelihood, better: MaximumLikelihood
    ) -> MaximumLikelihood:
        """An estimate with the slopes by sizes of the one before it, corrected by the step.

        Unchanged where parameters moved as well (what changed is not of the sizes alone), and where
        the maximum itself is looked for.
        """
        if self.keys or not self.rough:
            return better
        old, new = at.noise.values, better.noise.values
        step = {n: float(np.log(new[n] / old[n])) for n in self.sizes(at)}
        kept = at.kept.carried(at.predictions, better.predictions, better.noise, step)
        return replace(better, kept=kept)

    def with_size_slopes(self, at: MaximumLikelihood, fresh: bool = False) -> MaximumLikelihood:
        """With slopes by sizes of the noise made anew, where those kept are missing or stale.

        ``fresh`` : they must have been made near by, not carried there.
        """
        names = self.sizes(at)
        stale = (
            at.kept.are_stale(at.noise, names, _FRESH)
            if fresh
            else at.kept.are_far(at.noise, names, _STALE)
        )
        if not stale:
            return at
        larger = np.exp(_DIFFERENCE)
        others = [at.noise.with_values({n: at.noise.values[n] * larger}) for n in names]
        runs = at.predictions
        if any(len(p.means) == 0 for p in runs):
            runs = predict_cases([(at.prepared, at.noise)], keep=True)[0]
        blocks = [others[j : j + LANES] for j in range(0, len(others), LANES)]
        jobs = list(itertools.product(range(len(runs)), blocks))

        def vary_sizes(job: tuple[int, Sequence[NoiseModel]]) -> list[tuple[Array, Array]]:
            return vary_noise(*at.prepared[job[0]], at.noise, job[1], runs[job[0]])

        samples = len(names) * max(len(p.misses) for p in runs)
        with np.errstate(all="ignore"):
            varied = list(itertools.chain(*run_in_threads(vary_sizes, jobs, samples)))
        sizes = {  # all of the first record come first
            n: tuple(size_slopes(p, *other, _DIFFERENCE)
                     for p, other in zip(at.predictions, varied[j :: len(names)], strict=True))
            for j, n in enumerate(names)
        }  # fmt: skip
        return replace(at, kept=at.kept.made_at(at.noise, sizes))

    def with_difference_slopes(self, at: MaximumLikelihood) -> MaximumLikelihood:
        """With all slopes by differences, made at these values."""
        at = self.with_size_slopes(at, fresh=True)
        held = [p.columns for p in at.predictions]
        widths = _difference_steps(held)
        others = predict_cases(
            [(_shift_parameter(at.prepared, self.keys[j], h), at.noise) for j, h in widths.items()]
        )
        beyond = {}
        for (j, h), other in zip(widths.items(), others, strict=True):
            if log_likelihood(other) > RUNAWAY:
                beyond[self.keys[j]] = tuple(
                    (old.misses - new.misses) * old.weight / h - mine[:, :, j]
                    for mine, old, new in zip(held, at.predictions, other, strict=True)
                )
        return replace(at, kept=replace(at.kept, beyond=beyond))

    def rows(self, at: MaximumLikelihood) -> list[list[Array]]:
        """The scoring regression's rows of every record."""
        blocks = []
        names, columns = self.sizes(at), innovation_slopes(at)
        for r, part in enumerate(at.predictions):
            chosen = None if self.masks is None else self.masks[r]
            mask = slice(None) if chosen is None else chosen
            beside = [at.kept.sizes[n][r] for n in names]
            blocks.append(regression_rows(part, columns[r], beside, mask))
        return blocks

    def find_rising_step(self, at: MaximumLikelihood, damping: float) -> _DampedStep:
        """The first damped step that rises."""
        names = (*self.keys, *self.sizes(at))
        upper, count = triangle(itertools.chain(*self.rows(at)))
        solved = solve_triangle(upper, count)
        limit = np.array([self.bounds.get(k, (-np.inf, np.inf)) for k in self.keys])
        upper, best = drop_bounded_columns(upper, solved, np.array(list(at.values.values())), limit)
        with np.errstate(over="ignore"):  # slopes of a model that runs away
            norms = np.linalg.norm(upper[:, :-1], axis=0)
        before = float(np.sum(upper[:, -1] ** 2))
        promised, step = 0.0, None
        for _ in range(_TRIES):
            step, damping = next_damped_step(upper, norms, damping, _STRAIN, step)
            promised = 0.5 * (before - float(np.sum((upper[:, :-1] @ step - upper[:, -1]) ** 2)))
            if promised < _VAIN * self.enough and promised < _VAIN * best:
                break
            trial = self._apply_step(at, names, step, solved.kept)
            parts = predict_cases([trial], self.keys, keep=self.tune)[0]
            height = log_likelihood(parts, self.masks)
            if height > at.log_likelihood:
                better = MaximumLikelihood(
                    *trial, self.keys, height, parts, None, False, 0, kept=at.kept
                )
                easier = _EASE if height - at.log_likelihood < _WELL * promised else _EASE**2
                return _DampedStep(better, max(damping * easier, 1e-9), solved, promised, best)
            damping = max(damping, 1e-6) * _STRAIN
        return _DampedStep(None, damping, solved, promised, best)

    def _apply_step(
        self, at: MaximumLikelihood, names: tuple[str, ...], step: Array, kept: Array
    ) -> tuple[FilterInputs, NoiseModel]:
        task = at.prepared[0][0]
        values, sizes = {}, {}
        for name, delta, told in zip(names, step, kept, strict=True):
            if name in self.keys:
                low, high = self.bounds.get(name, (-np.inf, np.inf))
                now = task.values[task.keys.index(name)]
                most = max(high if now <= 0 or low < 0 else _GROWTH * now, low)
                values[name] = float(np.clip(now + (delta if told else 0.0), low, min(high, most)))
            elif told:
                low, high = size_limits(task, name)
                grown = at.noise.values[name] * np.exp(np.clip(delta, -_LARGEST, _LARGEST))
                sizes[name] = float(np.clip(grown, low, high))
        prepared = tuple((t.with_values(values), s) for t, s in at.prepared)
        return prepared, at.noise.with_values(sizes)


def innovation_slopes(at: MaximumLikelihood) -> list[Array]:
    """(samples, channels, keys) slopes of the whitened innovations (sign turned), by record.

    Slopes that overflow count as zero.
    """
    slopes = [p.columns.copy() for p in at.predictions]
    for j, key in enumerate(at.keys):
        for mine, more in zip(slopes, at.kept.beyond.get(key, ()), strict=False):
            mine[:, :, j] += more
    for mine in slopes:
        mine[:, :, ~np.isfinite(mine).all(axis=(0, 1))] = 0.0
    return slopes


def _difference_steps(columns: Sequence[Array]) -> dict[int, float]:
    """For every column the step that moves the whitened innovations by ``_MOVE`` on average."""
    energy = np.sum([np.sum(c**2, axis=(0, 1)) for c in columns], axis=0)
    count = sum(c.shape[0] * c.shape[1] for c in columns)
    return {j: _MOVE * float(np.sqrt(count / e)) for j, e in enumerate(energy) if e > 0}


def _shift_parameter(prepared: FilterInputs, key: str, step: float) -> FilterInputs:
    """The records with one parameter moved."""
    task = prepared[0][0]
    value = float(task.values[task.keys.index(key)]) + step
    return tuple((t.with_values({key: value}), s) for t, s in prepared)
