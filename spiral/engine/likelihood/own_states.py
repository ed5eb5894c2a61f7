"""States that an effect brings, driven along a motion while its amplitude is zero.

The effect's own rate equation is traced alone, with the position and velocity of its port as given
functions of time, and compiled once for each number of axes,

    z' = r(z, q(t), q'(t), u(t), shapes),

then integrated by classical Runge-Kutta steps from rest (or from where its port is, for a state
that is said to be ``like`` it), of one sample or parts of one where the states are faster, for many
values of the shapes at once; the motion between samples is a parabola through a cubic Hermite
curve's middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace

import numpy as np
import sympy as sp

from spiral.engine.threads import run_in_threads
from spiral.physics.compile import CompiledModel, compile_model
from spiral.physics.signatures import Own, SystemMotion, effect_inputs, port_motion_along
from spiral.physics.trace import TracedModel
from spiral.types.cache import kept
from spiral.types.effect import Effect, expand
from spiral.types.label import parameter_of
from spiral.types.placement import check_effect
from spiral.types.port import At
from spiral.types.record import Array


def own_states_along(
    along: SystemMotion, dt: float, effect: Effect, shapes: Mapping[str, Array], shift: float = 0.0
) -> Array:
    """Own states (copies, samples, states), amplitudes at zero, along a motion.

    Parameters
    ----------
    shapes : (copies,) of each shape parameter. shift : rad added to ``u.phase``.
    """
    from spiral.engine.likelihood.own_states_kernel import drive_own_states

    port = check_effect(along.system, effect)
    axes = max(len(port.axes), 1)
    u = vars(effect_inputs(along, shift))
    names = tuple(sorted(u))
    compiled = compile_own_rates(type(effect), axes, names)
    position, velocity = port_motion_along(along, effect)
    middle, turning = midpoint_motion(position, velocity, dt)
    count = len(along.states)
    inputs = np.column_stack([np.broadcast_to(u[n], (count,)) for n in names] or [np.zeros(count)])
    copies = len(next(iter(shapes.values()), np.zeros(1)))
    values = np.zeros((copies, len(compiled.traced.keys)))
    for i, key in enumerate(compiled.traced.keys):
        name = parameter_of(key)
        known = compiled.traced.parameters[i]
        if known.role == "shape":
            values[:, i] = shapes.get(known.name, shapes.get(name, known.start or 0.0))
    own = len(compiled.traced.states) - 2 * axes
    states = np.zeros((copies, count, own))
    states[:, 0] = _first_own_states(effect, position)
    motion, between = (
        np.ascontiguousarray(np.hstack(m)) for m in ((position, velocity), (middle, turning))
    )
    inputs = np.ascontiguousarray(inputs)

    def drive(copy: int) -> None:
        one = slice(copy, copy + 1)
        drive_own_states(compiled.rate_value, motion, between, inputs, values[one], dt, states[one])

    run_in_threads(drive, range(copies), count)
    return states


def _first_own_states(effect: Effect, position: Array) -> list[float]:
    """First values of own states: zero, or the port's position for one that is ``like`` it."""
    values: list[float] = []
    for state in effect.states:
        place = position[0] if state.per_axis else position[0, :1]
        values += list(place) if state.like else [0.0] * len(place)
    return values


def arrange_own_states(effect: Effect, axes: int, states: Array) -> Own:
    """One copy's own states (samples, states) as the effect's equations see them."""
    own, at = {}, 0
    for state in effect.states:
        if not state.per_axis:
            own[state.name], at = states[:, at], at + 1
            continue
        own[state.name] = tuple(states[:, at + i] for i in range(axes))
        at += axes
    return own


@kept(64)
def compile_own_rates(kind: type[Effect], axes: int, inputs: tuple[str, ...]) -> CompiledModel:
    """The rates of an effect's own states, by (own states, positions, velocities)."""
    effect = kind()
    counts = [axes if s.per_axis else 1 for s in effect.states]
    total = sum(counts)
    x = sp.symbols(f"x0:{total + 2 * axes}", real=True)
    u = sp.symbols(f"u0:{max(len(inputs), 1)}", real=True)
    names = tuple(str(i) for i in range(axes))
    pairs = expand(effect.label, effect.parameters, names)
    keys = [k for k, _ in pairs]
    symbols = dict(zip(keys, sp.symbols(f"p0:{len(pairs)}", real=True), strict=True))
    p, own, at = SimpleNamespace(), SimpleNamespace(), 0
    for parameter in effect.parameters:
        chosen = [symbols[k] for k, _ in expand(effect.label, (parameter,), names)]
        setattr(p, parameter.name, tuple(chosen) if parameter.per_axis else chosen[0])
    for state, count in zip(effect.states, counts, strict=True):
        part = tuple(x[at : at + count])
        setattr(own, state.name, part if state.per_axis else part[0])
        at += count
    place = At(tuple(x[total : total + axes]), tuple(x[total + axes :]), own)
    given = effect.rate(place, SimpleNamespace(**dict(zip(inputs, u, strict=False))), p)
    rates = []
    for state in effect.states:
        rates += list(given[state.name]) if state.per_axis else [given[state.name]]
    return compile_model(
        TracedModel(
            states=tuple(map(str, x)), channels=(), inputs=inputs, keys=tuple(symbols),
            parameters=tuple(q for _, q in pairs), x=x, u=u, p=tuple(symbols.values()),
            rate=(*map(sp.sympify, rates), *(sp.Integer(0),) * (2 * axes)), output=x[:1],
            acceleration=(), forces=(), like=(),
        ),
        (),
    )  # fmt: skip


def midpoint_motion(position: Array, velocity: Array, dt: float) -> tuple[Array, Array]:
    """Position and velocity between samples, by cubic Hermite curves."""
    middle, turning = position.copy(), velocity.copy()
    middle[:-1] = 0.5 * (position[:-1] + position[1:]) + dt / 8 * (velocity[:-1] - velocity[1:])
    turning[:-1] = 1.5 / dt * np.diff(position, axis=0) - 0.25 * (velocity[:-1] + velocity[1:])
    return middle, turning
