"""The states that effects bring: their names and units, and those that begin at their port."""

from __future__ import annotations

from spiral.types.effect import Effect, InputEffect, SensorEffect, StateFlow
from spiral.types.errors import PluginError
from spiral.types.port import Port
from spiral.types.system import System

_SHOWN = SensorEffect | InputEffect | StateFlow  # whose port is one of channels, inputs or states


def own_states(system: System, effects: tuple[Effect, ...]) -> dict[str, str]:
    """States that effects bring, ``label.state`` with ``_axis`` where per axis, and their units."""
    return {
        f"{effect.label}.{state.name}{suffix}": system.place(effect).unit(state.unit)
        for effect in effects
        for state in effect.states
        for suffix in axis_suffixes(state.per_axis, system.place(effect))
    }


def states_like_port(system: System, effects: tuple[Effect, ...]) -> list[tuple[str, str]]:
    """Own states of effects that begin at a channel, an input or a state, and its name."""
    pairs: list[tuple[str, str]] = []
    for effect in effects:
        port = system.place(effect)
        for state in (s for s in effect.states if s.like):
            if state.like != "position" or not isinstance(effect, _SHOWN):
                raise PluginError(
                    f"state {state.name!r} of effect {effect.label!r} with like={state.like!r}",
                    "like='position', of an effect on a sensor, an input or a state",
                    "leave it out: the state begins at zero",
                )
            axes = port.axes if state.per_axis else port.axes[:1]
            names = [f"{effect.label}.{state.name}{s}" for s in axis_suffixes(state.per_axis, port)]
            pairs += zip(names, axes, strict=True)
    return pairs


def axis_suffixes(per_axis: bool, port: Port) -> list[str]:
    """``_axis`` for each axis of a port; one empty suffix where a value is not per axis."""
    return [f"_{axis}" for axis in port.axes] if per_axis and len(port.axes) > 1 else [""]
