"""Signatures: the columns that a model's parameters have in the observable equations of motion.

    s_l(t) = phi_l(q, q', u) = d a / d theta_l        (the paper's eqs. signature and sig_matrix)

a being the accelerations of the observed coordinates (the rates, in a system of first order). They
come from the traced physics, never from a second copy of an equation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from spiral.engine.series import sample_inputs, stage_inputs
from spiral.engine.study import column_owner
from spiral.physics.trace import TracedModel, trace
from spiral.types.effect import Effect
from spiral.types.errors import ConfigError, InputError
from spiral.types.model import Model
from spiral.types.placement import check_states
from spiral.types.record import Array, Record
from spiral.types.system import System


@dataclass(frozen=True)
class Signatures:
    """The signature matrix with the names of its columns.

    Parameters
    ----------
    keys : (p,) full names of the coefficients, ``gyroscopic.coefficient``.
    rows : (n,) the states whose rates are the equations, ``x_rate``.
    columns : (n, N, p) values of the columns at the samples, in the unit of a row's rate per
        that of the coefficient.
    left_out : effect -> why it has no column here.
    shapes : the shapes (gaps, widths) at which columns were taken, by full name.
    """

    keys: tuple[str, ...]
    rows: tuple[str, ...]
    columns: Array
    left_out: Mapping[str, str]
    shapes: Mapping[str, float]

    @property
    def stacked(self) -> Array:
        """(n N, p): all equations below one another."""
        return self.columns.reshape(-1, len(self.keys))

    @property
    def owners(self) -> tuple[str, ...]:
        """The effect of each column; the phase origin belongs to the unbalance."""
        return tuple(column_owner(k) for k in self.keys)

    def only(self, keys: tuple[str, ...]) -> Signatures:
        """These columns alone, in this order."""
        index = [self.keys.index(k) for k in keys]
        return replace(self, keys=keys, columns=self.columns[:, :, index])


def equation_rows(system: System) -> tuple[str, ...]:
    """States whose rates are measured: of each channel its velocity, or itself in first order.

    Raises
    ------
    ConfigError : a channel that is no state.
    """
    names = [s.name for s in system.states]
    check_states(system, "equations along measured states")
    return tuple(
        system.rate_name(c) if system.rate_name(c) in names else c for c in system.observed
    )


def signatures(
    model: Model, candidates: tuple[Effect, ...], states: Mapping[str, Array], record: Record
) -> Signatures:
    """The columns of a model and of candidates along a motion.

    Parameters
    ----------
    model : its effects, and values for what is not linear (a mass, a gap).
    candidates : further effects.
    states : state -> (N,) values; those of the observed coordinates and their velocities, or all.
    record : its inputs, on the same samples.

    Raises
    ------
    InputError : the model's own equations need a state that is not among ``states``.
    """
    system = model.system
    wanted = (*model.effects, *(c for c in candidates if c.label not in model.labels))
    left_out: dict[str, str] = {}
    kept: list[Effect] = []
    for effect in wanted:
        reason = _missing_states(system, effect, states)
        if reason and effect in model.effects:
            raise InputError(
                f"{effect.label} in the equations of {system.plugin_name()}, which need {reason}",
                "equations in measured coordinates and their velocities alone",
                "a system of what is measured, for instance system=planar_rotor",
            )
        if reason:
            left_out[effect.label] = f"needs {reason}"
        else:
            kept.append(effect)
    traced = trace(system, tuple(kept))
    rows = equation_rows(system)
    shapes = {**_middle_shapes(traced, system, states), **_input_shapes(system, kept, record)}
    values = {**shapes, **model.values}
    keys, columns = _nonzero_columns(traced, rows, values, states, _input_samples(system, record))
    for effect in kept:
        if not any(column_owner(k) == effect.label for k in keys):
            left_out[effect.label] = "no force anywhere along the record"
    return Signatures(keys, rows, columns, left_out, shapes)


def _missing_states(system: System, effect: Effect, states: Mapping[str, Array]) -> str:
    """States that an effect's columns need and nobody has; empty where there are none."""
    traced = trace(system, (effect,))
    needed: set[str] = set()
    for row in equation_rows(system):
        line = traced.rate_p.row(traced.states.index(row))
        for name, symbol in zip(traced.states, traced.x, strict=True):
            if line.has(symbol):
                needed.add(name)
    return ", ".join(sorted(needed - set(states)))


