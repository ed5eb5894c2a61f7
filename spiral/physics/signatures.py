"""Slopes of rates and readings by each amplitude of an effect, along a motion.

A system's rates are affine in what is injected at its places,

    x' = f(x, u, p) + G(x, u, p) Q,      Q = J^T F        (virtual work; a flow is its own Q)

so an effect that is absent has the slope G J^T dF/da by an amplitude a, F being linear in it. The
effect's own equation is evaluated along the states as arrays; nothing is compiled for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp

from spiral.physics.injections import state_entered
from spiral.physics.plugin_calls import call_equation
from spiral.physics.readings import reading_slopes
from spiral.physics.system_functions import (
    auxiliary_function,
    capacities,
    mass_matrix,
    parameter_symbols,
    port_geometry,
    port_position,
)
from spiral.physics.trace import trace
from spiral.types.cache import kept
from spiral.types.effect import (
    Effect,
    FlowEffect,
    ForceEffect,
    InputEffect,
    ParameterEffect,
    SensorEffect,
    StateFlow,
    is_path,
)
from spiral.types.label import parameter_of
from spiral.types.placement import check_effect, input_columns
from spiral.types.port import At, Port, varied_key
from spiral.types.record import Array
from spiral.types.system import MechanicalSystem, System, has_coordinates

Function = Callable[..., Any]
_SMALL = 1e-8  # amplitude of an effect on an input, which may be linear to leading order only
Own = Mapping[str, Any]
"""An effect's own states along a motion: (samples,) each, or a tuple of such, one for each axis."""


@dataclass(frozen=True)
class SystemMotion:
    """A motion of a system.

    ``states`` (samples, n) of the system alone, ``inputs`` (samples, input columns), ``rates``
    (samples, n) and ``readings`` (samples, channels) of the model as it is, ``values`` of the
    system's parameters by name, ``by_input`` slopes of the rates (samples, n) and the readings
    (samples, channels) by each input that an actuator may change, ``by_parameter`` by the logarithm
    of each parameter that is asked whether it varies (full name), ``by_state`` slopes of the rates
    by each state of which it is asked how it acts on others; ``reading_rates`` (samples, channels)
    where readings are no states; ``known`` keeps what all effects of a place share.
    """

    system: System
    states: Array
    inputs: Array
    rates: Array
    readings: Array
    values: Mapping[str, float]
    by_input: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    by_parameter: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    by_state: Mapping[str, Array] = field(default_factory=dict)
    reading_rates: Array | None = None
    known: dict[str, Any] = field(default_factory=dict, compare=False)

    def part(self, where: slice) -> SystemMotion:
        """The motion over a range of samples."""
        return replace(
            self, states=self.states[where], inputs=self.inputs[where], rates=self.rates[where],
            readings=self.readings[where], known={},
            reading_rates=None if self.reading_rates is None else self.reading_rates[where],
            by_input={k: (a[where], b[where]) for k, (a, b) in self.by_input.items()},
            by_parameter={k: (a[where], b[where]) for k, (a, b) in self.by_parameter.items()},
            by_state={k: slopes[where] for k, slopes in self.by_state.items()},
        )  # fmt: skip

    def compute_once(self, name: str, made: Callable[[], Any]) -> Any:
        """The value of a function, computed when this name is first asked for."""
        if name not in self.known:
            self.known[name] = made()
        return self.known[name]

    @property
    def parameters(self) -> list[float]:
        """The system's, in their order."""
        return [self.values[p.name] for p in self.system.parameters]


def amplitude_names(effect: Effect, port: Port) -> tuple[str, ...]:
    """Names of an effect's amplitudes in the order of columns, with ``_axis`` where per axis."""
    known = {p.name for p in effect.amplitudes()}
    return tuple(parameter_of(k) for k, p in effect.keys(port) if p.name in known)


