"""What a system's equations depend on, from their values at a few numbers.

The equations are functions of a plugin, with expressions or numbers for arguments. What cannot be
evaluated with numbers (a program that is not running) counts as depending on everything.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, Protocol

from spiral.types.cache import kept
from spiral.types.parameter import Input, Parameter, State

_SAME = 1e-9  # of a value, by which it may differ for rounding
_SHIFT = 0.37  # of a state and an input together, or of a parameter
_SMALL = 1e-4  # step of a slope, and the least that counts as one
_LIKE = 1e-3  # of a slope, by which it may differ from another


class ProbedSystem(Protocol):
    """What is asked of a system."""

    @property
    def states(self) -> tuple[State, ...]:
        """States, with units."""
        ...

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Known inputs."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its own parameters."""
        ...

    @property
    def injections(self) -> tuple[State, ...]:
        """Where effects enter."""
        ...

    @property
    def readings(self) -> tuple[State, ...]:
        """Channels that are no state."""
        ...

    def rate(self, x: Any, u: Any, p: Any, injected: dict[str, Any]) -> dict[str, Any]:
        """x' of every state."""
        ...

    def reading(self, x: Any, rates: Any, u: Any, p: Any) -> dict[str, Any]:
        """h of every reading."""
        ...


def readings_with_rates(system: ProbedSystem) -> set[str]:
    """Names of the readings that change with x': what hits or holds the machine makes them jump."""
    names = {r.name for r in system.readings}
    try:
        x, u, p = _point(system)
        rates = [_numbers((s.name for s in system.states), seed) for seed in (3, 4)]
        one, other = (system.reading(x, r, u, p) for r in rates)
        return {n for n in names if not _is_same(one[n], other[n])}
    except Exception:
        return names


@kept(64)
def follows_input(system: ProbedSystem, state: str, given: str) -> bool:
    """Whether a state's rate depends on it and an input by their difference alone."""
    try:
        x, u, p = _point(system)
        nothing = {i.name: 0.0 for i in system.injections}
        moved_x, moved_u = SimpleNamespace(**vars(x)), SimpleNamespace(**vars(u))
        setattr(moved_x, state, getattr(x, state) + _SHIFT)
        setattr(moved_u, given, getattr(u, given) + _SHIFT)
        here, both, alone = (
            system.rate(*at, p, nothing)[state] for at in ((x, u), (moved_x, moved_u), (x, moved_u))
        )
        return _is_same(here, both) and not _is_same(here, alone)
    except Exception:
        return False


@kept(64)
def is_balance_of(system: ProbedSystem, one: str, other: str) -> bool:
    """Whether a third state's rate depends on two states by their difference alone.

    What flows into a tank, and out of it, are such states: A z' = Q - q.
    """
    try:
        x, u, p = _point(system)
        nothing = {i.name: 0.0 for i in system.injections}
        both, alone = SimpleNamespace(**vars(x)), SimpleNamespace(**vars(x))
        for name in (one, other):
            setattr(both, name, getattr(x, name) + _SHIFT)
        setattr(alone, one, getattr(x, one) + _SHIFT)
        here, moved, apart = (system.rate(at, u, p, nothing) for at in (x, both, alone))
        third = (s.name for s in system.states if s.name not in (one, other))
        return any(_is_same(here[k], moved[k]) and not _is_same(here[k], apart[k]) for k in third)
    except Exception:
        return False


@kept(64)
def lines_of(system: ProbedSystem, coordinates: tuple[tuple[str, str], ...]) -> dict[str, int]:
    """The line that each coordinate is on; ``coordinates`` are their names with their rates' names.

    Two are on one line where some parameter acts on both by differences alone (a spring, a damper),
    and so are those of a chain of such pairs.
    """
    names = [name for name, _ in coordinates]
    line = {name: k for k, name in enumerate(names)}
    try:
        x, u, p = _point(system)
        for parameter in system.parameters:
            slopes = _slopes_by_parameter(system, x, u, p, parameter.name, coordinates)
            for a, b in itertools.combinations(names, 2):
                if _is_of_differences(slopes[a], b) and _is_of_differences(slopes[b], a):
                    line = {n: line[a] if k == line[b] else k for n, k in line.items()}
    except Exception:
        return line
    return line


Slopes = dict[str, dict[str, tuple[float, float]]]
"""Coordinate -> coordinate -> how its acceleration changes with the other's place and rate."""


def _slopes_by_parameter(
    system: ProbedSystem, x: SimpleNamespace, u: SimpleNamespace, p: SimpleNamespace,
    parameter: str, coordinates: tuple[tuple[str, str], ...],
) -> Slopes:  # fmt: skip
    """How much a parameter's own part of each acceleration changes as each coordinate moves."""
    nothing = {i.name: 0.0 for i in system.injections}
    more = SimpleNamespace(**vars(p))
    setattr(more, parameter, getattr(p, parameter) + _SHIFT)

    def own_part(at: SimpleNamespace) -> dict[str, float]:
        here, there = (system.rate(at, u, values, nothing) for values in (p, more))
        return {n: float(there[rate]) - float(here[rate]) for n, rate in coordinates}

    def slope(state: str) -> dict[str, float]:
        back, ahead = SimpleNamespace(**vars(x)), SimpleNamespace(**vars(x))
        setattr(back, state, getattr(x, state) - _SMALL)
        setattr(ahead, state, getattr(x, state) + _SMALL)
        before, after = own_part(back), own_part(ahead)
        return {n: (after[n] - before[n]) / (2 * _SMALL) for n in before}

    by_state = {n: (slope(n), slope(rate)) for n, rate in coordinates}
    return {
        n: {m: (place[n], rate[n]) for m, (place, rate) in by_state.items()} for n, _ in coordinates
    }


def _is_of_differences(slopes: dict[str, tuple[float, float]], other: str) -> bool:
    """Whether an acceleration goes by differences of places, or of rates, one of them another's.

    It is then the same wherever all of them are together.
    """
    for kind in (0, 1):
        all_ = [of[kind] for of in slopes.values()]
        if abs(slopes[other][kind]) > _SMALL and abs(sum(all_)) <= _LIKE * max(map(abs, all_)):
            return True
    return False


def _point(system: ProbedSystem) -> tuple[SimpleNamespace, SimpleNamespace, SimpleNamespace]:
    """Numbers for states, inputs and parameters."""
    inputs = [i.name for i in system.inputs]
    inputs += [i.rate.name for i in system.inputs if i.derivative]
    return (
        _numbers((s.name for s in system.states), 0),
        _numbers((*inputs, "time"), 1),
        _numbers((p.name for p in system.parameters), 2),
    )


def _numbers(names: Iterable[str], seed: int) -> SimpleNamespace:
    draw = random.Random(seed)
    return SimpleNamespace(**{n: draw.uniform(0.5, 1.5) for n in names})


def _is_same(one: Any, other: Any) -> bool:
    a, b = float(one), float(other)
    return abs(a - b) <= _SAME * max(abs(a), abs(b))
