"""Ports of what a driver adds where a system gives it no path, and of paths that it has.

The system is asked for its rates at numbers (``spiral.types.probing``).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from spiral.types.cache import kept
from spiral.types.port import Port
from spiral.types.probing import LIKE, ProbedSystem, is_same, moved, random_point

NEEDED = {
    "input": "a state on which no input acts",
    "state": "a state on which no state acts",
    "path": "a state on which another one acts",
}
"""What an effect with a driver needs of a system, by its kind."""


def driven_ports(
    system: ProbedSystem, given: Mapping[str, str], moving: Mapping[str, str],
    barred: Collection[str],
) -> dict[str, tuple[Port, ...]]:  # fmt: skip
    """By kind of driver, ``input``, ``state`` or ``path``: ports ``NAME by VARIABLE``.

    A path is one that the system gives a state to another: to one of first order, or to a single
    coordinate. Two coordinates and their rates are joined by forces, and no path.

    Parameters
    ----------
    given : units of inputs. moving : coordinates and their rates; none of them drives another.
    barred : injections that are no places.
    """
    units = {s.name: s.unit for s in system.states}
    own = {i.name: i.unit for i in system.injections if i.name in units and i.name not in barred}
    variables = (*given, *units)
    paths, reached = _paths_of(system, variables), _rates_reached(system, variables)
    free = [(n, v) for n in own for v in paths if n not in paths[v]]
    fed = [pair for pair in free if pair[1] in given]
    other = [(n, v) for n, v in free if v in units and units[n] != units[v]]
    tied = {*moving, *moving.values()}
    coupled = [pair for pair in other if not {*pair} <= tied]
    joined = [
        (n, v) for n in own for v in units
        if v != n and moving.get(n, n) in reached[v] and not {n, v} <= tied
        and (n not in moving or paths[v] == {n})
    ]  # fmt: skip
    return {
        "input": _ports(fed, given, own),
        "state": _ports(coupled, units, own),
        "path": _ports(joined, units, own),
    }


def cross_read_ports(
    system: ProbedSystem, given: Mapping[str, str], moving: Mapping[str, str]
) -> tuple[Port, ...]:
    """Ports ``CHANNEL by VARIABLE`` of what a sensor reads of another input or state.

    ``given`` are units of inputs, ``moving`` coordinates and their rates.
    """
    units = {s.name: s.unit for s in system.states}
    own = {c: system.unit_of(c) for c in system.observed}
    made = {c: _parts_of_reading(system, c) | {moving.get(c, "")} for c in own}
    free = [(c, v) for c in own for v in (*given, *units) if v not in made[c]]
    tied = {*moving, *moving.values()}
    fit = [(c, v) for c, v in free if v not in tied or units[v] == own[c]]
    return _ports(fit, {**given, **units}, own)


@kept(64)
def is_shift_more_than_constant(system: ProbedSystem, given: str) -> bool:
    """Whether a constant added to an input does more than one flow, or force, that is constant.

    As where it enters several rates, or multiplies a state. Not of an input that enters no rate by
    itself, nor where the equations cannot be evaluated.
    """
    variables = (given,)
    try:
        here, there = (_parts_of_rates(system, variables, away)[given] for away in (False, True))
    except Exception:
        return False
    if not np.any(here) and not np.any(there):
        return False
    size = max(np.abs(here).max(), np.abs(there).max())
    return (
        bool(np.abs(here - there).max() > LIKE * size)
        or len(_paths_of(system, variables)[given]) > 1
    )


def _ports(
    pairs: Iterable[tuple[str, str]], units: Mapping[str, str], forces: Mapping[str, str]
) -> tuple[Port, ...]:
    """Ports of what a variable adds to a state, ``NAME by VARIABLE``, of (state, variable).

    ``units`` are those of the variables, ``forces`` those of what enters the states.
    """
    return tuple(
        Port(f"{n} by {v}", (n,), lambda x, p: [], units[v], forces[n], against=v) for n, v in pairs
    )


@kept(64)
def _paths_of(system: ProbedSystem, variables: tuple[str, ...]) -> dict[str, frozenset[str]]:
    """By input or state: the injections through which the system lets it act.

    Those are what its part of the rates, r(v + dv) - r(v), is made of: with G the rates of unit
    injections, the least squares of it by G. All of them, where it is not made of them (an input
    that acts on a rate which no effect enters), and where the equations cannot be evaluated. What
    the rates of coordinates are by definition is no part.
    """
    names = [i.name for i in system.injections]
    try:
        x, u, p = random_point(system)
        nothing = dict.fromkeys(names, 0.0)
        here = _rate_vector(system, x, u, p, nothing)
        gains = np.array([
            _rate_vector(system, x, u, p, {**nothing, n: 1.0}) - here for n in names
        ]).T  # fmt: skip
        entered = np.any(gains != 0, axis=1)
        parts = _parts_of_rates(system, variables)
    except Exception:
        return dict.fromkeys(variables, frozenset(names))
    states = {s.name for s in system.states}
    return {
        n: frozenset(_made_of(np.where(entered, part, 0.0) if n in states else part, gains, names))
        for n, part in parts.items()
    }


@kept(64)
def _parts_of_rates(
    system: ProbedSystem, variables: tuple[str, ...], away: bool = False
) -> dict[str, Any]:
    """By input or state: its part of the rates, r(v + dv) - r(v), without injections.

    ``away`` : at other states.
    """
    x, u, p = random_point(system)
    x = moved(x, (s.name for s in system.states)) if away else x
    nothing = {i.name: 0.0 for i in system.injections}
    here = _rate_vector(system, x, u, p, nothing)
    return {n: _rate_vector(system, *_moved_point(x, u, n), p, nothing) - here for n in variables}


def _rates_reached(system: ProbedSystem, variables: tuple[str, ...]) -> dict[str, frozenset[str]]:
    """By input or state: the states whose rates change with it; none where that is not known."""
    try:
        parts = _parts_of_rates(system, variables)
    except Exception:
        return dict.fromkeys(variables, frozenset())
    names = [s.name for s in system.states]
    return {
        n: frozenset(m for m, change in zip(names, part, strict=True) if change)
        for n, part in parts.items()
    }


def _moved_point(x: Any, u: Any, name: str) -> tuple[Any, Any]:
    """States and inputs, one of them larger."""
    return (moved(x, (name,)), u) if hasattr(x, name) else (x, moved(u, (name,)))


@kept(256)
def _parts_of_reading(system: ProbedSystem, channel: str) -> frozenset[str]:
    """The states and inputs that a channel is made of, and the state that is its rate.

    Of a state that is itself and what its rate is by definition; of a reading, what it changes
    with, by its own formula or through the rates. All, where that cannot be evaluated.
    """
    variables = [s.name for s in system.states] + [i.name for i in system.inputs]
    try:
        x, u, p = random_point(system)
        nothing = {i.name: 0.0 for i in system.injections}

        def told(x: Any, u: Any) -> tuple[float, ...]:
            rates = system.rate(x, u, p, nothing)
            if channel in rates:
                return (getattr(x, channel),)
            return (float(system.reading(x, SimpleNamespace(**rates), u, p)[channel]),)

        here = told(x, u)
        seen = {n for n in variables if told(*_moved_point(x, u, n)) != here}
        rates, at = system.rate(x, u, p, nothing), {**vars(x), **vars(u)}
        same = {n for n in variables if channel in rates and is_same(rates[channel], at[n])}
        return frozenset({*seen, *same})
    except Exception:
        return frozenset(variables)


def _rate_vector(system: ProbedSystem, x: Any, u: Any, p: Any, injected: dict[str, float]) -> Any:
    rates = system.rate(x, u, p, injected)
    return np.array([float(rates[s.name]) for s in system.states])


def _made_of(change: Any, gains: Any, names: list[str]) -> list[str]:
    """The columns of ``gains`` by which a change is made; all where it is not."""
    parts, *_ = np.linalg.lstsq(gains, change, rcond=None)
    size = np.abs(change).max(initial=0.0)
    if np.abs(gains @ parts - change).max(initial=0.0) > LIKE * size:
        return names
    shares = np.abs(gains * parts).max(axis=0, initial=0.0)
    return [n for n, share in zip(names, shares, strict=True) if share > LIKE * size]
