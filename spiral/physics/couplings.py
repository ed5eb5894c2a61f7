"""The graph of a model: its states and their couplings, inputs, sensors, and places of effects.

Read off the traced equations, so that masses on springs, tanks, circuits and functions of one's own
are described in the same terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import sympy as sp

from spiral.physics.trace import TracedModel, trace
from spiral.types.effect import (
    Effect,
    FlowEffect,
    InputEffect,
    ParameterEffect,
    SensorEffect,
    StateFlow,
)
from spiral.types.model import Model
from spiral.types.placement import TIME
from spiral.types.port import Port, place_name
from spiral.types.system import System, has_coordinates


@dataclass(frozen=True)
class StateNode:
    """A coordinate with its rate, or a state of first order; hidden where no channel is either."""

    name: str
    unit: str
    coordinate: bool
    measured: bool


@dataclass(frozen=True)
class Link:
    """The system's own equations let ``source`` act on ``target``; both ways where ``mutual``."""

    source: str
    target: str
    mutual: bool


@dataclass(frozen=True)
class Feed:
    """A known input, its unit, and the states that it drives by the system's own equations."""

    name: str
    unit: str
    into: tuple[str, ...]


@dataclass(frozen=True)
class Reading:
    """A channel that is no state (an acceleration, a force), and the nodes that it is made of."""

    name: str
    unit: str
    touches: tuple[str, ...]


@dataclass(frozen=True)
class EffectNode:
    """An effect: whether it was added to what the system begins with, inputs read, own states."""

    label: str
    added: bool
    reads: tuple[str, ...]
    own: tuple[str, ...]


@dataclass(frozen=True)
class EffectPlace:
    """Where effects act: a ``port``, ``flow``, ``input`` or ``sensor``; ``touches`` names nodes.

    Of an input it names the input; of sensors ``channels`` are what they report.
    """

    name: str
    kind: str
    touches: tuple[str, ...]
    effects: tuple[EffectNode, ...]
    channels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Couplings:
    """A model as a graph; the order of all parts is the system's."""

    title: str
    nodes: tuple[StateNode, ...]
    links: tuple[Link, ...]
    inputs: tuple[Feed, ...]
    places: tuple[EffectPlace, ...]
    readings: tuple[Reading, ...] = ()


def couplings_of(model: Model) -> Couplings:
    """The graph of a model: the system's own terms as links, effects at their places."""
    system = model.system
    nodes = _state_nodes(system)
    known = [n.name for n in nodes]
    traced = trace(system, ())
    rows = {n: _names_in_row(system, traced, n) for n in known}
    pairs = [(a, b) for b in known for a in known if a != b and a in rows[b]]
    mutual = {frozenset(p) for p in pairs if p[::-1] in pairs}
    once = [p for p in pairs if frozenset(p) not in mutual or known.index(p[0]) < known.index(p[1])]
    links = tuple(Link(a, b, frozenset((a, b)) in mutual) for a, b in once)
    feeds = tuple(
        Feed(i.name, i.unit, tuple(n for n in known if {i.name, i.rate.name} & rows[n]))
        for i in system.inputs
    )
    readings = tuple(
        Reading(r.name, r.unit, _nodes_of_channel(system, traced, r.name, known))
        for r in system.readings
        if r.name in system.observed
    )
    return Couplings(
        system.plugin_name(), nodes, links, feeds, _effect_places(model, known), readings
    )


def _nodes_of_channel(
    system: System, traced: TracedModel, channel: str, known: Sequence[str]
) -> tuple[str, ...]:
    """The nodes that a channel is, or that a reading is made of."""
    told = [state for name, state, _ in traced.reading_states if name == channel]
    return _nodes_of_states(system, told or [channel], known)


def _state_nodes(system: System) -> tuple[StateNode, ...]:
    """Coordinates, then states of first order; a rate is part of its coordinate."""
    seen = set(system.observed)
    own = system.coordinates if has_coordinates(system) else ()
    rates = {c.name: system.rate_name(c.name) for c in own}
    return tuple(
        StateNode(s.name, s.unit, s.name in rates, bool({s.name, rates.get(s.name)} & seen))
        for s in system.states
        if s.name not in rates.values()
    )


