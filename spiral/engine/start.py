"""Start values of a fit: parameters from the balance of forces, states by local polynomials.

The balance M a - F = 0 of a mechanical system is linear in masses and amplitudes. With positions,
velocities and accelerations from local polynomials it is solved by scaled least squares. The
answer is biased by noise; it only has to lie in the basin of the short-window fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy as sp

from spiral.engine.series import Series, sample_inputs
from spiral.engine.study import CompiledStudy
from spiral.physics.outside.program import ProgramValue
from spiral.physics.starts import fill_declared_starts
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept
from spiral.types.errors import ConfigError
from spiral.types.record import Array

SMOOTHING = (5, 7, 11, 17, 25, 41, 65)


@dataclass(frozen=True)
class Motion:
    """Smoothed states (samples, n) and accelerations (samples, coordinates) of one record."""

    states: Array
    acceleration: Array


def smoothed_motion(study: CompiledStudy, series: Series, window: int) -> Motion:
    """Local polynomials of degree 3 (Savitzky-Golay) through the measured coordinates.

    A coordinate of which only the acceleration is measured is that integrated twice, cubics in time
    removed. A state without a measurement is where it is declared to ``start`` (zero), or the
    measured state or the input that it is declared ``like``.
    """
    traced = study.compiled.traced
    states = np.zeros((series.samples, len(traced.states)))
    acceleration = np.zeros((series.samples, len(traced.acceleration)))
    smooth = series.smooth_readings(window)
    for name, channel in traced.shown.items():
        states[:, traced.states.index(name)] = smooth[0][:, channel]
        if traced.rate_name(name) in traced.states:
            states[:, traced.states.index(traced.rate_name(name))] = smooth[1][:, channel]
            if traced.acceleration:  # none in a system that gives all rates itself
                acceleration[:, traced.states.index(name)] = smooth[2][:, channel]
    for name, channel in traced.accelerated.items():
        rate = _integrate_rate(smooth[0][:, channel], series)
        states[:, traced.states.index(traced.rate_name(name))] = rate
        states[:, traced.states.index(name)] = _integrate_rate(rate, series)
        if traced.acceleration:
            acceleration[:, traced.states.index(name)] = smooth[0][:, channel]
    inputs = sample_inputs(series.inputs, series.substeps)
    fill_declared_starts(traced, states, inputs, smooth[0], known=measured_states(traced))
    return Motion(states, acceleration)


def measured_states(traced: TracedModel) -> frozenset[str]:
    """States that readings tell, rates among them, wherever they are declared to begin."""
    told = {*traced.shown, *traced.accelerated}
    rates = {traced.rate_name(name) for name in told}
    return frozenset((told | rates) & {*traced.states})


def _integrate_rate(rate: Array, series: Series) -> Array:
    """Trapezoidal integral of a rate, less its cubic in time (unknown start values and drift)."""
    from scipy.integrate import cumulative_trapezoid

    integral = cumulative_trapezoid(rate, dx=series.dt, initial=0.0)
    time = np.linspace(-1.0, 1.0, len(integral))
    return integral - np.polynomial.Polynomial.fit(time, integral, 3)(time)


@dataclass(frozen=True)
class Balance:
    """The balance of forces of one model as regression: columns for the unknowns, and the rest.

    ``unknown`` are parameter positions in the study's arrays, ``states`` those of its states (a
    study may have more, which effects bring); ``turning`` is the one unknown whose column turns
    with the phase origin (an unbalance), if there is one.
    """

    unknown: tuple[int, ...]
    origin: int | None
    turning: int | None
    used: tuple[int, ...]
    states: tuple[int, ...]
    columns: Callable[..., list[Any]]
    rest: Callable[..., list[Any]]
    rows: int


def has_balance(traced: TracedModel) -> bool:
    """Whether forces can be balanced: a mechanical model all of whose coordinates are measured.

    Measured accelerations will do as well. An outside program has no balance: it only returns
    accelerations at given values.
    """
    coordinates = {n for n in traced.states if traced.rate_name(n) in traced.states}
    known = not any(sp.sympify(row).has(ProgramValue) for row in traced.balance)
    return bool(traced.balance) and known and coordinates <= {*traced.shown, *traced.accelerated}


def prepare_balance(study: CompiledStudy, traced: TracedModel, unknown: tuple[str, ...]) -> Balance:
    """Prepare the balance of a model traced without its candidates.

    Raises
    ------
    ConfigError : a parameter without a start, of a program or where coordinates are hidden.
    """
    if not has_balance(traced):
        raise ConfigError(
            f"no value for {', '.join(unknown)}",
            "a start for every parameter of a system with hidden coordinates, or of a program",
            f"give one: values='{{{unknown[0]}: 1.0}}'",
        )
    origin = "system.phase_origin" if "system.phase_origin" in traced.keys else None
    columns, rest, turning = _linear_balance(traced, unknown, origin)
    return Balance(
        unknown=tuple(study.index(k) for k in unknown),
        origin=study.index(origin) if origin else None,
        turning=turning,
        used=tuple(study.index(k) for k in traced.keys),
        states=tuple(study.compiled.traced.states.index(x) for x in traced.states),
        columns=columns,
        rest=rest,
        rows=len(traced.balance),
    )


@kept(32)
def _linear_balance(
    traced: TracedModel, unknown: tuple[str, ...], origin: str | None
) -> tuple[Callable[..., list[Any]], Callable[..., list[Any]], int | None]:
    """Columns of the unknowns, the rest, and which unknown turns."""
    symbols = [traced.p[traced.keys.index(k)] for k in unknown]
    linear = sp.Matrix(traced.balance).jacobian(symbols)
    rest = sp.Matrix(traced.balance).subs(dict.fromkeys(symbols, 0))
    arguments = [*traced.x, *traced.u, *traced.p, *traced.acceleration]
    made = [sp.lambdify(arguments, list(part), "numpy", cse=True) for part in (linear, rest)]
    return made[0], made[1], _turning_unknown(traced, linear, origin)


def _turning_unknown(traced: TracedModel, linear: sp.Matrix, origin: str | None) -> int | None:
    """The one unknown whose column turns with the phase origin, if there is just one."""
    if origin is None:
        return None
    symbol = traced.p[traced.keys.index(origin)]
    matches = [j for j in range(linear.cols) if symbol in linear.col(j).free_symbols]
    return matches[0] if len(matches) == 1 else None


def first_values(study: CompiledStudy, equations: Balance, values: Array, window: int) -> Array:
    """Values (records, parameters) with the unknown ones solved from the balance of forces.

    The phase origin is found together with its unbalance from a quadrature pair; records whose
    phase was not measured have a pair of their own, because their angles have nothing in common.
    """
    parts = [
        _balance_rows(equations, series, smoothed_motion(study, series, window), row, window)
        for series, row in zip(study.series, values, strict=True)
    ]
    target = np.concatenate([t for _, t in parts])
    turning = equations.turning
    group = angle_groups(study)
    matrix = np.concatenate([m for m, _ in parts])
    if turning is not None:
        pairs = max(group) + 1
        matrix = np.concatenate(
            [
                _expand_turning_pair(m, turning, g, pairs)
                for (m, _), g in zip(parts, group, strict=True)
            ]
        )
    solution = _scaled_least_squares(matrix, target)
    new = values.copy()
    steady = [p for j, p in enumerate(equations.unknown) if j != turning]
    for position, amount in zip(steady, solution, strict=False):
        new[:, position] = amount
    if turning is not None and equations.origin is not None:
        cosine, sine = solution[len(steady) :].reshape(-1, 2).T
        new[:, equations.unknown[turning]] = np.sqrt(np.mean(cosine**2 + sine**2))
        new[:, equations.origin] += np.arctan2(sine, cosine)[group]
    return new


def angle_groups(study: CompiledStudy) -> list[int]:
    """Records that share a phase origin have the same number: those with measured phase."""
    groups: list[int] = []
    own = 0
    shared = any("phase" in s.record.measured for s in study.series)
    for series in study.series:
        if "phase" in series.record.measured:
            groups.append(0)
        else:
            groups.append(own + (1 if shared else 0))
            own += 1
    return groups


def _expand_turning_pair(matrix: Array, turning: int, group: int, pairs: int) -> Array:
    """One record's rows with its turning column and quadrature moved to its group's pair."""
    steady = np.delete(matrix[:, :-1], turning, axis=1)
    wide = np.zeros((len(matrix), 2 * pairs))
    wide[:, 2 * group] = matrix[:, turning]
    wide[:, 2 * group + 1] = matrix[:, -1]
    return np.concatenate([steady, wide], axis=1)


def _balance_rows(
    equations: Balance, series: Series, moving: Motion, row: Array, window: int
) -> tuple[Array, Array]:
    """Rows (samples * coordinates) of the regression of one record, its ends left out."""
    u = sample_inputs(series.inputs, series.substeps)
    edge = slice(window, -window)

    def evaluate_rows(function: Callable[..., list[Any]], shift: float, width: int) -> Array:
        shifted = row.copy()
        if equations.origin is not None:
            shifted[equations.origin] += shift
        known = shifted[list(equations.used)]
        states = moving.states[:, equations.states]
        given = function(*states.T, *u.T, *known, *moving.acceleration.T)
        flat = np.array([np.broadcast_to(v, (len(u),))[edge] for v in given])
        return np.moveaxis(flat.reshape(equations.rows, width, -1), -1, 0).reshape(-1, width)

    count = len(equations.unknown)
    matrix = evaluate_rows(equations.columns, 0.0, count)
    if equations.turning is not None:
        quadrature = evaluate_rows(equations.columns, np.pi / 2, count)[:, [equations.turning]]
        matrix = np.concatenate([matrix, quadrature], axis=1)
    return matrix, -evaluate_rows(equations.rest, 0.0, 1)[:, 0]


def _scaled_least_squares(matrix: Array, target: Array) -> Array:
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0] = 1.0
    solution, *_ = np.linalg.lstsq(matrix / scale, target, rcond=1e-10)
    return solution / scale
