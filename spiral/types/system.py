"""Systems: the known physics that a study starts from."""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, ClassVar, TypeGuard

from spiral.types.accelerations import solve_accelerations
from spiral.types.cache import kept
from spiral.types.display import Summary
from spiral.types.drivers import NEEDED, cross_read_ports, driven_ports
from spiral.types.effect import Effect, InputEffect, ParameterEffect, SensorEffect, StateFlow
from spiral.types.errors import ConfigError, did_you_mean
from spiral.types.parameter import Input, Parameter, State
from spiral.types.plugin import Plugin
from spiral.types.port import (
    Port,
    difference_port,
    link_port,
    place_name,
    state_port,
    varied_ports,
)
from spiral.types.probing import balanced_states, follows_input, lines_of

TIME = "time"
"""The column of time among a model's inputs."""


class System(Plugin):
    """Known physics in state space: x' = rate(x, u, p) plus what effects add.

    A system names its states (those in ``observed`` are measured, the others hidden), inputs,
    ports and parameters. What sensors report that is no state, y = h(x, x', u, p), it names in
    ``readings``. ``seed`` are the effects that belong to it from the start.
    """

    kind: ClassVar[str] = "system"

    @property
    def title(self) -> str:
        """What the system is, in a few words; the plugin's name where none are given."""
        return self.plugin_name()

    @property
    def report(self) -> str:
        """What is known of its own error (a structure that was reduced), as a note; else empty."""
        return ""

    def __str__(self) -> str:
        return self._shown().text()

    def _repr_markdown_(self) -> str:
        return self._shown().markdown()

    def _shown(self) -> Summary:
        """What is measured, hidden, known and to be found, as it is printed."""
        rows = list(self.quantities())
        for one in self.parameters:
            first = self.defaults.get(f"system.{one.name}")
            unknown = "to be found" if first is None else f"to be found, from {first:g}"
            told = unknown if one.start is None else f"known, {one.start:g}"
            rows.append((one.name, one.unit or "1", told))
        seed = ", ".join(e.label for e in self.seed)
        return Summary(
            f"System {self.title}", ("name", "unit", ""), tuple(rows),
            f"seed: {seed}" if seed else "",
        )  # fmt: skip

    def quantities(self) -> tuple[tuple[str, str, str], ...]:
        """(name, unit, what it is) of every state, reading and input."""
        rows = []
        for state in (*self.states, *self.readings):
            told = "measured" if state.name in self.observed else "hidden" + state.first_guess
            rows.append((state.name, state.unit or "1", told))
        inputs = [(i.name, i.unit or "1", f"input, first tried as {i.shape}") for i in self.inputs]
        return (*rows, *inputs)

    @property
    @abstractmethod
    def states(self) -> tuple[State, ...]:
        """States in order, with units."""

    @property
    @abstractmethod
    def observed(self) -> tuple[str, ...]:
        """Names of the states and ``readings`` that sensors report, one channel each."""

    @property
    @abstractmethod
    def inputs(self) -> tuple[Input, ...]:
        """Known inputs."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the system itself, with absolute units."""

    @property
    def ports(self) -> tuple[Port, ...]:
        """Places where effects act, the first the default; not named, each injection's state."""
        units = {s.name: s.unit for s in self.states}
        return tuple(
            Port(
                i.name, (i.name,), lambda x, p, name=i.name: [getattr(x, name)], units[i.name],
                i.unit,
            )
            for i in self.injections if i.name in units
        )  # fmt: skip

    @property
    def seed(self) -> tuple[Effect, ...]:
        """Effects present from the start."""
        return ()

    @property
    @abstractmethod
    def injections(self) -> tuple[State, ...]:
        """Where effects enter, by name and unit: generalised forces, or flows into channels."""

    @abstractmethod
    def rate(
        self, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace, injected: dict[str, Any]
    ) -> dict[str, Any]:
        """Time derivative of every state, given the sums that effects inject."""

    @property
    def readings(self) -> tuple[State, ...]:
        """Channels that are no state, with units: an acceleration, a force in a mount."""
        return ()

    def reading(
        self, x: SimpleNamespace, rates: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace
    ) -> dict[str, Any]:
        """h(x, x', u, p) of each of ``readings``; ``rates`` are x' by the states' names."""
        return {}

    @property
    def auxiliaries(self) -> tuple[State, ...]:
        """Named functions of states, inputs and parameters that a parameter may follow as well."""
        return ()

    def auxiliary(
        self, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace
    ) -> dict[str, Any]:
        """a(x, u, p) of each of ``auxiliaries``."""
        return {}

    @property
    def arguments(self) -> dict[str, tuple[str, str]]:
        """Auxiliaries that one parameter multiplies, which may follow it: it, and what in words."""
        return {}

    @property
    def defaults(self) -> dict[str, float]:
        """Nominal values by full parameter name (``cubic_stiffness@bearing_1.stiffness``)."""
        return {}

    def rate_name(self, state: str) -> str:
        """Name of the state that is the rate of another one, where there is one."""
        return f"{state}_rate"

    def seen(self, u: SimpleNamespace, p: SimpleNamespace) -> SimpleNamespace:
        """The inputs as effects see them; a rotor shifts the phase by its record's origin."""
        return u

    def port(self, name: str = "") -> Port:
        """A port by name; the first where no name is given."""
        for port in (*self.ports, *self.links):
            if port.name == name or not name:
                return port
        names = [port.name for port in self.ports]
        raise ConfigError(
            f"port {name!r} of system {self.plugin_name()!r}",
            f"one of {', '.join(names)}",
            did_you_mean(name, names),
        )

    @property
    def links(self) -> tuple[Port, ...]:
        """Ports between any two coordinates of one unit, ``NAME-NAME`` with two axes."""
        return tuple(_coordinate_pairs(self)) if has_coordinates(self) else ()

    @property
    def planes(self) -> tuple[Port, ...]:
        """Those of ``links`` that may be a plane: effects of ``pairs`` are offered there.

        Coordinates between which a spring or a damper stands are on one line, and so are those of a
        whole chain: nothing turns one into the other.
        """
        if not has_coordinates(self):
            return ()
        line = lines_of(self, tuple((c.name, self.rate_name(c.name)) for c in self.coordinates))
        pairs = _coordinate_pairs(self).items()
        return tuple(port for port, (a, b) in pairs if line[a] != line[b])

    @property
    def balanced(self) -> bool:
        """Whether its equations are expressions; else a program gives the rates, ``rate`` alone."""
        return True

    @property
    def exact_to(self) -> float:
        """Hz up to which its equations hold; faster modes are integrated stably, not precisely."""
        return math.inf

    @property
    def sensed(self) -> tuple[Port, ...]:
        """Ports for effects on sensors: the channels, those of one unit together, one axis each.

        Such a port is ``sensors`` where all have one unit, else ``sensors NAME`` with all names.
        """
        units: dict[str, list[str]] = {}
        for name in self.observed:
            units.setdefault(self.unit_of(name), []).append(name)
        force = self.ports[0].force_unit
        return tuple(
            Port(
                "sensors" if len(units) == 1 else f"sensors {'-'.join(names)}", tuple(names),
                lambda x, p, names=names: [getattr(x, n) for n in names], unit, force,
            )
            for unit, names in units.items()
        )  # fmt: skip

    @property
    @kept(32)
    def cross_read(self) -> tuple[Port, ...]:
        """Ports for what a sensor reads of another variable, as ``CHANNEL by VARIABLE``.

        Those are inputs that no other follows, and states but what a channel reports and its rate;
        coordinates and their rates on a channel of their unit.
        """
        return cross_read_ports(self, _free_inputs(self), _moving(self))

    @property
    def driven(self) -> tuple[Port, ...]:
        """Ports for effects on actuators: each input, without those that follow from others.

        Such a port is called ``input NAME``, its axis ``NAME``.
        """
        tied = {i.derived_from for i in self.inputs}
        free = [i for i in self.inputs if not (i.derivative or i.derived_from or i.name in tied)]
        force = self.ports[0].force_unit
        return tuple(
            Port(f"input {i.name}", (i.name,), lambda x, p: [], i.unit, force) for i in free
        )

    @property
    def filled(self) -> tuple[Port, ...]:
        """Ports for flows: each state of first order that effects may flow into, as ``state NAME``.

        After them what a state has more than an input of its unit, as ``state NAME-INPUT`` (without
        a unit: of an input that it follows), or than another state where the two are balanced in a
        third one's rate (the flows into a tank and out of it), as ``state NAME-OTHER``; then pairs
        of one unit, as ``states NAME-NAME``.
        """
        forces = {c.name for c in self.coordinates} if has_coordinates(self) else set()
        units = {s.name: s.unit for s in self.states}
        own = [i for i in self.injections if i.name in units and i.name not in forces]
        pairs = [(a, b) for i, a in enumerate(own) for b in own[i + 1 :]]
        alike = [(a, b) for a, b in pairs if (units[a.name], a.unit) == (units[b.name], b.unit)]
        outside = [
            (i, u.name)
            for i in own
            for u in self.inputs
            if u.unit == units[i.name] and (u.unit or follows_input(self, i.name, u.name))
        ]
        differences = balanced_states(self, tuple(i.name for i in own))
        balanced = [
            (i, j.name)
            for i, j in itertools.permutations(own, 2)
            if units[i.name] == units[j.name] and {i.name, j.name} in differences
        ]
        return (
            *(state_port(units, i) for i in own),
            *(difference_port(units, i, other) for i, other in (*outside, *balanced)),
            *(state_port(units, *pair) for pair in alike),
        )

    @property
    @kept(32)
    def by_driver(self) -> Mapping[str, tuple[Port, ...]]:
        """Ports for what an ``input``, or a ``state``, adds where the system gives it no path.

        Such a port is called ``NAME by VARIABLE``: any coordinate that is a port or state that
        effects may flow into, by an input that no other follows, or a state of another unit. Those
        of a ``path`` are of a state that acts on another.
        """
        barred = {*_moving(self)}
        if has_coordinates(self):
            barred -= {*_plain_ports(self).values()}
        return driven_ports(self, _free_inputs(self), _moving(self), barred)

    def places_for_flow(self, effect: StateFlow) -> tuple[Port, ...]:
        """The ports at which a flow of this kind may act."""
        if effect.driver:
            return self.by_driver[effect.driver]
        return tuple(
            port
            for port in self.filled
            if len(port.axes) == effect.axes
            and (effect.differences if port.against else effect.differences != "only")
        )

    @property
    def varied(self) -> tuple[Port, ...]:
        """Ports for parameters that vary: each amplitude, with each variable that it may follow.

        Amplitudes are the system's parameters and those of its seed; variables its states, its
        inputs, its auxiliaries and time. Such a port is called ``parameter NAME with VARIABLE``.
        """
        return tuple(_varied_ports(self).values())

    @property
    def known(self) -> tuple[Port, ...]:
        """Ports for known parameters that may be off: those that have a value and are not found."""
        off = (p for p in self.parameters if p.start and p.role == "amplitude")
        return tuple(Port(f"parameter {p.name}", (p.name,), lambda x, p: [], "", "") for p in off)

    def place(self, effect: Effect) -> Port:
        """Where an effect acts: at a port, on an input, a parameter, a state, or the sensors."""
        if isinstance(effect, SensorEffect) and effect.driver:
            return self._place_of(effect, self.cross_read, "on a sensor", "another variable")
        if isinstance(effect, SensorEffect):
            if len(self.sensed) == 1:  # it has no name
                return self.sensed[0]
            fit = [p for p in self.sensed if effect.axes in (None, len(p.axes))]
            what = "which acts on what the sensors report"
            return self._place_of(effect, tuple(fit or self.sensed), what, "a channel")
        if isinstance(effect, InputEffect):
            return self._place_of(
                effect, self.driven, "which acts on an input", "an input that no other follows"
            )
        if isinstance(effect, ParameterEffect) and effect.steady:
            return self._place_of(effect, self.known, "of a known parameter", "a known parameter")
        if isinstance(effect, ParameterEffect):
            return _varied_ports(self).get(effect.port) or self._place_of(
                effect, self.varied, "which changes a parameter with a variable", "a parameter"
            )
        if isinstance(effect, StateFlow):
            fit = list(self.places_for_flow(effect))
            fit.sort(key=lambda port: bool(effect.units) and port.position_unit not in effect.units)
            due = NEEDED.get(effect.driver, "a state of first order for each axis")
            return self._place_of(effect, tuple(fit), "which flows into a state", due)
        return self.port(effect.port)

    def _place_of(self, effect: Effect, ports: tuple[Port, ...], what: str, due: str) -> Port:
        """One of these ports, the first where the effect names none."""
        for port in ports:
            if effect.port in ("", place_name(port)):
                return port
        names = [place_name(port) for port in ports]
        raise ConfigError(
            f"effect {effect.label!r}, {what}, with system {self.plugin_name()!r}",
            f"one of {', '.join(names)}" if names else due,
            did_you_mean(effect.port, names),
        )

    def unit_of(self, channel: str) -> str:
        """Unit of a state, an input or a reading by name."""
        known = (*self.states, *self.inputs, *self.readings)
        for item in known:
            if item.name == channel:
                return item.unit
        names = [item.name for item in known]
        raise ConfigError(
            f"channel {channel!r}",
            f"a state, input or reading of {self.plugin_name()!r}: {', '.join(names)}",
            did_you_mean(channel, names),
        )