def signatures(
    along: SystemMotion,
    effect: Effect,
    shapes: Mapping[str, float],
    shift: float = 0.0,
    own: Own | None = None,
) -> tuple[Array, Array]:
    """Slopes of rates (samples, n, amplitudes) and readings (samples, channels, amplitudes).

    Parameters
    ----------
    shapes : values of the effect's shape parameters by name. shift : rad added to ``u.phase``.
    own : its own states (``own_states_along``), where it has any.
    """
    system = along.system
    port = check_effect(system, effect)
    count, n = along.states.shape
    units = _unit_amplitudes(effect, port, shapes)
    # One amplitude after the other in memory: callers take them out one by one.
    rates = np.moveaxis(np.zeros((len(units), count, n)), 0, 2)
    readings = np.moveaxis(np.zeros((len(units), count, len(system.observed))), 0, 2)
    u, hidden = effect_inputs(along, shift), SimpleNamespace(**(own or {}))
    if isinstance(effect, SensorEffect):
        for j, p in enumerate(units):
            readings[:, :, j] = _readings_with_effect(along, effect, u, p, hidden) - along.readings
        return rates, readings
    if isinstance(effect, InputEffect | ParameterEffect):
        small = _unit_amplitudes(effect, port, shapes, _SMALL)  # the leading order alone
        if isinstance(effect, InputEffect):
            return _actuator_slopes(along, effect, port, u, small, hidden)
        return _varied_slopes(along, effect, port, u, small)
    gain = along.compute_once("pushed", lambda: _collapse_constant(_injection_gain_along(along)))
    for j, p in enumerate(units):
        rates[:, :, j] = _apply_matrix(gain, _injected_values(along, effect, port, u, p, hidden))
    if system.readings:
        felt = along.compute_once("felt", lambda: reading_slopes(
            system, along.states, along.rates, along.inputs, along.parameters
        ))  # fmt: skip
        for j in range(len(units)):
            readings[:, :, j] = _apply_matrix(felt, rates[:, :, j])
    return rates, readings


def _actuator_slopes(
    along: SystemMotion,
    effect: InputEffect,
    port: Port,
    u: SimpleNamespace,
    small: Sequence[SimpleNamespace],
    own: SimpleNamespace,
) -> tuple[Array, Array]:
    """Slopes of rates and readings by the (``small``) amplitudes of a change of an input."""
    recorded = _recorded_input(along, port)
    at = At((recorded,), (), own)
    driven = [call_equation(effect, "drive", effect.drive, at, u, p) for p in small]
    change = ((np.stack(driven, axis=1) - recorded[:, None]) / _SMALL)[:, None]
    rates, readings = along.by_input[port.axes[0]]
    return rates[:, :, None] * change, readings[:, :, None] * change


def _varied_slopes(
    along: SystemMotion,
    effect: ParameterEffect,
    port: Port,
    u: SimpleNamespace,
    small: Sequence[SimpleNamespace],
) -> tuple[Array, Array]:
    """Slopes of rates and readings by the (``small``) amplitudes of a parameter that varies."""
    at = At((followed_variable(along, port),) if port.against else (), (), SimpleNamespace())
    factors = [call_equation(effect, "factor", effect.factor, at, u, p) for p in small]
    change = (_stack_columns(factors, len(along.states)) - 1.0)[:, None] / _SMALL
    rates, readings = along.by_parameter[varied_key(port)]
    return rates[:, :, None] * change, readings[:, :, None] * change


def _readings_with_effect(
    along: SystemMotion,
    effect: SensorEffect,
    u: SimpleNamespace,
    p: SimpleNamespace,
    own: SimpleNamespace,
) -> Array:
    """(samples, channels) readings with a sensor's effect."""
    channels = check_effect(along.system, effect).axes
    places = [along.system.observed.index(c) for c in channels]
    position, velocity = port_motion_along(along, effect)
    at, readings = At(tuple(position.T), tuple(velocity.T), own), np.array(along.readings)
    told = call_equation(effect, "reading", effect.reading, list(readings.T[places]), at, u, p)
    readings[:, places] = _stack_columns(told, len(along.states))
    return readings


def _collapse_constant(matrix: Array) -> Array:
    """(rows, columns) of a matrix that is the same at every sample, else (samples, ..) as it is."""
    return matrix[0] if (matrix == matrix[:1]).all() else matrix


def _apply_matrix(matrix: Array, vectors: Array) -> Array:
    """(samples, rows) of a matrix, steady or for each sample, times (samples, columns)."""
    return vectors @ matrix.T if matrix.ndim == 2 else np.einsum("tij,tj->ti", matrix, vectors)


def port_motion_along(along: SystemMotion, effect: Effect) -> tuple[Array, Array]:
    """(samples, axes) positions and velocities where an effect acts.

    Velocities of an input and of a flow's place are differences per sample; those of a sensor's
    channels are their rates.
    """
    port = along.system.place(effect)
    if isinstance(effect, SensorEffect) and not effect.driver:
        return _channel_motion(along, port)
    if isinstance(effect, ParameterEffect | SensorEffect):
        still = np.zeros(len(along.states))
        position = (followed_variable(along, port) if port.against else still)[:, None]
        return position, np.gradient(position, axis=0)
    if isinstance(effect, InputEffect):
        position = _recorded_input(along, port)[:, None]
        return position, np.gradient(position, axis=0)
    if isinstance(effect, StateFlow):
        position = _flow_position(along, effect, port)
        return position, np.gradient(position, axis=0)
    if has_coordinates(along.system):
        position, velocity, _ = along.compute_once(port.name, lambda: _port_kinematics(along, port))
        return position, velocity
    place = port_position(along.system, port.name)(*along.states.T, *along.parameters)
    position = _stack_columns(place, len(along.states))
    return position, np.gradient(position, axis=0)