def _names_in_row(system: System, traced: TracedModel, name: str) -> set[str]:
    """Names of nodes and inputs in a node's own balance of forces, or in its rate."""
    own = [c.name for c in system.coordinates] if has_coordinates(system) else []
    row = traced.forces[own.index(name)] if name in own else _rate_expression(traced, name)
    used = {str(s) for s in sp.sympify(row).free_symbols}
    names = dict(zip((s.name for s in traced.x), traced.states, strict=True))
    names |= dict(zip((s.name for s in traced.u), traced.inputs, strict=True))
    names |= dict(zip((s.name for s in traced.acceleration), own, strict=False))
    base = {system.rate_name(n): n for n in own}
    return {base.get(names[s], names[s]) for s in used if s in names}


def _rate_expression(traced: TracedModel, name: str) -> Any:
    return traced.rate[traced.states.index(name)]


def _effect_places(model: Model, known: Sequence[str]) -> tuple[EffectPlace, ...]:
    """The system's ports, free ones too; then where else an effect of the model acts."""
    system, seed = model.system, {e.label for e in model.system.seed}
    groups = {
        ("port", p.name): (_nodes_of_port(system, p, known), []) for p in _force_ports(system)
    }
    channels: dict[str, tuple[str, ...]] = {}
    for effect in model.effects:
        kind, name, touched = _place_of_effect(system, effect, known)
        if kind == "sensor":
            channels[name] = system.place(effect).axes
        acting = EffectNode(
            effect.label, effect.label not in seed, tuple(i for i in effect.inputs if i != TIME),
            tuple(s.name for s in effect.states),
        )  # fmt: skip
        groups.setdefault((kind, name), (touched, []))[1].append(acting)
    return tuple(
        EffectPlace(n, k, touched, tuple(e), channels.get(n, ()))
        for (k, n), (touched, e) in groups.items()
    )


def _force_ports(system: System) -> tuple[Port, ...]:
    """Ports of forces; those of a system without coordinates only carry units."""
    return system.ports if has_coordinates(system) else ()


def _place_of_effect(
    system: System, effect: Effect, known: Sequence[str]
) -> tuple[str, str, tuple[str, ...]]:
    """An effect's kind of place, its name, and the nodes (or the input) that it touches."""
    if isinstance(effect, FlowEffect):
        into = _nodes_of_flow(system, effect, known)
        return "flow", ", ".join(into), into
    port = system.place(effect)
    if isinstance(effect, InputEffect):
        return "input", port.name, port.axes
    if isinstance(effect, ParameterEffect):
        touched = _nodes_of_states(system, (port.against,), known)
        return "parameter", place_name(port), touched
    if isinstance(effect, SensorEffect):
        traced = trace(system, ())
        made = (n for axis in port.axes for n in _nodes_of_channel(system, traced, axis, known))
        return "sensor", port.name, tuple(dict.fromkeys(made))
    if isinstance(effect, StateFlow):
        return "flow", ", ".join(port.axes), port.axes
    return "port", port.name, _nodes_of_port(system, port, known)


def _nodes_of_states(system: System, names: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Nodes of states by name, a rate by its coordinate's."""
    base = {system.rate_name(n): n for n in known}
    return tuple(dict.fromkeys(base.get(n, n) for n in names if base.get(n, n) in known))


def _nodes_of_port(system: System, port: Port, known: Sequence[str]) -> tuple[str, ...]:
    """The nodes that a port's position is made of."""
    x = SimpleNamespace(**{s.name: sp.Symbol(s.name) for s in system.states})
    p = SimpleNamespace(**{q.name: sp.Symbol(f"{q.name}_") for q in system.parameters})
    used = {str(s) for e in port.coordinates(x, p) for s in sp.sympify(e).free_symbols}
    return _nodes_of_states(system, [s.name for s in system.states if s.name in used], known)


def _nodes_of_flow(system: System, effect: Effect, known: Sequence[str]) -> tuple[str, ...]:
    """The nodes between which an effect lets something flow: those it changes, those it reads."""
    alone, with_it = trace(system, ()), trace(system, (effect,))
    touched: set[str] = set()
    for name in known:
        before, after = (sp.sympify(_rate_expression(t, name)) for t in (alone, with_it))
        if before != after:
            symbols = after.free_symbols - before.free_symbols
            pairs = zip(with_it.x, with_it.states, strict=True)
            touched |= {name, *(n for s, n in pairs if s in symbols)}
    return _nodes_of_states(system, [s.name for s in system.states if s.name in touched], known)
