"""The motion that records cover: states along them, largest position and velocity at each port.

Shapes of candidates (a gap, a width) are tried at shares of these scales. A measured coordinate and
its rate come from local polynomials through its samples. A hidden one is seen by no polynomial: it
is what a filter makes of the model as it stands and the record, with process noise that lets the
measurements overrule the model,

    x_hidden(t) = E[x(t) | y up to t],

at a level of 0.3 (``spiral.engine.filter.noise``). Where that runs away it is
the model's free run under the record's inputs.

What lies between a measured and a hidden coordinate (a joint, a nut) moves far less than either,
and the difference of two estimates made in two ways is mostly their errors. Where a fit is there,
such places, and those of hidden states alone, have the motion that its filter expects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp

from spiral.engine.filter.extended import filter_record
from spiral.engine.filter.noise import noise_groups
from spiral.engine.filter.setup import prepare_filter, with_level
from spiral.engine.filter.task import build_task, run_from_rest
from spiral.engine.series import Series, prepare_series, sample_inputs
from spiral.engine.start import measured_states, smoothed_motion
from spiral.engine.study import CompiledStudy
from spiral.inference.evidence.spectrum import frequency_band, frequency_shapes
from spiral.physics.compile import compile_model
from spiral.physics.signatures import auxiliary_along
from spiral.physics.trace import TracedModel, trace
from spiral.types.effect import Effect
from spiral.types.model import Model
from spiral.types.parameter import Parameter
from spiral.types.port import Port
from spiral.types.record import Array, Record
from spiral.types.system import TIME, System, has_coordinates

_LEVEL = 0.3  # process noise of the filter: a model that is wrong by three tenths of every rate
_OTHER_SIDE = 0.2  # of its largest size, from which a position goes to both sides of zero
_WINDOW = 11  # samples of a local polynomial


def largest_port_motion(
    system: System, records: Sequence[Record], along: Sequence[Array],
    expected: Sequence[Array] = (),
) -> dict[str, float]:  # fmt: skip
    """Largest |position| and |velocity| at every port, as ``PORT.position``, input and state.

    ``along`` are the states (samples, n) that each record visits; ``expected`` those that a fit's
    filter expects, which count where a place depends on what no sensor sees.
    """
    traced = trace(system, ())
    measured = np.concatenate(along)
    inferred = np.concatenate(expected) if expected else measured
    seen = {*traced.shown, *(traced.rate_name(c) for c in traced.shown)}
    hidden = {s for s, n in zip(traced.x, traced.states, strict=True) if n not in seen}
    largest = {}
    for port in (*system.ports, *system.links):
        for kind, expressions in port_motion_expressions(system, port, traced):
            unseen = any(sp.sympify(e).free_symbols & hidden for e in expressions)
            states = inferred if unseen else measured
            values = sp.lambdify(traced.x, expressions, "numpy")(*states.T)
            largest[f"{port.name}.{kind}"] = max(
                float(np.max(np.abs(np.broadcast_to(c, len(states))))) for c in values
            )
    for port in system.filled:
        made_of = [i for i, n in enumerate(traced.states) if n in (*port.axes, port.against)]
        unseen = any(traced.x[i] in hidden for i in made_of)
        visited = inferred if unseen else measured
        largest[f"{port.name}.position"] = _largest_level(system, port, records, visited)
        if not port.against:
            paths = expected if unseen and expected else along
            largest[f"{port.name}.velocity"] = _fastest_level(port, traced, records, paths)
    unseen = np.array([symbol in hidden for symbol in traced.x])
    followed = _followed_variables(system, records, np.where(unseen, inferred, measured))
    for port in system.varied:
        values = followed.get(port.against, np.zeros(1))
        largest[f"{port.name}.position"] = float(np.abs(values).max())
        middle = largest[f"{port.name}.middle"] = _middle_far_from_zero(values)
        largest[f"{port.name}.spread"] = float(np.abs(values - middle).max())
        largest[f"{port.name}.less"] = max(0.0, min(float(values.max()), -float(values.min())))
    return {**largest, **_largest_signals(system, records)}


def _middle_far_from_zero(values: Array) -> float:
    """The middle of values that lie farther from zero than apart (temperatures in K), else zero."""
    low, high = float(values.min()), float(values.max())
    far = min(abs(low), abs(high)) > high - low > 0 and low * high > 0
    return 0.5 * (low + high) if far else 0.0


def _largest_level(system: System, port: Port, records: Sequence[Record], states: Array) -> float:
    """Largest |level| of a port for flows along states (samples, n), from what it counts against.

    An input is counted as far apart as both may be.
    """
    columns = {s.name: states[:, i] for i, s in enumerate(system.states)}
    levels = np.stack([columns[name] for name in port.axes])
    if port.against in columns:
        levels = levels - columns[port.against]
    elif port.against:
        outside = np.concatenate([r.inputs[port.against] for r in records])
        levels = np.stack([levels - outside.min(), levels - outside.max()])
    return float(np.abs(levels).max())


def _fastest_level(
    port: Port, traced: TracedModel, records: Sequence[Record], paths: Sequence[Array]
) -> float:
    """Largest |rate| of the states of a port for flows along each record's states (samples, n)."""
    places = [traced.states.index(name) for name in port.axes]
    fastest = (
        np.abs(np.gradient(path[:, places], record.dt, axis=0)).max()
        for path, record in zip(paths, records, strict=True)
    )
    return float(max(fastest))