def _channel_motion(along: SystemMotion, port: Port) -> tuple[Array, Array]:
    """(samples, axes) what sensors see and its rates: of states, or of readings that are none."""
    system, names = along.system, [s.name for s in along.system.states]
    pairs = []
    for channel in port.axes:
        if channel in names:
            at = names.index(channel)
            pairs.append((along.states[:, at], along.rates[:, at]))
        else:
            assert along.reading_rates is not None
            at = system.observed.index(channel)
            pairs.append((along.readings[:, at], along.reading_rates[:, at]))
    return np.stack([a for a, _ in pairs], axis=1), np.stack([b for _, b in pairs], axis=1)


def _flow_position(along: SystemMotion, effect: StateFlow, port: Port) -> Array:
    """(samples, axes) what a flow follows: the states of its port from what they count against."""
    if effect.driver:
        return followed_variable(along, port)[:, None]
    levels = along.states[:, [_state_index(along.system, name) for name in port.axes]]
    return levels - followed_variable(along, port)[:, None] if port.against else levels


def followed_variable(along: SystemMotion, port: Port) -> Array:
    """(samples,) the state, the input, the auxiliary or the time that a port counts against."""
    system, name = along.system, port.against
    names, columns = [s.name for s in system.states], input_columns(system)
    if name in names:
        return along.states[:, names.index(name)]
    if name in columns:
        return along.inputs[:, columns.index(name)]
    return auxiliary_along(system, name, along.states, along.inputs, along.parameters)


def auxiliary_along(
    system: System, name: str, states: Array, inputs: Array, parameters: Sequence[float]
) -> Array:
    """(samples,) one of a system's ``auxiliaries`` along states and inputs (samples, columns)."""
    values = auxiliary_function(system, name)(*states.T, *inputs.T, *parameters)
    return np.array(np.broadcast_to(values, len(states)), float)


def _recorded_input(along: SystemMotion, port: Port) -> Array:
    """(samples,) what was recorded of an input."""
    return along.inputs[:, input_columns(along.system).index(port.axes[0])]


def _injected_values(
    along: SystemMotion,
    effect: Effect,
    port: Port,
    u: SimpleNamespace,
    p: SimpleNamespace,
    own: SimpleNamespace,
) -> Array:
    """(samples, injections) that an effect with these values injects."""
    system, count = along.system, len(along.states)
    names = [i.name for i in system.injections]
    injected = np.zeros((count, len(names)))
    if isinstance(effect, ForceEffect):
        position, velocity, jacobian = along.compute_once(
            port.name, lambda: _port_kinematics(along, port)
        )
        at = At(tuple(position.T), tuple(velocity.T), own)
        forces = _stack_columns(call_equation(effect, "force", effect.force, at, u, p), count)
        assert has_coordinates(system)
        pushed = [names.index(q.name) for q in system.coordinates]
        injected[:, pushed] = _apply_matrix(jacobian, forces)
        return injected
    if isinstance(effect, StateFlow):
        at = _seen_by_flow(along, effect, port, own)
        into = call_equation(effect, "flow", effect.flow, at, u, p)
        injected[:, [names.index(name) for name in port.axes]] = _stack_columns(into, count)
        return injected
    assert isinstance(effect, FlowEffect)
    x = SimpleNamespace(
        **{s.name: along.states[:, i] for i, s in enumerate(system.states)}, own=own
    )
    flows = call_equation(effect, "flow", effect.flow, x, u, p)
    for name, value in flows.items():
        injected[:, names.index(name)] = value
    return injected


def _seen_by_flow(along: SystemMotion, effect: StateFlow, port: Port, own: SimpleNamespace) -> At:
    """What a flow between states of first order sees along a motion."""
    places = [_state_index(along.system, name) for name in port.axes if effect.rated]
    velocity = tuple(along.rates[:, place] for place in places)
    counted = port.against and not effect.driver
    outside = followed_variable(along, port) if counted else 0.0
    position = tuple(_flow_position(along, effect, port).T)
    at = At(position, velocity, own, outside=outside)
    return replace(at, along_path=_path_along(along, port)) if is_path(effect) else at


def _path_along(along: SystemMotion, port: Port) -> Callable[[Any], Any]:
    """What more flows in where the driver of a path has another value, to leading order."""
    (into,), system = port.axes, along.system
    names = [i.name for i in system.injections]
    row = _state_index(system, state_entered(system, into))
    gain = along.compute_once("pushed", lambda: _collapse_constant(_injection_gain_along(along)))
    slope = along.by_state[port.against][:, row] / gain[..., row, names.index(into)]
    here = followed_variable(along, port)
    return lambda value: slope * (value - here)


