"""The input of a Kalman filter for one record: compiled model, samples, scales of every state.

Scales come from the model itself: its free run under the record's inputs. With s_i the standard
deviation of a state and a_i that of its rate, everything that a filter must be told (the initial
covariance, the process noise) is a dimensionless share of them, so that no unit and no amplitude
has to be chosen by hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from spiral.engine.filter.prior import Prior
from spiral.engine.filter.response import response_scales
from spiral.engine.filter.shifts import common_shifts
from spiral.engine.filter.static import StaticMap, static_map
from spiral.engine.kernel import trajectories
from spiral.engine.resting import (
    REST,
    find_rest_state,
    finite_state,
    hidden_of_first_order,
    resting_jacobian,
    steps_for_stability,
)
from spiral.engine.series import MOST_SUBSTEPS, Series, prepare_series
from spiral.engine.start import smoothed_motion
from spiral.engine.study import CompiledStudy
from spiral.physics.compile import CompiledModel, compile_model
from spiral.physics.readings import reading_slopes
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import trace
from spiral.types.model import Model
from spiral.types.record import Array, Record

_STEP = 0.7  # largest phase advance per Runge-Kutta step, rad
_LOUD = 10.0  # times the measured deviation beyond which a free run has gone astray
_QUIET = 1e-9  # share of the measured deviation under which a free run says nothing
_ROUNDING = 1e-12  # share of a mean under which a deviation is none
_WINDOWS, _LOST = (41, 21, 11, 5), 2.0  # of local cubics; noise levels that one may smooth away
_STILL = 0.3  # share of its value by which a state that stands still may be off


@dataclass(frozen=True)
class FilterInput:
    """What the Kalman filter needs for one record: model, samples, values, initial state, scales.

    ``compiled`` has derivatives for the record's own parameters only (see ``compile_model``);
    ``values`` (parameters,); ``inputs`` as of ``stage_inputs``; ``start`` and ``spread`` (n,) mean
    and standard deviation before the first sample; ``centre`` and ``scales`` (n,) mean and standard
    deviation of the settled states, ``rates`` (n,) that of their rates; ``static`` the static map,
    where there is one; ``moved`` are parameters that slopes will be asked by, for which one flow is
    compiled; ``prior`` is what is known of uncertain parameters; ``tied`` (n,) are the largest
    first deviations of states that only move together with others (``filter.shifts``). ``astray`` :
    the free run that the scales were taken of moves far more than the record does.
    """

    model: Model
    compiled: CompiledModel
    series: Series
    values: Array
    inputs: Array
    start: Array
    spread: Array
    centre: Array
    scales: Array
    rates: Array
    static: StaticMap | None
    moved: tuple[str, ...] = ()
    prior: Prior | None = None
    tied: Array | None = None
    astray: bool = False

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.compiled.traced.states

    @property
    def first_spread(self) -> Array:
        """(n,) standard deviation before the first sample; of a tied state at most its tie."""
        return self.spread if self.tied is None else np.minimum(self.spread, self.tied)

    @property
    def keys(self) -> tuple[str, ...]:
        """Full names of the parameters."""
        return self.compiled.traced.keys

    @property
    def mean_inputs(self) -> Array:
        """(input columns,) mean of the inputs over the record."""
        if self.inputs is self.series.inputs:
            return self.series.mean_inputs
        return self.inputs.mean(axis=0) if self.inputs.size else np.zeros(self.inputs.shape[1])

    @cached_property
    def is_driven_unseen(self) -> bool:
        """Whether no input of the model varies and readings go on moving: by what is unseen."""
        traced = self.compiled.traced
        changing = self.series.changing_inputs(traced.inputs)
        return self.series.is_lasting and traced.driving.isdisjoint(changing)

    @cached_property
    def disturbed(self) -> dict[bytes, Array]:
        """Cache: covariance that noise adds over a sample, by its intensity (``filter.noise``)."""
        return {}

    @cached_property
    def felt(self) -> Array:
        """(channels, n) slopes of readings by rates, at the centre (``physics.readings``)."""
        system, own = self.model.system, len(self.model.system.states)
        shares = np.zeros((len(self.compiled.traced.channels), len(self.states)))
        if system.readings:
            at, rates, inputs = self.centre[None, :own], np.zeros((1, own)), self.mean_inputs[None]
            values = list(self.parameter_values([f"system.{p.name}" for p in system.parameters]))
            shares[:, :own] = reading_slopes(system, at, rates, inputs, values)[0]
        return shares

    def parameter_values(self, keys: Sequence[str]) -> Array:
        """Values of these parameters."""
        return self.values[[self.keys.index(k) for k in keys]]

    def with_parameters(self, keys: Sequence[str], values: Array) -> FilterInput:
        """The same with these parameters at ``values`` (keys,)."""
        return self.with_values(dict(zip(keys, map(float, values), strict=True)))

    def with_values(self, values: Mapping[str, float]) -> FilterInput:
        """The same with other parameter values."""
        row = self.values.copy()
        for key, value in values.items():
            row[self.keys.index(key)] = value
        return replace(self, values=row)


Task = FilterInput
"""The former name of ``FilterInput``, which users' observers may import."""