def _largest_signals(system: System, records: Sequence[Record]) -> dict[str, float]:
    """Largest |value| and |rate| of inputs, how far they go from the middle, |value| of sensors."""
    largest = {}
    for port in system.driven:
        given = [(r.inputs[name], r.dt) for r in records for name in port.axes]
        largest[f"{port.name}.position"] = float(max(np.abs(u).max() for u, _ in given))
        low, high = min(u.min() for u, _ in given), max(u.max() for u, _ in given)
        largest[f"{port.name}.spread"] = float(0.5 * (high - low))
        largest[f"{port.name}.velocity"] = float(
            max(np.abs(np.diff(u)).max() / dt for u, dt in given)
        )
    for port in system.sensed:
        seen = [np.abs(r.channels[name]).max() for r in records for name in port.axes]
        largest[f"{port.name}.position"] = float(max(seen))
    return largest


def _followed_variables(
    system: System, records: Sequence[Record], states: Array
) -> dict[str, Array]:
    """Values of each state (samples, n), each input, each auxiliary, and the largest times."""
    followed = {s.name: states[:, i] for i, s in enumerate(system.states)}
    followed |= {i.name: np.concatenate([r.inputs[i.name] for r in records])
                 for i in system.inputs if all(i.name in r.inputs for r in records)}  # fmt: skip
    followed[TIME] = np.array([(r.samples - 1) * r.dt for r in records])
    if system.auxiliaries:
        given = (sample_inputs(prepare_series(system, r, 1).inputs, 1) for r in records)
        inputs, first = np.concatenate(list(given)), list(_first_values(system).values())
        with np.errstate(all="ignore"):
            along = {a.name: auxiliary_along(system, a.name, states, inputs, first)
                     for a in system.auxiliaries}  # fmt: skip
        followed |= {name: np.nan_to_num(values) for name, values in along.items()}
    return followed


def shape_scale(parameter: Parameter, largest: Mapping[str, float], port: Port) -> float:
    """The size of which a shape's grid gives shares; without a grid the parameter's start.

    That of a time is how long the fastest motion would take to the largest one.
    """
    if not parameter.grid:
        return parameter.start or 1.0
    if parameter.centre:
        return largest.get(f"{port.name}.middle", 0.0)
    if parameter.spread:
        return largest[f"{port.name}.spread"]
    if parameter.two_sided:
        less, more = (largest[f"{port.name}.{kind}"] for kind in ("less", "position"))
        return more if less >= _OTHER_SIDE * more else 0.0
    if parameter.unit == "s":
        position, fastest = (largest[f"{port.name}.{kind}"] for kind in ("position", "velocity"))
        farthest = largest.get(f"{port.name}.spread", position)
        return farthest / fastest if fastest > 0 else np.inf
    unit = "velocity" if parameter.unit == "position/s" else parameter.unit  # as formulas have it
    for kind in ("velocity", "position"):
        if kind in unit:
            return largest[f"{port.name}.{kind}"]
    return 1.0


