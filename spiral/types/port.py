"""Ports: places where effects act."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

from spiral.types.parameter import State
from spiral.types.rates import per_second


@dataclass(frozen=True)
class Port:
    """A place on the machine, given by its coordinates as functions of the state.

    ``coordinates(q, p)`` returns one expression per axis. Velocities and generalised forces
    follow by virtual work: v = J q', Q = J^T F with J = d(coordinates)/dq. An effect is written
    once and serves one axis or two, a disk or a bearing. ``against`` is the input or state from
    which the position of a place for flows counts, or the variable that a parameter follows; empty
    where it counts from zero.
    """

    name: str
    axes: tuple[str, ...]
    coordinates: Callable[[SimpleNamespace, SimpleNamespace], list[Any]]
    position_unit: str
    force_unit: str
    against: str = ""

    def unit(self, relative: str) -> str:
        """A unit relative to the port in absolute words: ``force/position`` -> ``(N)/(m)``."""
        import re

        words = {
            "force": f"({self.force_unit or '1'})",
            "position": f"({self.position_unit or '1'})",
            "velocity": f"({per_second(self.position_unit)})",
        }
        return re.sub(r"\b(force|position|velocity)\b", lambda m: words[m[0]], relative)


@dataclass(frozen=True)
class At:
    """What an effect sees at its port: position and velocity per axis, and its own states.

    A sensor sees its channels and their rates. ``acceleration`` is the rate of these rates, zero
    for a channel whose rate is no state of the system (it would need the inputs' rates), and empty
    where an effect is asked for its leading order alone. ``outside`` is what the ``position`` of a
    flow counts from, where it does. ``along_path(value)`` is what would flow in beside what does,
    if the driver of a ``path`` had that value; zero for its own.
    """

    position: tuple[Any, ...]
    velocity: tuple[Any, ...]
    own: SimpleNamespace
    acceleration: tuple[Any, ...] = ()
    outside: Any = 0.0
    along_path: Callable[[Any], Any] = lambda value: 0.0


def place_name(port: Port) -> str:
    """The port name of an effect on an input or into a state: the names of its axes."""
    return "-".join((*port.axes, port.against) if port.against else port.axes)


def state_port(units: dict[str, str], *into: State) -> Port:
    """A port of states of first order, for flows into them."""
    names = tuple(i.name for i in into)
    return Port(
        f"state{'s' * (len(into) > 1)} {'-'.join(names)}",
        names,
        lambda x, p: [getattr(x, n) for n in names],
        units[names[0]],
        into[0].unit,
    )


def difference_port(units: dict[str, str], into: State, other: str) -> Port:
    """A port for flows into a state that follow what it has more than an input or a state."""
    return replace(state_port(units, into), name=f"state {into.name}-{other}", against=other)


def varied_ports(
    names: Iterable[str], followed: Mapping[str, str], own: Mapping[str, tuple[str, str]]
) -> dict[str, Port]:
    """Ports ``parameter NAME with VARIABLE`` by their place's name.

    ``followed`` has the units of variables; one in ``own`` only the parameter named there follows.
    """
    ports = (
        Port(f"parameter {name} with {variable}", (name,), lambda x, p: [], unit, "", variable)
        for name in names
        for variable, unit in followed.items()
        if own.get(variable, (name, ""))[0] == name
    )
    return {place_name(port): port for port in ports}


def link_port(a: Port, b: Port) -> Port:
    """The port of two places with one axis each, ``NAME-NAME``."""
    return Port(
        f"{a.name}-{b.name}", (a.name, b.name),
        lambda q, p: [*a.coordinates(q, p), *b.coordinates(q, p)], a.position_unit, a.force_unit,
    )  # fmt: skip


def varied_key(port: Port) -> str:
    """The full name ``OWNER.PARAMETER`` of the parameter at a port of ``System.varied``."""
    (name,) = port.axes
    return name if "." in name else f"system.{name}"