def _middle_shapes(
    traced: TracedModel, system: System, states: Mapping[str, Array]
) -> dict[str, float]:
    """Shapes with a grid, at its middle: shares of the largest displacement or velocity."""
    shapes = {}
    rates = [r for r in equation_rows(system) if r not in system.observed]
    for key, parameter in zip(traced.keys, traced.parameters, strict=True):
        if parameter.role == "shape" and parameter.grid:
            names = rates if rates and "velocity" in parameter.unit else system.observed
            largest = max(float(np.max(np.abs(states[n]))) for n in names)
            shapes[key] = parameter.grid[len(parameter.grid) // 2] * largest
    return shapes


def _input_shapes(system: System, effects: Sequence[Effect], record: Record) -> dict[str, float]:
    """Shapes of what an actuator makes of an input: shares of that input's largest value."""
    shapes = {}
    for effect in effects:
        port = system.place(effect)
        if port.name not in {p.name for p in system.driven}:
            continue
        largest = max(float(np.max(np.abs(record.inputs[name]))) for name in port.axes)
        for shape in effect.parameters:
            if shape.role == "shape" and shape.grid and "position" in shape.unit:
                shapes[f"{effect.label}.{shape.name}"] = shape.grid[len(shape.grid) // 2] * largest
    return shapes


def _input_samples(system: System, record: Record) -> Array:
    """(N, inputs) in the order of the traced inputs, rates included."""
    return sample_inputs(stage_inputs(system, record, 1), 1)


def _nonzero_columns(
    traced: TracedModel,
    rows: tuple[str, ...],
    given: Mapping[str, float],
    states: Mapping[str, Array],
    inputs: Array,
) -> tuple[tuple[str, ...], Array]:
    """Keys with a column that is not zero, and the columns (n, N, p).

    Amplitudes stand at zero, where a column is the coefficient's own; a parameter that shows only
    beside an amplitude (a phase origin) is taken with all amplitudes at one.
    """
    count = len(inputs)
    x = [np.asarray(states.get(n, np.zeros(count)), dtype=float) for n in traced.states]
    pairs = list(zip(traced.keys, traced.parameters, strict=True))
    moving = [i for i, (k, q) in enumerate(pairs) if q.role == "amplitude" or k.startswith("sys")]
    own = {i for i, (k, q) in enumerate(pairs) if q.role == "amplitude" and not _is_system_key(k)}
    base = np.array([_value_or_one(k, q, given) for k, q in pairs])
    off = np.where([i in own for i in range(len(pairs))], 0.0, base)
    on = np.where([i in own for i in range(len(pairs))], 1.0, base)
    function = _jacobian(traced, rows, moving)
    columns = _evaluate_columns(function, x, inputs, off, (len(rows), count, len(moving)))
    beside = _evaluate_columns(function, x, inputs, on, columns.shape)
    silent = ~np.any(columns, axis=(0, 1))
    columns[:, :, silent] = beside[:, :, silent]
    seen = np.flatnonzero(np.any(columns, axis=(0, 1)))
    return tuple(pairs[moving[i]][0] for i in seen), columns[:, :, seen]


def _is_system_key(key: str) -> bool:
    return key.startswith("system.")


def _value_or_one(key: str, parameter, given: Mapping[str, float]) -> float:
    value = given.get(key, parameter.start)
    return 1.0 if value is None else float(value)


def _jacobian(traced: TracedModel, rows: tuple[str, ...], moving: list[int]):
    """(x, u, p) -> list of columns for each row, made by SymPy for arrays."""
    import sympy as sp

    lines = [traced.rate_p.row(traced.states.index(row)) for row in rows]
    entries = [[line[i] for i in moving] for line in lines]
    return sp.lambdify([traced.x, traced.u, traced.p], entries, modules="numpy", cse=True)


def _evaluate_columns(function, x: list[Array], inputs: Array, p: Array, shape) -> Array:
    with np.errstate(all="ignore"):
        entries = function(x, list(inputs.T), p)
    columns = np.empty(shape)
    for row, line in enumerate(entries):
        for column, values in enumerate(line):
            columns[row, :, column] = values
    if not np.isfinite(columns).all():
        raise ConfigError(
            "a signature that is not finite", "effects with finite forces along the record"
        )
    return columns