def with_scaled_shapes(model: Model, records: tuple[Record, ...]) -> tuple[Model, tuple[str, ...]]:
    """A model whose effects have all their shapes, and the full names of those that were lacking.

    A shape that was given no value takes the middle of its grid, a reference the middle of what it
    is counted from where that is far from zero; a frequency, or a time, the middle of the band that
    the records can show (geometric), whatever it starts from elsewhere.
    """
    lacking = {
        effect.label: shapes
        for effect in model.effects
        if (shapes := [p for p in effect.parameters if _lacks_value(model, effect, p)])
    }
    if not lacking:
        return model, ()
    bare = model
    for label in lacking:
        bare = bare.without(label)
    largest = largest_port_motion(model.system, records, states_along_records(bare, records))
    values = {}
    for effect in model.effects:
        for shape in lacking.get(effect.label, ()):
            if shape.spectrum:
                middle = float(np.sqrt(np.prod(frequency_band(records[0].samples, records[0].dt))))
                values[f"{effect.label}.{shape.name}"] = frequency_shapes(effect, middle)[
                    shape.name
                ]
                continue
            size = shape_scale(shape, largest, model.system.place(effect))
            if is_tried_scale(shape, size):
                middle = shape.grid[len(shape.grid) // 2]
                values[f"{effect.label}.{shape.name}"] = middle * size
    return replace(model, values={**model.values, **values}), tuple(values)


def _lacks_value(model: Model, effect: Effect, parameter: Parameter) -> bool:
    lacking = parameter.start is None or parameter.centre
    scaled = parameter.spectrum or (parameter.grid and lacking)
    return (
        bool(parameter.role == "shape" and scaled)
        and f"{effect.label}.{parameter.name}" not in model.values
    )


def is_tried_scale(shape: Parameter, size: float) -> bool:
    """Whether a shape with a grid has values at this scale: a positive one, or a centre at zero."""
    return bool(np.isfinite(size) and size > 0) or (shape.centre and shape.start is not None)


def covering_samples(states: Array, count: int = 64) -> Array:
    """Indices of samples that cover a motion: evenly spaced, and every state's extremes."""
    even = np.linspace(0, len(states) - 1, min(count, len(states))).astype(np.int64)
    return np.unique(np.concatenate([even, states.argmin(axis=0), states.argmax(axis=0)]))


def states_along_records(model: Model, records: tuple[Record, ...]) -> tuple[Array, ...]:
    """The system's states (samples, n) along every record; hidden ones as the model infers them."""
    traced = trace(model.system, ())
    study = CompiledStudy(
        compile_model(traced), tuple(prepare_series(model.system, r, 1) for r in records)
    )
    seen = [smoothed_motion(study, s, _WINDOW).states for s in study.series]
    hidden = [
        i for i, name in enumerate(traced.states) if name not in _states_from_channels(traced)
    ]
    if hidden:
        for states, series in zip(seen, study.series, strict=True):
            states[:, hidden] = _infer_states(model, series)[:, hidden]
    return tuple(seen)


def _states_from_channels(traced: TracedModel) -> set[str]:
    """States that ``motion`` takes from channels: measured, rates of such, and those like one."""
    return {*measured_states(traced), *(name for name, _ in traced.like)}


def _infer_states(model: Model, series: Series) -> Array:
    """(samples, n) hidden states by a filter, else by a free run, else zero."""
    traced = trace(model.system, model.effects)
    own = tuple(k for k, p in model.pairs if p.scope == "record")
    known = [model.values.get(k, p.start or 0.0) for k, p in model.pairs]
    n = len(trace(model.system, ()).states)
    with np.errstate(all="ignore"):
        task = build_task(model, compile_model(traced, own), np.array(known, float), series.record)
        task, settings = prepare_filter(task)
        noisy = with_level(task, settings, dict.fromkeys(noise_groups(task), _LEVEL))
        passed = filter_record(task, noisy)
        if passed.done == series.samples and np.isfinite(passed.means).all():
            return passed.means[:, :n]
        run = run_from_rest(task.compiled, task.series, task.inputs, task.values)
    return np.zeros((series.samples, n)) if run is None else run[:, :n]


def port_motion_expressions(
    system: System, port: Port, traced: TracedModel
) -> list[tuple[str, list[Any]]]:
    """A port's position, and in a mechanical system its velocity, as expressions of the states."""
    x = SimpleNamespace(**dict(zip(traced.states, traced.x, strict=True)))
    p = SimpleNamespace(**{name: sp.Float(value) for name, value in _first_values(system).items()})
    if not has_coordinates(system):
        return [("position", list(port.coordinates(x, p)))]
    q, v = system.split(x)
    position = sp.Matrix(port.coordinates(q, p))
    names = [c.name for c in system.coordinates]
    velocity = position.jacobian([getattr(q, n) for n in names])
    velocity = velocity * sp.Matrix([getattr(v, n) for n in names])
    return [("position", sp.flatten(position)), ("velocity", sp.flatten(velocity))]


def _first_values(system: System) -> dict[str, float]:
    """A value of each of a system's parameters: as given, as it is first tried, or one."""
    return {
        q.name: q.start or system.defaults.get(f"system.{q.name}") or 1.0 for q in system.parameters
    }
