"""What a system's equations depend on, from their values at a few numbers.

The equations are functions of a plugin, with expressions or numbers for arguments. What cannot be
evaluated with numbers (a program that is not running) counts as depending on everything.
"""

from __future__ import annotations

import random
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any, Protocol

from spiral.types.cache import kept
from spiral.types.parameter import Input, Parameter, State

_SAME = 1e-9  # of a value, by which it may differ for rounding
_SHIFT = 0.37  # of a state and an input together


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
