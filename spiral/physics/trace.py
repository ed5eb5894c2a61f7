"""A system and its effects, traced with SymPy to explicit expressions.

    x' = f(x, u, p),    y = h(x, u, p)

with exact Jacobians f_x, f_p, h_x, h_p. Everything else (compiled functions, LaTeX, regression
columns, exported code) is made from a ``TracedModel``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import sympy as sp

from spiral.physics.effect_states import axis_suffixes, own_states, states_like_port
from spiral.physics.injections import (
    PlacedEffect,
    sum_injections,
    system_rates,
    with_rates_of_states,
)
from spiral.physics.plugin_calls import call_equation
from spiral.physics.readings import own_readings
from spiral.types.cache import kept
from spiral.types.effect import (
    Effect,
    InputEffect,
    ParameterEffect,
    SensorEffect,
    StateFlow,
    values_for,
)
from spiral.types.errors import PluginError
from spiral.types.parameter import Parameter
from spiral.types.placement import check_effect, input_columns, model_keys
from spiral.types.port import At, varied_key
from spiral.types.system import System, has_coordinates

_IN_LINE = 3  # at most so many effects on one input act one after the other


@dataclass(frozen=True)
class TracedModel:
    """Symbols and expressions of one model; order of all tuples is the order of arrays."""

    states: tuple[str, ...]
    channels: tuple[str, ...]
    inputs: tuple[str, ...]
    keys: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    x: tuple[sp.Symbol, ...]
    u: tuple[sp.Symbol, ...]
    p: tuple[sp.Symbol, ...]
    rate: tuple[sp.Expr, ...]
    output: tuple[sp.Expr, ...]
    forces: tuple[sp.Expr, ...]
    acceleration: tuple[sp.Symbol, ...]
    like: tuple[tuple[str, str], ...] = ()
    starts: tuple[tuple[str, float], ...] = ()
    """States that begin elsewhere than at zero, and where."""
    rates: tuple[tuple[str, str], ...] = ()
    """Coordinates of the system whose rates have a name of their own, and that name."""
    reading_states: tuple[tuple[str, str, bool], ...] = ()
    """Of readings that are no state: channel, state, whether it is just that state's rate."""

    @cached_property
    def shown(self) -> dict[str, int]:
        """States that a channel reports as they are, and that channel's number."""
        return {c: j for j, c in enumerate(self.channels) if c in self.states}

    @cached_property
    def driving(self) -> frozenset[str]:
        """Input columns that rates follow, time among them."""
        followed = set().union(*(rate.free_symbols for rate in self.rate))
        return frozenset(n for n, u in zip(self.inputs, self.u, strict=True) if u in followed)

    @cached_property
    def measured_or_read(self) -> frozenset[str]:
        """States that are measured as they are, or that enter a reading that is no state."""
        return frozenset((*self.shown, *(state for _, state, _ in self.reading_states)))

    @cached_property
    def accelerated(self) -> dict[str, int]:
        """Unmeasured coordinates whose acceleration is measured, and the number of its channel."""
        plain = {state: channel for channel, state, is_rate in self.reading_states if is_rate}
        names = {n: plain.get(self.rate_name(n)) for n in self.states if n not in self.shown}
        return {n: self.channels.index(c) for n, c in names.items() if c is not None}

    def rate_name(self, state: str) -> str:
        """What the state that is the rate of another is called, where there is one."""
        return dict(self.rates).get(state, f"{state}_rate")

    def base_name(self, state: str) -> str:
        """The state that this one is the rate of, or itself."""
        return {rate: name for name, rate in self.rates}.get(state, state.removesuffix("_rate"))

    @cached_property
    def balance(self) -> tuple[sp.Expr, ...]:
        """M a - force - injected, multiplied out: linear in masses and amplitudes.

        Only when asked for: a learned curve takes seconds to multiply out, and most models never
        need it.
        """
        return tuple(sp.expand(row) for row in self.forces)

    @cached_property
    def rate_x(self) -> sp.Matrix:
        """f_x, n x n."""
        return _jacobian(self.rate, self.x)

    @cached_property
    def rate_p(self) -> sp.Matrix:
        """f_p, n x number of parameters."""
        return _jacobian(self.rate, self.p)

    @cached_property
    def output_x(self) -> sp.Matrix:
        """h_x, channels x n."""
        return _jacobian(self.output, self.x)

    @cached_property
    def output_p(self) -> sp.Matrix:
        """h_p, channels x number of parameters."""
        return _jacobian(self.output, self.p)


