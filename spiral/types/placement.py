"""Where an effect may act: its port in a system, the inputs and channels that it needs."""

from __future__ import annotations

from dataclasses import replace

from spiral.types.cache import kept
from spiral.types.drivers import is_shift_more_than_constant
from spiral.types.effect import (
    Effect,
    ForceEffect,
    InputEffect,
    ParameterEffect,
    SensorEffect,
    StateFlow,
    expand,
)
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.parameter import Parameter
from spiral.types.port import Port, place_name
from spiral.types.system import TIME, System, has_coordinates


def input_columns(system: System) -> tuple[str, ...]:
    """Columns of the input array: each input, ``NAME_rate`` where its rate is used, then time."""
    names = [i.name for i in system.inputs]
    return (*names, *(i.rate.name for i in system.inputs if i.derivative), TIME)


def model_keys(system: System, effects: tuple[Effect, ...]) -> tuple[tuple[str, Parameter], ...]:
    """Full names and parameters of a model: the system's first, then each effect's."""
    pairs = list(expand("system", system.parameters, ()))
    for effect in effects:
        pairs += effect.keys(system.place(effect))
    return tuple(pairs)


def at_every_place(system: System, effect: Effect) -> list[Effect]:
    """Copies of an effect for every place of a system where its kind acts, the first as it is."""
    if isinstance(effect, ForceEffect):
        names = [port.name for port in system.ports]
        names += [port.name for port in system.planes] if effect.pairs else []
    elif isinstance(effect, InputEffect) and effect.shifts:
        more = [n for p in system.driven for n in p.axes if is_shift_more_than_constant(system, n)]
        return [replace(effect, port=name) for name in more]
    elif isinstance(effect, InputEffect):
        names = [place_name(port) for port in system.driven]
    elif isinstance(effect, SensorEffect) and effect.driver:
        return [replace(effect, port=place_name(port)) for port in system.cross_read]
    elif isinstance(effect, SensorEffect):
        fit = [port for port in system.sensed if effect.axes in (None, len(port.axes))]
        names = [place_name(port) for port in fit]
    elif isinstance(effect, ParameterEffect):
        ports = system.known if effect.steady else system.varied
        return [replace(effect, port=place_name(port)) for port in ports]
    elif isinstance(effect, StateFlow):
        return [replace(effect, port=place_name(port)) for port in system.places_for_flow(effect)]
    else:
        names = []
    return [effect, *(replace(effect, port=name) for name in names[1:])]


@kept(16)
def at_fitting_places(system: System, effects: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """Copies of effects for every place of a system where they act and their units fit."""
    return tuple(e for one in effects for e in at_every_place(system, one) if fits(system, e))


def fits(system: System, effect: Effect) -> bool:
    """Whether an effect may act where it says: the system has what it needs, and units agree."""
    from spiral.types.units import units_fit

    try:
        check_effect(system, effect)
    except ConfigError:
        return False
    return units_fit(system, effect)


def check_effect(system: System, effect: Effect) -> Port:
    """The effect's port, or an error saying what the system lacks."""
    port = system.place(effect)
    if isinstance(effect, SensorEffect):
        _check_sensors(system, effect)
    if effect.axes is not None and len(port.axes) != effect.axes:
        raise ConfigError(
            f"effect {effect.label!r} at port {port.name!r} with {len(port.axes)} axis",
            f"a port with {effect.axes} axes",
            "choose an effect for one axis, or a system with two",
        )
    if isinstance(effect, ForceEffect) and not has_coordinates(system):
        raise ConfigError(
            f"effect {effect.label!r}, a force, with system {system.plugin_name()!r}",
            "a mechanical system, or an effect that is a flow",
            "spiral plugins effect lists them",
        )
    _check_channels(system, effect)
    have = [*(i.name for i in system.inputs), TIME]
    for name in effect.inputs:
        if name not in have and name.removesuffix("_rate") not in have:
            raise ConfigError(
                f"effect {effect.label!r} with system {system.plugin_name()!r}",
                f"a system with the input {name!r}; this one has: {', '.join(have)}",
                did_you_mean(name, have),
            )
    return port


def _check_sensors(system: System, effect: SensorEffect) -> None:
    """A change of readings has no port where all channels have one unit.

    One that mixes channels as the axes of one place needs such a place in the system: two sensors
    of one unit may as well be at two ends of a machine.
    """
    axes = effect.axes or 1
    if effect.driver:
        return
    if axes > 1 and not any(len(port.axes) == axes for port in system.ports):
        raise ConfigError(
            f"effect {effect.label!r} with system {system.plugin_name()!r}",
            f"a system with a port of {axes} axes, of which the sensors report the motion",
            "declare it, ports={disk: [x, y]}, or use effects on single sensors: offset, gain",
        )
    if effect.port and len(system.sensed) == 1:
        raise ConfigError(
            f"effect {effect.label!r}, which acts on what the sensors report",
            "no port",
            f"{effect.plugin_name()}",
        )


def _check_channels(system: System, effect: Effect) -> None:
    have = [s.name for s in system.states]
    for name in effect.channels:
        if name not in have:
            raise ConfigError(
                f"effect {effect.label!r} with system {system.plugin_name()!r}",
                f"a system with the state {name!r}; this one has: {', '.join(have)}",
                did_you_mean(name, have),
            )


def check_states(system: System, what: str) -> None:
    """Refuse channels that are no states.

    Raises
    ------
    ConfigError : one that is a reading (an acceleration, a force).
    """
    states = {s.name for s in system.states}
    for name in system.observed:
        if name not in states:
            raise ConfigError(
                f"{what} with the channel {name!r}, which is no state of {system.plugin_name()!r}",
                f"channels that are states: {', '.join(sorted(states))}",
                "strategy=likelihood, which predicts what such a sensor reads",
            )
