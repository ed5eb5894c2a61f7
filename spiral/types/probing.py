"""What a system's equations depend on, from their values at a few numbers.

The equations are functions of a plugin, with expressions or numbers for arguments. What cannot be
evaluated with numbers (a program that is not running) counts as depending on everything.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, Protocol

from spiral.types.cache import kept
from spiral.types.parameter import Input, Parameter, State

_SAME = 1e-9  # of a value, by which it may differ for rounding
_SHIFT = 0.37  # of states and inputs together, or of a parameter
LIKE = 1e-6
"""Of a change, by which another may differ from it for rounding."""


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

    @property
    def observed(self) -> tuple[str, ...]:
        """Names of what sensors report."""
        ...

    def unit_of(self, channel: str) -> str:
        """Unit of a state, an input or a reading."""
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
        x, u, p = random_point(system)
        rates = [_numbers((s.name for s in system.states), seed) for seed in (3, 4)]
        one, other = (system.reading(x, r, u, p) for r in rates)
        return {n for n in names if not is_same(one[n], other[n])}
    except Exception:
        return names


@kept(64)
def follows_input(system: ProbedSystem, state: str, given: str) -> bool:
    """Whether a state's rate depends on it and an input by their difference alone."""
    try:
        x, u, p = random_point(system)
        nothing = {i.name: 0.0 for i in system.injections}
        moved_x, moved_u = moved(x, (state,)), moved(u, (given,))
        here, both, alone = (
            system.rate(*at, p, nothing)[state] for at in ((x, u), (moved_x, moved_u), (x, moved_u))
        )
        return is_same(here, both) and not is_same(here, alone)
    except Exception:
        return False


@kept(64)
def balanced_states(system: ProbedSystem, names: tuple[str, ...]) -> frozenset[frozenset[str]]:
    """Pairs of these states on whose difference alone a third state's rate depends.

    What flows into a tank, and out of it, are such states: A z' = Q - q.
    """
    try:
        x, u, p = random_point(system)
        nothing = {i.name: 0.0 for i in system.injections}

        def changed(*names: str) -> set[str]:
            rates = system.rate(moved(x, names), u, p, nothing)
            return {n for n, rate in rates.items() if not is_same(rate, here[n])} - {*names}

        here = system.rate(x, u, p, nothing)
        alone = {name: changed(name) for name in names}
        pairs = (
            (one, other, (alone[one] & alone[other]) - {one, other})
            for one, other in itertools.combinations(names, 2)
        )
        return frozenset(
            frozenset((one, other))
            for one, other, both in pairs
            if both and both - changed(one, other)
        )
    except Exception:
        return frozenset()


@kept(64)
def lines_of(system: ProbedSystem, coordinates: tuple[tuple[str, str], ...]) -> dict[str, int]:
    """The line that each coordinate is on; ``coordinates`` are their names with their rates' names.

    Those are on one line that a parameter joins (a spring, a damper), and so are those of a chain.
    """
    line = {name: k for k, (name, _) in enumerate(coordinates)}
    with suppress(Exception):
        for parameter in system.parameters:
            joined = {line[name] for name in _joined_by(system, parameter.name, coordinates)}
            line = {n: min(joined) if k in joined else k for n, k in line.items()}
    return line


def _joined_by(
    system: ProbedSystem, parameter: str, coordinates: tuple[tuple[str, str], ...]
) -> list[str]:
    """Coordinates on whose accelerations a parameter acts by their differences alone.

    Its part of them changes as one of them moves, and does not as all move together.
    """
    x, u, p = random_point(system)
    more, nothing = moved(p, (parameter,)), {i.name: 0.0 for i in system.injections}

    def part(at: SimpleNamespace) -> dict[str, float]:
        without, with_more = (system.rate(at, u, values, nothing) for values in (p, more))
        return {n: float(with_more[rate]) - float(without[rate]) for n, rate in coordinates}

    here, together = part(x), part(moved(x, itertools.chain(*coordinates)))
    least = LIKE * max(map(abs, (*here.values(), *together.values())), default=0.0)
    acted_on = [
        pair for pair in coordinates if max(abs(here[pair[0]]), abs(together[pair[0]])) > least
    ]
    changes = {n: abs(part(moved(x, (n, rate)))[n] - here[n]) for n, rate in acted_on}
    return [n for n, c in changes.items() if c > least and abs(together[n] - here[n]) <= LIKE * c]


def moved(at: SimpleNamespace, names: Iterable[str]) -> SimpleNamespace:
    """The same numbers, some of them larger by as much."""
    return SimpleNamespace(**{**vars(at), **{n: getattr(at, n) + _SHIFT for n in names}})


def random_point(system: ProbedSystem) -> tuple[SimpleNamespace, SimpleNamespace, SimpleNamespace]:
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


def is_same(one: Any, other: Any) -> bool:
    """Whether two numbers differ by no more than rounding."""
    a, b = float(one), float(other)
    return abs(a - b) <= _SAME * max(abs(a), abs(b))