def _jacobian(values: tuple[sp.Expr, ...], symbols: tuple[sp.Symbol, ...]) -> sp.Matrix:
    if not symbols:
        return sp.zeros(len(values), 0)
    return sp.Matrix(values).jacobian(list(symbols))


@kept(128)
def trace(
    system: System, effects: tuple[Effect, ...], phase_shift: tuple[float, ...] = ()
) -> TracedModel:
    """Trace a system with effects.

    Parameters
    ----------
    system, effects : the physics.
    phase_shift : per effect, radians added to ``u.phase`` as that effect sees it (0 or pi/2, the
        quadrature companion of a synchronous effect whose phase origin is not known yet).

    Raises
    ------
    ConfigError : an effect needs what the system lacks.
    PluginError : an effect returns what does not fit its port.
    """
    shifts = phase_shift or (0.0,) * len(effects)
    pairs = model_keys(system, effects)
    symbols = {k: sp.Symbol(f"p{i}", real=True) for i, (k, _) in enumerate(pairs)}
    names = (*(s.name for s in system.states), *own_states(system, effects))
    states = {n: sp.Symbol(f"x{i}", real=True) for i, n in enumerate(names)}
    inputs = {n: sp.Symbol(f"u{i}", real=True) for i, n in enumerate(input_columns(system))}
    x = SimpleNamespace(**{s.name: states[s.name] for s in system.states})
    p, placed = _place_effects(system, effects, x, inputs, states, symbols)
    u, placed = _apply_actuators(placed, inputs)
    seen = [_shift_phase(system.seen(u, p), shift) for shift in shifts]
    placed = with_rates_of_states(system, placed, seen, x, u, p)
    injected = sum_injections(system, placed, seen, x)
    rates = system_rates(system, x, u, p, injected)
    shown, read = own_readings(system, x, rates, u, p)
    placed = [_with_sensor_motion(item, shown, rates, states) for item in placed]
    for item, view in zip(placed, seen, strict=True):
        rates.update(_own_rates(item, view))
    output = _apply_sensors(system, placed, seen, shown)
    acceleration, forces = _force_balance(system, x, u, p, injected, rates)
    return TracedModel(
        states=names,
        channels=system.observed,
        inputs=tuple(inputs),
        keys=tuple(symbols),
        parameters=tuple(q for _, q in pairs),
        x=tuple(states.values()), u=tuple(inputs.values()), p=tuple(symbols.values()),
        rate=tuple(sp.sympify(rates[n]) for n in names),
        output=tuple(output),
        acceleration=acceleration,
        forces=forces,
        like=(*_declared_likeness(system), *states_like_port(system, effects)),
        starts=tuple((s.name, s.start) for s in system.states if s.start),
        rates=_rate_names(system),
        reading_states=read,
    )  # fmt: skip


def _rate_names(system: System) -> tuple[tuple[str, str], ...]:
    """States whose rates have a name of their own, and that name."""
    pairs = ((s.name, system.rate_name(s.name)) for s in system.states)
    return tuple((name, rate) for name, rate in pairs if rate != f"{name}_rate")


def _declared_likeness(system: System) -> tuple[tuple[str, str], ...]:
    """States that move like another one of the system, with that one's name."""
    return tuple((s.name, s.like) for s in system.states if s.like)


def _place_effects(
    system: System,
    effects: tuple[Effect, ...],
    x: SimpleNamespace,
    inputs: dict[str, sp.Symbol],
    states: dict[str, sp.Symbol],
    symbols: dict[str, sp.Symbol],
) -> tuple[SimpleNamespace, list[PlacedEffect]]:
    """The system's parameters as they act, and the effects at their places with theirs.

    Places are where the parameters as given put them.
    """
    given = _system_parameters(system, symbols)
    placed = [_place_effect(system, e, x, inputs, given, states, symbols) for e in effects]
    acting = _vary_parameters(placed, symbols, inputs)
    placed = [replace(i, p=values_for(i.effect, i.port.axes, acting)) for i in placed]
    return _system_parameters(system, acting), placed