def prepare_task(
    model: Model,
    record: Record,
    start: Array | None = None,
    inputs: Array | None = None,
    substeps: int | None = None,
    every: bool = False,
) -> FilterInput:
    """Compile the model, put the record on the integrator's grid, and find the scales.

    Parameters
    ----------
    model : every parameter needs a value.
    start : (n,) mean before the first sample; left out, the first measurement, its static map for
        hidden coordinates, and rates of zero.
    inputs : as of ``stage_inputs``, where a fit has corrected them (needs ``substeps`` as there).
    substeps : Runge-Kutta steps per sample; left out, enough for the fastest mode.
    every : derivatives for all parameters, not the record's own alone.

    Raises
    ------
    ConfigError : a parameter without a value.
    """
    traced = trace(model.system, model.effects)
    own = tuple(k for k, p in model.pairs if p.scope == "record")
    compiled = compile_model(traced, None if every else own)
    values = model.row("model", "values='{{{}: 1.0}}', or let a fit find it (calibrate=true)")
    return build_task(model, compiled, values, record, start, inputs, substeps)


def with_record(task: FilterInput, record: Record, start: Array | None = None) -> FilterInput:
    """The same model and values on another record, scales found anew; nothing is compiled again."""
    return build_task(task.model, task.compiled, task.values, record, start)


def build_task(
    model: Model,
    compiled: CompiledModel,
    values: Array,
    record: Record,
    start: Array | None = None,
    inputs: Array | None = None,
    substeps: int | None = None,
    series: Series | None = None,
    like: FilterInput | None = None,
) -> FilterInput:
    """A task of functions compiled elsewhere: of the model, or of one with more effects.

    ``series`` is the record where it is prepared already; ``like`` a task whose scales are taken of
    the states that it has.
    """
    if series is None:
        if substeps is None:
            substeps = enough_substeps(compiled, values, prepare_series(model.system, record, 1))
        series = prepare_series(model.system, record, substeps)
    mapping = static_map(compiled.traced, values)
    grid = series.inputs if inputs is None else inputs
    names, tied, astray = compiled.traced.states, None, False
    if like is not None and set(names) <= set(like.states):  # no free run for what is not asked
        centre, scales, rates = (np.zeros(len(names)) for _ in range(3))
        tied = _adopt_ties(compiled, values, grid, like)
    else:
        states, astray, guessed = _settled_states(compiled, series, grid, values, mapping)
        centre, scales, rates = motion_scales(states, series.dt)
        if guessed and (response := response_scales(compiled, values, series)) is not None:
            scales, rates = response
        shifts = common_shifts(compiled, values, grid.mean(axis=0), scales)
        tied = shifts.tied_deviations(states) if shifts.anchors else None
    begin = _first_state(compiled, series, mapping) if start is None else np.array(start, float)
    begin = finite_state(compiled, values, begin, grid[0]) if start is None else begin
    task = FilterInput(
        model, compiled, series, values, grid, begin, scales.copy(), centre, scales, rates, mapping,
        tied=tied, astray=astray,
    )  # fmt: skip
    return task if like is None else _adopt_scales(task, like)


def with_start_spread(task: FilterInput, spread: Array | None) -> FilterInput:
    """The task with standard deviations ``spread`` (n,) of its first state.

    At most those of the settled motion, which are taken where ``spread`` is nan, or None.
    """
    if spread is None:
        return replace(task, spread=task.scales.copy())
    return replace(task, spread=np.fmin(spread, task.scales))