def _port_kinematics(along: SystemMotion, port: Port) -> tuple[Array, Array, Array]:
    """(samples, axes) positions and velocities of a port, and its Jacobian's transpose."""
    count = len(along.states)
    position, velocity, jacobian = port_geometry(along.system, port.name)(
        *along.states.T, *along.parameters
    )
    turned = np.swapaxes(_stack_matrix(jacobian, count), 1, 2)
    return (
        _stack_columns(position, count),
        _stack_columns(velocity, count),
        _collapse_constant(turned),
    )


def _unit_amplitudes(
    effect: Effect, port: Port, shapes: Mapping[str, Any], size: float = 1.0
) -> list[SimpleNamespace]:
    """Parameters with one amplitude at 1 (or a size) and all others at 0, for each in turn."""
    axes = port.axes if len(port.axes) > 1 else (port.axes[0] if port.axes else "",)
    spots = [
        (q.name, i) for q in effect.amplitudes() for i in range(len(axes) if q.per_axis else 1)
    ]
    parameter_sets = []
    for name, place in spots:
        p = SimpleNamespace()
        for q in effect.parameters:
            if q.role == "shape":
                one: Any = shapes.get(q.name, q.start or 0.0)
                setattr(p, q.name, (one,) * len(axes) if q.per_axis else one)
                continue
            values = [size * (q.name == name and i == place) for i in range(len(axes))]
            setattr(p, q.name, tuple(values) if q.per_axis else values[0])
        parameter_sets.append(p)
    return parameter_sets


def effect_inputs(along: SystemMotion, shift: float) -> SimpleNamespace:
    """The inputs as effects see them, each (samples,)."""
    system = along.system
    u = SimpleNamespace(**dict(zip(input_columns(system), along.inputs.T, strict=True)))
    seen = system.seen(u, SimpleNamespace(**along.values))
    return SimpleNamespace(**{**vars(seen), "phase": seen.phase + shift}) if shift else seen


def _state_index(system: System, name: str) -> int:
    return [s.name for s in system.states].index(name)


def _stack_columns(values: Sequence[Any], count: int) -> Array:
    """(samples, values) of arrays and numbers."""
    return np.stack([np.broadcast_to(np.asarray(v, float), (count,)) for v in values], axis=1)


def _stack_matrix(rows: Sequence[Sequence[Any]], count: int) -> Array:
    """(samples, rows, columns) of a nested list of arrays and numbers."""
    return np.stack([_stack_columns(row, count) for row in rows], axis=1)


def injection_slopes(system: System) -> sp.Matrix:
    """Slopes (states, injections) of the rates by what is injected, in the symbols of ``trace``."""
    traced = trace(system, ())
    x = SimpleNamespace(**dict(zip((s.name for s in system.states), traced.x, strict=True)))
    u = SimpleNamespace(**dict(zip(traced.inputs, traced.u, strict=True)))
    p = parameter_symbols(traced)
    pushes = {i.name: sp.Symbol(f"q{j}", real=True) for j, i in enumerate(system.injections)}
    rates = system.rate(x, u, p, pushes)
    wanted = sp.Matrix([sp.sympify(rates[s.name]) for s in system.states])
    return wanted.jacobian(list(pushes.values())).subs(dict.fromkeys(pushes.values(), 0))


def _injection_gain_along(along: SystemMotion) -> Array:
    """G (samples, n, injections): slopes of the rates by what is injected.

    Of a mechanical system M^-1 for the accelerations, inverted sample by sample: as a formula the
    inverse of six coordinates fills pages. One with rates of its own is asked by its formulas: a
    program may take a force through an input.
    """
    system, count = along.system, len(along.states)
    if not has_coordinates(system) or type(system).rate is not MechanicalSystem.rate:
        rows = _injection_gain(system)(*along.states.T, *along.inputs.T, *along.parameters)
        return _stack_matrix(rows, count)
    mass = mass_matrix(system)(*along.states.T, *along.parameters)
    inverse = np.linalg.inv(_stack_matrix(mass, count))
    states, names = [s.name for s in system.states], [c.name for c in system.coordinates]
    gain = np.zeros((count, len(states), len(system.injections)))
    pushed = [states.index(system.rate_name(n)) for n in names]
    gain[:, pushed, : len(names)] = inverse
    changing, capacity = capacities(system)
    values = capacity(*along.states.T, *along.inputs.T, *along.parameters)
    for j, other in enumerate(system.injections[len(names) :], len(names)):
        over = values[changing.index(other.name)] if other.name in changing else 1.0
        gain[:, states.index(other.name), j] = 1.0 / over
    return gain


@kept(32)
def _injection_gain(system: System) -> Function:
    """G(x, u, p): slopes of the rates by what is injected."""
    traced = trace(system, ())
    slopes = injection_slopes(system).tolist()
    return sp.lambdify([*traced.x, *traced.u, *traced.p], slopes, "numpy")
