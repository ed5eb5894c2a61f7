"""The motion that a filter predicts, along which effects are scored while none of them acts."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from spiral.engine.filter.task import FilterInput
from spiral.engine.likelihood.predict import Prediction
from spiral.engine.likelihood.rates import rates_and_readings_along
from spiral.engine.series import sample_inputs
from spiral.inference.evidence.assembly import Assembly
from spiral.physics.signatures import SystemMotion
from spiral.types.effect import ParameterEffect, is_path
from spiral.types.placement import input_columns
from spiral.types.port import varied_key
from spiral.types.record import Array

_STEP = 1e-5  # of an input's largest value, or a parameter, for the slopes of the rates by it


def predicted_motion(
    assembly: Assembly, task: FilterInput, part: Prediction, varied: Collection[str] = (),
    driving: Collection[str] = (),
) -> SystemMotion:  # fmt: skip
    """The motion that the filter predicts: states of the system, rates and readings of the model.

    It is that before each sample's readings: the updated one contains their noise, which scores
    would attribute to sensor effects. Slopes are by each input that an actuator may change, by the
    parameters ``varied`` and by the states ``driving``.
    """
    system = assembly.problem.model.system
    n, substeps = len(system.states), task.series.substeps
    rows = np.ascontiguousarray(part.expected[:, : len(task.states)])
    inputs = sample_inputs(task.inputs, substeps)
    along = _ModelAlong(task, rows, inputs, task.inputs[:: 3 * substeps])
    rates, readings = along.evaluate()
    by_input = {p.axes[0]: along.by_input(input_columns(system).index(p.axes[0]))
                for p in system.driven}  # fmt: skip
    by_parameter = {k: along.by_parameter(k) for k in {*varied} & {*task.keys}}
    by_state = {k: along.by_state(k) for k in {*driving} & {*task.states}}
    known = dict(zip(task.keys, map(float, task.values), strict=True))
    values = {p.name: known[f"system.{p.name}"] for p in system.parameters}
    moved = np.gradient(readings, task.series.dt, axis=0) if system.readings else None
    return SystemMotion(
        system, rows[:, :n], inputs, rates[:, :n], readings, values,
        {k: (more[:, :n], told) for k, (more, told) in by_input.items()},
        {k: (more[:, :n], told) for k, (more, told) in by_parameter.items()},
        {k: more[:, :n] for k, (more, _) in by_state.items()}, moved,
    )  # fmt: skip


Slopes = tuple[Array, Array]
"""Of the rates (samples, n) and the readings (samples, channels)."""


@dataclass(frozen=True)
class _ModelAlong:
    """Rates and readings of a model along states (samples, n), with slopes by differences."""

    task: FilterInput
    states: Array
    inputs: Array
    read: Array

    def evaluate(self, x: Array | float = 0.0, u: Array | float = 0.0, p: Array | float = 0.0
                 ) -> Slopes:  # fmt: skip
        """Rates and readings with states, inputs and parameters larger by these."""
        return rates_and_readings_along(
            self.task.compiled, self.states + x, self.inputs + u, self.read + u,
            self.task.values + p,
        )  # fmt: skip

    def by_input(self, place: int) -> Slopes:
        """By an input."""
        step = _STEP * (float(np.abs(self.inputs[:, place]).max()) or 1.0)
        return self._slopes(step, u=_one_step(self.inputs.shape[1], place, step))

    def by_parameter(self, key: str) -> Slopes:
        """By the logarithm of a parameter."""
        place = self.task.keys.index(key)
        change = _STEP * float(self.task.values[place])
        return self._slopes(_STEP, p=_one_step(len(self.task.values), place, change))

    def by_state(self, name: str) -> Slopes:
        """By a state."""
        place = self.task.states.index(name)
        step = _STEP * float(self.task.scales[place])
        return self._slopes(step, x=_one_step(len(self.task.states), place, step))

    def _slopes(self, step: float, **moved: Array) -> Slopes:
        above = self.evaluate(**moved)
        below = self.evaluate(**{k: -v for k, v in moved.items()})
        more, told = ((a - b) / (2 * step) for a, b in zip(above, below, strict=True))
        return more, told


def varied_keys(assembly: Assembly) -> set[str]:
    """The parameters (full names) that effects offered change with a variable."""
    system, offered = assembly.problem.model.system, (v.original for v in assembly.offered)
    return {varied_key(system.place(e)) for e in offered if isinstance(e, ParameterEffect)}


def driving_states(assembly: Assembly) -> set[str]:
    """The states of which effects offered change how they act on others."""
    system = assembly.problem.model.system
    offered = (*(v.original for v in assembly.offered), *assembly.later)
    return {system.place(e).against for e in offered if is_path(e)}


def _one_step(count: int, place: int, step: float) -> Array:
    """(count,) a step at one place, zero elsewhere."""
    steps = np.zeros(count)
    steps[place] = step
    return steps