def _adopt_scales(task: FilterInput, other: FilterInput) -> FilterInput:
    """A task with another's scales of the states that both have."""
    adopted = {name: getattr(task, name).copy() for name in ("spread", "centre", "scales", "rates")}
    for i, state in enumerate(task.states):
        if state in other.states:
            for name, values in adopted.items():
                values[i] = getattr(other, name)[other.states.index(state)]
    return replace(task, **adopted)


def with_finer_steps(task: FilterInput, times: int) -> FilterInput:
    """The task with so many times the Runge-Kutta steps per sample; all else is kept."""
    series = prepare_series(task.model.system, task.series.record, times * task.series.substeps)
    return replace(task, series=series, inputs=series.inputs)


def resting_first_state(task: FilterInput) -> Array | None:
    """A first state whose hidden states of first order are where their own rates are zero.

    By Newton's steps at the mean inputs: a level where what flows out is what is pumped in, a
    thrust that is asked for. Nothing where there are none, where the steps lead nowhere, or no
    further than the first state may be off.
    """
    hidden = hidden_of_first_order(task.compiled.traced)
    x = find_rest_state(task.compiled, task.values, task.start, task.mean_inputs, hidden)
    return x if x is not None and np.any(np.abs(x - task.start) > task.spread) else None


def enough_substeps(compiled: CompiledModel, values: Array, series: Series) -> int:
    """Steps per sample that keep |eigenvalue| dt below 0.7 at rest, at the largest inputs.

    At most ``MOST_SUBSTEPS``, or those that are needed for stability (``steps_for_stability``).
    """
    matrix = resting_jacobian(compiled, values, series)
    fastest = float(np.abs(np.linalg.eigvals(matrix)).max()) * series.dt
    precise = int(np.clip(np.ceil(fastest / _STEP), 1, MOST_SUBSTEPS))
    return max(precise, steps_for_stability(compiled, values, series))


def _adopt_ties(
    compiled: CompiledModel, values: Array, grid: Array, other: FilterInput
) -> Array | None:
    """Another task's ``tied``, where this model may be shifted in the same states."""
    if other.tied is None:
        return None
    at = [other.states.index(n) for n in compiled.traced.states]
    tied, scales = other.tied[at], other.scales[at]
    shifts = common_shifts(compiled, values, grid.mean(axis=0), scales)
    moved = np.any(shifts.directions != 0, axis=1)
    return tied if moved.any() and np.array_equal(moved, np.isfinite(tied)) else None


def _settled_states(
    compiled: CompiledModel, series: Series, grid: Array, values: Array, mapping: StaticMap | None
) -> tuple[Array, bool, bool]:
    """States (samples, n) of a free run; whether it is astray; whether they are guessed instead.

    Guessed are those of the smoothed measurements, where no free run tells.

    A machine that falls out of step, begun from rest, runs on by itself: its readings move
    ``_LOUD`` times as much as measured, and its states tell no scale. Of one that rests for ever (a
    culture that nobody has sown) hidden states move as from where they are declared to begin. Where
    starts are declared, the run from there is taken if it moves more nearly as measured than that
    from rest: an epidemic that nobody has brought in grows too late, if at all.
    """
    run, measured = _run_with_readings(compiled, series, grid, values), series.y.std(axis=0)
    begun = None
    if compiled.traced.starts:
        begin = _first_state(compiled, series, mapping)
        begun = _run_with_readings(compiled, series, grid, values, begin)
        if _is_nearer(begun, run, measured):
            run = begun
    shown = list(compiled.traced.shown.values())
    if run is not None and not np.any(run[1].std(axis=0)[shown] < _QUIET * measured[shown]):
        return run[0], _is_loud(run[1], measured), False
    states = _guess_states(compiled, series, mapping)
    still = states.std(axis=0) <= _ROUNDING * np.abs(states.mean(axis=0))
    if begun is not None and not _is_loud(begun[1], measured):
        states[:, still] = begun[0][:, still]
    return states, False, True


def _is_nearer(
    one: tuple[Array, Array] | None, other: tuple[Array, Array] | None, measured: Array
) -> bool:
    """Whether the readings of one run move more nearly as much as measured than another's.

    By the sum of squares of log(deviation / measured deviation) over the channels that move.
    """
    if one is None or other is None:
        return other is None and one is not None
    moving = measured > 0
    apart = [
        np.log(np.maximum(run[1].std(axis=0)[moving], _QUIET * measured[moving]) / measured[moving])
        for run in (one, other)
    ]
    return float(np.sum(apart[0] ** 2)) < float(np.sum(apart[1] ** 2))