def _place_effect(
    system: System,
    effect: Effect,
    x: SimpleNamespace,
    inputs: dict[str, sp.Symbol],
    p: SimpleNamespace,
    states: dict[str, sp.Symbol],
    symbols: dict[str, sp.Symbol],
) -> PlacedEffect:
    port = check_effect(system, effect)
    jacobian = None
    position: tuple[Any, ...] = ()
    velocity: tuple[Any, ...] = ()
    known: Any = {**inputs, **states}
    outside = known.get(port.against, 0)
    if isinstance(effect, SensorEffect) and not effect.driver:
        pass  # what it sees follows from the rates
    elif isinstance(effect, InputEffect):
        position = tuple(inputs[name] for name in port.axes)
    elif isinstance(effect, ParameterEffect) or getattr(effect, "driver", ""):
        if port.against and port.against not in known:
            known = system.auxiliary(x, SimpleNamespace(**inputs), p)
        position = (known[port.against],) if port.against else ()
    elif isinstance(effect, StateFlow):
        position = tuple(getattr(x, name) - outside for name in port.axes)
    elif has_coordinates(system):
        q, v = system.split(x)
        position, names = tuple(port.coordinates(q, p)), [c.name for c in system.coordinates]
        jacobian = sp.Matrix(position).jacobian([getattr(q, n) for n in names])
        velocity = tuple(jacobian * sp.Matrix([getattr(v, n) for n in names]))
    else:
        position = tuple(port.coordinates(x, p))
    own = SimpleNamespace()
    for state in effect.states:
        suffixes = axis_suffixes(state.per_axis, port)
        axes = tuple(states[f"{effect.label}.{state.name}{s}"] for s in suffixes)
        setattr(own, state.name, axes if state.per_axis else axes[0])
    at = At(position, velocity, own, outside=outside)
    return PlacedEffect(effect, port, at, values_for(effect, port.axes, symbols), jacobian)


def _system_parameters(system: System, values: Mapping[str, Any]) -> SimpleNamespace:
    """The system's parameters by name, from values by full name."""
    return SimpleNamespace(**{q.name: values[f"system.{q.name}"] for q in system.parameters})


def _vary_parameters(
    placed: list[PlacedEffect], symbols: dict[str, sp.Symbol], inputs: dict[str, sp.Symbol]
) -> dict[str, Any]:
    """The values that act, by full name: factors of several effects on one parameter multiply.

    A parameter of an effect that the model has not any more is left alone.
    """
    acting: dict[str, Any] = dict(symbols)
    for item in placed:
        effect = item.effect
        if isinstance(effect, ParameterEffect) and (key := varied_key(item.port)) in acting:
            u = SimpleNamespace(**inputs)
            acting[key] *= call_equation(effect, "factor", effect.factor, item.at, u, item.p)
    return acting


def _apply_actuators(
    placed: list[PlacedEffect], inputs: dict[str, sp.Symbol]
) -> tuple[SimpleNamespace, list[PlacedEffect]]:
    """The inputs as the effects of actuators change them, one effect after the other.

    More than ``_IN_LINE`` effects on one input (candidates), and those after a piecewise one, act
    on the recorded input instead, and their changes are added: nested expressions grow too large.
    """
    u, updated = SimpleNamespace(**inputs), []
    on = Counter(i.port.axes[0] for i in placed if isinstance(i.effect, InputEffect))
    for item in placed:
        if isinstance(effect := item.effect, InputEffect):
            (name,), now = item.port.axes, getattr(u, item.port.axes[0])
            given = inputs[name] if on[name] > _IN_LINE or now.has(sp.Piecewise) else now
            item = replace(item, at=replace(item.at, position=(given,)))
            value = call_equation(effect, "drive", effect.drive, item.at, u, item.p)
            setattr(u, name, now + value - given)
        updated.append(item)
    return u, updated