class MechanicalSystem(System):
    """M(q, p) q'' = force(q, q', u, p) + sum over ports of J^T F.

    States are the coordinates, their rates (``rate_name``), and states of first order beside them
    (a current, a pressure), which ``split`` hands on among the coordinates.
    """

    @property
    @abstractmethod
    def coordinates(self) -> tuple[State, ...]:
        """Generalised coordinates q with units."""

    @property
    @abstractmethod
    def injections(self) -> tuple[State, ...]:
        """Generalised forces, one for each coordinate, named like it; then flows into others."""

    @abstractmethod
    def mass(self, q: SimpleNamespace, p: SimpleNamespace) -> list[list[Any]]:
        """Mass matrix, nq x nq."""

    @abstractmethod
    def force(
        self, q: SimpleNamespace, v: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace
    ) -> list[Any]:
        """Generalised forces of the system itself, nq values."""

    @property
    def others(self) -> tuple[State, ...]:
        """States of first order beside the coordinates; none unless a system names them."""
        return ()

    def flows(
        self, q: SimpleNamespace, v: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace
    ) -> dict[str, Any]:
        """Time derivatives of the other states by name."""
        return {}

    def capacities(
        self, q: SimpleNamespace, v: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace
    ) -> dict[str, Any]:
        """What flows into the other states are divided by, over that at rest, where it changes."""
        return {}

    @property
    def states(self) -> tuple[State, ...]:
        """Coordinates, then their rates, then the others."""
        rates = (State(self.rate_name(c.name), f"{c.unit or '1'}/s") for c in self.coordinates)
        return (*self.coordinates, *rates, *self.others)

    def split(self, x: SimpleNamespace) -> tuple[SimpleNamespace, SimpleNamespace]:
        """Coordinates q, the other states beside them, and rates v by the coordinates' names."""
        names = [c.name for c in self.coordinates]
        q = SimpleNamespace(**{n: getattr(x, n) for n in (*names, *(s.name for s in self.others))})
        v = SimpleNamespace(**{n: getattr(x, self.rate_name(n)) for n in names})
        return q, v

    def rate(
        self, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace, injected: dict[str, Any]
    ) -> dict[str, Any]:
        """q' = v, v' = M^-1 (force + injected), and of the others their flows + injected."""
        q, v = self.split(x)
        names = [c.name for c in self.coordinates]
        total = [f + injected[n] for f, n in zip(self.force(q, v, u, p), names, strict=True)]
        acceleration = solve_accelerations(self.mass(q, p), total)
        rates = {n: getattr(v, n) for n in names}
        rates.update({self.rate_name(n): a for n, a in zip(names, acceleration, strict=True)})
        capacity = self.capacities(q, v, u, p)
        for n, f in self.flows(q, v, u, p).items():
            rates[n] = f + (injected[n] / capacity[n] if n in capacity else injected.get(n, 0))
        return rates


