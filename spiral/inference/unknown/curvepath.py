"""Values of the state of a learned curve that a record visits, and the forces there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp

from spiral.engine.growth import Stage
from spiral.engine.sensitivities import run_windows
from spiral.inference.evidence.assembly import Assembly, effects_of
from spiral.inference.evidence.scales import port_motion_expressions
from spiral.physics.learned import (
    Learned,
    LearnedFlow,
    LearnedForce,
    LearnedParameterChange,
    LearnedStateFlow,
)
from spiral.types.effect import (
    Effect,
    FlowEffect,
    ForceEffect,
    ParameterEffect,
    StateFlow,
    values_for,
)
from spiral.types.label import owner_of
from spiral.types.port import At
from spiral.types.record import Array

_STEP, _SMALL = 1e-4, 1e-6


@dataclass(frozen=True)
class CurveAxis:
    """One curve of a learned effect: ``axis`` the direction or channel that it acts in.

    ``state`` in words what it follows; ``seen`` (samples,) the values visited; ``typical`` the rms
    velocity along the axis.
    """

    number: int
    axis: str
    state: str
    seen: Array
    typical: float


def window_states(assembly: Assembly, stage: Stage) -> Array:
    """(samples, states) along the fitted windows, without samples where they diverge."""
    parts = [
        run_windows(assembly.study, r, layout, stage.fitted.point)[0]
        for r, layout in enumerate(stage.layouts)
    ]
    return np.concatenate([p[np.isfinite(p).all(axis=1)] for p in parts])


def courses(
    assembly: Assembly, states: Array, learned: Learned, inputs: Mapping[str, Array]
) -> tuple[CurveAxis, ...]:
    """The curves of an effect with the values of what they follow.

    ``states`` (samples, all) and ``inputs`` (samples,), time among them, along the records.
    """
    traced, system = assembly.study.compiled.traced, assembly.problem.model.system
    if isinstance(learned, LearnedParameterChange):
        port = system.place(learned)
        own = port.against in traced.states
        seen = states[:, traced.states.index(port.against)] if own else inputs[port.against]
        return (CurveAxis(0, port.axes[0], port.against, seen, 0.0),)
    if isinstance(learned, LearnedStateFlow):
        axes = system.place(learned).axes
        levels = [states[:, traced.states.index(name)] for name in axes]
        return (CurveAxis(0, axes[0], " - ".join(axes), levels[0] - sum(levels[1:]), 0.0),)
    if isinstance(learned, LearnedFlow):
        level = states[:, traced.states.index(learned.state)]
        return (CurveAxis(0, learned.into, learned.state, level, 0.0),)
    port = system.place(learned)
    at: dict[str, list[Array]] = {}
    for kind, expressions in port_motion_expressions(system, port, traced):
        values = sp.lambdify(traced.x, expressions, "numpy")(*states.T)
        at[kind] = [np.broadcast_to(v, (len(states),)) for v in values]
    if learned.follows == "radius":
        radius = np.sqrt(sum(v**2 for v in at["position"]))
        return (
            CurveAxis(0, port.axes[0], f"the radius of {' and '.join(port.axes)}", radius, 0.0),
        )
    rate = "'" if learned.follows == "velocity" else ""
    speeds = [float(np.sqrt(np.mean(v**2))) for v in at["velocity"]]
    rows = zip(port.axes, at[learned.follows], speeds, strict=True)
    return tuple(CurveAxis(i, a, a + rate, seen, v) for i, (a, seen, v) in enumerate(rows))


@dataclass(frozen=True)
class StatePath:
    """A state, or an input or time, that takes the values ``at``, all others at rest.

    Of a curve that is multiplied by a velocity it is the part of the force that turns with the
    velocity's sign, at its rms value.
    """

    assembly: Assembly
    learned: Learned
    course: CurveAxis
    at: Array

    def force(self, row: Array, labels: list[str]) -> Array:
        """(points,) the force or flow of some effects along the path, or a factor less one."""
        if not self.learned.times:
            return self._total_force(row, labels, 0.0)
        speed = self.course.typical
        ahead, back = (self._total_force(row, labels, v) for v in (speed, -speed))
        return (ahead - back) / 2

    def slope(self, row: Array, labels: list[str], index: int) -> Array:
        """(points,) its derivative by a parameter."""
        keys = self.assembly.study.keys
        if index >= len(keys) or owner_of(keys[index]) not in labels:
            return np.zeros(len(self.at))
        step = _STEP * max(abs(row[index]), 1e-12)
        if self.assembly.study.compiled.traced.parameters[index].role == "amplitude":
            linear = not isinstance(self.learned, LearnedParameterChange)  # rounded above zero
            step = 1.0 if linear else _SMALL  # exact for any step, or far below the rounding
        ahead, back = row.copy(), row.copy()
        ahead[index] += step
        back[index] -= step
        owner = [owner_of(keys[index])]
        return (self.force(ahead, owner) - self.force(back, owner)) / (2 * step)

    def _total_force(self, row: Array, labels: list[str], velocity: float) -> Array:
        total = np.zeros(len(self.at))
        for effect in effects_of(self.assembly, labels):
            same = (
                _effect_kind(effect) is _effect_kind(self.learned)
                and effect.port == self.learned.port
            )
            if effect.inputs or effect.states or not same:
                continue
            with np.errstate(invalid="ignore", divide="ignore"):
                given = self._effect_force(effect, self._effect_values(effect, row), velocity)
            total = total + np.nan_to_num(np.broadcast_to(given, total.shape))
        return total

    def _effect_values(self, effect: Effect, row: Array) -> SimpleNamespace:
        axes = self.assembly.problem.model.system.place(effect).axes
        return values_for(effect, axes, dict(zip(self.assembly.study.keys, row, strict=False)))

    def _effect_force(self, effect: Effect, p: SimpleNamespace, velocity: float) -> Any:
        """The force of one effect along the axis, or its flow into the channel."""
        system, still = self.assembly.problem.model.system, np.zeros(len(self.at))
        if isinstance(self.learned, LearnedFlow):
            assert isinstance(effect, FlowEffect)
            x = SimpleNamespace(**{s.name: still for s in system.states})
            setattr(x, self.learned.state, self.at)
            return effect.flow(x, SimpleNamespace(), p).get(self.learned.into, 0.0)
        if isinstance(effect, ParameterEffect):
            at = At((self.at,), (), SimpleNamespace())
            return effect.factor(at, SimpleNamespace(), p) - 1.0
        if isinstance(effect, StateFlow):
            levels = (self.at, *[still] * (len(system.place(effect).axes) - 1))
            at = At(levels, (still,) * len(levels), SimpleNamespace())
            return effect.flow(at, SimpleNamespace(), p)[0]
        if not (isinstance(effect, ForceEffect) and isinstance(self.learned, LearnedForce)):
            return 0.0
        axes = system.place(self.learned).axes
        q, v = [still] * len(axes), [still] * len(axes)
        moving = v if self.learned.follows == "velocity" else q
        moving[self.course.number] = self.at
        if self.learned.times:
            v[self.course.number] = still + velocity
        given = effect.force(At(tuple(q), tuple(v), SimpleNamespace()), SimpleNamespace(), p)
        return given[self.course.number]


def _effect_kind(effect: Effect) -> type:
    """The class that an effect counts as: a force, a flow, a change of a parameter."""
    kinds = (ForceEffect, FlowEffect, StateFlow, ParameterEffect)
    return next((k for k in kinds if isinstance(effect, k)), type(effect))