def _with_sensor_motion(
    item: PlacedEffect, shown: dict[str, Any], rates: dict[str, Any], states: dict[str, sp.Symbol]
) -> PlacedEffect:
    """A sensor sees its channels and their rates, in a system of any order.

    The rate of a reading that is no state is that of its formula, with the inputs held.
    """
    if not isinstance(item.effect, SensorEffect) or item.effect.driver:
        return item
    second = {states[name]: sp.sympify(rate) for name, rate in rates.items()}
    position: tuple[Any, ...] = tuple(sp.sympify(shown[name]) for name in item.port.axes)
    velocity = tuple(_total_derivative(value, second) for value in position)
    acceleration = tuple(second.get(v, sp.Integer(0)) for v in velocity)
    return replace(item, at=At(position, velocity, item.at.own, acceleration))


def _total_derivative(value: Any, rates: dict[sp.Symbol, sp.Expr]) -> Any:
    """d/dt of an expression in the states."""
    if value in rates:
        return rates[value]
    return sum((value.diff(x) * r for x, r in rates.items() if value.has(x)), sp.Integer(0))


def _shift_phase(u: SimpleNamespace, shift: float) -> SimpleNamespace:
    if not shift:
        return u
    return SimpleNamespace(**{**vars(u), "phase": u.phase + sp.nsimplify(shift / sp.pi) * sp.pi})


def _own_rates(item: PlacedEffect, u: SimpleNamespace) -> dict[str, Any]:
    effect = item.effect
    if not effect.states:
        return {}
    given = call_equation(effect, "rate", effect.rate, item.at, u, item.p)
    rates: dict[str, Any] = {}
    for state in effect.states:
        if state.name not in given:
            raise PluginError(
                f"rate() of effect {effect.label!r} without {state.name!r}",
                "a value for each state of its own",
            )
        value = given[state.name]
        values = list(value) if state.per_axis else [value]
        for suffix, one in zip(axis_suffixes(state.per_axis, item.port), values, strict=True):
            rates[f"{effect.label}.{state.name}{suffix}"] = one
    return rates


def _apply_sensors(
    system: System, placed: list[PlacedEffect], seen: list[SimpleNamespace], shown: dict[str, Any]
) -> list[sp.Expr]:
    """Expressions of the channels behind the effects of sensors, applied one after the other.

    Variants of one effect, of which one acts, are applied side by side. Effects with shapes come
    first: a piecewise expression inside another is multiplied out by SymPy without end.
    """
    order = sorted(
        zip(placed, seen, strict=True),
        key=lambda pair: not any(p.role == "shape" for p in pair[0].effect.parameters),
    )
    y: list[Any] = [shown[name] for name in system.observed]
    before, last = y, ""
    for item, u in order:
        if isinstance(item.effect, SensorEffect):
            effect = item.effect
            kind = replace(effect, variant="").label if effect.variant else ""
            before, last = (before if kind and kind == last else y), kind
            own = [system.observed.index(name) for name in item.port.axes]
            seen_there = [before[i] for i in own]
            told = list(
                call_equation(effect, "reading", effect.reading, seen_there, item.at, u, item.p)
            )
            if len(told) != len(own):
                raise PluginError(
                    f"reading of effect {item.effect.label!r} with {len(told)} values",
                    f"{len(own)} values, one for each channel",
                )
            y = list(y)
            for i, new, old in zip(own, told, seen_there, strict=True):
                y[i] = y[i] + new - old
    return [sp.sympify(value) for value in y]


def _force_balance(
    system: System, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace,
    injected: dict[str, Any], rates: dict[str, Any],
) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Expr, ...]]:  # fmt: skip
    """Accelerations a and M a - force - injected, which are zero: the balance of forces."""
    if not has_coordinates(system):
        return (), ()
    q, v = system.split(x)
    count = len(system.coordinates)
    a = tuple(sp.Symbol(f"a{i}", real=True) for i in range(count))
    if not system.balanced:  # per unit mass
        speeds = (rates[system.rate_name(c.name)] for c in system.coordinates)
        return a, tuple(sp.sympify(s - r) for s, r in zip(a, speeds, strict=True))
    inertia = sp.Matrix(system.mass(q, p)) * sp.Matrix(a)
    own = system.force(q, v, u, p)
    names = [c.name for c in system.coordinates]
    forces = tuple(sp.sympify(inertia[i] - own[i] - injected[names[i]]) for i in range(count))
    return a, forces
