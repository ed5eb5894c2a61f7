"""Readings that are no state: y = h(x, x', u, p), an acceleration or a force in a mount.

What pushes a state moves such a reading at once, by

    dy = H dx',      H = dh/dx'

beside what the pushed state does to it later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp

from spiral.physics.plugin_calls import call_equation
from spiral.types.cache import kept
from spiral.types.errors import ConfigError, PluginError, did_you_mean
from spiral.types.placement import input_columns
from spiral.types.record import Array
from spiral.types.system import System


def own_readings(
    system: System, x: SimpleNamespace, rates: Mapping[str, Any], u: SimpleNamespace,
    p: SimpleNamespace,
) -> tuple[dict[str, Any], tuple[tuple[str, str, bool], ...]]:  # fmt: skip
    """What each channel reports without effects of sensors, and (channel, state, plain) of them.

    A reading tells of the states whose rates its formula takes, or else of those that it names;
    ``plain`` where it is the rate of this state and nothing else.

    Raises
    ------
    PluginError : a reading without its formula. ConfigError : one that tells of no state.
    """
    names = [s.name for s in system.states]
    shown = {name: getattr(x, name) for name in system.observed if name in names}
    if not system.readings:
        return shown, ()
    moving = {n: sp.Symbol(f"r{i}", real=True) for i, n in enumerate(names)}
    given = call_equation(system, "reading", system.reading, x, SimpleNamespace(**moving), u, p)
    told: list[tuple[str, str, bool]] = []
    for name in (r.name for r in system.readings):
        if name not in given:
            raise PluginError(
                f"reading() of system {system.plugin_name()!r} without {name!r}",
                "a value for each of its readings",
                did_you_mean(name, given),
            )
        value = sp.sympify(given[name])
        if name in system.observed:
            by_rate = [n for n in names if value.has(moving[n])]
            of = by_rate or [n for n in names if value.has(getattr(x, n))]
            if not of:
                raise ConfigError(
                    f"observed: {name}, a reading that tells of no state",
                    "a formula of one state or rate at least",
                    f"leave {name} out: what is driven or constant says nothing of the machine",
                )
            told += [(name, n, value == moving[n]) for n in of]
            shown[name] = value.subs({moving[n]: rates[n] for n in by_rate})
    return shown, tuple(told)


def reading_slopes(
    system: System, states: Array, rates: Array, inputs: Array, parameters: list[float]
) -> Array:
    """(samples, channels, n) H along states and rates (samples, n)."""
    slopes = np.zeros((len(states), len(system.observed), states.shape[1]))
    for channel, state, function in _reading_slope_functions(system):
        slopes[:, channel, state] = function(*states.T, *rates.T, *inputs.T, *parameters)
    return slopes


@kept(32)
def _reading_slope_functions(system: System) -> list[tuple[int, int, Callable[..., Any]]]:
    """(channel, state, dh/dx') wherever that is not zero."""
    x, r, u, p = (
        {name: sp.Symbol(f"{letter}{i}", real=True) for i, name in enumerate(names)}
        for letter, names in (
            ("x", [s.name for s in system.states]), ("r", [s.name for s in system.states]),
            ("u", input_columns(system)), ("p", [q.name for q in system.parameters]),
        )
    )  # fmt: skip
    given = call_equation(
        system, "reading", system.reading, *(SimpleNamespace(**s) for s in (x, r, u, p))
    )
    symbols = [*x.values(), *r.values(), *u.values(), *p.values()]
    functions = []
    for channel, name in enumerate(system.observed):
        for state, rate in enumerate(r.values()):
            slope = sp.sympify(given[name]).diff(rate) if name in given else sp.Integer(0)
            if slope != 0:
                functions.append((channel, state, sp.lambdify(symbols, slope, "numpy")))
    return functions