def _moving(system: System) -> dict[str, str]:
    """Coordinates, and what their rates are called; none of a system without coordinates."""
    own = system.coordinates if has_coordinates(system) else ()
    return {c.name: system.rate_name(c.name) for c in own}


def _free_inputs(system: System) -> dict[str, str]:
    """Inputs that no other follows, and their units."""
    return {port.axes[0]: port.position_unit for port in system.driven}


@kept(32)
def _varied_ports(system: System) -> dict[str, Port]:
    """``System.varied`` by the names that effects give as their port."""
    names = [p.name for p in system.parameters if (p.role, p.scope) == ("amplitude", "machine")]
    keys = (pair for effect in system.seed for pair in effect.keys(system.place(effect)))
    names += [key for key, p in keys if p.role == "amplitude"]
    free = (i for i in system.inputs if not i.derived_from)
    followed = {x.name: x.unit for x in (*system.states, *free, *system.auxiliaries)}
    return varied_ports(names, followed | {TIME: "s"}, system.arguments)


@kept(32)
def _coordinate_pairs(system: MechanicalSystem) -> dict[Port, tuple[str, str]]:
    """Pairs of the ports that are coordinates, one axis each, with these coordinates."""
    plain = _plain_ports(system).items()
    return {
        link_port(a, b): (x, y)
        for (a, x), (b, y) in itertools.combinations(plain, 2)
        if (a.position_unit, a.force_unit) == (b.position_unit, b.force_unit)
    }


@kept(32)
def _plain_ports(system: MechanicalSystem) -> dict[Port, str]:
    """The ports that are a coordinate, with that coordinate."""
    import sympy

    q = SimpleNamespace(**{s.name: sympy.Symbol(s.name) for s in system.states})
    p = SimpleNamespace(**{k.name: sympy.Symbol(f"p_{k.name}") for k in system.parameters})
    names = {q.__dict__[c.name]: c.name for c in system.coordinates}
    single = [(x, x.coordinates(q, p)[0]) for x in system.ports if len(x.axes) == 1]
    return {x: names[at] for x, at in single if at in names}


def has_coordinates(system: System) -> TypeGuard[MechanicalSystem]:
    """Whether forces can act on a system: it is mechanical, with at least one coordinate."""
    return isinstance(system, MechanicalSystem) and bool(system.coordinates)