def _is_loud(readings: Array, measured: Array) -> bool:
    """Whether readings (samples, channels) move far more than their ``measured`` deviations."""
    return bool(np.any(readings.std(axis=0) > _LOUD * measured))


def motion_scales(states: Array, dt: float) -> tuple[Array, Array, Array]:
    """Mean and standard deviation of states, and that of their rates.

    A state that does not move takes ``_STILL`` of what it is at, or what others move by where it is
    at zero.
    """
    mean, scales = states.mean(axis=0), states.std(axis=0)
    rates = np.gradient(states, dt, axis=0).std(axis=0)
    moves = scales > _ROUNDING * np.abs(mean)
    typical = np.median(scales[moves]) if np.any(moves) else 1.0
    scales = np.where(moves, scales, np.where(mean == 0, typical, _STILL * np.abs(mean)))
    rates = np.where(moves & (rates > 0), rates, scales / (dt * len(states)))
    return np.where(mean == 0, REST, mean), scales, rates


def run_from_rest(
    compiled: CompiledModel, series: Series, grid: Array, values: Array
) -> Array | None:
    """States (samples, n) from rest under the record's inputs; nothing where it diverges."""
    run = _run_with_readings(compiled, series, grid, values)
    return None if run is None else run[0]


def run_from(task: FilterInput, begin: Array) -> Array | None:
    """States (samples, n) of a free run from a first state; nothing where it diverges."""
    run = _run_with_readings(task.compiled, task.series, task.inputs, task.values, begin)
    return None if run is None else run[0]


def _run_with_readings(
    compiled: CompiledModel, series: Series, grid: Array, values: Array, begin: Array | None = None
) -> tuple[Array, Array] | None:
    """States (samples, n) and readings (samples, channels) of a free run, from rest if no begin."""
    n = len(compiled.traced.states)
    states, readings = np.empty((series.samples, n)), np.empty_like(series.y)
    whole, first = np.array([series.samples]), np.zeros(1, dtype=np.int64)
    if begin is None:
        begin = finite_state(compiled, values, np.zeros(n), series.mean_inputs)
    ok = trajectories(
        compiled.rate_value, compiled.output_value, np.array(begin, dtype=float)[None, :], first,
        whole, np.ascontiguousarray(values[None, :]), grid, series.substeps, series.dt, states,
        readings,
    )  # fmt: skip
    return (states, readings) if ok and np.all(np.isfinite(states)) else None


def _guess_states(compiled: CompiledModel, series: Series, mapping: StaticMap | None) -> Array:
    """Smoothed measurements and their rates; hidden coordinates by the static map."""
    study = CompiledStudy(compiled, (series,))
    states = smoothed_motion(study, series, _smoothing_window(series)).states
    names = compiled.traced.states
    if mapping is not None:
        for place in (str, compiled.traced.rate_name):  # the coordinates, then their rates
            rows = [names.index(place(name)) for name in mapping.observed]
            hidden_values = states[:, rows] @ mapping.matrix.T
            for j, name in enumerate(mapping.hidden):
                states[:, names.index(place(name))] = hidden_values[:, j]
    return states


def _smoothing_window(series: Series) -> int:
    """The longest window (samples) that smooths away no more than the sensors' noise."""
    longest = series.samples // 2 * 2 - 1
    for window in (w for w in _WINDOWS if w <= longest):
        lost = (series.y - series.smooth_readings(window)[0]).std(axis=0)
        if np.all(lost <= _LOST * series.sigma):
            return window
    return min(_WINDOWS[-1], longest)


def _first_state(compiled: CompiledModel, series: Series, mapping: StaticMap | None) -> Array:
    names = compiled.traced.states
    start = np.zeros(len(names))
    for channel, j in compiled.traced.shown.items():
        start[names.index(channel)] = series.y[0, j]
    if mapping is not None:
        hidden = mapping.matrix @ [start[names.index(n)] for n in mapping.observed]
        for name, value in zip(mapping.hidden, hidden, strict=True):
            start[names.index(name)] = value
    told = compiled.traced.shown
    fill_declared_starts(compiled.traced, start, series.inputs[0], series.y[0], known=told)
    return start
