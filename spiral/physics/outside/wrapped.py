"""A program as the equations of a system: each rate that is no state stands as an input.

x' = v, v' = rate_of_v, T' = rate_of_T
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spiral.physics.outside.program import Array, CalledProgram
from spiral.types.rates import per_second

RATE = "rate_of_"
_POINTS = 5


@dataclass(frozen=True, eq=False)
class WrappedProgram:
    """A program, and equations around it.

    Parameters
    ----------
    program : rates of the states by states, inputs, parameters and time.
    sizes : how many of its arguments are states, inputs, parameters.
    text : equations as ``definition`` reads them, with an input ``rate_of_STATE`` for each rate
        that only the program knows.
    recorded : inputs that a record has.
    pushed : coordinate -> the program's input that a force on it goes through, and its unit.
    """

    program: CalledProgram
    sizes: tuple[int, int, int]
    text: str
    recorded: tuple[str, ...]
    pushed: tuple[tuple[str, str, str], ...] = ()

    def rates(self, x: Any, u: Any, p: Any, injected: Mapping[str, Any]) -> dict[str, Any]:
        """``rate_of_STATE`` -> expression, at values by name and forces through inputs."""
        n, nu, _ = self.sizes
        names = self.program.arguments
        through: dict[str, Any] = dict.fromkeys(names[n : n + nu], 0)
        for coordinate, entry, _ in self.pushed:
            through[entry] = through[entry] + injected.get(coordinate, 0)
        given = [getattr(x, name) for name in names[:n]]
        given += [getattr(u, name, 0) + push for name, push in through.items()]
        given += [getattr(p, name) for name in names[n + nu : -1]]
        values = self.program.values([*given, u.time])
        return {RATE + s: v for s, v in zip(self.program.rows, values, strict=True)}


def kinematic_rates(program: CalledProgram, count: int, start: Sequence[float]) -> dict[str, str]:
    """States whose rate is another state, wherever the program is asked: name -> its rate.

    Parameters
    ----------
    count : how many arguments are states. start : arguments near which it is asked.
    """
    rng = np.random.default_rng(0)
    around = np.asarray(start, dtype=float) * (1 + 0.1 * rng.normal(size=(_POINTS, len(start))))
    around += 1e-2 * rng.normal(size=around.shape)
    rates, _ = program.values_and_slopes(around)
    kinematic = {}
    for i, name in enumerate(program.rows):
        same = [j for j in range(count) if _is_same(rates[:, i], around[:, j]) and j != i]
        if same:
            kinematic[name] = program.arguments[same[0]]
    return kinematic


def rate_equations(program: CalledProgram, rates: Mapping[str, str]) -> list[str]:
    """An equation for each state."""
    return [f"{name}' = {rates.get(name, RATE + name)}" for name in program.rows]


def rate_inputs(program: CalledProgram, rates: Mapping[str, str], units: Mapping[str, str]) -> Any:
    """Inputs ``rate_of_STATE`` for the rates that only the program knows: name -> unit."""
    left = (name for name in program.rows if name not in rates)
    return {RATE + name: per_second(units[name]) for name in left}


def _is_same(values: Array, others: Array) -> bool:
    return bool(np.allclose(values, others, rtol=1e-12, atol=0.0))
